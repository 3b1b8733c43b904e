"""What the recorder must know: a plain record that the configuration is resolved into."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderSettings:
    """How much is kept, and when it is written.

    Args:
        directory: Where recordings are written; None: nowhere, only the rings are kept.
        on: Kinds of events that trigger a recording.
        before_s: How long before the trigger a recording begins, in s.
        after_s: How long after it a recording ends, in s.
        ring_s: How long each robot's bytes are kept in memory, in s.
        ring_bytes: How much memory that may take for each robot, compressed.
        keep_files: How many recordings are kept.
        keep_bytes: How much they may take on the disk together.
        keep_s: How old they may become, in s.
    """

    directory: Path | None = None
    on: tuple[str, ...] = ("fault.raised", "estop.pressed", "collision.detected", "link.lost")
    before_s: float = 30.0
    after_s: float = 10.0
    ring_s: float = 60.0
    ring_bytes: int = 8_000_000
    keep_files: int = 100
    keep_bytes: int = 2_000_000_000
    keep_s: float = 90 * 86400.0
