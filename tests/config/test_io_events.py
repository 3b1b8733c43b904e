"""The key `io_events` of a robot: which inputs and outputs have events."""

from __future__ import annotations

import pytest

from gateway.config import parse
from gateway.config.printing import as_toml
from gateway.core.settings import RobotSettings
from gateway.errors import ConfigError

_ROBOT = '[[robots]]\nname = "r1"\nvendor = "{vendor}"\nhost = "10.0.0.2"\n'


def read(value: str, vendor: str = "rainbow") -> tuple[str, ...]:
    """The globs of a robot, which are the same after printing and reading again."""
    config = parse(f"{_ROBOT.format(vendor=vendor)}io_events = {value}\n", "test")
    (robot,) = config.robots
    (again,) = parse(as_toml(config), "again").robots
    assert isinstance(robot, RobotSettings)
    assert isinstance(again, RobotSettings)
    assert robot.io_events == again.io_events
    return robot.io_events


@pytest.mark.parametrize(
    "globs", [(), ("digital_in.box.3", "digital_out.*"), ("*",), ("digital_in",), ("digital_*.t?ol.[01]",)]
)
def test_globs_of_banks_that_the_protocol_tells_are_taken(globs: tuple[str, ...]) -> None:
    assert read(repr(list(globs))) == globs


def test_where_the_controller_names_the_banks_any_name_may_stand() -> None:
    assert read('["digital_in.lamp.0"]', 'xcore"\nprotocol = "objects') == ("digital_in.lamp.0",)


@pytest.mark.parametrize(
    ("value", "vendor", "says"),
    [
        ('["digital_in.bux.3"]', "rainbow", 'is called "digital_in.bux.3"; did you mean "digital_in.box"?'),
        ('["digital_out.9"]', "rainbow", "no input or output is called"),
        ('["analog_in.box.0"]', "rainbow", "analog_in.box.0"),
        ('["digital_in.box.0.1"]', "rainbow", "digital_in.box.0.1"),
        ('[""]', "rainbow", "io_events"),
        ('["digital_in.box.0", 3]', "rainbow", "io_events"),
        ('"digital_in.box.3"', "rainbow", "io_events"),
        ("true", "rainbow", "io_events"),
        ('["*"]', 'fairino"\nprotocol = "status', "does not tell inputs and outputs; remove the key"),
    ],
)
def test_an_event_that_could_never_come_is_an_error_in_its_line(value: str, vendor: str, says: str) -> None:
    with pytest.raises(ConfigError) as refused:
        read(value, vendor)
    assert says in str(refused.value)
    assert ": robots.0.io_events" in str(refused.value) or "io_events" in str(refused.value)
