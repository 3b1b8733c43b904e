"""The scanner knows the line of every key, whatever stands around it."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.config.toml_lines import Path, lines


def paths(value: object, path: Path = ()) -> Iterator[Path]:
    """Every path of a parsed text."""
    if path:
        yield path
    if isinstance(value, dict):
        for name, part in value.items():
            yield from paths(part, (*path, name))
    elif isinstance(value, list):
        for index, part in enumerate(value):
            yield from paths(part, (*path, index))


TRICKY = (
    "# [[robots]]",
    'a = "x" # "b = 1"',
    "\"b.c\" = 'its'",
    'multi = """',
    "[[robots]]",
    'c = 1 \\""" # ] } , =',
    '"""""',
    'lit = """"quoted" at both ends"""""',
    'd.e . "f \\" g" = [ 1, # one',
    "  [ \"]\", '[' ],",
    "  { x = 1, \"y,}\" = '''",
    "z = 3",
    "''' },",
    "]",
    '[ server . "deep key" ] # ]',
    "when = 1979-05-27 07:32:00 # a date with a space",
    "inf = -inf",
    "empty = []",
    "none = {}",
    "[[robots]]",
    "[[robots]]",
    'name = "r\\\\"',
    "[robots.reqdata]",
    "x = '\\'",
    "[[robots.list]]",
    "[[robots.list]]",
    "n = 0xff",
    "[[robots]]",
    "[[robots.list]]",
    "last = 1",
)


def test_nothing_that_stands_in_strings_comments_or_arrays_confuses_it() -> None:
    text = "\n".join(TRICKY)
    found = lines(text).found
    assert set(found) == set(paths(tomllib.loads(text)))
    expected: dict[Path, int] = {
        ("a",): 2,
        ("b.c",): 3,
        ("multi",): 4,
        ("lit",): 8,
        ("d", "e", 'f " g'): 9,
        ("d", "e", 'f " g', 0): 9,
        ("d", "e", 'f " g', 1, 1): 10,
        ("d", "e", 'f " g', 2, "y,}"): 11,
        ("server",): 15,
        ("server", "deep key"): 15,
        ("server", "deep key", "when"): 16,
        ("robots",): 20,
        ("robots", 0): 20,
        ("robots", 1, "name"): 22,
        ("robots", 1, "reqdata", "x"): 24,
        ("robots", 1, "list", 1, "n"): 27,
        ("robots", 2, "list", 0, "last"): 30,
    }
    assert {path: found[path] for path in expected} == expected


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_both_kinds_of_line_ends_count_the_same(newline: str) -> None:
    assert lines(newline.join(['a = """', '"""', "b = 1"])).found == {("a",): 1, ("b",): 3}


def test_a_path_without_a_line_has_that_of_what_is_around_it() -> None:
    found = lines("\n[server]\n")
    assert found.of(("server", "listen")) == 2
    assert found.of(("robots", 0)) is None


@pytest.mark.parametrize(
    ("text", "twice"),
    [
        ("a = 1\na = 2", (("a",), 2)),
        ("[a]\nb = 1\nb = 2", (("a", "b"), 3)),
        ("[a]\n[b]\n[a]", (("a",), 3)),
        ("[[a]]\nb = 1\n[[a]]\nb = 1\nb.c = 1\n'b' = 3", (("a", 1, "b"), 6)),
    ],
)
def test_a_key_or_table_that_is_there_twice_is_noted(text: str, twice: tuple[Path, int]) -> None:
    assert lines(text).twice == [twice]


@pytest.mark.parametrize(
    "text",
    ["a", "a =", "[", "[a", '"', 'a = "', "a = [", "a = [1 2]", "a = {b", "=", "\x00", "[" * 5000],
)
def test_a_text_that_is_no_toml_ends_the_walk(text: str) -> None:
    assert len(lines(f"first = 1\n{text}").found) <= 3


@given(st.text(alphabet="ab.=[]{}\"'\\#, \n1", max_size=60))
def test_any_text_that_tomllib_takes_is_understood_and_no_other_hurts(text: str) -> None:
    found = lines(text)
    try:
        parsed = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return
    assert set(found.found) == set(paths(parsed))
    assert not found.twice


WORDS = st.text(alphabet="#'[]{}=,\n\"\\ aé", max_size=8)


def _toml(text: str) -> Iterator[str]:
    """A text in each of the ways TOML can write it."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    yield '"' + escaped.replace("\n", "\\n") + '"'
    yield f'"""{escaped}"""'
    if "'''" not in text and not text.endswith("'"):
        yield f"'''{text}'''"


@st.composite
def documents(draw: st.DrawFn) -> tuple[str, dict[Path, int]]:
    """A text whose author noted the line of each key while writing it."""
    text, noted, table, sizes = "", dict[Path, int](), Path(), 0
    for index in range(draw(st.integers(1, 12))):
        line = text.count("\n") + 1
        match draw(st.sampled_from(["pair", "pair", "array", "inline", "table", "tables", "comment"])):
            case "table":
                table = (f"t{index}",)
                text += f"[ t{index} ]"
            case "tables":
                table = ("list", sizes)
                sizes += 1
                text += "[[list]] # [x]"
            case "comment":
                text += "# " + draw(WORDS).replace("\n", "")
                text += "\n"
                continue
            case kind:
                value = draw(st.sampled_from(list(_toml(draw(WORDS)))))
                if kind == "array":
                    value = f"[ {value}, # ]\n\n {value} ,]"
                elif kind == "inline":
                    value = f"{{ a = {value}, b.c = [{value}] }}"
                noted[*table, f"k {index}"] = line
                text += f'"k {index}" = {value}'
        text += draw(st.sampled_from(["\n", " # c\n", "\n\n"]))
    return text, noted


@given(documents())
def test_the_line_of_each_key_is_the_one_its_author_wrote_it_on(document: tuple[str, dict[Path, int]]) -> None:
    text, noted = document
    parsed, found = tomllib.loads(text), lines(text).found
    assert set(found) == set(paths(parsed))
    assert {path: found[path] for path in noted} == noted
