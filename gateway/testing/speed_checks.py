"""The check of speed: decode and normalise cost at most a stated multiple of the least that anybody must do.

That is `struct.unpack` of the words of a binary frame, `json.loads` of a JSON message, and for other text to find its
numbers by a pattern and convert them.
"""

from __future__ import annotations

import json
import re
import struct
import sys
from collections.abc import Callable
from time import thread_time

from gateway.api.model import FRAME_GROUPS
from gateway.testing.playing import is_json, opened, tell
from gateway.testing.subject import CheckFailed, Subject
from gateway.testing.vector_checks import the_frame
from gateway.testing.vectors import Vector

_ATTEMPTS = 5  # a machine that is busy with something else is asked again
_ROUNDS = 30
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
_CALLS = 60  # calls that are timed together


def decoding_is_fast(subject: Subject) -> None:
    """Decode and normalise of all canonical groups cost at most Protocol.cost times the least, such as `unpack`."""
    found = [ratio(subject)]
    while min(found) > subject.protocol.cost and len(found) < _ATTEMPTS:
        found.append(ratio(subject))
    if min(found) > subject.protocol.cost:
        name, _ = least_of(subject.states[0], subject)
        raise CheckFailed(
            f"decode and normalise cost {min(found):.1f} times {name} of the same bytes, the protocol states "
            f"{subject.protocol.cost:g}: use fewer functions in signal rows, or state what it costs",
        )


def ratio(subject: Subject) -> float:
    """How much longer decode and normalise of the first vector take than the least that anybody must do with it."""
    vector = subject.states[0]
    raw = vector.raw
    normaliser = subject.normaliser(vector.options)
    decoder = opened(subject, vector)
    frame = the_frame(subject, vector)
    if frame is None:
        raise CheckFailed(f"{vector} carries state, but is skipped: give its kind the layouts")
    readers = normaliser.readers(frame.layout)
    reads = [reader.read for group, reader in readers.items() if group in FRAME_GROUPS]
    feed, asked = decoder.feed, vector.asked
    _, least = least_of(vector, subject)

    def decode() -> None:
        tell(decoder, asked)
        feed(raw)
        for read in reads:
            read(frame)

    traced = sys.gettrace()
    sys.settrace(None)  # coverage slows Python down, but not struct
    try:
        rounds = [(_seconds(decode), _seconds(least)) for _ in range(_ROUNDS)]
    finally:
        sys.settrace(traced)
    return min(slow for slow, _ in rounds) / min(bare for _, bare in rounds)


def least_of(vector: Vector, subject: Subject) -> tuple[str, Callable[[], object]]:
    """The least that anybody must do with the bytes of a frame, and its name."""
    raw = vector.raw
    if subject.protocol.framing is not None:
        words = struct.Struct(f"<{len(raw) // 4}I{len(raw) % 4}x")
        return "struct.unpack", lambda: words.unpack(raw)
    if is_json(vector):
        return "json.loads", lambda: json.loads(raw)
    return "finding the numbers", lambda: [float(found) for found in _NUMBER.findall(raw.decode())]


def _seconds(call: Callable[[], object]) -> float:
    start = thread_time()
    for _ in range(_CALLS):
        call()
    return thread_time() - start
