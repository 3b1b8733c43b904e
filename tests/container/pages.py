"""What config/docker/compose.yaml and docs/container.md tell people to do, as options for podman."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from tests.container.kit import ROOT

COMPOSE = ROOT / "config" / "docker" / "compose.yaml"
PAGE = ROOT / "docs" / "container.md"
# What an engine that runs one container without a network cannot follow: names, ports, restarts, where logs are kept.
_LEFT_OUT = {"image", "restart", "ports", "logging", "stop_grace_period", "pids_limit", "mem_limit"}
_LEFT_OUT_OPTIONS = {"detach", "publish", "restart", "name"}


def compose_options(folder: Path) -> list[str]:
    """The service of compose.yaml.

    Args:
        folder: Stands for the folder of compose.yaml.
    """
    yaml = pytest.importorskip("yaml")
    document = yaml.safe_load(COMPOSE.read_text("utf-8"))
    service = {key: value for key, value in document["services"]["robot-gateway"].items() if key not in _LEFT_OUT}
    files = {name: folder / secret["file"] for name, secret in document["secrets"].items()}
    health = service.pop("healthcheck")
    test = " ".join(health["test"][1:])
    options = [
        f"--user={service.pop('user')}",
        *(f"--cap-drop={name}" for name in service.pop("cap_drop")),
        *(f"--security-opt={name.removesuffix(':true')}" for name in service.pop("security_opt")),
        *(f"--volume={folder / name}" for name in service.pop("volumes")),
        *(f"--volume={files[name]}:/run/secrets/{name}:ro" for name in service.pop("secrets")),
        *(f"--tmpfs={_for_podman(name)}" for name in service.pop("tmpfs")),
        f"--health-cmd={test}",
    ]
    if service.pop("read_only"):
        options.append("--read-only")
    assert not service, f"the tests do not follow {sorted(service)} of compose.yaml"
    return options


def run_options(folder: Path) -> list[str]:
    """The first `docker run --detach` of the page.

    Args:
        folder: Stands for $PWD.
    """
    block = re.search(r"^docker run --detach(?:.*\\\n)*.*$", PAGE.read_text("utf-8"), re.MULTILINE)
    assert block, "docs/container.md has no docker run --detach"
    words = shlex.split(block[0].replace("\\\n", " ").replace("$PWD", str(folder)))
    assert words[:2] == ["docker", "run"]
    assert words[-1].startswith("robot-gateway:")
    options, left = [], words[2:-1]
    while left:
        name = left.pop(0)
        assert name.startswith("--")
        values = [left.pop(0)] if left and not left[0].startswith("--") else []
        if name.removeprefix("--") not in _LEFT_OUT_OPTIONS:
            options.append("=".join([name, *map(_for_podman, values)]))
    return options


def _for_podman(value: str) -> str:
    """Podman knows no owner of a tmpfs but the user of the container, who is the one that the pages name."""
    return value.replace("uid=10001,gid=10001", "U")
