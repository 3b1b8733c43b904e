"""The tables `[export.…]`: where a gateway sends what it reads, and the secret files that they name."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import re
import ssl
import stat
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import urlsplit

import msgspec
from msgspec import Meta

from gateway.config.problems import Problems, hint, quoted, read_fields
from gateway.config.tokens import secret_file

EXPORTS = ("nats",)
LARGEST = 64 * 1024  # bytes of a secret file
STATE = "STATE_DIRECTORY"
_INSTALL = "needs nats-py, which is not installed: pip install 'robot-gateway[nats]'"
_SCHEMES = ("nats", "tls", "ws", "wss")
_PLAIN = re.compile(r"[A-Za-z0-9_-]{1,64}")

_WORD = r"^[A-Za-z0-9_-]{1,32}(?!\n)$"
_SAYS = "a name of 1 to 32 characters a-z, A-Z, 0-9, _ and -, in quotes: it is one word of every subject"
GroupName = Literal[
    "joints", "tcp", "wrench", "io", "analog", "status", "safety", "controller", "link", "link_stats", "events",
    "commands", "vendor",
]  # fmt: skip


class NatsTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The table `[export.nats]`: what is sent to a NATS server, and where it waits while there is none."""

    servers: Annotated[
        list[str],
        Meta(
            min_length=1,
            max_length=16,
            description="Addresses, tried in turn; tls:// speaks TLS only. No user and no password stands in them.",
            extra={"says": 'a list of addresses such as ["nats://127.0.0.1:4222"]'},
        ),
    ]
    plant: Annotated[str, Meta(pattern=_WORD, description="First word of every subject.", extra={"says": _SAYS})]
    cell: Annotated[
        str,
        Meta(pattern=_WORD, description="Second word of every subject: one gateway's alone.", extra={"says": _SAYS}),
    ]
    samples_hz: Annotated[
        float, Meta(ge=0, le=100, description="How often the samples of each topic are sent; 0: never.")
    ] = 1.0
    groups: Annotated[
        tuple[GroupName, ...], Meta(min_length=1, description="Which groups of every robot are sent.")
    ] = ("joints", "tcp", "io", "status", "safety", "link", "link_stats", "events", "commands")
    format: Annotated[Literal["json", "msgpack"], Meta(description="How a sample or event is written.")] = "json"
    credentials: Annotated[
        str | None,
        Meta(
            description="File with what the server asks for: a .creds file, an nkey seed, user:password, or a token.",
            extra={"says": "a file, in quotes"},
        ),
    ] = None
    tls_ca: Annotated[
        str | None,
        Meta(description="PEM file of whom to trust instead of whom this machine trusts.", extra={"says": "a file"}),
    ] = None
    tls_certificate: Annotated[
        str | None, Meta(description="PEM file of the gateway's own certificate.", extra={"says": "a file, in quotes"})
    ] = None
    tls_key: Annotated[
        str | None, Meta(description="PEM file of its key, without a password.", extra={"says": "a file, in quotes"})
    ] = None
    outbox: Annotated[
        str, Meta(description="Folder where events wait. Empty: outbox in the folder that systemd or the user has.")
    ] = ""
    outbox_mb: Annotated[float, Meta(ge=0.01, le=1_000_000, description="Events may take so many MB there.")] = 256.0
    outbox_days: Annotated[float, Meta(ge=0.0001, le=3650, description="And wait for so many days.")] = 14.0
    stream: Annotated[str, Meta(description="JetStream stream of the events. Empty: PLANT-events.")] = ""
    stream_days: Annotated[
        float, Meta(ge=0, le=3650, description="How long a stream that is made here keeps them; 0: for ever.")
    ] = 30.0
    stream_mb: Annotated[
        float, Meta(ge=0, le=10_000_000, description="How many MB it keeps, the newest ones; 0: without a limit.")
    ] = 1024.0
    bucket: Annotated[str, Meta(description="Key-value bucket of the states. Empty: the plant's name.")] = ""
    ttl_s: Annotated[
        float,
        Meta(
            ge=0, le=315_360_000, description="A bucket that is made here forgets a silent cell after this; 0: never."
        ),
    ] = 604_800.0
    heartbeat_s: Annotated[float, Meta(ge=0.1, le=60, description="How often the gateway says that it lives.")] = 2.0

    @property
    def stream_name(self) -> str:
        """The stream of the events."""
        return self.stream or f"{self.plant}-events"

    @property
    def bucket_name(self) -> str:
        """The bucket of the states."""
        return self.bucket or self.plant


EXPORT_TABLES: dict[str, type[msgspec.Struct]] = {"nats": NatsTable}


@dataclass(frozen=True, slots=True, kw_only=True)
class NatsAccess:
    """How a server is reached.

    Attributes:
        servers: Addresses, tried in turn.
        secret: What the server asks for; None: nothing. Never printed.
        ca: Whom to trust; None: whom this machine trusts.
        certificate: The client's own.
        key: Its key.
        digest: Changes with the content of the files.
    """

    servers: tuple[str, ...]
    secret: str | None = field(default=None, repr=False)
    ca: Path | None = None
    certificate: Path | None = None
    key: Path | None = None
    digest: str = field(default="", repr=False)

    @property
    def secured(self) -> bool:
        """Whether TLS is spoken in any case."""
        return self.ca is not None or self.certificate is not None

    def tls(self) -> ssl.SSLContext | None:
        """For TLS; None: nothing of it is configured.

        Raises:
            OSError: A file cannot be read, or used (`ssl.SSLError`).
        """
        if not self.secured and not any(server.startswith(("tls:", "wss:")) for server in self.servers):
            return None
        context = ssl.create_default_context(cafile=None if self.ca is None else str(self.ca))
        if self.certificate is not None:
            context.load_cert_chain(self.certificate, self.key, password=_no_password)
        return context


@dataclass(frozen=True, slots=True, kw_only=True)
class NatsSettings:
    """`[export.nats]`, ready to use.

    Attributes:
        table: As configured.
        access: How the server is reached.
        outbox: Folder where events wait.
    """

    table: NatsTable
    access: NatsAccess
    outbox: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportSettings:
    """The tables below `[export]`; None: there is no such table."""

    nats: NatsSettings | None = None


class AccessError(ValueError):
    """A secret file cannot be used; the text says which key it is of, and why.

    Attributes:
        key: Names the file.
    """

    def __init__(self, key: str, text: str) -> None:
        super().__init__(text)
        self.key = key


def read_exports(problems: Problems, raw: object, folder: Path, env: Mapping[str, str]) -> ExportSettings:
    """Read the tables below `[export]`, and note everything that is wrong with them."""
    if not isinstance(raw, dict):
        problems.add(("export",), "must be a table: write [export.nats]")
        return ExportSettings()
    for name in raw:
        if name not in EXPORTS:
            problems.add(("export", name), f"unknown table; {hint(name, EXPORTS, 'there is only')}")
    nats = _nats(problems, raw["nats"], folder, env) if "nats" in raw else None
    return ExportSettings(nats=nats)


def _nats(problems: Problems, table: object, folder: Path, env: Mapping[str, str]) -> NatsSettings | None:
    """`[export.nats]`; None: something is wrong with it."""
    path = ("export", "nats")
    if not isinstance(table, dict):
        problems.add(path, "must be a table: write [export.nats], with one pair of brackets")
        return None
    n_before = len(problems)
    values = read_fields(problems, path, table, NatsTable)
    if not has_nats():
        problems.add(path, _INSTALL)
    if len(problems) > n_before:
        return None
    nats = msgspec.convert(values, NatsTable)
    for key, name in (("stream", nats.stream_name), ("bucket", nats.bucket_name)):
        if _PLAIN.fullmatch(name) is None:
            problems.add((*path, key), f"{quoted(name)} is no name: 1 to 64 characters a-z, A-Z, 0-9, _ and -")
    for fault in filter(None, map(server_fault, nats.servers)):
        problems.add((*path, "servers"), fault)
    access = None
    try:
        access = _access(nats, folder, env)
    except AccessError as error:
        problems.add((*path, error.key), str(error))
    if access is None or len(problems) > n_before:
        return None
    _warn(problems, nats, access)
    return NatsSettings(table=nats, access=access, outbox=_outbox(nats.outbox, folder, env))


def has_nats() -> bool:
    """Whether nats-py is installed."""
    return importlib.util.find_spec("nats") is not None


def server_fault(server: str) -> str | None:
    """Say what is wrong with the address of a server, without repeating a password; None: nothing."""
    address = server if "://" in server else f"nats://{server}"
    try:
        parts = urlsplit(address)
        port, host = parts.port, parts.hostname
    except ValueError:
        return "is no address like nats://127.0.0.1:4222"
    if "@" in parts.netloc:
        return "no user and no password stands in an address: put them into a file and name it with credentials"
    if parts.scheme not in _SCHEMES:
        return f"{quoted(server)} begins with none of {', '.join(f'{one}://' for one in _SCHEMES)}"
    if not host or (port is not None and not port) or parts.path not in {"", "/"} or " " in server:
        return f"{quoted(server)} is no address like nats://127.0.0.1:4222"
    return None


def nats_access(
    servers: tuple[str, ...],
    *,
    credentials: Path | None = None,
    ca: Path | None = None,
    certificate: Path | None = None,
    key: Path | None = None,
) -> NatsAccess:
    """How a server is reached, with the files read and tried.

    Raises:
        AccessError: One of them cannot be used.
    """
    if (certificate is None) != (key is None):
        raise AccessError("tls_key", "tls_certificate and tls_key stand together or not at all")
    secret = None if credentials is None else _secret(credentials)
    digest = hashlib.sha256()
    for name, path in (("tls_ca", ca), ("tls_certificate", certificate), ("tls_key", key)):
        digest.update(b"\0" if path is None else _read(name, path))
    access = NatsAccess(
        servers=servers, secret=secret, ca=ca, certificate=certificate, key=key, digest=digest.hexdigest()
    )
    try:
        access.tls()
    except (OSError, ValueError) as error:
        reason = getattr(error, "reason", None) or getattr(error, "strerror", None) or "it is no PEM"
        raise AccessError("tls_ca" if certificate is None else "tls_certificate", f"cannot be used: {reason}") from None
    return access


def state_folder(env: Mapping[str, str]) -> Path:
    """The folder that the service manager or the user has for what must outlive the process."""
    if handed := env.get(STATE, "").split(":")[0]:
        return Path(handed)
    home = Path(env.get("HOME") or "/var/lib")
    return Path(env.get("XDG_STATE_HOME") or home / ".local" / "state") / "robot-gateway"


def _outbox(text: str, folder: Path, env: Mapping[str, str]) -> Path:
    return folder / Path(text).expanduser() if text else state_folder(env) / "outbox"


def _access(nats: NatsTable, folder: Path, env: Mapping[str, str]) -> NatsAccess:
    def place(text: str | None) -> Path | None:
        return None if text is None else secret_file(folder / Path(text).expanduser(), env)

    return nats_access(
        tuple(nats.servers),
        credentials=place(nats.credentials),
        ca=place(nats.tls_ca),
        certificate=place(nats.tls_certificate),
        key=place(nats.tls_key),
    )


def _warn(problems: Problems, nats: NatsTable, access: NatsAccess) -> None:
    path = ("export", "nats")
    if access.secret is not None and access.tls() is None and not all(map(_is_here, nats.servers)):
        what = "the credentials go over the network in the clear: write tls:// in servers, or set tls_ca"
        problems.warn((*path, "servers"), what)
    if nats.credentials is not None and Path(nats.credentials).is_absolute():
        file = Path(nats.credentials)
        if os.access(file, os.R_OK) and file.stat().st_mode & stat.S_IROTH:
            what = f"everybody on this machine can read {file}; run: chmod o-r {file}"
            problems.warn((*path, "credentials"), what)


def _is_here(server: str) -> bool:
    host = urlsplit(server if "://" in server else f"nats://{server}").hostname or ""
    return host in {"localhost", "::1"} or host.startswith("127.")


def _secret(path: Path) -> str:
    text = _read("credentials", path).decode("utf-8", "replace").strip()
    if not text:
        raise AccessError("credentials", f"{path}: is empty; it holds a .creds file, an nkey seed, or user:password")
    return text


def _read(key: str, path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(LARGEST)
    except FileNotFoundError:
        raise AccessError(key, f"{path}: does not exist") from None
    except IsADirectoryError:
        raise AccessError(key, f"{path}: is a folder; name the file in it") from None
    except PermissionError:
        raise AccessError(key, f"{path}: may not be read by this user; look at: ls -l {path}") from None
    except OSError as error:
        raise AccessError(key, f"{path}: cannot be read: {error.strerror}") from None


def _no_password() -> str:
    raise ValueError("the key has a password; the gateway takes one without")
