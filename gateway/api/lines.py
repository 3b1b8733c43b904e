"""Lines of text in a stream that is cut anywhere: what text protocols stand on, as binary ones on `FramedDecoder`."""

from __future__ import annotations

from gateway.api.decoder import Reject, Skipped

LONGEST = 65_536


class Lines:
    """Cuts a stream into lines.

    A line that is too long costs itself: it is given out piece by piece as it comes, so that no sender can fill the
    memory, the first piece as a reject and the rest as skipped.

    Args:
        end: What ends a line.
        longest: Bytes that a line may have, its end included.
    """

    def __init__(self, end: bytes = b"\n", longest: int = LONGEST) -> None:
        if not 0 < len(end) < longest:
            raise ValueError(f"a line has at most {longest} bytes and must end with something")
        self._end = end
        self._longest = longest
        self._buffer = b""
        self._searched = 0  # no end begins before this place of the buffer
        self._too_long = False

    @property
    def pending(self) -> int:
        """How many bytes wait for the end of their line."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[bytes | Reject | Skipped]:
        """Take received bytes; return whole lines, ends included, and what was no line, in order."""
        buffer = self._buffer + data if self._buffer else data
        found: list[bytes | Reject | Skipped] = []
        at = 0
        while (end_at := buffer.find(self._end, max(at, self._searched))) >= 0:
            end_at += len(self._end)
            found.append(self._line(buffer[at:end_at]))
            self._too_long = False
            at, self._searched = end_at, 0
        rest = buffer[at:]
        if len(rest) >= self._longest or (self._too_long and len(rest) >= len(self._end)):
            cut = len(rest) - len(self._end) + 1  # the last bytes may begin the end of the line
            found.append(self._piece(rest[:cut]))
            self._too_long = True
            rest = rest[cut:]
        self._buffer = rest
        self._searched = max(0, len(rest) - len(self._end) + 1)
        return found

    def end(self) -> list[Reject]:
        """Return what is left in the buffer when the stream ends: a line that never became whole."""
        left, self._buffer, self._searched = self._buffer, b"", 0
        too_long, self._too_long = self._too_long, False
        if not left or too_long:
            return [Reject(left, "truncated", "the rest of a line that is too long")] if left else []
        return [Reject(left, "truncated", f"{len(left)} bytes came, but not the end of their line, {self._end!r}")]

    def _line(self, line: bytes) -> bytes | Reject | Skipped:
        if self._too_long or len(line) > self._longest:
            return self._piece(line)
        return line

    def _piece(self, raw: bytes) -> Reject | Skipped:
        if self._too_long:
            return Skipped(raw, "the rest of a line that is too long")
        return Reject(raw, "too_long", f"a line of more than {self._longest} bytes")
