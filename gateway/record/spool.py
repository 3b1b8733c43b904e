"""What goes to a writer of recordings: messages over a pipe or a socket, each with its length before it.

A stream that ends without `End` was cut off: whoever writes a file of it gives it up.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import msgspec

from gateway.errors import GatewayError
from gateway.record.chunks import Block

# A block holds at most 256 KiB of bytes; the rest are smaller. More is no message of ours.
LARGEST = 16 * 1024 * 1024
_LENGTH = struct.Struct(">I")


class SpoolError(GatewayError):
    """The stream is not what a gateway sends.

    Attributes:
        reason: What is wrong.
    """

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class Begin(msgspec.Struct, frozen=True, kw_only=True, tag="begin"):
    """The first message.

    Attributes:
        robots: The robots as understood, TOML as in a configuration file.
        vendor_dirs: Folders of further plugins.
        from_t: The recording holds what was received from then on, µs UTC.
        reason: Why it was made, in words for people, by name.
        gateway: The version that recorded.
    """

    robots: str
    vendor_dirs: list[str]
    from_t: int
    reason: dict[str, str]
    gateway: str


class Raw(msgspec.Struct, frozen=True, kw_only=True, tag="raw"):
    """What a robot's sessions received and sent.

    Attributes:
        robot: Its name.
        block: The next block of its ring.
    """

    robot: str
    block: Block


class Said(msgspec.Struct, frozen=True, kw_only=True, tag="said"):
    """What was published and does not follow from bytes.

    Attributes:
        topic: Its topic.
        t: When, µs UTC.
        seq: Its number in the topic or ring.
        data: JSON of the sample or event.
    """

    topic: str
    t: int
    seq: int
    data: bytes


class Lost(msgspec.Struct, frozen=True, kw_only=True, tag="lost"):
    """Something was left out here: the reader was too slow.

    Attributes:
        n_messages: How many messages.
        n_bytes: How large they were.
    """

    n_messages: int
    n_bytes: int


class End(msgspec.Struct, frozen=True, kw_only=True, tag="end"):
    """The last message: the recording is whole.

    Attributes:
        to_t: The recording holds what was received until then, µs UTC.
        more: What else it says of itself: what triggered it again.
    """

    to_t: int
    more: dict[str, str] = {}


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """What has become of a recording.

    Attributes:
        error: Why there is no file; "": there is.
        n_bytes: Its size.
        n_messages: How many messages it holds.
        notes: What could not be recorded, one sentence each.
    """

    error: str = ""
    n_bytes: int = 0
    n_messages: int = 0
    notes: list[str] = []


Message = Begin | Raw | Said | Lost | End
_ENCODER = msgspec.msgpack.Encoder()
_DECODER: msgspec.msgpack.Decoder[Message] = msgspec.msgpack.Decoder(Message)


def encode(message: Message) -> bytes:
    """A message with its length before it."""
    data = _ENCODER.encode(message)
    return _LENGTH.pack(len(data)) + data


class SpoolReader:
    """Finds the messages of a stream that may be cut anywhere."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[Message]:
        """Take some bytes; the messages that they complete.

        Raises:
            SpoolError: They are none of ours.
        """
        self._buffer += data
        at = 0
        while len(self._buffer) - at >= _LENGTH.size:
            (length,) = _LENGTH.unpack_from(self._buffer, at)
            if length > LARGEST:
                raise SpoolError(f"a message of {length} bytes is no message of a gateway")
            end = at + _LENGTH.size + length
            if len(self._buffer) < end:
                break
            try:
                found = _DECODER.decode(memoryview(self._buffer)[at + _LENGTH.size : end])
            except msgspec.DecodeError as error:
                raise SpoolError(f"a message cannot be read: {error}") from error
            at = end
            yield found
        del self._buffer[:at]
