"""The configuration file: what may stand in it, and how it becomes one record for the gateway.

Whatever is wrong with a file is found in one go and reported in one `ConfigError`.
"""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from gateway.config.keys import TOP_KEYS, Server
from gateway.config.problems import Problems, fault_of, hint, quoted, read_fields, read_toml
from gateway.config.robots import Robots
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
        vendor_dirs: Folders of further plugins, absolute.
        robots: In the order of the file.
        registry: Where the plugins came from.
        warnings: What the operator should know, one line each.
    """

    file: str
    server: Server
    vendor_dirs: tuple[Path, ...]
    robots: tuple[RobotSettings | BrokenRobot, ...]
    registry: Registry
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
            raise ConfigError(f"{named}: does not exist; ${VARIABLE} names it: correct or unset that")
        return Path(named)
    places = (cwd / "gateway.toml", system)
    for place in places:
        if _is_there(place):
            return place
    looked = ", ".join(map(str, places))
    raise ConfigError(
        f"no configuration found: looked for ${VARIABLE} (not set), {looked}; name one with --config FILE"
    )


def load(path: Path, registry: Registry | None = None) -> Config:
    """Read a configuration file.

    Args:
        path: The file; relative `vendor_dirs` start from its folder.
        registry: Used instead of one for the file's `vendor_dirs`.

    Raises:
        ConfigError: It cannot be read, or with everything that is wrong with it.
    """
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST + 1)
    except FileNotFoundError:
        raise ConfigError(f"{path}: does not exist; name another file, or start from config/gateway.toml") from None
    except IsADirectoryError:
        raise ConfigError(f"{path}: is a folder; name the file in it") from None
    except PermissionError:
        raise ConfigError(f"{path}: may not be read by this user; look at: ls -l {path}") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    if len(data) > LARGEST:
        raise ConfigError(f"{path}: is larger than {LARGEST} bytes; that is no configuration")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ConfigError(f"{path}:{line}: is not UTF-8 (byte 0x{data[error.start]:02x}); save it as UTF-8") from None
    return parse(text, str(path), registry, path.absolute().parent)


def parse(text: str, file: str, registry: Registry | None = None, folder: Path = Path()) -> Config:
    """Read the text of a configuration.

    Args:
        text: TOML.
        file: Its name, for the messages.
        registry: Used instead of one for the text's `vendor_dirs`.
        folder: Where relative `vendor_dirs` start.

    Raises:
        ConfigError: With everything that is wrong.
    """
    raw, problems = read_toml(text, file)
    for name in raw:
        if name not in TOP_KEYS:
            problems.add((name,), f"unknown key; {hint(name, TOP_KEYS, 'the keys here are')}")
    server = _server(problems, raw.get("server", {}))
    dirs = _vendor_dirs(problems, raw.get("vendor_dirs", []), folder)
    found = registry or _registry(problems, dirs)
    robots = Robots(problems, found, _listening(server)).read(raw.get("robots", []))
    problems.check()
    return Config(
        file=file,
        server=server,
        vendor_dirs=tuple(dirs),
        robots=tuple(robots),
        registry=found or Registry(),
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
    values = read_fields(problems, ("server",), raw, Server, elsewhere=top)
    server = msgspec.convert(values, Server)
    try:
        host, _ = server.address
    except ValueError as error:
        problems.add(("server", "listen"), str(error))
        return server
    if host != "localhost" and not _is_loopback(host):
        problems.add(
            ("server", "listen"),
            f"{quoted(server.listen)} would be open to other machines, and access control is not there yet: "
            "only 127.0.0.1, [::1] and localhost may be used",
        )
    return server


def _listening(server: Server) -> tuple[str, int]:
    try:
        return server.address
    except ValueError:  # which is told already
        return "", 0


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


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
