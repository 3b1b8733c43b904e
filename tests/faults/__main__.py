"""The long form: every fault again and again, in random order, on random robots, until the time is over.

    python -m tests.faults --minutes 60

It prints a report and ends with exit code 1 where a rule was broken.
"""

from __future__ import annotations

import argparse
import secrets
import sys
import tempfile
import time
import traceback
from pathlib import Path
from random import Random

import anyio

from tests.faults import clocks, limits, many, names, network, plugins, trials
from tests.faults.cell import CELL
from tests.faults.kit import Turn
from tests.faults.report import Report

# Of a run of less than this the many robots take a part, not their ten minutes.
_WHOLE_MIN = 20.0
_PART = 0.25


async def soak(minutes: float, seed: int, folder: Path) -> Report:
    """Let everything happen until the time is over."""
    random, report = Random(seed), Report()  # noqa: S311 - faults, no secret
    end_s = time.monotonic() + minutes * 60
    for reason in filter(None, (network.why_not(), names.why_not(), clocks.why_not(), limits.why_no_disk())):
        print(f"left out: {reason}", flush=True)
    many_s = many.LONG_S if minutes >= _WHOLE_MIN else minutes * 60 * _PART
    await _take(many.series(many_s), folder / "many", random, report, 0.0)
    n_rounds = 0
    while n_rounds == 0 or time.monotonic() < end_s:
        n_rounds += 1
        turns: list[Turn] = [*_series(), *trials.TRIALS]
        random.shuffle(turns)
        for number, turn in enumerate(turns):
            left_s = end_s - time.monotonic()
            if left_s < 0 and n_rounds > 1:
                break
            print(f"{left_s / 60:.1f} min left: {turn.name}; {len(report.broken)} rules broken", flush=True)
            share_s = max(0.0, left_s) / (len(turns) - number)
            await _take(turn, folder / f"{n_rounds}-{number}", random, report, share_s)
    return report


async def _take(turn: Turn, folder: Path, random: Random, report: Report, share_s: float) -> None:
    """Let one series or trial happen; a stage that cannot be made, or breaks, is told and costs no other."""
    try:
        await turn.run(folder, random, report, share_s)
    except (Exception, BaseExceptionGroup) as error:  # noqa: BLE001 - whatever it was, it is a broken rule
        report.row(turn.name, "the stage").broken.append("".join(traceback.format_exception(error)))


def _series() -> list[Turn]:
    """Those that are possible here."""
    found: list[Turn] = [CELL, plugins.PLUGINS, limits.DESCRIPTORS]
    if network.why_not() is None:
        found.append(network.NETWORK)
    if names.why_not() is None:
        found.append(names.NAMES)
    if clocks.why_not() is None:
        found.append(clocks.CLOCK)
    if limits.why_no_disk() is None:
        found.append(limits.DISK)
    return found


def main() -> int:
    """Read the arguments, run, and print the report."""
    parser = argparse.ArgumentParser(description="Every fault that we can make, until the time is over.")
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=None, help="the same seed, the same order of faults")
    parser.add_argument("--report", type=Path, default=None, help="a file that takes the report, too")
    options = parser.parse_args()
    seed = secrets.randbelow(1_000_000) if options.seed is None else options.seed
    print(f"{options.minutes:g} minutes of faults, seed {seed}", flush=True)
    with tempfile.TemporaryDirectory(prefix="faults-") as folder:
        report = anyio.run(soak, options.minutes, seed, Path(folder))
    print(report.text(), flush=True)
    if options.report:
        options.report.write_text(report.text() + "\n", "utf-8")
    return 1 if report.broken else 0


if __name__ == "__main__":
    sys.exit(main())
