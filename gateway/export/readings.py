"""What a gateway elsewhere has sent, as readings for a bus here: decoded only when somebody asks."""

from __future__ import annotations

from typing import Literal, TypeVar

import msgspec

from gateway.api.model import GROUPS, Event, Quality, Sample
from gateway.core.bus import Topic

_Kind = TypeVar("_Kind")
_SILENT = {"STALE", "DISCONNECTED"}


class _Head(msgspec.Struct):
    """Of a sample, what must be known before anybody asks for it."""

    q: Literal["GOOD", "SUBSTITUTED", "UNCERTAIN", "BAD", "STALE", "DISCONNECTED"]
    t: int


class _Envelope(msgspec.Struct):
    """A sample whose data is not decoded yet."""

    topic: str
    seq: int
    epoch: str
    t: int
    q: Quality
    data: msgspec.Raw
    t_src: int | None = None
    t_last: int | None = None
    origin: Literal["live", "sim", "replay"] = "live"


_HEADS = (msgspec.json.Decoder(_Head), msgspec.msgpack.Decoder(_Head))
_ENVELOPES = (msgspec.json.Decoder(_Envelope), msgspec.msgpack.Decoder(_Envelope))
_EVENTS = (msgspec.json.Decoder(Event), msgspec.msgpack.Decoder(Event))
_STRUCTS: dict[str, type] = {name: group.struct or dict for name, group in GROUPS.items()}
_DATA: dict[str, tuple[msgspec.json.Decoder[object], msgspec.msgpack.Decoder[object]]] = {
    name: (msgspec.json.Decoder(one), msgspec.msgpack.Decoder(one)) for name, one in _STRUCTS.items()
}


def _format(payload: bytes) -> int:
    return 0 if payload[:1] == b"{" else 1


class ToldReading:
    """A sample as it came: origin, quality, times and place in the sequence stay as they were told.

    Args:
        payload: JSON or MessagePack.

    Attributes:
        t: Receive time at the gateway that has sent it, µs UTC.

    Raises:
        msgspec.DecodeError: It is no sample.
    """

    __slots__ = ("_payload", "_sample", "encoded", "t", "urgent")

    def __init__(self, payload: bytes) -> None:
        head: _Head = _HEADS[_format(payload)].decode(payload)
        self._payload = payload
        self._sample: Sample | None = None
        self.t = head.t
        self.urgent = head.q in _SILENT
        self.encoded: dict[object, bytes] = {}

    def broken(self, topic: Topic, error: Exception) -> Sample:
        """The empty sample in the place of one that cannot be encoded."""
        raise ValueError(f"{topic.name} cannot be encoded") from error

    def sample(self, topic: Topic) -> Sample:
        """The sample; data that is not as this version knows it is empty, and BAD."""
        if self._sample is None:
            which = _format(self._payload)
            told: _Envelope = _ENVELOPES[which].decode(self._payload)
            q = told.q
            try:
                data = _DATA[topic.group.name][which].decode(told.data)
            except msgspec.DecodeError:
                data, q = _STRUCTS[topic.group.name](), Quality.BAD
            self._sample = Sample(
                topic=topic.name,
                seq=told.seq,
                epoch=told.epoch,
                t=told.t,
                t_src=told.t_src,
                t_last=told.t_last,
                q=q,
                origin=told.origin,
                data=data,
            )
        return self._sample


def told_event(payload: bytes) -> Event:
    """An event as it came.

    Raises:
        msgspec.DecodeError: It is none.
    """
    return _EVENTS[_format(payload)].decode(payload)


def decoded(payload: bytes, kind: type[_Kind]) -> _Kind:
    """A document of the bucket.

    Raises:
        msgspec.DecodeError: It is another.
    """
    if payload[:1] in {b"{", b"["}:
        return msgspec.json.decode(payload, type=kind)
    return msgspec.msgpack.decode(payload, type=kind)
