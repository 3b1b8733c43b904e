"""`make fuzz`, and what it says to reproduce a crash.

    python -m tests.fuzz --seconds 60              every target for a minute each; a table at the end
    python -m tests.fuzz --seconds 60 config …     only these
    python -m tests.fuzz config FILE               runs a target once, on a file: its traceback is the crash
    python -m tests.fuzz --list

Corpora and crash files stay under build/fuzz. atheris is needed only for the first two: pip install -e '.[dev,fuzz]'.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tests.fuzz import campaign


def main() -> int:
    """Do what the command line asks for; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=int, metavar="S", help="fuzz each target so long")
    parser.add_argument("--list", action="store_true", help="show the targets")
    parser.add_argument("--child", metavar="TARGET", help=argparse.SUPPRESS)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help="or TARGET FILE, without --seconds")
    args, fuzzer_args = parser.parse_known_args()
    if args.child:
        campaign.fuzz(args.child, [*fuzzer_args, *args.targets])  # these are the folders of the corpus
        return 0
    if fuzzer_args:
        parser.error(f"unknown: {' '.join(fuzzer_args)}")
    known = campaign.targets()
    if args.list:
        print("\n".join(known))
        return 0
    if args.seconds is None:
        if len(args.targets) != 2 or args.targets[0] not in known:
            parser.error("give --seconds S, or a target and a file")
        known[args.targets[0]].run(Path(args.targets[1]).read_bytes())
        print("no crash")
        return 0
    unknown = [name for name in args.targets if name not in known]
    if unknown:
        parser.error(f"there is no target {', '.join(unknown)}; --list shows them")
    return campaign.run(args.seconds, args.targets or list(known))


if __name__ == "__main__":
    sys.exit(main())
