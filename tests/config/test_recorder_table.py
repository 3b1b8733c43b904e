"""The table `[recorder]`: what is right, what is wrong with it, and what a reload changes of it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import msgspec
import pytest

from gateway.config import parse
from gateway.config.diff import diff, understand
from gateway.config.printing import as_toml, robots_as_toml
from gateway.core.registry import Registry
from gateway.core.settings import RobotSettings
from gateway.errors import ConfigError
from gateway.record.settings import recorder_settings

REGISTRY = Registry()
ROBOT = '[[robots]]\nname = "r1"\nvendor = "rainbow"\nhost = "10.0.0.1"\n'


def test_without_the_table_everything_is_kept_and_written_into_the_state_folder() -> None:
    recorder = parse("", "test", REGISTRY).recorder
    settings = recorder_settings(recorder, {"STATE_DIRECTORY": "/var/lib/robot-gateway"})
    assert recorder.enabled
    assert settings.directory == Path("/var/lib/robot-gateway/recordings")
    assert settings.on == ("fault.raised", "estop.pressed", "collision.detected", "link.lost")
    assert (settings.before_s, settings.after_s, settings.ring_s, settings.ring_bytes) == (30, 10, 60, 32_000_000)
    assert recorder_settings(recorder, {}).directory is None


def test_a_folder_is_found_from_that_of_the_file() -> None:
    config = parse('[recorder]\ndirectory = "recordings"\n', "test", REGISTRY, Path("/etc/cell"))
    assert recorder_settings(config.recorder, {"STATE_DIRECTORY": "/x"}).directory == Path("/etc/cell/recordings")
    assert 'directory = "/etc/cell/recordings"' in as_toml(config)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("recorder = 5", "write [recorder]"),
        ("[recorder]\nbefore = 5", 'did you mean "before_s"?'),
        ("[recorder]\nbefore_s = 90", "ring_s keeps"),
        ("[recorder]\nring_s = 10", "ring_s keeps"),
        ('[recorder]\non = ["estop.presed"]', 'did you mean "estop.pressed"?'),
        ('[recorder]\non = ["stop"]', "recorder.on"),
        ("[recorder]\nkeep_files = 0", "recorder.keep_files"),
        ("[recorder]\nring_mb = 0.1", "recorder.ring_mb"),
        ("[recorder]\nvendor_dirs = []", "above the first [table]"),
    ],
)
def test_what_is_wrong_is_named_with_a_hint(text: str, said: str) -> None:
    with pytest.raises(ConfigError) as raised:
        parse(text, "test", REGISTRY)
    assert said in str(raised.value)


def test_what_is_printed_means_the_same() -> None:
    config = parse('[recorder]\non = []\nkeep_mb = 5.5\ndirectory = "/x"\n' + ROBOT, "test", REGISTRY)
    assert parse(as_toml(config), "test", REGISTRY).recorder == config.recorder


def test_robots_alone_are_printed_without_anything_of_the_server() -> None:
    config = parse('[server]\nlisten = "127.0.0.1:1234"\n' + ROBOT, "test", REGISTRY)
    text = robots_as_toml(robot for robot in config.robots if isinstance(robot, RobotSettings))
    assert "server" not in text
    assert "1234" not in text
    assert parse(text, "test", REGISTRY).robots == config.robots


def test_a_reload_names_what_changes_and_what_has_to_wait_for_a_restart() -> None:
    config = parse("", "test", REGISTRY)
    other = dataclasses.replace(config, recorder=msgspec.structs.replace(config.recorder, after_s=5.0, enabled=False))
    plan = diff(understand(config), understand(other), ())
    assert [(one.key, one.before, one.after) for one in plan.recorder] == [("after_s", "10.0", "5.0")]
    assert [told for told in plan.restart if told.startswith("recorder.enabled:")]
    assert diff(understand(config), understand(config), ()).recorder == []
