"""Which recordings are kept: so many, so large together, so old. Only files that a recorder named are ever touched."""

from __future__ import annotations

import fcntl
import os
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from gateway.record.settings import PART, RecorderSettings

# 2026-11-22T03-04-05Z_r1_estop.pressed.mcap; a second one of the same second has -2 behind the time.
NAME = re.compile(r"\d{4}-\d\d-\d\dT\d\d-\d\d-\d\dZ(-\d+)?_[a-z0-9_.-]+\.mcap")


@dataclass(frozen=True, slots=True)
class Kept:
    """One recording on the disk.

    Args:
        path: The file.
        n_bytes: Its size.
        at_s: When it was written, s since 1970.
    """

    path: Path
    n_bytes: int
    at_s: float


def recordings(directory: Path) -> list[Kept]:
    """The recordings of a folder, the newest first."""
    found = []
    for path in _named(directory, ""):
        try:
            stat = path.stat()
        except OSError:  # it was taken away meanwhile
            continue
        found.append(Kept(path, stat.st_size, stat.st_mtime))
    return sorted(found, key=lambda kept: (kept.at_s, kept.path.name), reverse=True)


def too_many(found: list[Kept], settings: RecorderSettings, now_s: float) -> list[Kept]:
    """Those that go, of recordings with the newest first; the newest always stays."""
    gone, total = [], 0
    for number, kept in enumerate(found):
        total += kept.n_bytes
        old = now_s - kept.at_s > settings.keep_s
        if number and (number >= settings.keep_files or total > settings.keep_bytes or old):
            gone.append(kept)
    return gone


def tidy(directory: Path, settings: RecorderSettings, now_s: float) -> list[Path]:
    """Remove the recordings that are too many; which they were.

    Raises:
        OSError: The folder cannot be read or changed.
    """
    gone = [kept.path for kept in too_many(recordings(directory), settings, now_s)]
    for path in gone:
        path.unlink(missing_ok=True)
    return gone


def sweep(directory: Path) -> list[Path]:
    """Remove what interrupted recordings have left and nobody writes any more; which they were.

    Raises:
        OSError: The folder cannot be read or changed.
    """
    gone = [path for path in _named(directory, PART) if not _is_written(path)]
    for path in gone:
        path.unlink(missing_ok=True)
    return gone


def hold(path: Path) -> int:
    """Show that a file is being written, for as long as the descriptor is open.

    Raises:
        OSError: It is not there.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    with suppress(OSError):  # a file system without locks
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return descriptor


def _is_written(path: Path) -> bool:
    """Whether some process, maybe of another gateway, writes a file now."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    finally:
        os.close(descriptor)
    return False


def _named(directory: Path, behind: str) -> Iterator[Path]:
    for path in directory.iterdir():
        name = path.name
        if name.endswith(behind) and NAME.fullmatch(name.removesuffix(behind) if behind else name):
            yield path
