"""`robot-gateway new-vendor`: the folder that it writes, what vendor-check then says, and an author who fills it in."""

from __future__ import annotations

import os
import re
import shutil
import struct
from collections.abc import Mapping
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from gateway.cli.new_vendor import new_vendor
from gateway.cli.vendor_check import vendor_check
from gateway.core.registry import Registry, unsafe
from tests.cli.command import ROOT, command_here

SCAFFOLD = ROOT / "gateway" / "scaffold"
FILES = ["README.md", "__init__.py", "layouts.py", "signals.py", "simulator.py", "vectors.toml"]


@pytest.fixture
def plugins(tmp_path: Path) -> Path:
    """A folder that plugins may be loaded from."""
    folder = tmp_path / "plugins"
    folder.mkdir()
    folder.chmod(0o755)
    return folder


def run(command: object, *arguments: str) -> tuple[int, str]:
    """The exit code, and what is printed on both streams."""
    app = typer.Typer()
    app.command()(command)  # type: ignore[type-var] # a command, whatever its arguments
    result = CliRunner().invoke(app, arguments)
    return result.exit_code, result.output


def check(name: str, plugins: Path) -> tuple[int, str]:
    """What vendor-check says, in one line."""
    code, text = run(vendor_check, name, "--vendor-dir", str(plugins))
    return code, " ".join(text.split())


def to_fill(folder: Path) -> dict[str, list[str]]:
    """The words behind each mark of each file."""
    found = {
        file.name: re.findall(r'FILL: (.*?)[\s|."]*$', file.read_text(), re.MULTILINE) for file in folder.iterdir()
    }
    return {name: marks for name, marks in found.items() if marks}


def fill(file: Path, lines: Mapping[str, str]) -> None:
    """Put other text in place of the lines that hold some words each."""
    text = file.read_text().splitlines()
    for words, new in lines.items():
        (at,) = [number for number, line in enumerate(text) if words in line]
        text[at] = new
    file.write_text("\n".join(line for line in text if line != "DELETED") + "\n")


def test_the_folder_is_written_and_a_plugin_that_can_be_imported(plugins: Path) -> None:
    code, text = run(new_vendor, "oscar", "--into", str(plugins))
    assert code == 0
    assert sorted(file.name for file in (plugins / "oscar").iterdir()) == sorted(FILES)
    assert f"vendor-check oscar --vendor-dir {plugins}" in text
    vendor = Registry([plugins]).vendor("oscar")
    assert (vendor.name, vendor.title, [protocol.name for protocol in vendor.protocols]) == (
        "oscar",
        "Oscar",
        ["state"],
    )


def test_the_files_are_safe_to_load_whatever_the_umask(plugins: Path) -> None:
    before = os.umask(0)
    try:
        assert run(new_vendor, "oscar", "--into", str(plugins))[0] == 0
        assert run(new_vendor, "papa", "--into", str(plugins / "more"))[0] == 0
    finally:
        os.umask(before)
    assert unsafe(plugins) == unsafe(plugins / "more") == []


@pytest.mark.limit(60)
def test_vendor_check_says_each_thing_to_fill_once_with_its_file_and_line(plugins: Path) -> None:
    run(new_vendor, "oscar", "--into", str(plugins))
    code, text = check("oscar", plugins)
    assert code == 1
    marks = to_fill(plugins / "oscar")
    assert sorted(marks) == sorted(FILES)
    for name, words in marks.items():
        for what in words:
            assert text.count(" ".join(what.split())) == 1, what
        assert text.count(f"{name} line ") == len(words)
    assert text.index("layouts.py line") < text.index("signals.py line") < text.index("README.md line")
    assert "no source: name manual, version and section" in text
    assert "the framing has no magic" in text
    assert "the protocol has no signal row" in text
    assert text.count("vectors.toml has no vector of protocol state") == 1
    assert "the same as vectors_cover_everything, above" in text
    assert "Error" not in text


def test_a_checkout_is_found_where_the_command_runs(tmp_path: Path) -> None:
    (tmp_path / "vendors").mkdir()
    shutil.copy(ROOT / "vendors" / "__init__.py", tmp_path / "vendors")
    done = command_here("new-vendor", "oscar", cwd=tmp_path)
    assert (done.code, done.err) == (0, "")
    assert (tmp_path / "vendors" / "oscar" / "layouts.py").is_file()
    listed = command_here("vendors", "--json", cwd=tmp_path)
    assert '"oscar"' in listed.out


def test_elsewhere_a_folder_must_be_named(tmp_path: Path) -> None:
    done = command_here("new-vendor", "oscar", cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert "is no checkout of the gateway: go there, or name a folder of plugins with --into" in done.err


@pytest.mark.parametrize("name", ["Oscar", "9lives", "os-car", "", "../oscar", "o" * 33, "ös"])
def test_a_name_that_is_none_is_refused(name: str, plugins: Path) -> None:
    code, text = run(new_vendor, name, "--into", str(plugins))
    assert code == 2
    assert "is no name of a plugin: a lower-case letter, then" in " ".join(text.split())
    assert list(plugins.iterdir()) == []


def test_a_word_of_python_is_no_name(plugins: Path) -> None:
    code, text = run(new_vendor, "class", "--into", str(plugins))
    assert (code, "is a word of Python" in text) == (2, True)


def test_a_folder_that_is_there_is_left_alone(plugins: Path) -> None:
    (plugins / "oscar").mkdir()
    code, text = run(new_vendor, "oscar", "--into", str(plugins))
    assert (code, "is there already: take another name" in text) == (2, True)
    assert list((plugins / "oscar").iterdir()) == []


def test_a_vendor_that_is_built_in_keeps_its_name(plugins: Path) -> None:
    code, text = run(new_vendor, "rainbow", "--into", str(plugins))
    assert (code, "a vendor rainbow is there already (built in)" in text) == (2, True)


def test_a_folder_that_others_may_write_to_is_refused(plugins: Path) -> None:
    plugins.chmod(0o777)
    code, text = run(new_vendor, "oscar", "--into", str(plugins))
    assert (code, "chmod go-w" in text) == (2, True)
    assert list(plugins.iterdir()) == []


def test_where_nothing_can_be_written_is_said(plugins: Path) -> None:
    code, text = run(new_vendor, "oscar", "--into", "/proc/oscar")
    assert (code, "--into /proc/oscar: it cannot be made: " in text) == (1, True)
    code, text = run(new_vendor, "oscar", "--into", "/proc/self/task")
    assert (code, "cannot be written: " in text) == (1, True)
    (plugins / "file").write_text("")
    assert "is no folder" in run(new_vendor, "oscar", "--into", str(plugins / "file"))[1]


# The invented robot of the test's author: pushed frames of 20 bytes, 4F 53, size, three angles, a state, a checksum.
def frame(angles: tuple[float, float, float], state: int) -> bytes:
    """Pack a frame by hand."""
    body = struct.pack("<2sH3fH", b"OS", 20, *angles, state)
    return body + struct.pack("<H", sum(place * byte for place, byte in enumerate(body, 1)) & 0xFFFF)


VECTOR = """
[[vectors]]
name = "{name}"
protocol = "push"
origin = "packed with plain struct from the diagram of an invented manual"
layout = "state"
hex = "{hex}"
vendor = {{ start = 21327, size = 20, angles = {degrees}, state = {state} }}
canonical.joints = {{ q = "GOOD", position = {radians} }}
canonical.status = {{ q = "GOOD", program.state = "{program}" }}
"""

AUTHOR = {
    "layouts.py": {
        "a diagram of its bytes": '"""The state frame of Oscar: 4F 53, size, 3 x f32, state and checksum, each u16."""',
        "SOURCE = ": 'SOURCE = "An invented manual, version 1, section 1"',
        "FILL: size": "    size=18,",
        "little-endian": '    byteorder="<",',
        "FILL: rows": '        Field(name="start", offset=0, type="u16", meaning="4F 53"),',
        'Field(name="size"': '        Field(name="size", offset=2, type="u16", meaning="Bytes of the whole frame"),\n'
        '        Field(name="angles", offset=4, type="f32", count=3, unit="deg", meaning="Angle of each joint"),\n'
        '        Field(name="state", offset=16, type="u16", meaning="1 idle, 2 running"),',
        "LAYOUTS = ": "LAYOUTS = (STATE,)",
    },
    "__init__.py": {
        "what is read": '"""Oscar: state frames, pushed on port 4711; nothing is ever sent."""',
        "import Framing": "from gateway.api.framing import Checksum, Framing, Kind",
        "FILL: magic": '    magic=b"OS",',
        "FILL: header": "    header=4,",
        "FILL: length:": "    length_at=2,",
        "FILL: length_type": '    length_type="u16",',
        "FILL: length_adds": "    length_adds=0,",
        "FILL: layout_at": "    layout_at=0,",
        "FILL: byteorder": '    byteorder="little",',
        "FILL: kinds": "DELETED",
        "kinds=(": '    kinds=(Kind(type=None, name="state", layouts=LAYOUTS, smallest=20, largest=64),),',
        "FILL: checksum": '    checksum=Checksum(type="u16", of=weighted),',
        "one_length=True": "DELETED",
        "FRAMING = ": "def weighted(covered: bytes) -> int:\n"
        '    """The sum of all bytes, each times its place."""\n'
        "    return sum(place * byte for place, byte in enumerate(covered, 1)) & 0xFFFF\n\n\n"
        "FRAMING = Framing(",
        "FILL: title": '    title="Oscar Robots",',
        "FILL: name": '            name="push",',
        "FILL: protocol": '            title="State data, pushed",',
        "FILL: port": "            port=4711,\n            cost=60.0,  # a checksum in Python over every byte",
        "FILL: where the controller is asked": "DELETED",
    },
    "signals.py": {
        "what the controller does not send": '"""From the fields of Oscar to the model: joints and program."""',
        "import Signal": "from gateway.api.model import ProgramState\nfrom gateway.api.signals import Signal\n\n\n"
        "def program(state: int) -> ProgramState:\n"
        '    """What the program is doing."""\n'
        "    return {1: ProgramState.STOPPED, 2: ProgramState.RUNNING}.get(state, ProgramState.UNKNOWN)\n",
        "FILL: a row": '    Signal("joints.position", "angles"),\n'
        '    Signal("status.program.state", "state", program),',
    },
    "vectors.toml": {
        "FILL: vectors": VECTOR.format(
            name="running",
            hex=frame((90.0, -45.0, 180.0), 2).hex(" "),
            degrees="[90.0, -45.0, 180.0]",
            state=2,
            radians="[1.5707963267948966, -0.7853981633974483, 3.141592653589793]",
            program="RUNNING",
        )
        + VECTOR.format(
            name="idle",
            hex=frame((30.0, 0.0, -60.0), 1).hex(" "),
            degrees="[30.0, 0.0, -60.0]",
            state=1,
            radians="[0.5235987755982988, 0.0, -1.0471975511965976]",
            program="STOPPED",
        ),
    },
    "simulator.py": {
        "import RobotState": "from gateway.api.model import ProgramState\nfrom gateway.sim.scenario import RobotState",
        "import STATE": "from vendors.oscar import weighted\nfrom vendors.oscar.layouts import STATE",
        "FILL: values": "    state_word = 2 if state.phase.program is ProgramState.RUNNING else 1\n"
        "    degrees = [57.29577951308232 * angle for angle in state.position[:3]]\n"
        '    return {"start": 0x534F, "size": 20, "angles": degrees, "state": state_word}',
        "FILL: header and checksum": '    return payload + weighted(payload).to_bytes(2, "little")',
        "FILL: time": "    period_s: float | None = 0.02",
        "FILL: answers": "        return []",
        "FILL: protocol": '    ports=(Port(protocol="push", port=4711, session=StateSession, header=4),),',
        "FILL: the protocol": '    demos=(Demo(protocol="push"),),',
    },
    "README.md": {
        "which controllers": "Reads the invented robots of a test. Nothing is ever sent.",
        "| protocol |": "| protocol | `push`: TCP 4711, frames of 20 bytes with a checksum |",
        "| manual |": "| manual | An invented manual, version 1 |",
        "| frames |": "| frames | 20 bytes |",
        "the quirks": "The state word has two values only: 1 idle and 2 running; any other is UNKNOWN.",
        "what a damaged length": "The checksum shows every changed byte; two may cancel each other out.",
        "what the manual does not say": "Nothing: it is invented. There is no longer frame and no shorter one either.",
        "which robot": "No robot at all.",
    },
}


@pytest.mark.limit(60)
def test_an_author_fills_it_in_as_the_page_says_and_every_check_passes(plugins: Path) -> None:
    run(new_vendor, "oscar", "--into", str(plugins))
    for name, lines in AUTHOR.items():
        fill(plugins / "oscar" / name, lines)
    assert to_fill(plugins / "oscar") == {}
    code, text = check("oscar", plugins)
    assert ("failed " in text.replace("0 failed", ""), code) == (False, 0), text
    assert text.endswith("0 exempt, 0 failed")


PAGE = (ROOT / "docs" / "vendors.md").read_text()
EXAMPLE = "".join(
    file.read_text()
    for file in sorted((ROOT / "vendors" / "universal_robots").iterdir())
    if file.suffix in {".py", ".toml"}
)
SHOWN = [
    code
    for language, code in re.findall(r"^```(\w+)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    if language == "python" or "base = " in code
]


def test_the_page_shows_code_of_each_file() -> None:
    assert len(SHOWN) >= 10


@pytest.mark.parametrize("code", SHOWN, ids=lambda code: code.split("\n")[0][:40])
def test_what_the_page_shows_stands_in_its_example_line_by_line(code: str) -> None:
    lines = EXAMPLE.splitlines()
    assert [line for line in code.splitlines() if line not in lines] == []


def test_the_page_speaks_of_every_argument_that_the_scaffold_asks_for() -> None:
    text = "".join(file.read_text() for file in SCAFFOLD.glob("*.py.txt"))
    asked = set(re.findall(r"^ +(\w+)=.*FILL: ", text, re.MULTILINE)) - {"name", "title", "size"}
    assert {"magic", "length_at", "byteorder", "ports"} <= asked
    assert [word for word in asked if f"`{word}`" not in PAGE and f"{word}=" not in PAGE] == []
