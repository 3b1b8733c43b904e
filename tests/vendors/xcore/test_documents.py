"""Files of motion commands: every form, every way to be wrong, and nothing that escapes."""

from __future__ import annotations

import json

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from gateway.api import documents
from gateway.api.documents import Checked
from vendors.xcore import files
from vendors.xcore.documents import COMMANDS, CommandOptions, check_commands, schema

Json = dict[str, object]

LINE: Json = {"class": "MoveL", "target": {"trans": [0.4, 0, 0.5], "rpy": [3.14, 0, 3.14]}, "speed": 200}
JOINTS: Json = {"class": "MoveAbsJCommand", "target": {"joints": [0, 0.5, -0.5, 0, 1.5, 0]}, "zone": 10}
WAIT: Json = {"class": "MoveWait", "duration_": 0.5}
APPEND: Json = {"class": "MoveLCommand", "commands": [{"target": {"trans": [0.4, 0, 0.5]}, "speed": 200}]}
VALIDATOR = Draft202012Validator(schema())


def check(value: object, **options: object) -> Checked:
    """Check what JSON makes of a value, or a text, or bytes."""
    text = value if isinstance(value, str | bytes) else json.dumps(value)
    data = text if isinstance(text, bytes) else text.encode()
    return check_commands(data, msgspec.convert(options, CommandOptions))


def lines(*values: object) -> str:
    """One value in each line."""
    return "\n".join(value if isinstance(value, str) else json.dumps(value) for value in values) + "\n"


def problems(checked: Checked) -> list[str]:
    """All that is wrong, rows first, each with the number of its row."""
    rows = [f"{row.cells[0]}: {problem}" for row in checked.rows for problem in row.problems]
    return [*rows, *map(str, checked.problems)]


def test_an_array_of_commands_is_shown_as_people_read_it() -> None:
    found = check([JOINTS, LINE, WAIT])
    assert found.good
    assert [row.cells for row in found.rows] == [
        ("1", "MoveAbsJ", "0 0.5 -0.5 0 1.5 0 rad (0 29 -29 0 86 0 deg)", "default", "10"),
        ("2", "MoveL", "0.4 0 0.5 m, 3.14 0 3.14 rad", "200", "default"),
        ("3", "MoveWait", "0.5 s", "-", "-"),
    ]
    assert all(len(row.cells) == len(COMMANDS.columns) for row in found.rows)


@pytest.mark.parametrize(
    ("file", "numbers"),
    [
        (LINE, ["1"]),
        ([LINE, LINE], ["1", "2"]),
        ({**APPEND, "commands": [LINE, LINE]}, ["1", "2"]),
        ([{**APPEND, "commands": [LINE, LINE]}, WAIT, APPEND], ["1.1", "1.2", "2", "3.1"]),
        (lines(LINE, "", JOINTS), ["line 1", "line 3"]),
        (lines(APPEND, [LINE, JOINTS], WAIT), ["line 1.1", "line 2.1", "line 2.2", "line 3"]),
        (lines([APPEND, LINE], LINE), ["line 1.1.1", "line 1.2", "line 2"]),
        ("\ufeff" + json.dumps([LINE]), ["1"]),
        (lines(LINE, JOINTS).replace("\n", "\r\n"), ["line 1", "line 2"]),
        (json.dumps([LINE, JOINTS], indent=2), ["1", "2"]),
    ],
)
def test_every_form_of_a_file_is_taken(file: object, numbers: list[str]) -> None:
    found = check(file)
    assert problems(found) == []
    assert [row.cells[0] for row in found.rows] == numbers


@pytest.mark.parametrize(
    ("file", "says"),
    [
        (b"", "is empty"),
        (b" \n\t\n", "is empty"),
        ("[]", "is an empty array; at least one command is needed"),
        (lines(LINE, "[]"), "line 2: is an empty array; at least one command is needed"),
        (b'[{"class":\n"\xff"}]', "line 2: no UTF-8 at byte 2 of the line"),
        ("[1, 2\n 3]", "no valid JSON at line 2, column 2: Expecting ',' delimiter"),
        ('{"class": "MoveL",}', "no valid JSON at line 1, column 19: "),
        ("MoveL p1, v100", "no valid JSON at line 1, column 1: Expecting value"),
        (lines(LINE, '{"class": "MoveL", "target"'), "line 2: no valid JSON at column 28: Expecting ':' delimiter"),
        ("[" * 200_000, "no valid JSON: arrays or objects are nested too deeply"),
        ('{"a":' * 200_000, "no valid JSON: arrays or objects are nested too deeply"),
        ("[" + "9" * 5000 + "]", "no valid JSON: a number has thousands of digits"),
        ({**APPEND, "commands": []}, "commands: is empty; allowed: 1 to 100 commands"),
        ({"class": "MoveL", "commands": {}}, "commands: an object is not an array of commands"),
        ({"class": "MoveL", "commands": [LINE] * 101}, "commands: has 101 commands; allowed: 1 to 100 commands"),
        ({"class": "MoveWait", "commands": [WAIT] * 2}, "commands: has 2 commands; allowed: 1 command, because MoveW"),
        ({"commands": [LINE]}, "class: is missing; it names the class of all commands of the list"),
        ({**APPEND, "class": 5}, "class: 5 is not the name of a command class"),
        ([LINE, {**APPEND, "class": "MovL"}], '2.class: "MovL" is no known class; did you mean "MoveL"?'),
        ({**APPEND, "comands": 1}, 'comands: is no known member; did you mean "commands"?'),
        ('{"class":"MoveL","class":"MoveL","commands":[{"target":{}}]}', "class: is there twice"),
    ],
)
def test_what_is_wrong_with_the_file_is_told_once(file: object, says: str) -> None:
    found = check(file)
    assert not found.good
    assert len(found.problems) == 1
    assert str(found.problems[0]).startswith(says)
    assert found.n_wrong == 0


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (5, "1: 5 is not a command object"),
        (None, "1: null is not a command object"),
        ([], "1: an empty array is not a command object"),
        ({"target": {}}, "1: class: is missing; it is the name of a command class"),
        ({"class": 5}, "1: class: 5 is not the name of a command class"),
        ({"class": "MovL"}, '1: class: "MovL" is no known class; did you mean "MoveL"?'),
        ({"class": "Frame"}, '1: class: "Frame" is no known class; known are MoveAbsJCommand, MoveJCommand'),
        ({**JOINTS, "jointSpeed": 1.5}, "1: jointSpeed: 1.5 is not -1 or a number from 0 to 1"),
        ({**LINE, "speed": float("nan")}, "1: speed: NaN is not -1 or a number from 5 to 4000; it must be finite"),
        ({**LINE, "speed": 4500}, "1: speed: 4500 is not -1 or a number from 5 to 4000"),
        ({**LINE, "speed": "200"}, '1: speed: "200" is not -1 or a number from 5 to 4000; it stands without quotes'),
        ({**LINE, "target": {"trans": [True, 0, 0]}}, "1: target.trans[0]: true is not a number"),
        ({**WAIT, "duration_": 0}, "1: duration_: 0 is not a number of at least 0.001"),
        ({"class": "MoveSP", "target": {}}, "1: direction: is missing"),
    ],
)
def test_what_is_wrong_with_a_command_is_told_by_its_member(command: object, says: str) -> None:
    (found,) = problems(check([command]))
    assert found.startswith(says)


def test_joints_must_fit_the_robot() -> None:
    assert problems(check([JOINTS], axes=7)) == ["1: target.joints: has 6 elements; the robot has 7 axes"]
    assert check([JOINTS], axes=6).good


def test_without_a_robot_all_commands_must_agree() -> None:
    seven = {**JOINTS, "target": {"joints": [0] * 7}}
    assert problems(check([LINE, JOINTS, seven])) == [
        "3: target.joints: has 7 elements; command 2 has 6, and all are for one robot"
    ]
    assert problems(check(lines(seven, JOINTS))) == [
        "line 2: target.joints: has 6 elements; command line 1 has 7, and all are for one robot"
    ]
    assert check([seven, seven]).good


def test_an_industrial_robot_may_be_faster() -> None:
    fast = {**LINE, "speed": 7000}
    assert check([fast], work_type="industrial").good
    assert not check([fast], work_type="collaborative").good


def test_a_member_that_is_there_twice_is_told() -> None:
    text = '[{"class": "MoveL", "target": {"trans": [0,0,0], "rpy": [0,0,0], "rpy": [1,0,0]}, "speed": 5, "speed": 6}]'
    assert problems(check(text)) == ["1: speed: is there twice", "1: target.rpy: is there twice"]


def test_a_command_of_a_list_may_repeat_the_class_but_not_change_it() -> None:
    found = check({"class": "MoveL", "commands": [LINE, JOINTS, 7]})
    assert problems(found)[0] == '2: class: "MoveAbsJCommand" is not "MoveL", the one class of this list'
    assert problems(found)[-1] == "3: 7 is not an object"
    assert not found.rows[0].problems


def test_too_large_a_file_is_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "LARGEST", 100)
    assert problems(check(b" " * 101)) == ["has 101 bytes; 100 are read at most"]
    assert documents.LARGEST == COMMANDS.largest == 64 * 1024 * 1024


def test_huge_numbers_and_odd_texts_are_shown_shortened() -> None:
    (odd,) = check([{"class": "x" * 5000}]).rows
    assert max(map(len, odd.cells)) < 100
    text = f'[{{"class": "MoveL", "target": {{"trans": [1{"0" * 400}, 1e999, 0]}}, "speed": "{"x" * 500}"}}]'
    found = check(text)
    assert [problem.path for problem in found.rows[0].problems] == ["target.trans[0]", "target.trans[1]", "speed"]
    assert max(len(str(problem)) for problem in found.rows[0].problems) < 200
    assert max(map(len, found.rows[0].cells)) < 100


@pytest.mark.parametrize(
    "value",
    [LINE, JOINTS, WAIT, APPEND, [LINE, JOINTS, WAIT], [APPEND, APPEND], [APPEND, LINE], {**APPEND, "class": "MoveL"}],
)
def test_the_schema_takes_what_the_check_takes(value: object) -> None:
    Draft202012Validator.check_schema(schema())
    VALIDATOR.validate(value)
    assert check(value).good


@pytest.mark.parametrize(
    "value",
    [
        [], 5, {}, [5], {"class": "MoveL"}, {**LINE, "class": "MovL"}, {**LINE, "more": 1}, {**APPEND, "more": 1},
        {**APPEND, "commands": []}, {**APPEND, "commands": [LINE] * 101}, {**JOINTS, "jointSpeed": 1.5},
        {"class": "MoveWait", "commands": [WAIT, WAIT]}, {"commands": [LINE]}, {**APPEND, "commands": [JOINTS]},
    ],
)  # fmt: skip
def test_the_schema_refuses_what_the_check_refuses(value: object) -> None:
    assert not VALIDATOR.is_valid(value)
    assert not check(value).good


@given(st.binary(max_size=60) | st.text(max_size=60).map(lambda text: text.encode("utf-8", "replace")))
def test_no_bytes_make_it_fail(data: bytes) -> None:
    assert not check_commands(data, CommandOptions()).good


LEAF = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3)
JSON = st.recursive(
    LEAF | st.sampled_from(["MoveL", "MoveWait"]),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(["class", "commands", "target", "joints", "trans", "speed", "zone", "duration_"]), inner
        )
    ),
    max_leaves=12,
)


@given(JSON | st.lists(st.fixed_dictionaries({"class": st.just("MoveL"), "target": JSON}, optional={"speed": JSON})))
def test_no_json_makes_it_fail(value: object) -> None:
    for row in check(value).rows:
        assert len(row.cells) == len(COMMANDS.columns)


def test_thousands_of_unknown_members_are_not_all_told() -> None:
    many = {f"m{number}": 1 for number in range(5000)}
    assert len(check({**APPEND, **many}).problems) == 100
    assert len(check([{**LINE, **many}]).rows[0].problems) == 101
    pairs = ", ".join(f'"{"y" * 200}{number}": 1' for number in range(500))
    twice = check(f'[{{"class": "MoveWait", {pairs}, {pairs}}}]').rows[0].problems
    assert len(twice) == 201
    assert max(len(str(problem)) for problem in twice) < 200


def test_what_stands_there_is_shown_also_where_it_is_wrong() -> None:
    (row,) = check([{**LINE, "speed": None, "zone": -1}]).rows
    assert row.cells[3:] == ("null", "default")


def test_options_of_another_type_are_a_mistake_of_the_caller() -> None:
    class Other(msgspec.Struct):
        pass

    with pytest.raises(TypeError, match="Other is no CommandOptions"):
        check_commands(b"[]", Other())
