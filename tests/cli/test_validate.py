"""`robot-gateway validate`: its table, its JSON, its schema, and how it ends."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from gateway.cli import validate
from tests.cli.command import command_here

# Two types of lines of text: in one of them numbers below a limit, in the other anything but shouting.
KILO = """
from typing import Annotated
import msgspec
from gateway.api.documents import Checked, DocumentType, Problem, Row
from gateway.api.vendor import Vendor
from vendors.rainbow import VENDOR as _rainbow

class Limit(msgspec.Struct, frozen=True):
    most: Annotated[Annotated[int, msgspec.Meta(ge=1, le=9)] | None, msgspec.Meta(description="Highest number.")] = None

class None_(msgspec.Struct, frozen=True):
    pass

def numbers(data, options):
    rows = []
    for at, line in enumerate(data.decode().splitlines(), 1):
        high = options.most is not None and int(line) > options.most
        problem = Problem("value", f"{line} is above {options.most}", line, f"at most {options.most}")
        rows.append(Row((str(at), line), (problem, problem) if high else ()))
    return Checked(tuple(rows), () if rows else (Problem("", "is empty"),))

def words(data, options):
    return Checked(tuple(Row((line, "words " * 30)) for line in data.decode("utf-8", "replace").split("|")))

VENDOR = Vendor(name="kilo", title="Kilo", protocols=_rainbow.protocols, documents=(
    DocumentType(name="numbers", title="Numbers, one a line", noun="number", columns=("line", "value"), check=numbers,
        options=Limit, schema=lambda: {"title": "numbers"}, largest=100),
    DocumentType(name="words", title="Words", noun="word", columns=("word", "text"), check=words, options=None_,
        schema=lambda: {"title": "words"}),
))
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A vendor with two document types, one whose options clash, and a broken one."""
    folder = tmp_path / "dir"
    clash = KILO.replace("most:", "wrong:").replace("options.most", "options.wrong").replace('"kilo"', '"mike"')
    for name, text in (("kilo", KILO), ("lima", "1 / 0"), ("mike", clash)):
        (folder / name).mkdir(parents=True)
        (folder / name / "__init__.py").write_text(text)
        (folder / name / "__init__.py").chmod(0o644)
        (folder / name).chmod(0o755)
    folder.chmod(0o755)
    return folder


def call(folder: Path, *arguments: str, given: str | bytes | None = None, columns: int | None = None) -> Result:
    """Run the command with the vendors of a folder."""
    env = {"COLUMNS": None if columns is None else str(columns)}
    return CliRunner(env=env).invoke(validate.app, ["--vendor-dir", str(folder), *arguments], input=given)


def test_a_good_file_is_a_table_and_ends_with_0(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "good.txt").write_text("3\n40\n")
    result = call(folder, "kilo", str(tmp_path / "good.txt"))
    assert result.exit_code == 0
    rows = [line.split() for line in result.stdout.splitlines()]
    assert rows[0] == ["line", "value"]
    assert rows[2:] == [["1", "3"], ["2", "40"], ["2", "numbers,", "0", "wrong"]]
    assert result.stderr == ""


def test_what_is_wrong_stands_in_its_row_and_it_ends_with_1(folder: Path) -> None:
    result = call(folder, "kilo", "-", "--most", "5", given="3\n7\n")
    assert result.exit_code == 1
    rows = [" ".join(line.split()) for line in result.stdout.splitlines()]
    assert rows[0] == "line value what is wrong"
    assert rows[2:] == ["1 3", "2 7 value: 7 is above 5", "value: 7 is above 5", "2 numbers, 1 wrong"]


def test_what_is_wrong_with_the_file_is_told_below(folder: Path) -> None:
    result = call(folder, "kilo", "-", given="")
    assert result.exit_code == 1
    assert result.stdout == "is empty\n0 numbers, 0 wrong, 1 other problem\n"


def test_only_what_is_wrong_is_shown_on_request(folder: Path) -> None:
    result = call(folder, "kilo", "-", "--most", "5", "--wrong", given="3\n7\n")
    assert "1     3" not in result.stdout
    assert "7 is above 5" in result.stdout
    assert result.stdout.endswith("2 numbers, 1 wrong\n")
    assert call(folder, "kilo", "-", "--wrong", given="3\n").stdout == "1 number, 0 wrong\n"


def test_json_has_every_fact(folder: Path) -> None:
    result = call(folder, "kilo", "-", "--most", "5", "--json", given="3\n7\n")
    assert result.exit_code == 1
    problem = {"path": "value", "message": "7 is above 5", "found": "7", "allowed": "at most 5"}
    assert json.loads(result.stdout) == {
        "vendor": "kilo",
        "type": "numbers",
        "file": "-",
        "good": False,
        "count": 2,
        "wrong": 1,
        "problems": [],
        "rows": [
            {"line": "1", "value": "3", "problems": []},
            {"line": "2", "value": "7", "problems": [problem, problem]},
        ],
    }
    only = call(folder, "kilo", "-", "--most", "5", "--json", "--wrong", given="3\n7\n")
    assert [row["line"] for row in json.loads(only.stdout)["rows"]] == ["2"]
    assert call(folder, "kilo", "-", "--json", given="3\n").exit_code == 0


@pytest.mark.parametrize("columns", [80, 120])
def test_the_table_fits_the_terminal_and_nothing_moves_its_cursor(folder: Path, columns: int) -> None:
    result = call(folder, "kilo", "-", "--type", "words", given="a\x1b[2J\x9bb|[red]c[/red]|\u202e", columns=columns)
    assert result.exit_code == 0
    assert max(map(len, result.stdout.splitlines())) <= columns
    assert "a\\u001b[2J" in result.stdout
    assert "[red]c[/red]" in result.stdout
    assert not {"\x1b", "\x9b", "\u202e"} & set(result.stdout)


def test_a_long_table_is_cut_and_says_so(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(validate, "_MOST", 3)
    result = call(folder, "kilo", "-", given="1\n2\n3\n4\n5\n")
    assert result.stdout.splitlines()[-2:] == [
        "2 more rows are not shown; --wrong shows only those that are wrong; --json has all",
        "5 numbers, 0 wrong",
    ]


def test_a_long_list_of_problems_is_cut_and_says_so(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(validate, "_MOST", 0)
    result = call(folder, "kilo", "-", given="")
    assert result.stdout.splitlines()[0] == "1 more problems are not shown; --json has all"


def test_each_type_has_options_and_a_schema_of_its_own(folder: Path) -> None:
    assert json.loads(call(folder, "kilo", "--schema").stdout) == {"title": "numbers"}
    for given in (["--type", "words"], ["--type=words"]):
        assert json.loads(call(folder, "kilo", *given, "--schema").stdout) == {"title": "words"}
    assert "--most <int>" in call(folder, "kilo", "--help").stdout
    assert "--most" not in call(folder, "kilo", "--type", "words", "--help").stdout
    result = call(folder, "kilo", "-", "--type", "words", "--most", "5", given="x")
    assert result.exit_code == 2
    assert "No such option: --most" in result.output


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("kilo", "FILE: is missing"),
        ("kilo /nowhere/x", "/nowhere/x: cannot be read: No such file or directory"),
        ("kilo /", "/: cannot be read: Is a directory"),
        ("kilo - --most 12", "--most: 12 is not a whole number from 1 to 9"),
        ("kilo - --most x", "--most"),
        ("kilo - --type letters", '--type: "letters" is none of numbers, words'),
        ("kilo - --type", "--type"),
        ("kilos -", 'did you mean "kilo"?'),
        ("rainbow -", "VENDOR rainbow: has no types of files that can be checked; vendors that have: kilo, mike"),
        ("--vendor-dir /nowhere kilo -", "/nowhere"),
    ],
)
def test_wrong_usage_ends_with_2_and_says_what_is_wrong(folder: Path, arguments: str, says: str) -> None:
    result = call(folder, *arguments.split(), given="")
    assert result.exit_code == 2
    assert says in " ".join(result.output.split())
    assert "Traceback" not in result.output


@pytest.mark.parametrize(
    ("vendor", "says"), [("lima", "ZeroDivisionError"), ("mike", "the options wrong of its documents have names that")]
)
def test_a_broken_vendor_is_listed_and_says_what_is_wrong(folder: Path, vendor: str, says: str) -> None:
    result = call(folder, vendor)
    assert result.exit_code == 1
    assert says in " ".join(result.output.split())
    listed = call(folder, "--help", columns=80)
    assert listed.exit_code == 0
    assert f" {vendor} Cannot be used: " in " ".join(listed.stdout.split())


def test_help_lists_the_vendors_that_have_documents_and_fits_80_columns(folder: Path) -> None:
    result = call(folder, "--help", columns=80)
    assert " kilo Check a file of kilo objects" in " ".join(result.stdout.split())
    assert "  rainbow  " not in result.stdout
    assert max(map(len, result.stdout.splitlines())) <= 80
    one = call(folder, "kilo", "--help", columns=80).stdout
    assert "numbers  Numbers, one a line" in one
    assert "robot-gateway validate kilo --schema" in one
    assert max(map(len, one.splitlines())) <= 80


def test_no_more_than_a_file_may_have_is_read(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[int] = []
    monkeypatch.setattr(validate, "_print", lambda _, checked, **_more: read.append(len(checked.rows)))
    call(folder, "kilo", "-", given="1\n" * 200)
    assert read == [51]


def test_the_command_is_there() -> None:
    done = command_here("validate", "--help")
    assert (done.code, done.err) == (0, "")
    assert "robot-gateway validate xcore moves.json --axes 6" in done.out
