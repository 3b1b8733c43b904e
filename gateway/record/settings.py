"""What the recorder must know: a plain record that the configuration is resolved into."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from gateway.config.keys import Recorder

# Below the folder that the service manager gives.
FOLDER = "recordings"
# Behind the name of a file that is still being written.
PART = ".part"
_MB = 1_000_000
_DAY_S = 86_400.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderSettings:
    """How much is kept, and when it is written.

    Args:
        directory: Where recordings are written; None: nowhere, only the rings are kept.
        on: Kinds of events that trigger a recording.
        before_s: How long before the trigger a recording begins, in s.
        after_s: How long after it a recording ends, in s.
        ring_s: How long each robot's bytes are kept in memory, in s.
        ring_bytes: How much memory that may take, compressed, of all robots together.
        keep_files: How many recordings are kept.
        keep_bytes: How much they may take on the disk together.
        keep_s: How old they may become, in s.
    """

    directory: Path | None = None
    on: tuple[str, ...] = ("fault.raised", "estop.pressed", "collision.detected", "link.lost")
    before_s: float = 30.0
    after_s: float = 10.0
    ring_s: float = 60.0
    ring_bytes: int = 32_000_000
    keep_files: int = 100
    keep_bytes: int = 2_000_000_000
    keep_s: float = 90 * _DAY_S


def recorder_settings(recorder: Recorder, env: Mapping[str, str]) -> RecorderSettings:
    """The table `[recorder]`, with the folder that it means.

    Args:
        recorder: As configured.
        env: The environment: the service manager's state directory.
    """
    state = env.get("STATE_DIRECTORY", "").split(":", maxsplit=1)[0]
    named = recorder.directory or (str(Path(state) / FOLDER) if state else "")
    return RecorderSettings(
        directory=Path(named) if named else None,
        on=tuple(recorder.on),
        before_s=recorder.before_s,
        after_s=recorder.after_s,
        ring_s=recorder.ring_s,
        ring_bytes=int(recorder.ring_mb * _MB),
        keep_files=recorder.keep_files,
        keep_bytes=int(recorder.keep_mb * _MB),
        keep_s=recorder.keep_days * _DAY_S,
    )
