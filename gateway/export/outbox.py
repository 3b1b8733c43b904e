"""Where events wait until somebody has acknowledged them: one SQLite file, written by one thread, bounded.

An event is on disk (WAL, synchronous FULL) before it is sent, and leaves when it is acknowledged. With it, in the same
transaction, is kept how far each ring has been read: what a crash or a full disk has left out is read from the ring
again while the gateway lives. The oldest events go first when there is no room, or when they are too old.
"""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import anyio
import anyio.to_thread
import structlog

_LOG = structlog.get_logger()
_Value = TypeVar("_Value")

ROW_BYTES = 160  # what a row takes besides its payload, about
_BUSY_S = 0.2
_BOOTS = 64  # so many rings are remembered
_SCHEMA = """
CREATE TABLE IF NOT EXISTS events (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    name TEXT NOT NULL,
    robot TEXT NOT NULL,
    grp TEXT NOT NULL,
    stored REAL NOT NULL,
    payload BLOB NOT NULL
);
CREATE TABLE IF NOT EXISTS taken (boot TEXT PRIMARY KEY, seq INTEGER NOT NULL, stored REAL NOT NULL);
CREATE TABLE IF NOT EXISTS counts (what TEXT PRIMARY KEY, n INTEGER NOT NULL);
"""


class OutboxError(Exception):
    """The outbox cannot be used now.

    Attributes:
        reason: Why, and what to do.
    """

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Row:
    """One event that waits.

    Attributes:
        name: `boot:seq`.
        robot: Of whom it tells.
        group: `events` or `commands`.
        payload: As it is sent.
        id: Its place in the order; 0 before it is stored.
    """

    name: str
    robot: str
    group: str
    payload: bytes
    id: int = 0


@dataclass(frozen=True, slots=True)
class Fill:
    """How full it is.

    Attributes:
        events: How many wait.
        n_bytes: What they take.
        oldest: When the oldest was stored, s since 1970; None: none waits.
        dropped: How many will never arrive, since the file was made.
    """

    events: int = 0
    n_bytes: int = 0
    oldest: float | None = None
    dropped: int = 0


class Outbox:
    """The events of one exporter that wait.

    Args:
        path: The file; its folder is made.
        max_bytes: So much may wait.
        max_age_s: And for so long.
        now: The time, s since 1970.

    Attributes:
        fill: How full it is, as of the last change.
    """

    def __init__(self, path: Path, max_bytes: float, max_age_s: float, now: Callable[[], float] = time.time) -> None:
        self.path = path
        self.fill = Fill()
        self._max_bytes = max_bytes
        self._max_age_s = max_age_s
        self._now = now
        self._base: sqlite3.Connection | None = None
        self._limiter = anyio.CapacityLimiter(1)  # one writer

    @property
    def is_open(self) -> bool:
        """Whether it can be used."""
        return self._base is not None

    async def open(self) -> Mapping[str, int]:
        """Open the file; one that is damaged is put aside, and a new one begun.

        Returns:
            How far each ring was read, by its boot.

        Raises:
            OutboxError: It cannot be used now.
        """
        return await self._threaded(self._open)

    async def close(self) -> None:
        """Close it; what is in it stays."""
        await self._threaded(self._close)

    async def put(self, rows: Sequence[Row], taken: Mapping[str, int], missed: int = 0) -> int:
        """Store events, in order, and how far their rings are read with it.

        Args:
            rows: The events.
            taken: The last event that was read of each ring, by its boot.
            missed: How many were gone from a ring before they could be read.

        Returns:
            How many old ones had to go.

        Raises:
            OutboxError: Nothing is stored.
        """
        return await self._threaded(partial(self._put, rows, taken, missed))

    async def first(self, limit: int) -> list[Row]:
        """The events that wait longest, in order.

        Raises:
            OutboxError: They cannot be read.
        """
        return await self._threaded(partial(self._first, limit))

    async def remove(self, ids: Collection[int], dropped: int = 0) -> None:
        """Let events go: they are acknowledged, or, so many of them, can never be sent.

        Raises:
            OutboxError: They stay.
        """
        await self._threaded(partial(self._remove, ids, dropped))

    async def _threaded(self, call: Callable[[], _Value]) -> _Value:
        try:
            return await anyio.to_thread.run_sync(call, limiter=self._limiter)
        except sqlite3.Error as error:
            raise OutboxError(f"{self.path}: {error}") from error
        except OSError as error:
            raise OutboxError(f"{self.path}: {error.strerror or error}") from error

    def _open(self) -> dict[str, int]:
        self._close()
        self.path.parent.mkdir(parents=True, exist_ok=True, mode=0o750)
        try:
            self._base = self._opened()
        except sqlite3.DatabaseError as error:
            if isinstance(error, sqlite3.OperationalError):
                if "locked" in str(error):
                    what = "another gateway uses this outbox: give each one its own folder or its own cell name"
                    raise OutboxError(f"{self.path}: {what}") from None
                raise
            aside = self.path.with_suffix(f".damaged-{int(self._now())}")
            self.path.rename(aside)
            for rest in ("-wal", "-shm"):
                Path(f"{self.path}{rest}").unlink(missing_ok=True)
            _LOG.error("outbox.damaged", reason=f"{error}; put aside as {aside}, a new one is begun")
            self._base = self._opened()
        self._look()
        return {boot: seq for boot, seq in self._base.execute("SELECT boot, seq FROM taken")}  # noqa: C416 - typed so

    def _opened(self) -> sqlite3.Connection:
        base = sqlite3.connect(self.path, timeout=_BUSY_S, isolation_level=None, check_same_thread=False)
        try:
            base.execute("PRAGMA locking_mode = EXCLUSIVE")
            base.execute("PRAGMA journal_mode = WAL")
            base.execute("PRAGMA synchronous = FULL")
            base.execute("BEGIN IMMEDIATE")
            for statement in _SCHEMA.split(";"):
                base.execute(statement)
            base.execute("COMMIT")
            found = base.execute("PRAGMA quick_check(1)").fetchone()
            if found != ("ok",):
                raise sqlite3.DatabaseError(f"damaged: {found[0]}")  # noqa: TRY301 - closed below
        except BaseException:
            base.close()
            raise
        return base

    def _close(self) -> None:
        base, self._base = self._base, None
        if base is not None:
            base.close()

    def _put(self, rows: Sequence[Row], taken: Mapping[str, int], missed: int) -> int:
        now = self._now()
        with self._transaction() as base:
            base.executemany(
                "INSERT INTO events (name, robot, grp, stored, payload) VALUES (?, ?, ?, ?, ?)",
                [(row.name, row.robot, row.group, now, row.payload) for row in rows],
            )
            base.executemany(
                "INSERT OR REPLACE INTO taken (boot, seq, stored) VALUES (?, ?, ?)",
                [(boot, seq, now) for boot, seq in taken.items()],
            )
            base.execute(
                "DELETE FROM taken WHERE boot NOT IN (SELECT boot FROM taken ORDER BY stored DESC LIMIT ?)", (_BOOTS,)
            )
            n_bytes = self.fill.n_bytes + sum(ROW_BYTES + len(row.payload) for row in rows)
            gone, gone_bytes = self._make_room(base, n_bytes, now - self._max_age_s)
            _count(base, gone + missed)
        self._changed(len(rows) - gone, n_bytes - gone_bytes - self.fill.n_bytes, gone + missed)
        return gone

    def _make_room(self, base: sqlite3.Connection, n_bytes: int, not_before: float) -> tuple[int, int]:
        """Drop what is too old, and the oldest that there is no room for; how many, and their bytes."""
        gone = gone_bytes = last = 0
        for number, size, stored in base.execute("SELECT id, length(payload), stored FROM events ORDER BY id"):
            if n_bytes - gone_bytes <= self._max_bytes and stored >= not_before:
                break
            last, gone, gone_bytes = number, gone + 1, gone_bytes + size + ROW_BYTES
        if gone:
            base.execute("DELETE FROM events WHERE id <= ?", (last,))
        return gone, gone_bytes

    def _first(self, limit: int) -> list[Row]:
        found = self._opened_base.execute(
            "SELECT name, robot, grp, payload, id FROM events ORDER BY id LIMIT ?", (limit,)
        )
        return [Row(*row) for row in found]

    def _remove(self, ids: Collection[int], dropped: int) -> None:
        removed = n_bytes = 0
        with self._transaction() as base:
            for one in ids:
                found = base.execute("DELETE FROM events WHERE id = ? RETURNING length(payload)", (one,)).fetchall()
                removed, n_bytes = removed + len(found), n_bytes + sum(ROW_BYTES + size for (size,) in found)
            _count(base, dropped)
        self._changed(-removed, -n_bytes, dropped)

    def _changed(self, events: int, n_bytes: int, dropped: int) -> None:
        """Keep count: looking at every row each time would take long in a full outbox."""
        oldest = self._opened_base.execute("SELECT stored FROM events ORDER BY id LIMIT 1").fetchone()
        was = self.fill
        self.fill = Fill(
            events=was.events + events,
            n_bytes=was.n_bytes + n_bytes,
            oldest=oldest[0] if oldest else None,
            dropped=was.dropped + dropped,
        )

    @property
    def _opened_base(self) -> sqlite3.Connection:
        if self._base is None:
            raise OutboxError(f"{self.path}: is not open")
        return self._base

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        base = self._opened_base
        base.execute("BEGIN IMMEDIATE")
        try:
            yield base
        except BaseException:
            base.execute("ROLLBACK")
            raise
        base.execute("COMMIT")

    def _look(self) -> None:
        base = self._opened_base
        events, n_bytes, oldest = base.execute(
            f"SELECT count(*), coalesce(sum(length(payload) + {ROW_BYTES}), 0), min(stored) FROM events"  # noqa: S608
        ).fetchone()
        found = base.execute("SELECT n FROM counts WHERE what = 'dropped'").fetchone()
        self.fill = Fill(events, n_bytes, oldest, found[0] if found else 0)


def _count(base: sqlite3.Connection, dropped: int) -> None:
    if dropped:
        base.execute(
            "INSERT INTO counts (what, n) VALUES ('dropped', ?) ON CONFLICT (what) DO UPDATE SET n = n + ?",
            (dropped, dropped),
        )
