"""Something that is done on the running loop again and again."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def repeating(period_s: float, call: Callable[[], None]) -> Iterator[None]:
    """Call something for as long as the context lasts, the first time after one period.

    Args:
        period_s: From the end of a call to the next one.
        call: It must return at once.
    """
    loop = asyncio.get_running_loop()
    timer: asyncio.TimerHandle

    def on_timer() -> None:
        nonlocal timer
        try:
            call()
        finally:
            timer = loop.call_later(period_s, on_timer)

    timer = loop.call_later(period_s, on_timer)
    try:
        yield
    finally:
        timer.cancel()
