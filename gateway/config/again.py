"""Reads the configuration of a gateway that runs once more. Plugins that are loaded stay the objects that they are."""

from __future__ import annotations

import dataclasses
import os
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path

from gateway.config.file import Config, load
from gateway.config.tokens import secret_file
from gateway.core.registry import Registry
from gateway.core.settings import RobotSettings
from gateway.errors import ConfigError, UnknownVendor


def load_again(running: Config, env: Mapping[str, str] = os.environ) -> Config:
    """Read the file of a running configuration again.

    Where its `vendor_dirs` are the same, so is the registry. Other folders may bring new plugins, but none in the place
    of one that is loaded: code is exchanged by a restart.

    Args:
        running: What runs.
        env: Where secrets may be found that cannot be read at their path.

    Raises:
        ConfigError: It cannot be used, with everything that is wrong.
    """
    config = _loaded(running, env)
    return dataclasses.replace(config, warnings=(*config.warnings, *_copies(config, env)))


def _copies(config: Config, env: Mapping[str, str]) -> Iterator[str]:
    """Say which secrets are copies that the service manager made at the start: a reload reads no others."""
    server, folder = config.server, Path(config.file).absolute().parent
    for key, named in (("tokens", server.tokens), ("tls", None if server.tls is None else server.tls.certificate)):
        path = folder / Path(named).expanduser() if named is not None else None
        if path is not None and secret_file(path, env) != path:
            yield (
                f"{config.file}: server.{key}: what has changed in {path} since the service was started counts after a "
                "restart: systemctl restart robot-gateway"
            )


def _loaded(running: Config, env: Mapping[str, str]) -> Config:
    file = Path(running.file)
    if _is_blank(file):
        raise ConfigError(f"{file}: is empty: perhaps it was being written; without robots it needs at least [server]")
    dirs = _vendor_dirs(file)
    if dirs is None or dirs == running.vendor_dirs:
        return load(file, running.registry, env)
    try:
        registry = Registry(dirs)
    except ConfigError:
        return load(file, env=env)  # raises the same, with the lines
    loaded = {robot.vendor.name for robot in running.robots if isinstance(robot, RobotSettings)}
    moved = [
        f"{file}: vendor_dirs: the plugin {name} is loaded from {running.registry.source(name)}, and would now come "
        f"from {source}: restart the gateway to exchange the code of a plugin"
        for name in sorted(loaded)
        if (source := _source(registry, name)) not in {None, running.registry.source(name)}
    ]
    if moved:
        raise ConfigError(*moved)
    return load(file, registry, env)


def _is_blank(file: Path) -> bool:
    """Whether nothing stands in a file: one that is being written must not take every robot away."""
    try:
        return not file.read_bytes().strip()
    except OSError:
        return False  # `load` says it


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
