"""The registry: finds plugins without importing them, and turns whatever is wrong with one into one error."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from gateway.core.registry import Registry
from gateway.errors import ConfigError, UnknownVendor, VendorError

PLUGIN = """
from gateway.api.vendor import Protocol, Vendor
from vendors.rainbow import VENDOR as _rainbow
from vendors.{name}.layouts import PORT

VENDOR = Vendor(name="{name}", title="Kilo Arms", protocols=(
    Protocol(name="status", title="Status", port=PORT, framing=_rainbow.protocols[0].framing, signals=()),
))
"""
TWICE = """
import dataclasses
VENDOR = dataclasses.replace(VENDOR, protocols=VENDOR.protocols * 2)
"""


def write(folder: Path, text: str, *, layouts: str = "PORT = 4711\n") -> Path:
    """Write a plugin whose `__init__.py` is the text."""
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text(text)
    (folder / "layouts.py").write_text(layouts)
    for part in (folder.parent, folder, *folder.iterdir()):
        part.chmod(part.stat().st_mode & ~0o022)
    return folder


def kilo(tmp_path: Path) -> Path:
    """A folder with one good plugin, `kilo`."""
    write(tmp_path / "dir" / "kilo", PLUGIN.format(name="kilo"))
    return tmp_path / "dir"


def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, entry: str) -> Path:
    """Install a distribution that lists one entry point."""
    site = tmp_path / "site"
    info = site / "kilo_robots-1.2.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: kilo-robots\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text(f"[robot_gateway.vendors]\n{entry}\n")
    monkeypatch.syspath_prepend(str(site))
    return site


def test_the_built_in_vendors_are_found_without_importing_one() -> None:
    before = set(sys.modules)
    assert "rainbow" in Registry().names()
    assert not {name for name in set(sys.modules) - before if name.startswith("vendors.")}


def test_a_built_in_vendor_is_loaded_once() -> None:
    registry = Registry()
    assert registry.vendor("rainbow") is registry.vendor("rainbow")
    assert registry.vendor("rainbow").name == "rainbow"
    assert (registry.folder("rainbow") / "layouts.py").is_file()
    assert registry.source("rainbow") == "built in"


def test_a_folder_of_vendor_dirs_is_loaded_with_its_own_modules(tmp_path: Path) -> None:
    registry = Registry([kilo(tmp_path)])
    assert "kilo" in registry.names()
    assert registry.vendor("kilo").protocol().port == 4711
    assert registry.folder("kilo") == (tmp_path / "dir" / "kilo").resolve()
    assert registry.source("kilo") == str((tmp_path / "dir").resolve())


def test_loading_leaves_no_files_in_a_folder_of_vendor_dirs(tmp_path: Path) -> None:
    Registry([kilo(tmp_path)]).vendor("kilo")
    assert sorted(path.name for path in (tmp_path / "dir" / "kilo").iterdir()) == ["__init__.py", "layouts.py"]


def test_a_second_registry_loads_the_plugin_from_its_own_folder(tmp_path: Path) -> None:
    first = write(tmp_path / "a" / "kilo", PLUGIN.format(name="kilo"))
    second = write(tmp_path / "b" / "kilo", PLUGIN.format(name="kilo"), layouts="PORT = 4712\n")
    assert Registry([first.parent]).vendor("kilo").protocol().port == 4711
    assert Registry([second.parent]).vendor("kilo").protocol().port == 4712


def test_a_folder_named_twice_counts_once(tmp_path: Path) -> None:
    folder = kilo(tmp_path)
    assert Registry([folder, folder / ".." / "dir"]).vendor("kilo").name == "kilo"


def test_files_and_folders_that_are_no_plugin_are_passed_over(tmp_path: Path) -> None:
    folder = kilo(tmp_path)
    (folder / "README.md").write_text("about")
    (folder / "notes").mkdir()
    for part in (folder / "README.md", folder / "notes"):
        part.chmod(part.stat().st_mode & ~0o022)
    assert set(Registry([folder]).names()) - set(Registry().names()) == {"kilo"}


def test_an_installed_package_is_found_by_its_entry_point(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    site = install(tmp_path, monkeypatch, "lima = lima_robots.plugin")
    write(site / "lima_robots" / "plugin", PLUGIN.replace("vendors.{name}", "lima_robots.plugin").format(name="lima"))
    registry = Registry()
    assert "lima" in registry.names()
    assert registry.source("lima") == "package kilo-robots 1.2"
    assert registry.vendor("lima").title == "Kilo Arms"
    assert registry.folder("lima") == site / "lima_robots" / "plugin"


def test_an_entry_point_to_nothing_is_a_broken_vendor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, monkeypatch, "mike = no_such_package_at_all.plugin")
    registry = Registry()
    with pytest.raises(VendorError, match=r"cannot be imported: ModuleNotFoundError: No module named 'no_such"):
        registry.vendor("mike")
    with pytest.raises(VendorError, match="cannot be imported"):
        registry.folder("mike")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("import no_such_module_at_all", r"ModuleNotFoundError: No module named 'no_such_.*__init__.py:1\)"),
        ("x = 1\ny = 1 / 0", r"ZeroDivisionError: division by zero \(.*__init__.py:2\)"),
        ("def (:", r"SyntaxError: invalid syntax \(.*__init__.py:1\)"),
        ("import sys\nsys.exit(3)", r"SystemExit: 3"),
        ("class Odd(BaseException): ...\nraise Odd('x')", r"Odd: x"),
        ("raise StopIteration", r"StopIteration"),
        ("def f(): f()\nf()", r"RecursionError"),
        ("from vendors.kilo.missing import X", r"ModuleNotFoundError: No module named 'vendors.kilo.missing'"),
        ("", "exports no VENDOR"),
        ("VENDOR = 'kilo'", "its VENDOR is no Vendor record but str"),
        (PLUGIN.format(name="kilo").replace('name="kilo"', 'name="lima"'), 'its VENDOR is named "lima".*"kilo"'),
        ("from gateway.api.vendor import Vendor\nVENDOR = Vendor(name='kilo', title='', protocols=())", "no protocols"),
        (f"{PLUGIN.format(name='kilo')}{TWICE}", "have one name: status, status"),
    ],
)  # fmt: skip
def test_whatever_is_wrong_with_a_plugin_is_one_error_and_stays_it(tmp_path: Path, text: str, reason: str) -> None:
    write(tmp_path / "dir" / "kilo", text)
    registry = Registry([tmp_path / "dir"])
    told = []
    for _ in range(2):
        with pytest.raises(VendorError, match=reason) as caught:
            registry.vendor("kilo")
        told.append((caught.value.vendor, caught.value.reason))
    assert told[0] == told[1]
    assert told[0][0] == "kilo"
    assert registry.vendor("rainbow").name == "rainbow"


def test_a_plugin_that_fails_leaves_no_modules_behind(tmp_path: Path) -> None:
    write(tmp_path / "dir" / "kilo", "import vendors.kilo.layouts\n1 / 0")
    with pytest.raises(VendorError):
        Registry([tmp_path / "dir"]).vendor("kilo")
    assert not [name for name in sys.modules if name.startswith("vendors.kilo")]


def test_ctrl_c_during_an_import_is_not_swallowed(tmp_path: Path) -> None:
    write(tmp_path / "dir" / "kilo", "raise KeyboardInterrupt")
    with pytest.raises(KeyboardInterrupt):
        Registry([tmp_path / "dir"]).vendor("kilo")


def test_an_unknown_vendor_is_told_from_a_broken_one_with_the_nearest_name() -> None:
    with pytest.raises(UnknownVendor, match='did you mean "rainbow"') as caught:
        Registry().vendor("rainbw")
    assert caught.value.nearest == ("rainbow",)
    with pytest.raises(UnknownVendor, match=r"known: .*rainbow"):
        Registry().folder("zzz")


def test_a_name_that_exists_twice_is_an_error_that_names_both_places(tmp_path: Path) -> None:
    write(tmp_path / "dir" / "rainbow", PLUGIN.format(name="rainbow"))
    registry = Registry([tmp_path / "dir"])
    with pytest.raises(VendorError) as caught:
        registry.vendor("rainbow")
    assert str((tmp_path / "dir" / "rainbow").resolve()) in caught.value.reason
    assert str(Registry().folder("rainbow")) in caught.value.reason


def test_the_virtual_controller_is_loaded_only_when_it_is_asked_for(tmp_path: Path) -> None:
    folder = kilo(tmp_path)
    (folder / "kilo" / "simulator.py").write_text("from vendors.kilo.layouts import PORT\nSIMULATOR = PORT\n")
    (folder / "kilo" / "simulator.py").chmod(0o644)
    registry = Registry([folder])
    registry.vendor("kilo")
    assert "vendors.kilo.simulator" not in sys.modules
    assert registry.simulator("kilo") == 4711


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (None, "there is no module or package `simulator`"),
        ("", "exports no SIMULATOR"),
        ("1 / 0", "ZeroDivisionError.*simulator.py:1"),
    ],
)
def test_a_virtual_controller_that_is_not_there_is_a_vendor_error(
    tmp_path: Path, text: str | None, reason: str
) -> None:
    folder = kilo(tmp_path)
    if text is not None:
        (folder / "kilo" / "simulator.py").write_text(text)
        (folder / "kilo" / "simulator.py").chmod(0o644)
    with pytest.raises(VendorError, match=reason):
        Registry([folder]).simulator("kilo")


@pytest.mark.parametrize("part", [".", "kilo", "kilo/layouts.py", "kilo/__pycache__/layouts.cpython-311.pyc"])
@pytest.mark.parametrize("bit", [0o020, 0o002])
def test_a_folder_that_others_may_write_to_is_refused(tmp_path: Path, part: str, bit: int) -> None:
    folder = kilo(tmp_path)
    (folder / "kilo" / "__pycache__").mkdir(mode=0o755)
    target = folder / part
    if not target.exists():
        target.write_bytes(b"")
    target.chmod((0o755 if target.is_dir() else 0o644) | bit)
    with pytest.raises(ConfigError) as caught:
        Registry([folder])
    assert caught.value.problems == (f"{target.resolve()}: others may write to it; run: chmod go-w {target.resolve()}",)


def test_a_folder_above_in_which_others_may_exchange_things_is_refused(tmp_path: Path) -> None:
    folder = kilo(tmp_path)
    tmp_path.chmod(0o777)
    with pytest.raises(ConfigError, match="others may exchange what is in it"):
        Registry([folder])
    tmp_path.chmod(0o1777)
    Registry([folder])


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file away")
@pytest.mark.parametrize("part", [".", "kilo", "kilo/layouts.py"])
def test_a_folder_that_belongs_to_somebody_else_is_refused(tmp_path: Path, part: str) -> None:
    folder = kilo(tmp_path)
    os.chown(folder / part, 12345, -1)
    with pytest.raises(ConfigError, match="belongs to user 12345"):
        Registry([folder])


def test_a_symbolic_link_in_a_plugin_is_refused(tmp_path: Path) -> None:
    folder = kilo(tmp_path)
    (folder / "kilo" / "more.py").symlink_to("/nowhere")
    with pytest.raises(ConfigError, match="is a symbolic link"):
        Registry([folder])


def test_a_folder_that_is_not_there_or_no_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError) as caught:
        Registry([tmp_path / "missing", tmp_path / "file"])
    assert caught.value.problems == (
        f"{(tmp_path / 'missing').resolve()}: does not exist",
        f"{(tmp_path / 'file').resolve()}: is no folder",
    )


def test_naming_the_plugin_itself_instead_of_its_folder_is_explained(tmp_path: Path) -> None:
    folder = kilo(tmp_path)
    with pytest.raises(ConfigError, match=f"is itself a plugin; name the folder that it stands in, {folder.resolve()}"):
        Registry([folder / "kilo"])


@pytest.mark.parametrize(
    ("wrong", "hint"),
    [
        ('signals=("x",)', "cannot work"),
        ('signals=(Signal("joints.positon", "jnt_ang"),)', "joints.positon"),
        ('signals=(Signal("joints.position", "jnt_angle"),)', "jnt_angle"),
        ('signals=(Signal("joints.position", "jnt_cur"),)', "unit 'A'"),
        ("signals=(), options=None", "cannot work"),
    ],
)
def test_a_plugin_whose_rows_cannot_work_is_broken_from_the_start(tmp_path: Path, wrong: str, hint: str) -> None:
    text = "from gateway.api.signals import Signal\n" + PLUGIN.format(name="kilo").replace("signals=()", wrong)
    write(tmp_path / "dir" / "kilo", text)
    with pytest.raises(VendorError, match=hint):
        Registry([tmp_path / "dir"]).vendor("kilo")
