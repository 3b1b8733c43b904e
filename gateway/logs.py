"""Logging set-up: readable lines on a terminal, JSON otherwise. Imported by `cli` and `app` only.

What libraries log with the standard library, from warnings on, takes the same form.
"""

from __future__ import annotations

import contextlib
import logging
import sys
from typing import TextIO, cast

import structlog

# Without the local variables, which may hold what a client has sent: its token.
_TRACEBACK = structlog.dev.RichTracebackFormatter(show_locals=False)
LEVELS = {"debug": logging.DEBUG, "info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}


class Unfailing:
    """Writes to a stream, where that is possible: a full disk, or a reader that has gone, costs the lines and no more.

    It goes past the stream's buffers, so that nothing is left in them that would fail when the process ends.

    Args:
        stream: Where to write.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._raw = getattr(getattr(stream, "buffer", None), "raw", None)

    def write(self, text: str) -> int:
        """Write text, or lose it."""
        with contextlib.suppress(OSError):
            if self._raw is None:
                return self._stream.write(text)
            left = memoryview(text.encode("utf-8", "backslashreplace"))
            while left:
                left = left[self._raw.write(left) or len(left) :]  # None: it would block
        return len(text)

    def flush(self) -> None:
        """Hand on what a stream without a file may hold back."""
        if self._raw is None:
            with contextlib.suppress(OSError):
                self._stream.flush()


def configure(level: str = "info") -> None:
    """Send log events to stderr, from `level` on.

    Raises:
        ValueError: The level is unknown.
    """
    if level not in LEVELS:
        raise ValueError(f"log level {level!r} is unknown; known are {', '.join(LEVELS)}")
    terminal, out = sys.stderr.isatty(), Unfailing(sys.stderr)
    stamps: list[structlog.typing.Processor] = [
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="%H:%M:%S" if terminal else "iso", utc=not terminal),
    ]
    shown: list[structlog.typing.Processor] = (
        [structlog.dev.ConsoleRenderer(pad_event_to=18, exception_formatter=_TRACEBACK)]
        if terminal
        else [structlog.processors.format_exc_info, structlog.processors.JSONRenderer(ensure_ascii=False)]
    )
    structlog.configure(
        processors=[structlog.contextvars.merge_contextvars, *stamps, *shown],
        wrapper_class=structlog.make_filtering_bound_logger(LEVELS[level]),
        logger_factory=structlog.PrintLoggerFactory(file=cast("TextIO", out)),
    )
    _take_in_the_standard_library(LEVELS[level], stamps, shown, out)


def _take_in_the_standard_library(
    level: int,
    stamps: list[structlog.typing.Processor],
    shown: list[structlog.typing.Processor],
    out: Unfailing,
) -> None:
    """Give the warnings and errors of libraries, and Python's own warnings, the form of our events."""
    handler = logging.StreamHandler(out)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=[structlog.stdlib.add_logger_name, *stamps],
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *shown],
        )
    )
    root = logging.getLogger()
    others = [one for one in root.handlers if not isinstance(one.formatter, structlog.stdlib.ProcessorFormatter)]
    root.handlers = [*others, handler]
    root.setLevel(max(level, logging.WARNING))
    logging.captureWarnings(capture=True)
