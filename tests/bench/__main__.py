"""`make bench`: one table of figures, each with its ratio to a baseline measured in turns in the same run."""

from __future__ import annotations

import sys

import msgspec

from tests.bench import frames


def main() -> None:
    """Measure and print; `--json` for programs."""
    rows = list(frames.rows())
    if "--json" in sys.argv[1:]:
        print(msgspec.json.encode(rows).decode())
        return
    print(f"{'':66} {'µs':>8} {'ratio':>7} {'least':>7} {'most':>7}")
    for row in rows:
        print(f"{row.name:66} {row.value_us:8.2f} {row.ratio:7.2f} {row.least:7.2f} {row.most:7.2f}")


main()
