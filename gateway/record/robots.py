"""The robots of a recording: as they were configured when it was made, or as another configuration has them."""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from gateway.config import Config, load, parse
from gateway.config.printing import toml_value
from gateway.core.registry import Registry
from gateway.core.settings import BrokenRobot, RobotSettings
from gateway.errors import ConfigError, VendorError
from gateway.record.reading import Recording


@dataclass(frozen=True, slots=True)
class Robots:
    """The robots of a recording.

    Attributes:
        usable: Those that can be replayed, by name.
        left_out: Why the others cannot, by name.
    """

    usable: dict[str, RobotSettings] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)

    def add(self, name: str, robot: RobotSettings | BrokenRobot | str) -> None:
        """Add a robot, or the reason why it cannot be replayed."""
        if isinstance(robot, RobotSettings):
            self.usable[name] = robot
        else:
            self.left_out[name] = robot if isinstance(robot, str) else str(robot.error)


def robots_of(
    recording: Recording,
    *,
    names: Collection[str] = (),
    config: Path | None = None,
    vendor_dirs: Collection[Path] = (),
    registry: Registry | None = None,
) -> Robots:
    """Find the robots of a recording.

    The folders of plugins that the recording names are not used: whoever sends a file would choose what is run here.

    Args:
        recording: The recording.
        names: Only these; none: all.
        config: A configuration whose robots, folders of plugins and options take the place of the recorded ones.
        vendor_dirs: Further folders of plugins.
        registry: Used instead of one for all these folders.

    Raises:
        ConfigError: The configuration, or a folder, cannot be used.
        KeyError: The recording holds no bytes of a robot that is named.
    """
    for name in names:
        if name not in recording.names:
            raise KeyError(name)
    other = load(config) if config is not None else None
    registry = registry or Registry([*(other.vendor_dirs if other else ()), *vendor_dirs])
    there = {robot.name: robot for robot in other.robots} if other else {}
    tables = dict(_tables(recording.robots))
    found = Robots()
    for name in names or recording.names:
        found.add(name, there.get(name) or _recorded(recording.robots, tables.get(name), registry))
    return found


def robots_in(text: str, registry: Registry) -> Robots:
    """The robots of a recorded configuration, each for itself: one that cannot be used costs no other.

    Args:
        text: TOML.
        registry: Where their plugins are found.
    """
    found = Robots()
    for name, table in _tables(text):
        found.add(name, _recorded(text, table, registry))
    return found


def _tables(text: str) -> Iterator[tuple[str, Mapping[str, object]]]:
    """The recorded entries of the robots, by name."""
    try:
        robots = tomllib.loads(text).get("robots", [])
    except tomllib.TOMLDecodeError:
        return
    for robot in robots if isinstance(robots, list) else []:
        if isinstance(robot, dict) and isinstance(robot.get("name"), str):
            yield robot["name"], robot


def _recorded(text: str, table: Mapping[str, object] | None, registry: Registry) -> RobotSettings | BrokenRobot | str:
    """A robot as a configuration has it; else why it cannot be replayed."""
    if table is None:
        return "the recording does not say how it was configured: give a configuration that has it with --config"
    vendor = table.get("vendor")
    if isinstance(vendor, str) and vendor not in registry.names():
        known = ", ".join(registry.names())
        folders = _folders(text)
        where = f"; it was recorded with vendor_dirs = {toml_value(folders)}" if folders else ""
        return (
            f"its vendor {vendor!r} is not installed here, known are {known}{where}: "
            "name the folder that holds it with --vendor-dir, or a configuration with --config"
        )
    lines = [f"{_key(key)} = {toml_value(value)}" for key, value in table.items()]
    try:
        config: Config = parse("\n".join(["[[robots]]", *lines, ""]), "recorded", registry)
    except (ConfigError, VendorError) as error:
        told = "; ".join(str(error).splitlines())
        return f"it cannot be used as it was recorded: {told}; give other options with --config"
    return config.robots[0]


def _folders(text: str) -> list[str]:
    try:
        folders = tomllib.loads(text).get("vendor_dirs", [])
    except tomllib.TOMLDecodeError:
        return []
    return [str(folder) for folder in folders] if isinstance(folders, list) else []


def _key(key: str) -> str:
    return key if key.isascii() and key.replace("-", "_").isidentifier() else toml_value(key)
