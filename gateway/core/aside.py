"""Work beside other work, given up without a trace.

anyio keeps the exception of a task that its group cancels in a circle with everything that the task has, which only the
collector of garbage would end. A task that its own scope ends leaves nothing (ADR 0021).
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable

import anyio


async def until_given_up(scope: anyio.CancelScope, work: Callable[[], Awaitable[None]]) -> None:
    """Work until it is done, or until a scope is cancelled that belongs to nothing else."""
    with scope:
        await work()
