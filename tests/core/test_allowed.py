from __future__ import annotations

from collections.abc import Callable

import pytest

from gateway.api.decoder import Frame, Refused
from gateway.api.framing import FramedDecoder
from gateway.core.allowed import AllowedDecoder
from gateway.core.kept import KeptDecoder
from gateway.errors import VendorError
from tests.core import toy


class Owing(FramedDecoder):
    """A decoder that owes what the test says, wherever it is asked."""

    def __init__(self, owed: bytes | Refused) -> None:
        super().__init__(toy.FRAMING)
        self.owed = owed

    def outgoing(self) -> bytes:
        assert isinstance(self.owed, bytes)
        return self.owed

    def goodbye(self) -> bytes:
        return self.outgoing()

    def tick(self) -> bytes | Refused:
        return self.owed


def entries(decoder: AllowedDecoder) -> list[Callable[[], object]]:
    return [decoder.outgoing, decoder.tick, decoder.goodbye]


@pytest.mark.parametrize("owed", [b"ask", b"", b"reqdata\n"])
def test_what_a_pattern_matches_whole_may_be_sent(owed: bytes) -> None:
    decoder = AllowedDecoder(Owing(owed), "toy", (b"ask", rb"reqdata\n?"))
    assert [entry() for entry in entries(decoder)] == [owed] * 3


@pytest.mark.parametrize("owed", [b"move_j(1)", b"ask ", b"asking", b"xask", b"ask\nmove", bytes(1000)])
@pytest.mark.parametrize("patterns", [(b"ask",), ()])
def test_anything_else_is_never_sent_and_the_error_says_what_it_was(owed: bytes, patterns: tuple[bytes, ...]) -> None:
    decoder = AllowedDecoder(Owing(owed), "toy", patterns)
    for entry in entries(decoder):
        with pytest.raises(VendorError, match="vendor toy: it would send b") as caught:
            entry()
        assert repr(owed[:40]) in str(caught.value)
        assert len(str(caught.value)) < 400


def test_a_refusal_is_passed_on() -> None:
    refusal = Refused("out of step", "out_of_step")
    assert AllowedDecoder(Owing(refusal), "toy", ()).tick() == refusal


def test_a_session_that_must_not_be_dropped_lives_on_and_sends_nothing() -> None:
    kept = KeptDecoder(AllowedDecoder(Owing(b"stop"), "toy", ()))
    assert (kept.outgoing(), kept.tick(), kept.goodbye()) == (b"", b"", b"")
    assert kept.trouble is not None
    assert "it would send b'stop'" in kept.trouble.reason
    assert isinstance(kept.feed(toy.frame())[0], Frame)
