"""Conversations to decode: what one side of each has received and sent, piece by piece, from files of several kinds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from gateway.errors import GatewayError

PieceKind = Literal["begin", "received", "sent", "missing", "end"]
FileKind = Literal["mcap", "capture", "raw"]
_MCAP = b"\x89MCAP0\r\n"
_PCAPNG = b"\x0a\x0d\x0d\x0a"
_PCAP = {magic.to_bytes(4, order) for magic in (0xA1B2C3D4, 0xA1B23C4D) for order in ("big", "little")}
_READ = 1 << 16


class FileError(GatewayError):
    """A file cannot be read as what it seems to be.

    Attributes:
        path: The file.
        reason: What is wrong, and what to do.
    """

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}")
        self.path = path
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Piece:
    """One read or one write of a session, or that one begins or ends.

    Attributes:
        kind: What it is; `missing`: bytes that were received and not captured.
        data: The bytes.
        t: When, µs UTC; None: the file does not say.
    """

    kind: PieceKind
    data: bytes = b""
    t: int | None = None


@dataclass(slots=True)
class Conversation:
    """What was said with one controller.

    Attributes:
        name: A robot's, or both ends of a connection; "" where there is but one.
        pieces: In their order.
        datagrams: Whether each piece is a datagram.
        notes: What should be known of it, one sentence each.
    """

    name: str
    pieces: Iterable[Piece]
    datagrams: bool = False
    notes: list[str] = field(default_factory=list)


def kind_of(path: Path) -> FileKind:
    """What kind of file it is, by its first bytes; one that is called .mcap or .pcap is no raw stream.

    Raises:
        FileError: It cannot be read, or is empty.
    """
    try:
        with path.open("rb") as file:
            head = file.read(len(_MCAP))
    except FileNotFoundError:
        raise FileError(path, "does not exist") from None
    except IsADirectoryError:
        raise FileError(path, "is a folder; name the file in it") from None
    except PermissionError:
        raise FileError(path, f"may not be read by this user; look at: ls -l {path}") from None
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror}") from None
    if not head:
        raise FileError(path, "is empty, it has 0 bytes")
    if head == _MCAP or ".mcap" in path.suffixes:
        return "mcap"
    if head[:4] == _PCAPNG or head[:4] in _PCAP or path.suffix in {".pcap", ".pcapng", ".cap"}:
        return "capture"
    return "raw"


def raw_pieces(path: Path, datagram: int | None = None) -> Iterator[Piece]:
    """A file of what was received and nothing else.

    Args:
        path: The file.
        datagram: So many bytes are a datagram; None: it is a stream.
    """
    yield Piece("begin")
    with path.open("rb") as file:
        while data := file.read(datagram or _READ):
            yield Piece("received", data)
    yield Piece("end")
