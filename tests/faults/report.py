"""What a run has done and seen, as a table for people."""

from __future__ import annotations

import statistics
from dataclasses import dataclass, field

from tests.faults.processes import Usage


@dataclass(frozen=True, slots=True)
class Seen:
    """What one strike has shown.

    Attributes:
        recovery_s: From the end of the fault to the next good sample; None: nothing had to recover.
        note: What was seen, in words.
    """

    recovery_s: float | None = None
    note: str = ""


@dataclass(slots=True)
class Row:
    """All strikes of one fault."""

    times: int = 0
    recoveries_s: list[float] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)
    note: str = ""

    def add(self, seen: Seen) -> None:
        """Take one more strike."""
        self.times += 1
        self.note = seen.note or self.note
        if seen.recovery_s is not None:
            self.recoveries_s.append(seen.recovery_s)


@dataclass(slots=True)
class Stay:
    """One stay of a gateway process: from when it was warm to the end."""

    series: str
    before: Usage
    after: Usage
    n_samples: int
    longest_pause_s: float


@dataclass
class Report:
    """All of it.

    Attributes:
        rows: By series and fault.
        stays: Of the gateway processes.
    """

    rows: dict[tuple[str, str], Row] = field(default_factory=dict)
    stays: list[Stay] = field(default_factory=list)

    def row(self, series: str, fault: str) -> Row:
        """The row of a fault."""
        return self.rows.setdefault((series, fault), Row())

    @property
    def broken(self) -> list[str]:
        """Every rule that was broken."""
        return [f"{series}, {fault}: {text}" for (series, fault), row in self.rows.items() for text in row.broken]

    def text(self) -> str:
        """The tables, in Markdown."""
        return "\n".join([*self._faults(), "", *self._stays(), "", *self._rules()])

    def _faults(self) -> list[str]:
        lines = [
            "| series | fault | times | recovery p50 | max | rules broken | last seen |",
            "|---|---|---|---|---|---|---|",
        ]
        for (series, fault), row in self.rows.items():
            found = row.recoveries_s
            times = f"{statistics.median(found):.2f} s | {max(found):.2f} s" if found else "- | -"
            lines.append(f"| {series} | {fault} | {row.times} | {times} | {len(row.broken)} | {row.note} |")
        return lines

    def _stays(self) -> list[str]:
        lines = [
            "| gateway under | samples of the others | longest pause | tasks | fds | sockets | threads | memory, MiB |",
            "|---|---|---|---|---|---|---|---|",
        ]
        for stay in self.stays:
            one, two = stay.before, stay.after
            pairs = (
                (one.tasks, two.tasks),
                (one.fds, two.fds),
                (one.sockets, two.sockets),
                (one.threads, two.threads),
                (f"{one.memory_kib / 1024:.1f}", f"{two.memory_kib / 1024:.1f}"),
            )
            used = " | ".join(f"{first} → {last}" for first, last in pairs)
            lines.append(f"| {stay.series} | {stay.n_samples} | {stay.longest_pause_s:.2f} s | {used} |")
        return lines

    def _rules(self) -> list[str]:
        return [f"BROKEN: {text}" for text in self.broken] or ["No rule was broken."]
