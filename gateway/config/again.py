"""Reads the configuration of a gateway that runs once more. Plugins that are loaded stay the objects that they are."""

from __future__ import annotations

import tomllib
from pathlib import Path

from gateway.config.file import Config, load
from gateway.core.registry import Registry
from gateway.core.settings import RobotSettings
from gateway.errors import ConfigError, UnknownVendor


def load_again(running: Config) -> Config:
    """Read the file of a running configuration again.

    Where its `vendor_dirs` are the same, so is the registry. Other folders may bring new plugins, but none in the place
    of one that is loaded: code is exchanged by a restart.

    Raises:
        ConfigError: It cannot be used, with everything that is wrong.
    """
    file = Path(running.file)
    dirs = _vendor_dirs(file)
    if dirs is None or dirs == running.vendor_dirs:
        return load(file, running.registry)
    try:
        registry = Registry(dirs)
    except ConfigError:
        return load(file)  # raises the same, with the lines
    loaded = {robot.vendor.name for robot in running.robots if isinstance(robot, RobotSettings)}
    moved = [
        f"{file}: vendor_dirs: the plugin {name} is loaded from {running.registry.source(name)}, and would now come "
        f"from {source}: restart the gateway to exchange the code of a plugin"
        for name in sorted(loaded)
        if (source := _source(registry, name)) not in {None, running.registry.source(name)}
    ]
    if moved:
        raise ConfigError(*moved)
    return load(file, registry)


def _vendor_dirs(file: Path) -> tuple[Path, ...] | None:
    """The folders that a file names; None where it is so wrong that `load` has to say it."""
    try:
        named = tomllib.loads(file.read_text("utf-8-sig")).get("vendor_dirs", [])
    except (OSError, ValueError):
        return None
    if not isinstance(named, list) or not all(isinstance(one, str) for one in named):
        return None
    return tuple(file.absolute().parent / Path(one).expanduser() for one in named)


def _source(registry: Registry, name: str) -> str | None:
    try:
        return registry.source(name)
    except UnknownVendor:
        return None
