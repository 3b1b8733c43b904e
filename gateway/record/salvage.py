"""Reads an MCAP file that was cut off or damaged, record by record: each chunk has a checksum of its own."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from io import BytesIO
from typing import IO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Message, Metadata
from mcap.stream_reader import breakup_chunk
from zstandard import ZstdError

MAGIC = b"\x89MCAP0\r\n"
LARGEST_RECORD = 256 * 1024 * 1024
# What damaged bytes make the library raise.
DAMAGE = (
    McapError,
    ZstdError,
    ValueError,
    KeyError,
    IndexError,
    EOFError,
    OverflowError,
    MemoryError,
    StopIteration,
    struct.error,
)
_HEAD = struct.Struct("<BQ")  # of every record: what it is, and how many bytes follow


@dataclass(slots=True)
class Salvaged:
    """What was found.

    Attributes:
        messages: Time in µs UTC, topic, number and bytes of each, in the order of the file.
        metadata: What the file says of itself.
        attachments: What is attached to it.
        problem: What is wrong with the file; "": nothing but its index.
    """

    messages: list[tuple[int, str, int, bytes]] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    attachments: list[Attachment] = field(default_factory=list)
    problem: str = ""


class _Salvage:
    """Collects what is good."""

    def __init__(self) -> None:
        self.found = Salvaged()
        self.channels: dict[int, Channel] = {}
        self.messages: list[Message] = []
        self.damaged: list[int] = []  # where records begin that cannot be read

    def take(self, opcode: int, content: bytes) -> None:
        """Take one record of the file."""
        read = _READ.get(opcode)
        if read is not None:
            read(self, content)

    def chunk(self, content: bytes) -> None:
        for record in breakup_chunk(Chunk.read(_stream(content)), validate_crc=True):
            if isinstance(record, Channel):
                self.channels.setdefault(record.id, record)
            elif isinstance(record, Message):
                self.messages.append(record)

    def channel(self, content: bytes) -> None:
        channel = Channel.read(_stream(content))
        self.channels.setdefault(channel.id, channel)

    def metadata(self, content: bytes) -> None:
        self.found.metadata.append(Metadata.read(_stream(content)))

    def attachment(self, content: bytes) -> None:
        self.found.attachments.append(Attachment.read(_stream(content)))

    def message(self, content: bytes) -> None:
        self.messages.append(Message.read(_stream(content), len(content)))

    def finish(self) -> Salvaged:
        """Name the channels of the messages."""
        for message in self.messages:
            channel = self.channels.get(message.channel_id)
            if channel is not None:
                self.found.messages.append((message.log_time // 1000, channel.topic, message.sequence, message.data))
        self.messages.clear()
        return self.found


_READ: dict[int, Callable[[_Salvage, bytes], None]] = {
    Opcode.CHUNK: _Salvage.chunk,
    Opcode.CHANNEL: _Salvage.channel,
    Opcode.METADATA: _Salvage.metadata,
    Opcode.ATTACHMENT: _Salvage.attachment,
    Opcode.MESSAGE: _Salvage.message,
}


def salvage(file: IO[bytes]) -> Salvaged:
    """Read whatever is good in an MCAP file."""
    size = file.seek(0, 2)
    at = file.seek(len(MAGIC))
    work = _Salvage()
    ended = ""
    while True:
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            ended = f"it ends after {size} bytes, before its index"
            break
        opcode, length = _HEAD.unpack(head)
        if length > min(size - at - _HEAD.size, LARGEST_RECORD):
            ended = f"it is cut off or damaged after {at} of {size} bytes"
            break
        try:
            work.take(opcode, file.read(length))
        except DAMAGE:
            work.damaged.append(at)
        at += _HEAD.size + length
        if opcode == Opcode.FOOTER:
            break
    found = work.finish()
    problems = [ended] if ended else []
    if work.damaged:
        problems.append(
            f"{len(work.damaged)} of its parts are damaged and left out, the first at byte {work.damaged[0]}"
        )
    found.problem = "; ".join(problems) or "bytes of it are damaged; every part that can be read is"
    return found


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))
