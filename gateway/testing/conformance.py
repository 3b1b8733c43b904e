"""The conformance suite: the table of checks that every vendor's plugin must pass, and how one is run.

    async for outcome in run(subjects(registry, "rainbow")): ...

A check takes a `Subject` and raises `CheckFailed`, or `DoesNotApply` where a protocol of this kind has nothing to look
at; it may be a coroutine. One is left out only by the plugin itself, with `Vendor(exempt={"check": "reason"})`.
"""

from __future__ import annotations

import inspect
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal

from gateway.core.registry import Registry
from gateway.testing import (
    canonical_checks,
    damage_checks,
    end_to_end_checks,
    line_checks,
    polling_checks,
    simulator_checks,
    speed_checks,
    stream_checks,
    surplus_checks,
    table_checks,
    value_checks,
    vector_checks,
)
from gateway.testing.subject import NOT_BINARY, NOT_TEXT, PUSHED, CheckFailed, DoesNotApply, Subject

Result = Literal["passed", "does not apply", "exempt", "failed"]


Shape = Literal["bytes", "text", "polled"]
# What a protocol of each shape is, and why a check of that shape has nothing to look at in another.
SHAPES: Mapping[Shape, tuple[Callable[[Subject], bool], str]] = {
    "bytes": (lambda subject: subject.protocol.framing is not None, NOT_BINARY),
    "text": (lambda subject: bool(subject.protocol.records), NOT_TEXT),
    "polled": (lambda subject: subject.polls, PUSHED),
}


@dataclass(frozen=True, slots=True)
class Check:
    """A row of the suite.

    Args:
        run: The check; its name and its docstring are what people read.
        of: What a protocol must be for it to have something to look at; nothing: any protocol.
        limit_s: How long it may take in a test.
    """

    run: Callable[[Subject], Awaitable[None] | None]
    of: tuple[Shape, ...] = ()
    limit_s: float = 20.0

    @property
    def name(self) -> str:
        """What the check is called, in messages and in `Vendor.exempt`."""
        return self.run.__name__

    @property
    def text(self) -> str:
        """What it checks, in one sentence."""
        return (self.run.__doc__ or "").strip().partition("\n")[0]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a check said of a protocol.

    Attributes:
        message: Why it does not apply or is exempt, or what is wrong and what to do.
    """

    subject: Subject
    check: Check
    result: Result
    message: str = ""


CHECKS: tuple[Check, ...] = (
    Check(table_checks.record_is_valid),
    Check(table_checks.nothing_is_left_to_fill),
    Check(table_checks.folder_is_documented),
    Check(table_checks.tables_hold, of=("bytes",)),
    Check(table_checks.framing_holds, of=("bytes",)),
    Check(table_checks.records_hold, of=("text",)),
    Check(table_checks.signals_compile),
    Check(vector_checks.vectors_cover_everything),
    Check(vector_checks.vectors_decode),
    Check(vector_checks.vendor_group_is_whole),
    Check(vector_checks.encoding_agrees, of=("bytes",)),
    Check(vector_checks.bulk_reading_agrees, of=("bytes",)),
    Check(stream_checks.cuts_change_nothing),
    Check(stream_checks.junk_is_rejected, of=("bytes",)),
    Check(stream_checks.garbage_gives_nothing, of=("bytes",)),
    Check(stream_checks.cut_frames_are_truncated, of=("bytes",)),
    Check(damage_checks.damaged_values_move_nothing, of=("bytes",), limit_s=60.0),
    Check(damage_checks.damaged_values_stay_alone, of=("bytes",), limit_s=60.0),
    Check(damage_checks.damaged_headers_cost_little, of=("bytes",), limit_s=60.0),
    Check(damage_checks.damage_never_passes, of=("bytes",), limit_s=60.0),
    Check(line_checks.damaged_lines_stay_alone, of=("text",), limit_s=60.0),
    Check(line_checks.cut_lines_tell_nothing, of=("text",), limit_s=60.0),
    Check(line_checks.long_lines_cost_themselves, of=("text",), limit_s=60.0),
    Check(line_checks.junk_lines_tell_nothing, of=("text",)),
    Check(value_checks.values_have_their_types, of=("text",)),
    Check(value_checks.numbers_stay_finite, of=("text",), limit_s=60.0),
    Check(value_checks.json_is_taken_with_care, of=("text",), limit_s=60.0),
    Check(canonical_checks.canonical_groups_fit_the_model),
    Check(canonical_checks.nothing_is_told_that_is_not_finite, of=("bytes",), limit_s=60.0),
    Check(canonical_checks.cut_off_is_null, of=("bytes",)),
    Check(canonical_checks.keys_follow_values, of=("bytes",), limit_s=60.0),
    Check(value_checks.what_is_not_told_is_null, of=("text",)),
    Check(value_checks.named_values_move_keys, of=("text",)),
    Check(polling_checks.only_allowed_bytes_are_sent),
    Check(polling_checks.one_request_is_outstanding),
    Check(polling_checks.skipped_frames_answer_nothing, of=("polled",)),
    Check(polling_checks.unrequested_frames_end_the_session, of=("polled", "bytes")),
    Check(polling_checks.late_answers_answer_nothing, of=("polled", "text")),
    Check(surplus_checks.an_answer_too_many_is_noticed, of=("polled", "text")),
    Check(polling_checks.requests_never_outrun_answers, of=("polled",)),
    Check(simulator_checks.simulator_answers),
    Check(end_to_end_checks.data_arrives_and_returns),
    Check(speed_checks.decoding_is_fast),
)


def subjects(registry: Registry, name: str) -> tuple[Subject, ...]:
    """Every protocol of a vendor.

    Raises:
        VendorError: The plugin cannot be loaded, or there is none of that name.
    """
    vendor = registry.vendor(name)
    folder = registry.folder(name)
    simulator = partial(registry.simulator, name)
    return tuple(Subject(vendor, protocol, folder, simulator) for protocol in vendor.protocols)


async def perform(check: Check, subject: Subject) -> Outcome:
    """Run one check, unless the plugin says why it must be left out."""
    unknown = set(subject.vendor.exempt) - {one.name for one in CHECKS}
    if unknown and check is CHECKS[0]:
        return Outcome(
            subject, check, "failed", f"exempt names no check: {', '.join(sorted(unknown))}: correct the name"
        )
    if check.name in subject.vendor.exempt:
        return Outcome(subject, check, "exempt", subject.vendor.exempt[check.name])
    for shape in check.of:
        fits, why_not = SHAPES[shape]
        if not fits(subject):
            return Outcome(subject, check, "does not apply", why_not)
    try:
        waiting = check.run(subject)
        if inspect.isawaitable(waiting):
            await waiting
    except DoesNotApply as reason:
        return Outcome(subject, check, "does not apply", str(reason))
    except CheckFailed as failure:
        return Outcome(subject, check, "failed", str(failure))
    except Exception as error:  # noqa: BLE001 - whatever a plugin raises is the author's to see, and no reason to stop
        return Outcome(subject, check, "failed", f"{type(error).__name__}: {error}: the plugin must not raise this")
    return Outcome(subject, check, "passed")


async def run(of: Iterable[Subject]) -> AsyncIterator[Outcome]:
    """Run every check over some protocols, in the order of the table."""
    for subject in of:
        for check in CHECKS:
            yield await perform(check, subject)
