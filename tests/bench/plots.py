"""Pictures of how cost grows, from the rows of `sweeps`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tests.bench.table import Row

_LABELS = {
    "robots": "robots",
    "clients": "clients, each with every sample",
    "rate": "frames of each robot per second",
    "groups": "groups subscribed to: joints, then tcp, then vendor (every field)",
}


def drawn(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Draw one picture for each axis; returns the files."""
    import matplotlib as mpl  # noqa: PLC0415 - only where pictures are asked for

    mpl.use("svg")
    mpl.rcParams["svg.hashsalt"] = "robot-gateway"
    from matplotlib import pyplot as plt  # noqa: PLC0415

    folder.mkdir(parents=True, exist_ok=True)
    made = []
    for axis, label in _LABELS.items():
        found = [row for row in rows if row.name.startswith(f"by {axis}: ")]
        if not found:
            continue
        at = [float(row.name.rpartition(" ")[2]) for row in found]
        figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
        axes.plot(at, [row.value for row in found], marker="o")
        axes.fill_between(at, [row.low for row in found], [row.high for row in found], alpha=0.2)
        axes.set(xlabel=label, ylabel="CPU of the gateway, % of a core", ylim=(0, None))
        axes.grid(visible=True, alpha=0.3)
        path = folder / f"cost-by-{axis}.svg"
        figure.savefig(path, metadata={"Date": None})
        plt.close(figure)
        made.append(path)
    return made
