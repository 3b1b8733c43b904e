"""`[export.nats]`: what may stand in it, what is wrong with it, and that no secret is ever shown."""

from __future__ import annotations

from pathlib import Path

import pytest

from gateway.config import Config, parse
from gateway.config.diff import KeyChange, diff, understand
from gateway.config.exports import server_fault
from gateway.config.printing import as_toml
from gateway.errors import ConfigError

NATS = '[export.nats]\nservers = ["nats://127.0.0.1:4222"]\nplant = "plant1"\ncell = "cell1"\n'


def read(text: str, folder: Path = Path(), **env: str) -> Config:
    return parse(text, "gateway.toml", folder=folder, env=env)


def problem(text: str, folder: Path = Path()) -> str:
    with pytest.raises(ConfigError) as error:
        read(text, folder)
    return "\n".join(error.value.problems)


def test_the_least_that_must_stand_there_has_every_default() -> None:
    nats = read(NATS, STATE_DIRECTORY="/var/lib/robot-gateway:/other").export.nats
    assert nats is not None
    assert nats.outbox == Path("/var/lib/robot-gateway/outbox")
    assert (nats.table.stream_name, nats.table.bucket_name, nats.table.format) == ("plant1-events", "plant1", "json")
    assert "events" in nats.table.groups
    assert read("").export.nats is None


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ('cell = "cell.1"', "gateway.toml:4: export.nats.cell:"),
        ('cell = "cell 1"', "one word of every subject"),
        ('plant = "*"', "one word of every subject"),
        ('servers = ["http://x"]', "begins with none of nats://"),
        ('servers = ["nats://u:hunter22@x:4222"]', "no user and no password stands in an address"),
        ('servers = ["nats://x:99999"]', "is no address like"),
        ("servers = []", "a list of addresses"),
        ("samples_hz = -1", "a number from 0 to 100"),
        ('groups = ["joint"]', "export.nats.groups"),
        ('stream = "a.b"', "is no name"),
        ("sample_hz = 1", "did you mean"),
        ('credentials = "missing"', "missing: does not exist"),
        ('tls_certificate = "c.pem"', "stand together"),
        ('tls_ca = "wrong.pem"', "cannot be used"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(tmp_path: Path, keys: str, words: str) -> None:
    (tmp_path / "wrong.pem").write_text("no certificate")
    name = keys.partition(" ")[0]
    lines = [line for line in NATS.splitlines() if not line.startswith(f"{name} ")]
    at = 3 if name in {"cell", "plant"} else len(lines)
    lines.insert(min(at, len(lines)), keys)
    told = problem("\n".join(lines), tmp_path)
    assert words in told
    assert "hunter22" not in told


def test_another_table_is_unknown() -> None:
    assert "export.mqtt: unknown table" in problem("[export.mqtt]\n")
    assert "must be a table" in problem("export = 1\n")


def test_without_the_package_the_configuration_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gateway.config.exports.has_nats", lambda: False)
    assert "pip install 'robot-gateway[nats]'" in problem(NATS)


def test_a_secret_is_read_at_its_path_or_among_the_credentials_and_never_printed(tmp_path: Path) -> None:
    (tmp_path / "creds").mkdir()
    (tmp_path / "creds" / "robot-gateway_cell.creds").write_text("cell1:s3cr3t-w0rd\n")
    config = read(NATS + 'credentials = "cell.creds"\n', tmp_path, CREDENTIALS_DIRECTORY=str(tmp_path / "creds"))
    assert config.export.nats is not None
    assert config.export.nats.access.secret == "cell1:s3cr3t-w0rd"  # noqa: S105 - invented
    assert "s3cr3t" not in as_toml(config) + repr(config)


def test_credentials_in_the_clear_over_the_network_are_a_warning(tmp_path: Path) -> None:
    (tmp_path / "c").write_text("cell1:word")
    text = NATS.replace("127.0.0.1", "10.0.0.1") + 'credentials = "c"\n'
    assert "in the clear" in " ".join(read(text, tmp_path).warnings)
    assert "clear" not in " ".join(read(text.replace("nats://", "tls://"), tmp_path).warnings)


def test_a_reload_names_the_keys_that_change_and_of_a_secret_only_that_it_does(tmp_path: Path) -> None:
    (tmp_path / "c").write_text("cell1:one")
    text = NATS + 'credentials = "c"\n'
    before = understand(read(text, tmp_path))
    assert diff(before, understand(read(text, tmp_path)), ()).exports == []
    changed = diff(before, understand(read(text + "samples_hz = 5\n", tmp_path)), ())
    assert changed.exports == [KeyChange(key="nats.samples_hz", before="1.0", after="5.0")]
    (tmp_path / "c").write_text("cell1:other")
    assert diff(before, understand(read(text, tmp_path)), ()).exports == [KeyChange(key="nats.credentials")]
    gone = diff(before, understand(read("", tmp_path)), ())
    assert KeyChange(key="nats.cell", before='"cell1"') in gone.exports
    assert not gone.doors


def test_what_is_printed_means_the_same() -> None:
    config = read(NATS + "samples_hz = 3\n", STATE_DIRECTORY="/s")
    printed = as_toml(config)
    again = read(printed)
    assert as_toml(again) == printed
    assert again.export.nats is not None
    assert config.export.nats is not None
    assert again.export.nats.outbox == config.export.nats.outbox


@pytest.mark.parametrize("server", ["127.0.0.1", "nats://h", "tls://h:1", "wss://h", "nats://[::1]:4222"])
def test_right_addresses(server: str) -> None:
    assert server_fault(server) is None
