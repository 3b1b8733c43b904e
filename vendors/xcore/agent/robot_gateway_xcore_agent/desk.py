"""Takes the gateway's commands on one thread, has them carried out on another, and answers each exactly once."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Callable, Deque, List, NamedTuple, Optional

from robot_gateway_xcore_agent import sdk
from robot_gateway_xcore_agent.commands import LONGEST_ID, Args, Command, RefusedError, checked
from robot_gateway_xcore_agent.lines import Members, TooLongError, line
from robot_gateway_xcore_agent.reader import Reader
from robot_gateway_xcore_agent.worker import Worker


def refusal(identifier: str, error: str, message: str) -> Members:
    """Make the result of a command that the agent did not carry out."""
    return {"id": identifier, "ok": False, "ec": 0, "message": message, "error": error}


class _Job(NamedTuple):
    identifier: str
    name: str
    command: Command
    args: Args
    deadline: float


class Desk:
    """Takes commands on the stream's thread, carries them out on the worker's, and answers each exactly once.

    Args:
        reader: What reads the robot; None if the agent makes no calls.
        worker: The thread that calls.
        wake: Tells the stream that there is a result.
        most: How many commands may be outstanding.
        timeout_s: Seconds from a command to its result at the latest.
    """

    def __init__(
        self,
        reader: Optional[Reader],
        worker: Optional[Worker],
        wake: Callable[[], None],
        *,
        most: int = 8,
        timeout_s: float = 5.0,
    ) -> None:
        self._reader = reader
        self._worker = worker
        self._wake = wake
        self._most = most
        self._timeout_s = timeout_s
        self._lock = threading.Lock()
        self._open: List[_Job] = []
        self._results: Deque[Members] = deque()

    def take(self, message: Members) -> None:
        """Take one command; its result comes from `results`, now or later."""
        identifier = message.get("id")
        if not isinstance(identifier, str) or len(identifier) > LONGEST_ID:
            text = f"id must be a text of at most {LONGEST_ID} characters"
            self._results.append(refusal("", "bad_request", text))
            return
        try:
            self._queue(identifier, message)
        except RefusedError as error:
            self._results.append(refusal(identifier, error.error, str(error)))

    def _queue(self, identifier: str, message: Members) -> None:
        name, command, args = checked(message)
        if self._reader is None or self._worker is None:
            raise RefusedError(
                "unsupported", "this tap makes no calls of its own: it was started without a state period"
            )
        if not hasattr(self._reader.robot, name):
            raise RefusedError("unsupported", "this robot has no such call")
        hanging = self._worker.overdue
        if hanging is not None:
            raise RefusedError("busy", f"{hanging.name} has not returned")
        with self._lock:
            if len(self._open) >= self._most:
                raise RefusedError("busy", f"{self._most} commands are outstanding")
            job = _Job(identifier, name, command, args, time.monotonic() + self._timeout_s)
            self._open.append(job)
        self._worker.do(lambda: self._carry_out(job))

    def _carry_out(self, job: _Job) -> None:
        if self._reader is None or not self._is_open(job):
            return
        result: Members
        try:
            answer, encoded = job.command.carry(self._reader, job.args)
            result = {"id": job.identifier, "ok": answer.ok, "ec": answer.ec, "message": answer.message}
            if answer.ok:
                result["value"] = encoded(answer.value)
            line({"type": "result", **result})
        except TooLongError as error:
            result = refusal(job.identifier, "range", str(error))
        except Exception as error:  # noqa: BLE001 - an object that is not what the SDK documents
            text = f"{type(error).__name__}: {error}"
            result = {"id": job.identifier, "ok": False, "ec": sdk.FAILED, "message": text[:500]}
        self._answer(job, result)

    def _is_open(self, job: _Job) -> bool:
        with self._lock:
            return any(job is other for other in self._open)

    def _answer(self, job: _Job, result: Members) -> None:
        with self._lock:
            left = [other for other in self._open if other is not job]
            if len(left) == len(self._open):
                return  # answered already: it was too late
            self._open = left
            self._results.append(result)
        self._wake()

    def results(self, now: float) -> List[Members]:
        """Give the results that have come, and those of commands that are past their deadline.

        Args:
            now: Seconds of time.monotonic().
        """
        with self._lock:
            late = [job for job in self._open if now > job.deadline]
            self._open = [job for job in self._open if now <= job.deadline]
        for job in late:
            text = f"{job.name} has not returned in {self._timeout_s:g} s"
            self._results.append(refusal(job.identifier, "timeout", text))
        found = []
        while self._results:
            found.append(self._results.popleft())
        return found

    def forget(self) -> None:
        """Drop everything that a connection asked for: it is gone."""
        with self._lock:
            self._open = []
            self._results.clear()
