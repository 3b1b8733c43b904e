"""What attends a running gateway: the triggers of a reload, the control socket, and word to the service manager."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Collection, Mapping
from contextlib import asynccontextmanager
from typing import Protocol

import anyio
import anyio.to_thread
import msgspec
import structlog

from gateway.api.messages import RecorderInfo, RobotInfo
from gateway.config import Config
from gateway.config.again import load_again
from gateway.config.diff import Plan
from gateway.errors import ConfigError, GatewayError
from gateway.notify import Notifier, status_line
from gateway.record.recorder import Recorder
from gateway.recording import commands as of_recorder
from gateway.server.control import Command, ControlError, control_path, controlled

_LOG = structlog.get_logger()
WRONG_CONFIGURATION = "WRONG_CONFIGURATION"
NOT_APPLIED = "NOT_APPLIED"
UNKNOWN_ROBOT = "UNKNOWN_ROBOT"


class Reload(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="command", tag="reload"):
    """Read the configuration again and carry out what has changed.

    Attributes:
        check: Only say what would be done.
        drop: Robots whose sessions are dropped although they must not be.
    """

    check: bool = False
    drop: list[str] = []


class Reloadable(Protocol):
    """A gateway, as its attendants see it."""

    @property
    def config(self) -> Config:
        """What it runs."""
        ...

    @property
    def recorder(self) -> Recorder | None:
        """Its recorder; None: it is off."""
        ...

    def infos(self) -> list[RobotInfo]:
        """Every robot with the state of its link."""
        ...

    async def reload(self, config: Config, *, drop: Collection[str] = (), check: bool = False) -> Plan:
        """Take another configuration."""
        ...


class Reloader:
    """Reads the configuration of a gateway again, one time after the other.

    Args:
        gateway: Whose.
        notifier: Who is told when it begins and ends.
    """

    def __init__(self, gateway: Reloadable, notifier: Notifier) -> None:
        self._gateway = gateway
        self._notifier = notifier
        self._one_at_a_time = anyio.Lock()

    async def command(self, request: Reload) -> Plan:
        """Carry out a command.

        Raises:
            ControlError: Nothing has changed; it says why.
        """
        async with self._one_at_a_time:
            if request.check:
                return await self._reload(request)
            self._notifier.reloading()
            try:
                return await self._reload(request)
            finally:
                self._notifier.ready()

    async def on_signal(self) -> None:
        """The same without anybody to answer: the log says what has come of it."""
        try:
            await self.command(Reload())
        except ControlError:
            return  # which is logged
        except Exception:  # noqa: BLE001 - a mistake in a reload must not end the gateway
            _LOG.exception("reload.failed")

    async def _reload(self, request: Reload) -> Plan:
        try:
            config = await anyio.to_thread.run_sync(load_again, self._gateway.config, abandon_on_cancel=True)
            self._check_names(request.drop, config)
            plan = await self._gateway.reload(config, drop=request.drop, check=request.check)
        except ControlError:
            raise
        except ConfigError as error:
            raise _refused(WRONG_CONFIGURATION, "the configuration is wrong: nothing has changed", error) from error
        except GatewayError as error:
            raise _refused(NOT_APPLIED, f"nothing has changed: {error}", error) from error
        if not request.check:
            _log(plan)
        return plan

    def _check_names(self, names: Collection[str], config: Config) -> None:
        known = {robot.name for robot in (*config.robots, *self._gateway.config.robots)}
        unknown = [name for name in names if name not in known]
        if unknown:
            raise ControlError(UNKNOWN_ROBOT, f"there is no robot {unknown[0][:40]!r}: nothing has changed")


@asynccontextmanager
async def attended(
    gateway: Reloadable, notifier: Notifier, env: Mapping[str, str]
) -> AsyncIterator[Callable[[], None]]:
    """Attend a running gateway for as long as the context lasts.

    Args:
        gateway: Whom.
        notifier: Who is told how it is.
        env: The environment.

    Yields:
        What to call at SIGHUP.
    """
    reloader = Reloader(gateway, notifier)
    path = control_path(gateway.config.server.control, env)
    commands = {"reload": Command(Reload, reloader.command), **of_recorder(gateway.recorder)}
    async with controlled(path, commands), anyio.create_task_group() as tasks:
        tasks.start_soon(notifier.feed_watchdog)
        tasks.start_soon(notifier.keep_telling, lambda: status_line(gateway.infos(), _recorder(gateway)))

        def on_hangup() -> None:
            tasks.start_soon(reloader.on_signal)

        yield on_hangup
        tasks.cancel_scope.cancel()


def _recorder(gateway: Reloadable) -> RecorderInfo | None:
    return None if gateway.recorder is None else gateway.recorder.info


def _refused(code: str, message: str, error: GatewayError) -> ControlError:
    problems = error.problems if isinstance(error, ConfigError) else [str(error)]
    _LOG.error("reload.refused", reason="; ".join(problems))
    return ControlError(code, message, problems)


def _log(plan: Plan) -> None:
    _LOG.info(
        "reload.applied",
        added=len(plan.added),
        removed=len(plan.removed),
        changed=len(plan.changed),
        unchanged=plan.unchanged,
        held=[one.name for one in plan.held],
        doors=[one.key for one in plan.doors],
        recorder=[one.key for one in plan.recorder],
    )
    for one in plan.held:
        _LOG.warning("reload.held", robot=one.name, reason=one.reason)
    for told in (*plan.restart, *plan.warnings):
        _LOG.warning("reload.noted", reason=told)
