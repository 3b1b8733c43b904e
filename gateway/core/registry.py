"""Finds the vendors and loads them by name: the only module that ever imports a plugin.

A plugin is a folder with an `__init__.py` that exports `VENDOR`. It stands in the package `vendors`, in a folder that
the configuration names in `vendor_dirs`, or in an installed package that the entry-point group
`robot_gateway.vendors` lists as `kilo = "package.of.kilo"`. A folder `DIR/kilo` is loaded under the name
`vendors.kilo`, so its own modules say `from vendors.kilo.layouts import ...` wherever the folder stands; `DIR` itself
becomes part of no search path.
"""

from __future__ import annotations

import contextlib
import difflib
import importlib
import importlib.metadata
import importlib.util
import os
import stat
import sys
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from gateway.api.normaliser import Normaliser
from gateway.api.vendor import ROBOT_OPTIONS, Protocol, Vendor
from gateway.errors import ConfigError, UnknownVendor, VendorError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from types import ModuleType

PACKAGE = "vendors"
ENTRY_POINTS = "robot_gateway.vendors"
BUILT_IN = "built in"
_SYSTEM_PARTS = 2  # / and what stands right below it belong to the system


@dataclass(frozen=True, slots=True)
class Place:
    """Where a plugin was found.

    Args:
        module: The name that it is imported under.
        source: Who brings it, in words: built in, a folder, an installed package.
        folder: Its folder; None where an installed package must be asked.
        foreign: Stands in a folder of `vendor_dirs`.
    """

    module: str
    source: str
    folder: Path | None = None
    foreign: bool = False

    def __str__(self) -> str:
        return f"{self.module} ({self.source})" if self.folder is None else str(self.folder)


class Registry:
    """Every vendor that this gateway can load; what is not asked for is not imported.

    Args:
        dirs: Folders of further plugins.

    Raises:
        ConfigError: A folder does not exist, or others may write to it: each problem starts with its path.
    """

    def __init__(self, dirs: Sequence[Path] = ()) -> None:
        resolved = list(dict.fromkeys(path.expanduser().resolve() for path in dirs))
        problems = [problem for path in resolved for problem in unsafe(path)]
        if problems:
            raise ConfigError(*problems)
        self._places: dict[str, list[Place]] = {}
        for name, place in (*_built_in(), *_in_dirs(resolved), *_installed()):
            self._places.setdefault(name, []).append(place)
        self._vendors: dict[str, Vendor | VendorError] = {}

    def names(self) -> list[str]:
        """The names of all plugins, sorted; none is imported for it."""
        return sorted(self._places)

    def vendor(self, name: str) -> Vendor:
        """Load a plugin, once.

        Raises:
            UnknownVendor: There is none of that name.
            VendorError: It cannot be loaded or exports no valid `VENDOR`; asked again, it says the same.
        """
        self._place(name)
        if name not in self._vendors:
            try:
                self._vendors[name] = self._load(name)
            except VendorError as error:
                self._vendors[name] = error
        found = self._vendors[name]
        if isinstance(found, VendorError):
            raise VendorError(found.vendor, found.reason) from found.__cause__
        return found

    def folder(self, name: str) -> Path:
        """The plugin's folder.

        Raises:
            UnknownVendor: There is none of that name.
            VendorError: It is an installed package that is not there.
        """
        place = self._place(name)
        if place.folder is not None:
            return place.folder
        with _as_vendor_error(name, place):
            spec = importlib.util.find_spec(place.module)
        if spec is None or not spec.submodule_search_locations:
            raise VendorError(name, f"{place}: there is no such package")
        return Path(spec.submodule_search_locations[0])

    def source(self, name: str) -> str:
        """Who brings the plugin, in words: built in, a folder, an installed package.

        Raises:
            UnknownVendor: There is none of that name.
        """
        return self._place(name).source

    def simulator(self, name: str) -> object:
        """Load the plugin's virtual controller: the `SIMULATOR` of its module or package `simulator`.

        Raises:
            UnknownVendor: There is none of that name.
            VendorError: The plugin is broken, or has no virtual controller.
        """
        self.vendor(name)
        place = self._place(name)
        folder = self.folder(name)
        if not any((folder / file).is_file() for file in ("simulator.py", "simulator/__init__.py")):
            raise VendorError(
                name, "has no virtual controller: there is no module or package `simulator` in its folder"
            )
        with _as_vendor_error(name, place), _no_bytecode(place):
            module = importlib.import_module(f"{place.module}.simulator")
        if not hasattr(module, "SIMULATOR"):
            raise VendorError(name, f"{module.__file__} exports no SIMULATOR")
        return module.SIMULATOR

    def _place(self, name: str) -> Place:
        if name not in self._places:
            nearest = difflib.get_close_matches(name, self._places, n=3)
            hint = f"did you mean {' or '.join(map(_quote, nearest))}?" if nearest else f"known: {self._known()}"
            raise UnknownVendor(name, f"there is no such vendor; {hint}", nearest)
        return self._places[name][0]

    def _known(self) -> str:
        return ", ".join(self.names()) or "none at all"

    def _load(self, name: str) -> Vendor:
        places = self._places[name]
        if len(places) > 1:
            raise VendorError(name, f"found more than once: {' and '.join(map(str, places))}; remove all but one")
        place = places[0]
        with _as_vendor_error(name, place), _no_bytecode(place):
            return _tried(name, _exported(name, _import(name, place)))


def unsafe(path: Path) -> list[str]:
    """Say why nothing may be loaded from a folder of plugins: a line for each reason, with the path and the remedy."""
    if not path.is_dir():
        return [f"{path}: {'is no folder' if path.exists() else 'does not exist'}"]
    if (path / "__init__.py").exists():
        return [f"{path}: is itself a plugin; name the folder that it stands in, {path.parent}"]
    mode = path.stat().st_mode
    if mode & (stat.S_IWGRP | stat.S_IWOTH) and (mode & stat.S_ISVTX or len(path.parts) <= _SYSTEM_PARTS):
        return [
            f"{path}: belongs to everybody on this machine; put the plugins into a folder of their own, and name that"
        ]
    try:
        plugins = [folder for _, folder in _plugins(path)]
        parts = [path, *plugins, *(part for folder in plugins for part in sorted(folder.rglob("*")))]
        found = [(part, _distrust(part)) for part in parts] + [(part, _distrust_above(part)) for part in path.parents]
    except OSError as error:
        return [f"{error.filename or path}: cannot be read ({error.strerror}); run: sudo chmod -R a+rX {path}"]
    return [f"{part}: {reason}" for part, reason in found if reason]


def _distrust(part: Path) -> str | None:
    """Say why a file or folder is not to be trusted: whoever may change it could run code in the gateway."""
    status = part.lstat()
    if stat.S_ISLNK(status.st_mode):
        return "is a symbolic link; put a copy of what it leads to in its place"
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return f"others may write to it; run: chmod go-w {part}"
    if status.st_uid not in {0, os.geteuid()}:
        return f"belongs to user {status.st_uid}, not to root or to the gateway's user; run: sudo chown root {part}"
    return None


def _distrust_above(part: Path) -> str | None:
    """The same for a folder above: whoever may rename what is in it could put another in its place."""
    mode = part.stat().st_mode
    if mode & (stat.S_IWGRP | stat.S_IWOTH) and not mode & stat.S_ISVTX:
        return f"others may exchange what is in it; run: chmod go-w {part}"
    return None


def _plugins(path: Path) -> Iterator[tuple[str, Path]]:
    for folder in sorted(path.iterdir()):
        if (folder / "__init__.py").is_file():
            yield folder.name, folder


def _built_in() -> Iterator[tuple[str, Place]]:
    spec = importlib.util.find_spec(PACKAGE)
    for path in (spec.submodule_search_locations or ()) if spec else ():
        for name, folder in _plugins(Path(path)):
            yield name, Place(f"{PACKAGE}.{name}", BUILT_IN, folder)


def _in_dirs(dirs: Sequence[Path]) -> Iterator[tuple[str, Place]]:
    for path in dirs:
        for name, folder in _plugins(path):
            yield name, Place(f"{PACKAGE}.{name}", str(path), folder, foreign=True)


def _installed() -> Iterator[tuple[str, Place]]:
    for entry in importlib.metadata.entry_points(group=ENTRY_POINTS):
        source = f"package {entry.dist.name} {entry.dist.version}" if entry.dist else "an installed package"
        yield entry.name, Place(entry.module, source)


def _import(name: str, place: Place) -> ModuleType:
    """Import a plugin; one that fails, or stands elsewhere than the one loaded before, leaves no modules behind."""
    if place.folder is None:
        return importlib.import_module(place.module)
    file = place.folder / "__init__.py"
    loaded = sys.modules.get(place.module)
    if loaded is not None and loaded.__file__ is not None and Path(loaded.__file__).resolve() == file.resolve():
        return loaded
    _forget(place.module)
    spec = importlib.util.spec_from_file_location(place.module, file, submodule_search_locations=[str(place.folder)])
    if spec is None or spec.loader is None:
        raise ImportError(f"{file} is no module")
    parent = importlib.import_module(PACKAGE)
    module = importlib.util.module_from_spec(spec)
    sys.modules[place.module] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        _forget(place.module)
        raise
    setattr(parent, name, module)
    return module


def _forget(module: str) -> None:
    for name in [name for name in sys.modules if name == module or name.startswith(f"{module}.")]:
        del sys.modules[name]


def _exported(name: str, module: ModuleType) -> Vendor:
    """What a plugin exports, if it is valid."""
    vendor = getattr(module, "VENDOR", None)
    if not isinstance(vendor, Vendor):
        fault = "exports no VENDOR" if vendor is None else f"its VENDOR is no Vendor record but {type(vendor).__name__}"
    elif vendor.name != name:
        fault = f"its VENDOR is named {_quote(str(vendor.name))}, its folder or entry point {_quote(name)}"
    elif not vendor.protocols or not all(isinstance(protocol, Protocol) for protocol in vendor.protocols):
        fault = "its VENDOR has no protocols, or something else among them"
    elif len({protocol.name for protocol in vendor.protocols}) < len(vendor.protocols):
        fault = f"two of its protocols have one name: {', '.join(protocol.name for protocol in vendor.protocols)}"
    else:
        return vendor
    raise VendorError(name, f"{fault} ({module.__file__})")


def _tried(name: str, vendor: Vendor) -> Vendor:
    """A plugin whose rows fit its longest table: what cannot work is found here, not in the middle of a shift."""
    for protocol in vendor.protocols:
        try:
            options = {**dict.fromkeys(ROBOT_OPTIONS), **msgspec.structs.asdict(protocol.options())}
            Normaliser(protocol.signals, options).readers(protocol.longest)
        except (Exception, SystemExit) as error:
            raise VendorError(name, f"its protocol {_quote(protocol.name)} cannot work: {error}") from error
    return vendor


@contextlib.contextmanager
def _as_vendor_error(name: str, place: Place) -> Iterator[None]:
    """Turn whatever a plugin raises, SystemExit included, into a VendorError with the line that it comes from."""
    try:
        yield
    except (KeyboardInterrupt, VendorError):
        raise
    except BaseException as error:
        text = traceback.format_exception_only(error)[-1].strip()
        frames = [frame for frame in traceback.extract_tb(error.__traceback__) if str(place.folder) in frame.filename]
        if isinstance(error, SyntaxError) and error.filename:
            text = f"{text} ({error.filename}:{error.lineno})"
        elif frames:
            text = f"{text} ({frames[-1].filename}:{frames[-1].lineno})"
        raise VendorError(name, f"cannot be imported: {text}") from error


@contextlib.contextmanager
def _no_bytecode(place: Place) -> Iterator[None]:
    """Leave nothing in a folder of `vendor_dirs`: a cache written under a loose umask would be refused next time."""
    before = sys.dont_write_bytecode
    sys.dont_write_bytecode = before or place.foreign
    try:
        yield
    finally:
        sys.dont_write_bytecode = before


def _quote(text: str) -> str:
    return f'"{text}"'
