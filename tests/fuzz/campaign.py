"""Runs targets under atheris, one after the other, each in a process of its own, and tells what came of them."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

from rich import box
from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from tests.fuzz.target import Target

FOLDER = Path("build/fuzz")
_LONGEST = 16_384  # bytes of one input
_SLOWEST_S = 10
_MOST_MB = 2048
_GRACE_S = 120  # to instrument and to read the corpus
_MOST_LINES = 40
_UNCAUGHT = "=== Uncaught Python exception: ==="
_DONE = re.compile(r"#(\d+)\s+\w+\s+cov: (\d+) ft: (\d+) corp: (\d+)/(\S+)")
_EXECUTED = re.compile(r"number_of_executed_units:\s+(\d+)")


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of one target."""

    target: str
    executions: int
    coverage: int
    corpus: int
    crashes: tuple[Path, ...]
    output: str


def targets() -> dict[str, Target]:
    """Every target; imported late, so that atheris can instrument what is imported with it."""
    found = importlib.import_module("tests.fuzz.targets").all_targets()
    return cast("dict[str, Target]", found)


def fuzz(name: str, fuzzer_args: list[str]) -> None:
    """Fuzz one target in this process; it does not return."""
    atheris = importlib.import_module("atheris")  # an extra that nothing else needs

    with atheris.instrument_imports(include=["gateway", "vendors"]):
        target = targets()[name]
    atheris.Setup([sys.argv[0], *fuzzer_args], target.run)
    atheris.Fuzz()


def run(seconds: int, names: list[str]) -> int:
    """Fuzz some targets for so many seconds each and print a table; the exit code."""
    try:
        importlib.import_module("atheris")
    except ImportError:
        print("atheris is missing (it has wheels for Python 3.11): pip install -e '.[dev,fuzz]'", file=sys.stderr)
        return 2
    known = targets()
    outcomes = []
    for name in names:
        print(f"{name}: {seconds} s …", file=sys.stderr)
        outcomes.append(_one(known[name], seconds))
        _tell(outcomes[-1])
    Console().print(_table(outcomes, seconds))
    return 1 if any(outcome.crashes for outcome in outcomes) else 0


def _one(target: Target, seconds: int) -> Outcome:
    corpus, seeds, crashes = (FOLDER / part / target.name for part in ("corpus", "seeds", "crashes"))
    for folder in (corpus, seeds, crashes):
        folder.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(target.seeds):
        (seeds / str(number)).write_bytes(seed[:_LONGEST])
    before = set(crashes.iterdir())
    limits = [f"-max_total_time={seconds}", f"-timeout={_SLOWEST_S}", f"-rss_limit_mb={_MOST_MB}"]
    told = [f"-max_len={_LONGEST}", f"-artifact_prefix={crashes}/", "-print_final_stats=1"]
    command = [sys.executable, "-m", "tests.fuzz", "--child", target.name, *limits, *told]
    command += [str(corpus), str(seeds)]
    try:
        done = subprocess.run(  # noqa: S603 - our own module
            command, check=False, capture_output=True, timeout=seconds + _GRACE_S
        )
        output = (done.stderr + done.stdout).decode(errors="replace")  # a traceback is on stdout
        failed = done.returncode != 0
    except subprocess.TimeoutExpired as error:
        output, failed = (error.stderr or b"").decode(errors="replace") + "\nit did not end in time\n", True
    found = tuple(sorted(set(crashes.iterdir()) - before))
    if failed and not found:  # it ended without a crash file: what it said is all there is
        note = crashes / "output.txt"
        note.write_text(output)
        found = (note,)
    last = [match.groups() for match in _DONE.finditer(output)][-1:]
    _, coverage, _, size, _ = last[0] if last else ("0", "0", "0", "0", "")
    executed = _EXECUTED.search(output)
    return Outcome(target.name, int(executed[1]) if executed else 0, int(coverage), int(size), found, output)


def _tell(outcome: Outcome) -> None:
    """Say at once what a crash is and how to have it again."""
    if not outcome.crashes:
        return
    _, _, traceback = outcome.output.partition(_UNCAUGHT)
    said = traceback or outcome.output
    print("\n".join(said.strip().splitlines()[:_MOST_LINES]), file=sys.stderr)
    for crash in outcome.crashes:
        print(f"again: python -m tests.fuzz {outcome.target} {crash}", file=sys.stderr)


def _table(outcomes: list[Outcome], seconds: int) -> Table:
    table = Table(box=box.SIMPLE_HEAD, title=f"{seconds} s each")
    table.add_column("target")
    for heading in ("executions", "a second", "coverage", "corpus", "crashes"):
        table.add_column(heading, justify="right")
    for outcome in outcomes:
        numbers = (outcome.executions, outcome.executions // max(1, seconds), outcome.coverage, outcome.corpus)
        table.add_row(outcome.target, *(f"{number:,}" for number in numbers), str(len(outcome.crashes)))
    return table
