"""`make bench`: one table of figures, each with its ratio to a baseline measured in turns in the same run.

python -m tests.bench [NAME…] [--json FILE] [--markdown FILE] [--plots FOLDER] [--quick | --long] [--rounds N]
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
from pathlib import Path

import msgspec

from tests.bench import plots
from tests.bench.plan import FULL, LONG, QUICK, Plan
from tests.bench.rows import BENCHMARKS
from tests.bench.table import HEAD, Row, block_of, markdown_of, put_in


class Run(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that was measured.

    Args:
        machine: Where.
        begun: When, local time.
        plan: How large and how long.
        benchmarks: The rows by benchmark.
    """

    machine: str
    begun: str
    plan: Plan
    benchmarks: dict[str, list[Row]]


def _machine() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    model = next((line.partition(": ")[2] for line in lines if line.startswith("model name")), platform.machine())
    busy = os.getloadavg()[0]
    return (
        f"{os.cpu_count()} × {model}, {platform.system()} {platform.release()}, "
        f"Python {platform.python_version()}, load before the run {busy:.2f}"
    )


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(BENCHMARKS)}; none: all")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every figure there; - is the standard output")
    parser.add_argument(
        "--markdown", type=Path, metavar="FILE", help="refresh the tables of a page, docs/performance.md"
    )
    parser.add_argument("--plots", type=Path, metavar="FOLDER", help="draw how cost grows, from the sweeps")
    parser.add_argument("--rounds", type=int, metavar="N", help="rounds of each figure; at least 5 for a judgement")
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--quick", action="store_true", help="short and small: for looking, not for judging")
    size.add_argument("--long", action="store_true", help="clients come and go for ten minutes")
    found = parser.parse_args()
    unknown = [name for name in found.names if name not in BENCHMARKS]
    if unknown:
        parser.error(f"unknown: {', '.join(unknown)}; there are {', '.join(BENCHMARKS)}")
    return found


def main() -> None:
    """Measure and print."""
    asked = _arguments()
    plan = QUICK if asked.quick else LONG if asked.long else FULL
    if asked.rounds:
        plan = msgspec.structs.replace(plan, rounds=asked.rounds)
    run = Run(machine=_machine(), begun=time.strftime("%Y-%m-%d %H:%M"), plan=plan, benchmarks={})
    out = sys.stderr if asked.json == Path("-") else sys.stdout
    print(f"{run.machine}; {plan.rounds} rounds\n{HEAD}", file=out)
    for name in asked.names or BENCHMARKS:
        print(f"\n{name}: {BENCHMARKS[name].title}", file=out, flush=True)
        run.benchmarks[name] = list(BENCHMARKS[name].rows(plan))
        print(block_of(run.benchmarks[name]), file=out, flush=True)
    judged = [row.met for rows in run.benchmarks.values() for row in rows if row.met is not None]
    print(f"\n{sum(judged)} of {len(judged)} goals met", file=out)
    if asked.json is not None:
        text = msgspec.json.format(msgspec.json.encode(run), indent=1) + b"\n"
        if asked.json == Path("-"):
            sys.stdout.buffer.write(text)
        else:
            asked.json.write_bytes(text)
    if asked.markdown is not None:
        page = asked.markdown.read_text("utf-8")
        for name, rows in run.benchmarks.items():
            page = put_in(page, name, f"*{run.machine}; {plan.rounds} rounds; {run.begun}.*\n\n{markdown_of(rows)}")
        asked.markdown.write_text(page, "utf-8")
    if asked.plots is not None:
        for path in plots.drawn(run.benchmarks.get("sweeps", []), asked.plots):
            print(path, file=out)


main()
