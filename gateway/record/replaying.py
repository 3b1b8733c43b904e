"""Plays a recording through the decoders again, and compares what they say with what was recorded."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from gateway.api.decoder import Event
from gateway.core.bus import Bus
from gateway.core.settings import RobotSettings
from gateway.record.chunks import Chunk, Silence
from gateway.record.mcapfile import Mark
from gateway.record.reading import Entry
from gateway.record.replayer import Replayer

_MARK = msgspec.json.Decoder(Mark)
_JSON = msgspec.json.Encoder()
_WAYS = {"received": "received", "sent": "sent"}


class RobotReplay:
    """One robot of a recording.

    Args:
        robot: As it was configured.
        bus: Where it is published; its samples say `origin: replay`.
    """

    def __init__(self, robot: RobotSettings, bus: Bus) -> None:
        self._replayer = Replayer(robot, bus, "replay")
        self._epoch = ""
        self._opening = False

    def take(self, entry: Entry) -> Sequence[Event]:
        """Take the next raw bytes or mark of the robot; what its decoder made of it."""
        kind = entry.topic.rpartition("/")[2]
        if kind == "session":
            return self._mark(entry)
        chunk = Chunk(entry.t, "received" if kind == "received" else "sent", entry.data, self._epoch, None)
        return self._replayer.read(chunk) if self._opening else self._replayer.play(chunk)

    def _mark(self, entry: Entry) -> Sequence[Event]:
        mark = _MARK.decode(entry.data)
        self._epoch = mark.epoch
        self._opening = mark.kind == "opening"
        if mark.kind == "opening":
            self._replayer.open(mark.epoch)
        elif mark.kind == "resume":
            self._replayer.resume(mark.epoch, mark.seqs, mark.faults)
        elif mark.kind == "number":
            self._replayer.publisher.number(mark.seqs)
        elif mark.kind == "silent" and mark.quality is not None:
            silence = msgspec.json.encode(Silence(mark.quality, mark.t_last))
            return self._replayer.play(Chunk(entry.t, "silent", silence, mark.epoch, mark.seqs))
        elif mark.kind in {"begin", "expired", "end"}:
            return self._replayer.play(Chunk(entry.t, mark.kind, b"", mark.epoch, None))  # type: ignore[arg-type]
        return ()
