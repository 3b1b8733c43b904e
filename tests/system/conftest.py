"""The package and the Debian are made once for all tests here; each file of tests boots a machine of its own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.system import kit


@pytest.fixture(scope="session")
def debian() -> Path:
    """The root folder of a Debian."""
    return kit.rootfs()


@pytest.fixture(scope="session")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Debian package of this checkout."""
    return kit.build_package(tmp_path_factory.mktemp("package"))


@pytest.fixture(scope="module")
def machine(debian: Path, package: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[kit.Machine]:
    """A booted machine that sees the package, but has not installed it."""
    with kit.booted(debian, tmp_path_factory.mktemp("console"), package.parent) as booted:
        yield booted
