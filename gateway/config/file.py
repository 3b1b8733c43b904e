"""The configuration file: what may stand in it, and how it becomes one record for the gateway.

Whatever is wrong with a file is found in one go and reported in one `ConfigError`.
"""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from gateway.api.model import EventKind
from gateway.config.certificates import CertificateError, TlsFiles, load_certificate
from gateway.config.exports import ExportSettings, read_exports
from gateway.config.keys import SERVER_TABLES, TOP_KEYS, Recorder, Server, is_loopback
from gateway.config.problems import Problems, fault_of, hint, quoted, read_fields, read_toml
from gateway.config.reading import read_file
from gateway.config.robots import Robots
from gateway.config.tokens import Token, read_tokens, secret_file
from gateway.core.registry import Registry
from gateway.core.settings import BrokenRobot, RobotSettings
from gateway.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Mapping

VARIABLE = "ROBOT_GATEWAY_CONFIG"
SYSTEM_FILE = Path("/etc/robot-gateway/gateway.toml")
LARGEST = 4 * 1024 * 1024  # bytes; a thousand robots take a tenth of it


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """A valid configuration.

    Args:
        file: The name it was read from.
        server: The listener.
        recorder: What is kept of the last seconds; its folder absolute, or "".
        vendor_dirs: Folders of further plugins, absolute.
        robots: In the order of the file.
        registry: Where the plugins came from.
        tokens: Who may read what; None: nobody needs a token.
        tls: Where certificate and key are read; None: the doors speak in the clear.
        export: Where it is sent besides.
        warnings: What the operator should know, one line each.
    """

    file: str
    server: Server
    vendor_dirs: tuple[Path, ...]
    robots: tuple[RobotSettings | BrokenRobot, ...]
    registry: Registry
    tokens: tuple[Token, ...] | None = None
    tls: TlsFiles | None = None
    export: ExportSettings = field(default_factory=ExportSettings)
    recorder: Recorder = field(default_factory=Recorder)
    warnings: tuple[str, ...] = ()


def find_config(explicit: Path | None, env: Mapping[str, str], cwd: Path, system: Path = SYSTEM_FILE) -> Path:
    """Find the configuration: the named file, `$ROBOT_GATEWAY_CONFIG`, `gateway.toml` here, or the system's.

    Raises:
        ConfigError: There is none; it names every place.
    """
    if explicit is not None:
        return explicit
    if named := env.get(VARIABLE):
        if not _is_there(Path(named)):
            raise ConfigError(
                f"{named}: does not exist; ${VARIABLE} names it: put the file there (in a container: mount it), "
                "or correct or unset the variable"
            )
        return Path(named)
    places = (cwd / "gateway.toml", system)
    for place in places:
        if _is_there(place):
            return place
    looked = ", ".join(map(str, places))
    raise ConfigError(
        f"no configuration found: looked for ${VARIABLE} (not set), {looked}; name one with --config FILE"
    )


def load(path: Path, registry: Registry | None = None, env: Mapping[str, str] = os.environ) -> Config:
    """Read a configuration file.

    Args:
        path: The file; relative paths in it start from its folder.
        registry: Used instead of one for the file's `vendor_dirs`.
        env: Where secrets may be found that cannot be read at their path.

    Raises:
        ConfigError: It cannot be read, or with everything that is wrong with it.
    """
    absent = "name another file, or start from config/gateway.toml"
    data, _ = read_file(path, LARGEST, absent=absent, kind="configuration")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ConfigError(f"{path}:{line}: is not UTF-8 (byte 0x{data[error.start]:02x}); save it as UTF-8") from None
    return parse(text, str(path), registry, path.absolute().parent, env)


def parse(
    text: str,
    file: str,
    registry: Registry | None = None,
    folder: Path = Path(),
    env: Mapping[str, str] = os.environ,
) -> Config:
    """Read the text of a configuration.

    Args:
        text: TOML.
        file: Its name, for the messages.
        registry: Used instead of one for the text's `vendor_dirs`.
        folder: Where relative paths start.
        env: Where secrets may be found that cannot be read at their path.

    Raises:
        ConfigError: With everything that is wrong.
    """
    raw, problems = read_toml(text, file)
    for name in raw:
        if name not in TOP_KEYS:
            problems.add((name,), f"unknown key; {hint(name, TOP_KEYS, 'the keys here are')}")
    server = _server(problems, raw.get("server", {}))
    doors = Secrets(problems, server, folder, env)
    recorder = _recorder(problems, raw.get("recorder", {}), folder)
    dirs = _vendor_dirs(problems, raw.get("vendor_dirs", []), folder)
    found = registry or _registry(problems, dirs)
    robots = Robots(problems, found, _listening(server)).read(raw.get("robots", []))
    export = read_exports(problems, raw.get("export", {}), folder, env)
    problems.check()
    return Config(
        file=file,
        server=server,
        recorder=recorder,
        vendor_dirs=tuple(dirs),
        robots=tuple(robots),
        registry=found or Registry(),
        tokens=doors.tokens,
        tls=doors.tls,
        export=export,
        warnings=problems.warnings,
    )


def _is_there(path: Path) -> bool:
    """A file that may not even be looked at is there: reading it says what is wrong."""
    try:
        return path.is_file()
    except PermissionError:
        return True


def _server(problems: Problems, raw: object) -> Server:
    if not isinstance(raw, dict):
        problems.add(("server",), "must be a table: write [server], with one pair of brackets")
        return Server()
    top = dict.fromkeys(TOP_KEYS, "belongs at the top of the file, above the first [table]")
    plain = {name: value for name, value in raw.items() if name not in SERVER_TABLES}
    values = read_fields(problems, ("server",), plain, Server, also=SERVER_TABLES, elsewhere=top)
    for name, struct in SERVER_TABLES.items():
        if name in raw and (table := _table(problems, ("server", name), raw[name], struct)) is not None:
            values[name] = table
    server = msgspec.convert(values, Server)
    try:
        host, _ = server.address
    except ValueError as error:
        problems.add(("server", "listen"), str(error))
        return server
    if not is_loopback(host):
        _check_open(problems, server, raw)
    if "*" in server.allowed_origins and "tokens" not in raw:
        what = '"*" lets any page read the cell in the browser of its visitor: set server.tokens, or name the pages'
        problems.add(("server", "allowed_origins"), what)
    return server


def _recorder(problems: Problems, raw: object, folder: Path) -> Recorder:
    if not isinstance(raw, dict):
        problems.add(("recorder",), "must be a table: write [recorder], with one pair of brackets")
        return Recorder()
    top = dict.fromkeys(TOP_KEYS, "belongs at the top of the file, above the first [table]")
    recorder = msgspec.convert(read_fields(problems, ("recorder",), raw, Recorder, elsewhere=top), Recorder)
    kinds = [kind.value for kind in EventKind]
    for kind in recorder.on:
        if kind not in kinds:
            what = f"there is no event {quoted(kind)}; {hint(kind, kinds, 'there are')}"
            problems.add(("recorder", "on"), what)
    if recorder.before_s > recorder.ring_s:
        what = f"{recorder.before_s:g} s before a trigger are more than the {recorder.ring_s:g} s that ring_s keeps"
        problems.add(("recorder", "before_s" if "before_s" in raw else "ring_s"), what)
    if recorder.directory:
        recorder = msgspec.structs.replace(recorder, directory=str(folder / Path(recorder.directory).expanduser()))
    return recorder


def _check_open(problems: Problems, server: Server, raw: Mapping[str, object]) -> None:
    """Hold a listener that other machines can reach to its conditions."""
    if "tokens" in raw:
        if "tls" not in raw:
            what = "tokens and data go over the network in the clear: set [server.tls], or put a TLS proxy in front"
            problems.warn(("server", "listen"), what)
    elif server.insecure:
        what = f"everybody who reaches {quoted(server.listen)} can read everything, without a token"
        problems.warn(("server", "insecure"), what)
    elif "insecure" not in raw or raw["insecure"] is False:
        what = (
            f"{quoted(server.listen)} would be open to other machines: set server.tokens to a file of tokens "
            "(robot-gateway token makes one), or insecure = true to let everybody read everything"
        )
        problems.add(("server", "listen"), what)


def _table(problems: Problems, path: tuple[str, ...], raw: object, struct: type[msgspec.Struct]) -> object:
    """A table below `[server]`; None: something is wrong with it."""
    if not isinstance(raw, dict):
        problems.add(path, f"must be a table: write [{'.'.join(path)}], with one pair of brackets")
        return None
    n_before = len(problems)
    values = read_fields(problems, path, raw, struct)
    return values if len(problems) == n_before else None


class Secrets:
    """The files that `[server]` names: tokens, certificate and key.

    Args:
        problems: Where it is noted what is wrong with them.
        server: Names them.
        folder: Where relative paths start.
        env: Where they may be found that cannot be read at their path.

    Attributes:
        tokens: Who may read what; None: nobody needs a token.
        tls: Where certificate and key are read; None: the doors speak in the clear.
    """

    def __init__(self, problems: Problems, server: Server, folder: Path, env: Mapping[str, str]) -> None:
        self.tokens: tuple[Token, ...] | None = None
        self.tls: TlsFiles | None = None
        self._problems = problems
        self._folder = folder
        self._env = env
        if server.tokens is not None:
            self._read_tokens(self._place(server.tokens))
        if server.tls is not None:
            self.tls = TlsFiles(self._place(server.tls.certificate), self._place(server.tls.key))
            self._look_at(self.tls)

    def _place(self, text: str) -> Path:
        return secret_file(self._folder / Path(text).expanduser(), self._env)

    def _read_tokens(self, path: Path) -> None:
        where = ("server", "tokens")
        try:
            self.tokens = read_tokens(path)
        except ConfigError as error:
            for problem in error.problems:
                self._problems.add(where, problem)
            return
        if not self.tokens:
            self._problems.warn(where, f"{path} has no [[tokens]]: nobody can read anything")

    def _look_at(self, files: TlsFiles) -> None:
        where = ("server", "tls")
        try:
            expires = load_certificate(files).expires
        except CertificateError as error:
            self._problems.add(where, str(error))
            return
        if expires <= datetime.now(UTC):
            self._problems.warn(where, f"{files.certificate} has expired on {expires:%Y-%m-%d}: clients refuse it")
        if files.key.stat().st_mode & stat.S_IROTH:
            self._problems.warn(where, f"everybody on this machine can read {files.key}; run: chmod o-r {files.key}")


def _listening(server: Server) -> tuple[str, int]:
    try:
        return server.address
    except ValueError:  # which is told already
        return "", 0


def _vendor_dirs(problems: Problems, raw: object, folder: Path) -> list[Path]:
    if fault_of(raw, list[str]):
        problems.add(("vendor_dirs",), f'{quoted(raw)} is not a list of folders like ["/opt/robots/vendors"]')
        return []
    return [folder / Path(text).expanduser() for text in msgspec.convert(raw, list[str])]


def _registry(problems: Problems, dirs: list[Path]) -> Registry | None:
    try:
        return Registry(dirs)
    except ConfigError as error:
        for problem in error.problems:
            problems.add(("vendor_dirs",), problem)
        return None
