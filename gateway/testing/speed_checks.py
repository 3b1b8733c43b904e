"""The check of speed: decode and normalise cost at most a stated multiple of a bare `struct.unpack`."""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from time import perf_counter

from gateway.api.model import FRAME_GROUPS
from gateway.testing.subject import CheckFailed, Subject
from gateway.testing.vector_checks import the_frame

_ATTEMPTS = 5  # a machine that is busy with something else is asked again
_ROUNDS = 30
_CALLS = 60  # calls that are timed together


def decoding_is_fast(subject: Subject) -> None:
    """Decode and normalise of all canonical groups cost at most Protocol.cost times `struct.unpack` of the bytes."""
    found = [ratio(subject)]
    while min(found) > subject.protocol.cost and len(found) < _ATTEMPTS:
        found.append(ratio(subject))
    if min(found) > subject.protocol.cost:
        raise CheckFailed(
            f"decode and normalise cost {min(found):.1f} times struct.unpack of the same bytes, the protocol states "
            f"{subject.protocol.cost:g}: use fewer functions in signal rows, or state what it costs",
        )


def ratio(subject: Subject) -> float:
    """How much longer decode and normalise of the first vector take than `struct.unpack` of its 32-bit words."""
    vector = subject.states[0]
    raw = vector.raw
    normaliser = subject.normaliser(vector.options)
    decoder = subject.protocol.reader()
    frame = the_frame(subject, vector)
    if frame is None:
        raise CheckFailed(f"{vector} carries state, but is skipped: give its kind the layouts")
    readers = normaliser.readers(frame.layout)
    reads = [reader.read for group, reader in readers.items() if group in FRAME_GROUPS]
    feed, words = decoder.feed, struct.Struct(f"<{len(raw) // 4}I{len(raw) % 4}x")
    start = frame.start

    def decode() -> None:
        feed(raw)
        for read in reads:
            read(raw, start)

    def unpack() -> None:
        words.unpack(raw)

    traced = sys.gettrace()
    sys.settrace(None)  # coverage slows Python down, but not struct
    try:
        rounds = [(_seconds(decode), _seconds(unpack)) for _ in range(_ROUNDS)]
    finally:
        sys.settrace(traced)
    return min(slow for slow, _ in rounds) / min(bare for _, bare in rounds)


def _seconds(call: Callable[[], None]) -> float:
    start = perf_counter()
    for _ in range(_CALLS):
        call()
    return perf_counter() - start
