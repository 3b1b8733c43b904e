"""`robot-gateway token`: the token stands on stdout once and nowhere else; the file holds names, hashes and topics."""

from __future__ import annotations

import hashlib
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.cli.command import PYTHON, ROOT, Finished, command_here, environment

TOKEN = re.compile(r"rgw_[A-Za-z0-9_-]{43}\n")
AMPLE = "rgw_" + "a" * 43


def said(text: str, *arguments: str) -> Finished:
    """Run `robot-gateway token` with a text on its stdin."""
    done = subprocess.run(  # noqa: S603
        [*PYTHON, "token", *arguments],
        input=text,
        env=environment(),
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
        timeout=15,
    )
    return Finished(done.returncode, done.stdout, done.stderr)


def entries(text: str) -> list[dict[str, object]]:
    """The entries of a file of tokens."""
    found = tomllib.loads(text)["tokens"]
    assert isinstance(found, list)
    return found


def test_a_new_token_stands_alone_on_stdout_and_its_entry_on_stderr() -> None:
    done = command_here("token", "new", "hmi", "--topics", "r1/*", "--topics", "*/safety,*/link")
    assert done.code == 0
    assert TOKEN.fullmatch(done.out)
    token = done.out.strip()
    assert token not in done.err
    _, _, entry = done.err.partition("\n\n")
    assert entries(entry) == [
        {"name": "hmi", "sha256": hashlib.sha256(token.encode()).hexdigest(), "topics": ["r1/*", "*/safety", "*/link"]}
    ]


def test_no_two_tokens_are_the_same() -> None:
    assert command_here("token", "new", "a").out != command_here("token", "new", "a").out


def test_an_entry_is_added_to_the_file_which_others_may_not_read(tmp_path: Path) -> None:
    file = tmp_path / "tokens.toml"
    first = command_here("token", "new", "hmi", "--file", str(file))
    second = command_here("token", "new", "paint", "--topics", "r2/*", "--file", str(file))
    assert (first.code, second.code) == (0, 0)
    assert "added: hmi, to" in first.err
    assert file.stat().st_mode & 0o777 in {0o600, 0o640}
    text = file.read_text("utf-8")
    assert [(entry["name"], entry["topics"]) for entry in entries(text)] == [("hmi", ["*"]), ("paint", ["r2/*"])]
    assert entries(text)[1]["sha256"] == hashlib.sha256(second.out.strip().encode()).hexdigest()
    for done in (first, second):
        assert done.out.strip() not in text + done.err


@pytest.mark.parametrize("kept", ["# ours", "# ours\n", "# ours\n\n"])
def test_what_stands_in_the_file_stays_and_so_does_its_mode(kept: str, tmp_path: Path) -> None:
    file = tmp_path / "tokens.toml"
    file.write_text(kept)
    file.chmod(0o644)
    assert command_here("token", "new", "hmi", "--file", str(file)).code == 0
    assert file.read_text().startswith(kept)
    assert [entry["name"] for entry in entries(file.read_text())] == ["hmi"]
    assert file.stat().st_mode & 0o777 == 0o644


def test_a_name_is_never_there_twice(tmp_path: Path) -> None:
    file = tmp_path / "tokens.toml"
    command_here("token", "new", "hmi", "--file", str(file))
    before = file.read_bytes()
    done = command_here("token", "new", "hmi", "--file", str(file))
    assert (done.code, done.out) == (1, "")
    assert "there is a token for hmi already" in done.err
    assert file.read_bytes() == before


def test_many_at_once_are_all_there(tmp_path: Path) -> None:
    file = tmp_path / "tokens.toml"
    names = [f"n{number % 3}" for number in range(6)]  # each of them twice
    started = [
        subprocess.Popen(  # noqa: S603
            [sys.executable, "-m", "gateway", "token", "new", name, "--file", str(file)],
            env=environment(),
            cwd=ROOT,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for name in names
    ]
    assert sorted(process.wait(15) for process in started) == [0, 0, 0, 1, 1, 1]
    assert sorted(str(entry["name"]) for entry in entries(file.read_text())) == ["n0", "n1", "n2"]


@pytest.mark.parametrize("text", ["tokens = 3", "[[tokens]]\nsha256 = ''", "name = ", "\udcff"])
def test_a_file_that_is_no_file_of_tokens_is_left_alone(text: str, tmp_path: Path) -> None:
    file = tmp_path / "tokens.toml"
    file.write_bytes(text.encode(errors="surrogateescape"))
    made = command_here("token", "new", "hmi", "--file", str(file))
    listed = command_here("token", "list", str(file))
    for done in (made, listed):
        assert (done.code, done.out) == (78, "")
        assert str(file) in done.err.replace("\n", "")
        assert "Traceback" not in done.err
    assert file.read_bytes() == text.encode(errors="surrogateescape")


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["new", "HMI"], 2, "1 to 32 of the characters"),
        (["new", ""], 2, "1 to 32 of the characters"),
        (["new", "a" * 33], 2, "1 to 32 of the characters"),
        (["new", "hmi", "--topics", "r1"], 2, "it matches no topic"),
        (["new", "hmi", "--topics", ""], 2, "it matches no topic"),
        (["new", "hmi", "--topics", "r1/*\n"], 0, ""),
        (["new", "hmi", "--file", "/nowhere/tokens.toml"], 1, "No such file or directory"),
        (["list", "/nowhere/tokens.toml"], 78, "does not exist"),
    ],
)
def test_what_cannot_be_done_is_said(arguments: list[str], code: int, says: str) -> None:
    done = command_here("token", *arguments)
    assert done.code == code
    assert says in done.err
    assert "Traceback" not in done.err


def test_the_hash_is_that_of_the_file() -> None:
    token = command_here("token", "new", "hmi")
    hashed = said(token.out, "hash")
    assert (hashed.code, hashed.err) == (0, "")
    assert hashed.out.strip() in token.err
    assert said(token.out.strip(), "hash").out == hashed.out


@pytest.mark.parametrize("text", ["", "\n", f"{AMPLE}\n{AMPLE}\n", "\udcff"])
def test_what_is_not_one_token_is_not_hashed(text: str) -> None:
    done = subprocess.run(  # noqa: S603
        [*PYTHON, "token", "hash"],
        input=text.encode(errors="surrogateescape"),
        env=environment(),
        cwd=ROOT,
        check=False,
        capture_output=True,
        timeout=15,
    )
    assert (done.returncode, done.stdout) == (2, b"")
    assert b"one token and nothing else" in done.stderr


def test_a_short_token_is_hashed_with_a_warning() -> None:
    done = said("letmein\n", "hash")
    assert done.out.strip() == hashlib.sha256(b"letmein").hexdigest()
    assert "short enough to be guessed" in done.err
    assert "letmein" not in done.err


def test_the_list_has_names_and_topics_and_no_hash(tmp_path: Path) -> None:
    file = tmp_path / "tokens.toml"
    for arguments in (["hmi"], ["paint", "--topics", "r2/*,r3/*"]):
        command_here("token", "new", *arguments, "--file", str(file))
    done = command_here("token", "list", str(file))
    assert (done.code, done.err) == (0, "")
    assert [line.split() for line in done.out.splitlines()] == [
        ["name", "topics"],
        ["hmi", "*"],
        ["paint", "r2/*", "r3/*"],
    ]
    file.write_text("")
    assert command_here("token", "list", str(file)).out == "no tokens\n"
