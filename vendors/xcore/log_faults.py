"""Which entries of the controller's log stand as faults: the log tells when one comes, but never when it goes."""

from __future__ import annotations

import msgspec

from gateway.api.model import Fault, Severity
from vendors.xcore.stream_record import Entry

_SEVERITIES = {"warning": Severity.WARNING, "error": Severity.ERROR}
# What an entry of the log is about is over when the robot, having stood still, does one of these again.
_AT_WORK = {"jogging", "moving", "rlProgram", "rtControlling", "demo"}
MOST = 32


class LogFaults:
    """The faults of one session.

    An entry stands, but for one of level info, from when it comes until the robot works again after it has not. Before
    the first evidence of either kind nothing is known: `standing` is None. A warning that does not hinder the robot is
    over by this too early, and comes back when the controller repeats it; one of a robot that never rests stays.

    Attributes:
        standing: The faults, newest last; None: not known.
        left_out: How many more came than are kept; those that stand do not give way.
    """

    def __init__(self) -> None:
        self.standing: list[Fault] | None = None
        self.left_out = 0
        self._stood_still = False

    def take(self, entry: Entry) -> bool:
        """Take an entry of the log; whether the faults have changed."""
        if entry.level == "info":
            return False
        log = entry.log
        fault = Fault(
            code=str(log.id),
            main=log.id,
            severity=_SEVERITIES.get(entry.level or ""),
            text=log.content or None,
            remedy=log.repair or None,
        )
        self._stood_still = False
        before = self.standing or []
        if fault in before:
            return False
        again = [known for known in before if known.key == fault.key]
        if again:  # repeated, with its text this time, or without
            self.standing = [_richer(known, fault) if known in again else known for known in before]
        elif len(before) < MOST:
            self.standing = [*before, fault]
        else:
            self.left_out += 1
        return self.standing != before

    def observe(self, operation_state: str) -> bool:
        """Take what the robot is busy with; whether the faults have changed."""
        if operation_state not in _AT_WORK:
            self._stood_still = self._stood_still or operation_state != "unknown"
            return False
        if self.standing == [] or (self.standing and not self._stood_still):
            return False
        self.standing = []
        self.left_out = 0
        return True


def _richer(known: Fault, again: Fault) -> Fault:
    """A fault with all that two entries of it tell; the newer word counts."""
    told = {name: getattr(again, name) for name in ("severity", "text", "remedy") if getattr(again, name) is not None}
    return msgspec.structs.replace(known, **told)
