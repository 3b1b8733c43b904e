from __future__ import annotations

from collections.abc import Callable

from gateway.api.decoder import Event, Frame, Refused, Reject
from gateway.api.framing import FramedDecoder
from gateway.core.kept import KeptDecoder
from tests.core import toy


class Faulty(FramedDecoder):
    """A decoder of which one entry point does something else."""

    def __init__(self, **entries: Callable[..., object]) -> None:
        super().__init__(toy.FRAMING)
        for name, entry in entries.items():
            setattr(self, name, entry)


def fail(*_: object) -> object:
    raise ZeroDivisionError


def leave(*_: object) -> object:
    raise SystemExit


def test_a_mistake_at_any_entry_point_is_trouble_and_never_raised() -> None:
    for entry in ("feed", "end", "outgoing", "tick", "goodbye"):
        for fault in (fail, leave):
            kept = KeptDecoder(Faulty(**{entry: fault}))
            kept.feed(b"x")
            assert (kept.end(), kept.outgoing(), kept.tick(), kept.goodbye()) == ([], b"", b"", b"")
            assert kept.trouble is not None


def test_bytes_that_a_plugin_fails_on_are_one_counted_reject() -> None:
    (event,) = KeptDecoder(Faulty(feed=fail)).feed(b"poison")
    assert isinstance(event, Reject)
    assert (event.raw, event.reason) == (b"poison", "plugin")


def test_a_refusal_is_counted_and_forgotten_with_the_next_good_frame() -> None:
    answers: list[list[Event]] = [[Refused("no layout explains it", "incompatible")], [Frame(toy.frame(), toy.LAYOUT)]]
    kept = KeptDecoder(Faulty(feed=lambda _data: answers.pop(0)))
    (refusal,) = kept.feed(b"x")
    assert isinstance(refusal, Reject)
    assert kept.trouble == Refused("no layout explains it", "incompatible")
    kept.feed(b"y")
    assert kept.trouble is None


def test_a_refusing_tick_asks_for_nothing() -> None:
    kept = KeptDecoder(Faulty(tick=lambda: Refused("out of step", "out_of_step")))
    assert kept.tick() == b""
    assert kept.trouble == Refused("out of step", "out_of_step")
