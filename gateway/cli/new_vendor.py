"""`robot-gateway new-vendor`: the folder of a new plugin, whose conformance run says what to fill in."""

from __future__ import annotations

import importlib.util
import keyword
import re
import shutil
from pathlib import Path
from string import Template
from typing import Annotated

import typer

from gateway.cli.common import FAILURE, USAGE, fail
from gateway.core.registry import PACKAGE, Registry, unsafe

NAME = re.compile(r"[a-z][a-z0-9_]{0,31}")
_TEMPLATES = Path(__file__).parents[1] / "scaffold"
_SUFFIX = ".txt"  # the templates are no modules yet: no linter or importer takes them for such
# Whatever the umask: the gateway refuses plugins that others may write to.
_FOLDER_MODE, _FILE_MODE = 0o755, 0o644


def new_vendor(
    name: Annotated[str, typer.Argument(help="Name of the plugin: lower-case letters, digits and _.", metavar="NAME")],
    *,
    into: Annotated[
        Path | None,
        typer.Option(
            help="The folder of plugins (vendor_dirs) to write it into. Default: `vendors` of the checkout here.",
            metavar="DIR",
        ),
    ] = None,
) -> None:
    """Write the folder of a new vendor's plugin.

    It can be imported at once. `robot-gateway vendor-check` then says what to fill in, file by file; docs/vendors.md
    walks through a whole one.

    Exit codes: 0 written; 1 it cannot be written; 2 wrong name, or no folder to write it into.

    Example: robot-gateway new-vendor kilo

    Example: robot-gateway new-vendor kilo --into ./my-vendors
    """
    _check_name(name)
    parent = _checkout() if into is None else _folder(into)
    folder = parent / name
    if folder.exists() or folder.is_symlink():
        fail(f"{folder} is there already: take another name, or remove it", USAGE)
    registry = Registry()
    if name in registry.names():
        fail(f"a vendor {name} is there already ({registry.source(name)}): take another name", USAGE)
    try:
        written = write(folder, name)
    except OSError as error:
        fail(f"{error.filename or folder} cannot be written: {error.strerror}", FAILURE)
    typer.echo(f"{folder}: {', '.join(written)}")
    where = "" if into is None else f" --vendor-dir {into}"
    typer.echo(f"What to fill in, file by file: robot-gateway vendor-check {name}{where}")


def write(folder: Path, name: str) -> list[str]:
    """Write the files of a new plugin into a folder that is not there yet; all of them or none.

    Returns:
        The names of the files.

    Raises:
        OSError: One cannot be written.
    """
    words = {"name": name, "title": name.replace("_", " ").title()}
    folder.mkdir()
    try:
        folder.chmod(_FOLDER_MODE)
        files = sorted(_TEMPLATES.glob(f"*{_SUFFIX}"))
        for template in files:
            file = folder / template.name.removesuffix(_SUFFIX)
            file.write_text(Template(template.read_text("utf-8")).substitute(words), "utf-8")
            file.chmod(_FILE_MODE)
    except OSError:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return [template.name.removesuffix(_SUFFIX) for template in files]


def _check_name(name: str) -> None:
    if not NAME.fullmatch(name):
        fail(f"{name!r} is no name of a plugin: a lower-case letter, then up to 31 letters, digits and _", USAGE)
    if keyword.iskeyword(name):
        fail(f"{name!r} is a word of Python, no name of a module: take another one", USAGE)


def _checkout() -> Path:
    """The package of the vendors, where the command runs in a checkout."""
    here = Path.cwd() / PACKAGE
    spec = importlib.util.find_spec(PACKAGE)
    places = spec.submodule_search_locations if spec is not None else None
    if not here.is_dir() or here.resolve() not in [Path(place).resolve() for place in places or ()]:
        fail(f"{Path.cwd()} is no checkout of the gateway: go there, or name a folder of plugins with --into", USAGE)
    return here


def _folder(into: Path) -> Path:
    """A folder of plugins: made where it is missing, and safe to load from."""
    try:
        if not into.exists():
            into.mkdir()
            into.chmod(_FOLDER_MODE)
    except OSError as error:
        fail(f"--into {into}: it cannot be made: {error.strerror}", FAILURE)
    if faults := unsafe(into):
        fail(f"--into {faults[0]}", USAGE)
    return into
