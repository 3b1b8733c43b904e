"""What a new configuration would change in a gateway that runs: compared by the settings as understood, not as written.

Nothing is done here, and nothing is asked: whoever applies a plan says which robots hold a session.
"""

from __future__ import annotations

import dataclasses
import json
import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import msgspec

from gateway.config.exports import ExportSettings
from gateway.config.file import Config
from gateway.config.keys import canonical
from gateway.config.printing import as_toml, toml_value
from gateway.core.settings import BrokenRobot, RobotSettings

Robot = RobotSettings | BrokenRobot
Keys = Mapping[str, str]
What = Literal["added", "changed", "removed"]

# Keys of [server] whose values are nobody's business, and those that are read at the start only.
SECRET = ("tokens", "tls.certificate", "tls.key")
AT_START = {"control": "the control socket moves when the gateway is started again"}
RECORDER_AT_START = {"enabled": "the recorder comes or goes when the gateway is started again"}
_SESSION = (
    "holds a session that must not be dropped, because its controller may stop the robot when it ends; "
    "the old settings stay until it ends by itself, or until: robot-gateway reload --drop {name}"
)
_NEIGHBOUR = "waits for {other}, which is still connected to the same controller"
_PLUGINS = "the code of plugins that are loaded already stays as it is"


class KeyChange(msgspec.Struct, frozen=True, kw_only=True):
    """One key with another value.

    Attributes:
        key: Its name, with that of its table.
        before: As it would be printed; None: not set, or a secret.
        after: The same, from now on.
    """

    key: str
    before: str | None = None
    after: str | None = None


class RobotChange(msgspec.Struct, frozen=True, kw_only=True):
    """One robot that comes, goes or changes.

    Attributes:
        name: Of the robot.
        title: What it is, in words.
        keys: What changes of it; empty where it comes or goes.
    """

    name: str
    title: str
    keys: list[KeyChange] = []


class Held(RobotChange, frozen=True, kw_only=True):
    """One robot whose change waits.

    Attributes:
        what: What would happen to it.
        reason: Why it does not, and what to do.
    """

    what: What
    reason: str


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """What changes.

    Attributes:
        added: Robots that come.
        removed: Robots that go.
        changed: Robots that are connected anew with other settings.
        held: Robots whose change waits.
        unchanged: How many robots notice nothing.
        doors: Keys of `[server]`.
        exports: Keys of `[export]`.
        recorder: Keys of `[recorder]`.
        restart: What does not change before the gateway is started again.
        warnings: What is worth knowing of the new configuration.
    """

    added: list[RobotChange] = []
    removed: list[RobotChange] = []
    changed: list[RobotChange] = []
    held: list[Held] = []
    unchanged: int = 0
    doors: list[KeyChange] = []
    exports: list[KeyChange] = []
    recorder: list[KeyChange] = []
    restart: list[str] = []
    warnings: list[str] = []

    @property
    def stopped(self) -> list[str]:
        """The robots whose links end."""
        return [robot.name for robot in (*self.removed, *self.changed)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Understood:
    """A configuration as it is understood: every default filled in, each value as it is printed.

    Attributes:
        robots: Keys of each robot, by its name.
        doors: Keys of `[server]`.
        recorder: Keys of `[recorder]`.
        vendor_dirs: The folders of further plugins.
        content: What stands in the files that `[server]` names; compared and never shown.
        exports: Keys of `[export]`.
        export: What they and their files say; compared and never shown.
    """

    robots: Mapping[str, Keys]
    doors: Keys
    recorder: Keys
    vendor_dirs: str
    content: Mapping[str, object]
    exports: Keys
    export: ExportSettings


def understand(config: Config) -> Understood:
    """Read a configuration as it would be printed."""
    printed = tomllib.loads(as_toml(config))
    robots = {str(table["name"]): dict(_flat(table)) for table in printed.get("robots", [])}
    return Understood(
        robots=robots,
        doors=dict(_flat(printed["server"])),
        recorder=dict(_flat(printed["recorder"])),
        vendor_dirs=toml_value(printed["vendor_dirs"]),
        content=_content(config),
        exports=dict(_flat(printed.get("export", {}))),
        export=config.export,
    )


def diff(running: Understood, new: Understood, holding: Collection[str]) -> Plan:
    """What a new configuration would change.

    Args:
        running: What runs now.
        new: What is asked for.
        holding: Robots with an open session that must not be dropped.
    """
    before, after = running.robots, new.robots
    plan = Plan(
        added=[_robot(name, after[name]) for name in after if name not in before],
        removed=[_robot(name, before[name]) for name in before if name not in after],
        changed=[
            _robot(name, after[name], _changes(before[name], after[name]))
            for name in after
            if name in before and before[name] != after[name]
        ],
        unchanged=sum(before.get(name) == keys for name, keys in after.items()),
        doors=_doors(running, new),
        exports=_exports(running, new),
        recorder=[one for one in _changes(running.recorder, new.recorder) if one.key not in RECORDER_AT_START],
        restart=_restart(running, new),
    )
    return _held_back(plan, before, after, holding)


def effective(plan: Plan, running: Mapping[str, Robot], new: Iterable[Robot]) -> list[Robot]:
    """The robots that shall run by a plan: the new ones, and in the place of each that waits what runs now."""
    held = {one.name: one.what for one in plan.held}
    over = {name for name in held if held[name] == "removed"}
    changes = {robot.name for robot in (*plan.added, *plan.changed)}
    return [
        *(robot if robot.name in changes else running[robot.name] for robot in new if held.get(robot.name) != "added"),
        *(robot for name, robot in running.items() if name in over),
    ]


def as_run(plan: Plan, running: Understood, new: Understood) -> Understood:
    """What is understood of a gateway by which a plan has been carried out."""
    held = {one.name: one.what for one in plan.held}
    robots = {name: keys for name, keys in new.robots.items() if name not in held}
    robots.update({name: running.robots[name] for name, what in held.items() if what != "added"})
    kept = {key: running.doors[key] for key in AT_START if key in running.doors}
    doors = {key: value for key, value in new.doors.items() if key not in AT_START} | kept
    recorder = {**new.recorder, **{key: running.recorder[key] for key in RECORDER_AT_START}}
    return dataclasses.replace(new, robots=robots, doors=doors, recorder=recorder)


def _held_back(plan: Plan, before: Mapping[str, Keys], after: Mapping[str, Keys], holding: Collection[str]) -> Plan:
    """Take out of a plan what would drop a session, and who would disturb it."""
    leaving: list[tuple[What, list[RobotChange]]] = [("changed", plan.changed), ("removed", plan.removed)]
    coming: list[tuple[What, list[RobotChange]]] = [("added", plan.added), ("changed", plan.changed)]
    held = [
        _held(robot, what, _SESSION.format(name=robot.name))
        for what, robots in leaving
        for robot in robots
        if robot.name in holding
    ]
    at = {_address(before[one.name]): one.name for one in held}
    waiting = [(what, robot) for what, robots in coming for robot in robots if robot.name not in holding]
    while late := [one for one in waiting if _address(after[one[1].name]) in at]:
        # who waits stays where it is, and others may be about to take that place
        waiting = [one for one in waiting if one not in late]
        held += [_held(robot, what, _NEIGHBOUR.format(other=at[_address(after[robot.name])])) for what, robot in late]
        at |= {_address(before[robot.name]): robot.name for what, robot in late if what == "changed"}
    names = {one.name for one in held}
    return msgspec.structs.replace(
        plan,
        held=held,
        added=[robot for robot in plan.added if robot.name not in names],
        removed=[robot for robot in plan.removed if robot.name not in names],
        changed=[robot for robot in plan.changed if robot.name not in names],
    )


def _held(robot: RobotChange, what: What, reason: str) -> Held:
    return Held(name=robot.name, title=robot.title, keys=robot.keys, what=what, reason=reason)


def _address(keys: Keys) -> tuple[str, str | None]:
    return canonical(json.loads(keys["host"])), keys.get("port")


def _robot(name: str, keys: Keys, changes: list[KeyChange] | None = None) -> RobotChange:
    words = [json.loads(keys[key]) for key in ("vendor", "protocol") if key in keys]
    port = f" port {keys['port']}" if "port" in keys else ""
    return RobotChange(name=name, title=f"{' '.join(words)} at {json.loads(keys['host'])}{port}", keys=changes or [])


def _changes(before: Keys, after: Keys) -> list[KeyChange]:
    names = dict.fromkeys([*before, *after])
    return [
        KeyChange(key=key, before=before.get(key), after=after.get(key))
        for key in names
        if before.get(key) != after.get(key)
    ]


def _doors(running: Understood, new: Understood) -> list[KeyChange]:
    """The keys of `[server]` that change; of a secret no more than that it does."""
    changes = [one for one in _changes(running.doors, new.doors) if one.key not in AT_START]
    named = {one.key for one in changes}
    content = [key for key, value in new.content.items() if value != running.content.get(key) and key not in named]
    shown = [KeyChange(key=one.key) if one.key in SECRET else one for one in changes]
    return [*shown, *(KeyChange(key=key) for key in content)]


def _exports(running: Understood, new: Understood) -> list[KeyChange]:
    """The keys of `[export]` that change; of a file that a key names no more than that it does."""
    changes = _changes(running.exports, new.exports)
    return changes if changes or running.export == new.export else [KeyChange(key="nats.credentials")]


def _restart(running: Understood, new: Understood) -> list[str]:
    told = [f"server.{key}: {why}" for key, why in AT_START.items() if running.doors.get(key) != new.doors.get(key)]
    told += [
        f"recorder.{key}: {why}"
        for key, why in RECORDER_AT_START.items()
        if running.recorder.get(key) != new.recorder.get(key)
    ]
    if running.vendor_dirs != new.vendor_dirs:
        told.append(f"vendor_dirs: {_PLUGINS}; new ones are loaded")
    return told


def _flat(table: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", toml_value(value)


def _content(config: Config) -> dict[str, object]:
    return {"tokens": config.tokens}
