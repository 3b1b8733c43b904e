"""An invented vendor that breaks on demand: at the entry point of its option `at`, while the file of `while_there` is.

A file with a number in it makes `feed` block the loop once for so many seconds instead.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec

from gateway.api.decoder import Decoder, Event, Reject
from gateway.api.framing import FramedDecoder, Framing, Kind
from gateway.api.layout import Field, Layout
from gateway.api.model import Motion
from gateway.api.signals import Signal
from gateway.api.vendor import DecoderFactory, OnStale, Protocol, Vendor

LAYOUT = Layout(
    name="fickle",
    size=16,
    source="invented",
    fields=(
        Field(name="header", offset=0, type="u8", count=4),
        Field(name="angle", offset=4, type="f32", count=2, unit="deg"),
        Field(name="word", offset=12, type="u32"),
    ),
)
FRAMING = Framing(
    magic=b"$",
    header=4,
    length_at=1,
    length_adds=4,
    type_at=3,
    kinds=(Kind(type=3, name="state", layouts=(LAYOUT,), smallest=16, largest=64, step=4),),
)


class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where and while what it breaks."""

    at: Annotated[str, msgspec.Meta(description="The entry point that raises.")] = ""
    while_there: Annotated[str, msgspec.Meta(description="The file while which it does.")] = ""

    def reach(self, entry_point: str) -> None:
        """Be at an entry point."""
        if entry_point == self.at and Path(self.while_there).exists():
            raise RuntimeError(f"fickle at {entry_point}")


class Fickle:
    """A decoder that breaks on demand."""

    def __init__(self, options: Options) -> None:
        self._options = options
        self._decoder = FramedDecoder(FRAMING)

    @property
    def ready(self) -> bool:
        """Whether the handshake is done."""
        self._options.reach("ready")
        return True

    @property
    def notes(self) -> Sequence[str]:
        """What the operator should know."""
        self._options.reach("notes")
        return ()

    @property
    def gaps(self) -> int | None:
        """How many frames are missing."""
        self._options.reach("gaps")
        return None

    def feed(self, data: bytes) -> list[Event]:
        """Take received bytes."""
        self._options.reach("feed")
        if self._options.at == "block":
            self._block()
        return self._decoder.feed(data)

    def end(self) -> list[Reject]:
        """The stream ends."""
        self._options.reach("end")
        return self._decoder.end()

    def outgoing(self) -> bytes:
        """Nothing is owed."""
        self._options.reach("outgoing")
        return b""

    def tick(self) -> bytes:
        """Nothing is asked."""
        self._options.reach("tick")
        return b""

    def goodbye(self) -> bytes:
        """Nothing is said."""
        self._options.reach("goodbye")
        return b""

    def _block(self) -> None:
        flag = Path(self._options.while_there)
        if flag.exists():
            seconds = float(flag.read_text("ascii"))
            flag.unlink()
            time.sleep(seconds)


def decoders(options: msgspec.Struct, _rate_hz: float) -> DecoderFactory:
    """Make what makes decoders."""
    assert isinstance(options, Options)

    def make() -> Decoder:
        options.reach("decoder")
        return Fickle(options)

    return make


def motion(word: int) -> Motion:
    """A signal function that always fails: a group of its own is null for it, and nothing else."""
    if word == word:  # noqa: PLR0124 - always
        raise RuntimeError("fickle at a signal")
    return Motion.MOVING


def protocol(name: str, on_stale: OnStale, *more: Signal) -> Protocol:
    """One of its protocols."""
    return Protocol(
        name=name,
        title="breaks on demand",
        port=None,
        framing=FRAMING,
        signals=(Signal("joints.position", "angle"), *more),
        options=Options,
        make_reader=lambda: FramedDecoder(FRAMING),
        make_decoders=decoders,
        tick_s=0.1,
        on_stale=on_stale,
    )


VENDOR = Vendor(
    name="fickle",
    title="Fickle",
    protocols=(
        protocol("close", "close"),
        protocol("keep", "keep"),
        protocol("signal", "close", Signal("status.motion", "word", motion)),
    ),
)
