"""The file of tokens, the other keys of access in `[server]`, and what their problems never say."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from gateway.config import load
from gateway.config.file import parse
from gateway.config.printing import as_toml
from gateway.config.tokens import Token, read_tokens, secret_file
from gateway.errors import ConfigError
from gateway.server.settings import door_settings
from tests.server.certificates import certificate

SECRET = "rgw_" + "abcdefgh_-" * 4 + "xyz"
HASH = hashlib.sha256(SECRET.encode()).hexdigest()
OTHER = hashlib.sha256(b"other").hexdigest()
GOOD = (
    f'[[tokens]]\nname = "hmi"\nsha256 = "{HASH}"\n\n[[tokens]]\nname = "r1"\nsha256 = "{OTHER}"\ntopics = ["r1/*"]\n'
)
ROBOT = '[[robots]]\nname = "r1"\nvendor = "rainbow"\nhost = "10.0.2.7"\n'


def written(folder: Path, text: str, name: str = "tokens.toml") -> Path:
    path = folder / name
    path.write_text(text, "utf-8")
    path.chmod(0o600)
    return path


def problems(path: Path) -> tuple[str, ...]:
    with pytest.raises(ConfigError) as error:
        read_tokens(path)
    return tuple(error.value.problems)


def test_a_file_of_tokens_is_read(tmp_path: Path) -> None:
    assert read_tokens(written(tmp_path, GOOD)) == (
        Token("hmi", bytes.fromhex(HASH), ("*",)),
        Token("r1", bytes.fromhex(OTHER), ("r1/*",)),
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f'[[tokens]]\nsha256 = "{HASH}"\n', "tokens.toml:1: tokens: name is missing"),
        ('[[tokens]]\nname = "a"\n', "tokens.toml:1: tokens: sha256 is missing"),
        (f'[[tokens]]\nname = "A b"\nsha256 = "{HASH}"\n', "tokens.toml:2: tokens.name: must be a name of 1 to 32"),
        (
            f'[[tokens]]\nname = "a"\nsha256 = "{SECRET}"\n',
            "tokens.toml:3: tokens.sha256: must be the hash of the token",
        ),
        (f'[[tokens]]\nname = "{SECRET}"\nsha256 = "{HASH}"\n', "tokens.toml:2: tokens.name: must be"),
        (f'[[tokens]]\nname = "a"\ntoken = "{SECRET}"\n', "the token itself must not stand here; its sha256 does"),
        (f'[[tokens]]\nname = "a"\nsha256 = "{HASH}"\ntopics = "*"\n', "tokens.topics: must be a list of globs"),
        (f'[[tokens]]\nname = "a"\nsha256 = "{HASH}"\ntopics = ["r1"]\n', 'such as ["r1/*", "*/joints"]'),
        (f'[[tokens]]\nname = "a"\nsha256 = "{HASH}"\ntopics = []\n', "tokens.topics: must be"),
        (f'[[tokens]]\nname = "a"\nsha256 = "{HASH}"\ntopic = ["*"]\n', 'unknown key; did you mean "topics"?'),
        (GOOD.replace('"r1"', '"hmi"'), "tokens.toml:6: tokens.name: is already the name of the token in line 2"),
        (GOOD.replace(OTHER, HASH.upper()), "tokens.sha256: is already the hash of the token in line 3"),
        ("tokens = 1\n", "must be tables: write [[tokens]]"),
        (f"[tokens]\nname = 1\n{SECRET} = 1\n", "must be tables: write [[tokens]]"),
        ("token = 1\n", "tokens.toml:1: token: unknown key; each token stands in a block"),
        (f"{SECRET}\n", "tokens.toml:1: no valid TOML"),
        (f'[[tokens]]\nname = "a"\nsha256 = {SECRET}\n', "tokens.toml:3: no valid TOML at column"),
        (f'"{SECRET}" = 1\n', "unknown key"),
    ],
)
def test_what_is_wrong_is_named_with_its_line_and_without_any_secret(tmp_path: Path, text: str, said: str) -> None:
    told = "\n".join(problems(written(tmp_path, text)))
    assert said in told
    for secret in (SECRET, SECRET[:16], HASH[:16], OTHER[:16]):
        assert secret not in told


def test_everything_that_is_wrong_is_told_at_once(tmp_path: Path) -> None:
    text = '[[tokens]]\nname = "A"\nsha256 = "x"\n[[tokens]]\nnam = "b"\n'
    assert len(problems(written(tmp_path, text))) == 5


@pytest.mark.parametrize("mode", [0o620, 0o602, 0o666])
def test_a_file_that_others_may_write_to_is_refused(tmp_path: Path, mode: int) -> None:
    path = written(tmp_path, GOOD)
    path.chmod(mode)
    (problem,) = problems(path)
    assert problem == f"{path}: others may write to it, and so make themselves a token; run: chmod go-w {path}"


def test_a_file_that_is_none_is_named(tmp_path: Path) -> None:
    assert "does not exist; robot-gateway token makes" in problems(tmp_path / "none.toml")[0]
    assert "is a folder" in problems(tmp_path)[0]
    path = tmp_path / "latin.toml"
    path.write_bytes(b'[[tokens]]\nname = "\xe4"\n')
    assert "latin.toml:2: is not UTF-8" in problems(path)[0]


def test_a_secret_is_found_among_the_credentials_of_systemd_where_its_path_cannot_be_read(tmp_path: Path) -> None:
    asked, handed = tmp_path / "etc" / "tokens.toml", tmp_path / "run"
    handed.mkdir()
    env = {"CREDENTIALS_DIRECTORY": str(handed)}
    assert secret_file(asked, env) == asked
    long = written(handed, GOOD, "robot-gateway_tokens.toml")
    assert secret_file(asked, env) == long
    short = written(handed, GOOD)
    assert secret_file(asked, env) == short
    assert secret_file(asked, {}) == asked
    asked.parent.mkdir()
    written(asked.parent, GOOD)
    assert secret_file(asked, env) == asked


def test_tokens_open_the_gateway_to_other_machines(tmp_path: Path) -> None:
    written(tmp_path, GOOD)
    path = written(tmp_path, f'[server]\nlisten = "0.0.0.0:1"\ntokens = "tokens.toml"\n{ROBOT}', "gateway.toml")
    config = load(path)
    assert config.tokens is not None
    assert [token.name for token in config.tokens] == ["hmi", "r1"]
    assert ["go over the network in the clear" in warning for warning in config.warnings] == [True]
    printed = as_toml(config)
    assert 'tokens = "tokens.toml"' in printed
    assert "# token r1 may read r1/*" in printed
    assert HASH[:12] not in printed
    assert OTHER[:12] not in printed
    settings = door_settings(config)
    assert settings.access.mode == "tokens"
    assert HASH[:12] not in "\n".join(config.warnings)


def test_a_file_without_tokens_lets_nobody_in(tmp_path: Path) -> None:
    written(tmp_path, "")
    config = parse(f'[server]\ntokens = "tokens.toml"\n{ROBOT}', "g.toml", folder=tmp_path)
    assert config.tokens == ()
    assert door_settings(config).access.mode == "tokens"
    assert "nobody can read anything" in config.warnings[0]


def test_problems_of_the_tokens_stand_among_those_of_the_configuration(tmp_path: Path) -> None:
    written(tmp_path, '[[tokens]]\nname = "a"\n')
    with pytest.raises(ConfigError) as error:
        parse('[server]\ntokens = "tokens.toml"\nflush_ms = -1\n', "g.toml", folder=tmp_path)
    assert [problem.split(" ", 2)[:2] for problem in error.value.problems] == [
        ["g.toml:2:", "server.tokens:"],
        ["g.toml:3:", "server.flush_ms:"],
    ]


@pytest.mark.parametrize("line", ['tokens = "{}"', 'token = "{}"', "tokens = {}", 'tokens = ["{}"]', 'listen = "{}"'])
def test_a_token_that_stands_in_the_configuration_itself_is_not_repeated(line: str) -> None:
    with pytest.raises(ConfigError) as error:
        parse(f"[server]\n{line.format(SECRET)}\n", "g.toml")
    assert SECRET[4:12] not in str(error.value)


def test_insecure_is_a_warning_where_it_opens_anything_and_nothing_elsewhere() -> None:
    config = parse(f'[server]\nlisten = "[::]:1"\ninsecure = true\n{ROBOT}', "g.toml")
    assert config.warnings == (
        'g.toml:3: server.insecure: everybody who reaches "[::]:1" can read everything, without a token',
    )
    assert door_settings(config).access.mode == "insecure"
    config = parse(f"[server]\ninsecure = true\n{ROBOT}", "g.toml")
    assert not config.warnings
    assert door_settings(config).access.mode == "loopback"


def test_a_star_among_the_origins_needs_tokens(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="lets any page read the cell"):
        parse('[server]\nallowed_origins = ["*"]\n', "g.toml")
    written(tmp_path, GOOD)
    text = '[server]\nallowed_origins = ["*"]\ntokens = "tokens.toml"\n'
    assert parse(text, "g.toml", folder=tmp_path).server.allowed_origins == ["*"]


def test_hosts_and_origins_are_taken_as_browsers_send_them() -> None:
    hosts = (
        'allowed_hosts = ["Cell.Example.com."]\nallowed_origins = ["HTTPS://HMI.example.com:443", "http://x:8080"]\n'
    )
    access = door_settings(parse(f'[server]\nlisten = "gw.local:1"\ninsecure = true\n{hosts}', "g.toml")).access
    assert access.allowed_hosts == {"cell.example.com", "gw.local"}
    assert access.allowed_origins == {"https://hmi.example.com", "http://x:8080"}


@pytest.mark.parametrize("origin", ["http://x/", "x", "http://x/y", "http://", "null", "http://a@b"])
def test_what_no_browser_sends_is_no_origin(origin: str) -> None:
    with pytest.raises(ConfigError, match="is not a list of origins"):
        parse(f'[server]\nallowed_origins = ["{origin}"]\n', "g.toml")


def test_certificate_and_key_are_looked_at_when_the_configuration_is_read(tmp_path: Path) -> None:
    files = certificate(tmp_path)
    text = f'[server.tls]\ncertificate = "{files.certificate}"\nkey = "cell.key"\n{ROBOT}'
    config = parse(text, "g.toml", folder=tmp_path)
    assert config.tls == files
    assert not config.warnings
    assert "[server.tls]" in as_toml(config)
    files.key.chmod(0o644)
    (warning,) = parse(text, "g.toml", folder=tmp_path).warnings
    assert f"run: chmod o-r {files.key}" in warning
    certificate(tmp_path, days=0)
    (warning,) = parse(text, "g.toml", folder=tmp_path).warnings
    assert "has expired on 20" in warning
    other = certificate(tmp_path, "other")
    other.key.replace(files.key)
    with pytest.raises(ConfigError, match="is not the key of the certificate"):
        parse(text, "g.toml", folder=tmp_path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[server.tls]\ncertificate = "a"\n', "server.tls: key is missing"),
        ('[server.tls]\ncertificate = "a"\nkey = "b"\n', "a: does not exist; put the certificate there"),
        ('[server.tls]\ncertificate = 1\nkey = "b"\n', "server.tls.certificate: 1 is not a file, in quotes"),
        ("[server]\ntls = true\n", "server.tls: must be a table: write [server.tls]"),
    ],
)
def test_what_is_wrong_with_the_table_of_tls_is_named(text: str, said: str) -> None:
    with pytest.raises(ConfigError) as error:
        parse(text, "g.toml")
    assert said in str(error.value)
