"""Logging set-up: readable lines on a terminal, JSON otherwise. Imported by `cli` and `app` only.

What libraries log with the standard library, from warnings on, takes the same form.
"""

from __future__ import annotations

import logging
import sys

import structlog

LEVELS = {"debug": logging.DEBUG, "info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}


def configure(level: str = "info") -> None:
    """Send log events to stderr, from `level` on.

    Raises:
        ValueError: The level is unknown.
    """
    if level not in LEVELS:
        raise ValueError(f"log level {level!r} is unknown; known are {', '.join(LEVELS)}")
    terminal = sys.stderr.isatty()
    stamps: list[structlog.typing.Processor] = [
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="%H:%M:%S" if terminal else "iso", utc=not terminal),
    ]
    shown: list[structlog.typing.Processor] = (
        [structlog.dev.ConsoleRenderer(pad_event_to=18)]
        if terminal
        else [structlog.processors.format_exc_info, structlog.processors.JSONRenderer(ensure_ascii=False)]
    )
    structlog.configure(
        processors=[structlog.contextvars.merge_contextvars, *stamps, *shown],
        wrapper_class=structlog.make_filtering_bound_logger(LEVELS[level]),
        logger_factory=structlog.PrintLoggerFactory(file=sys.stderr),
    )
    _take_in_the_standard_library(LEVELS[level], stamps, shown)


def _take_in_the_standard_library(
    level: int, stamps: list[structlog.typing.Processor], shown: list[structlog.typing.Processor]
) -> None:
    """Give the warnings and errors of libraries, and Python's own warnings, the form of our events."""
    handler = logging.StreamHandler(sys.stderr)
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
