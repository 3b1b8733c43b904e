from __future__ import annotations

import pytest

from gateway.config import parse
from gateway.config.printing import as_toml
from gateway.core.registry import Registry
from gateway.core.settings import RobotSettings
from gateway.errors import ConfigError

HEAD = '[[robots]]\nname = "r1"\nvendor = "fairino"\nhost = "192.0.2.1"\n'


def robot(text: str) -> RobotSettings:
    (found,) = parse(HEAD + text, "test.toml", Registry()).robots
    assert isinstance(found, RobotSettings)
    return found


def test_the_port_follows_the_transport() -> None:
    assert robot("").port == 20005
    assert robot('[robots.cnde]\ntransport = "udp"').port == 20006
    assert robot('port = 7\n[robots.cnde]\ntransport = "udp"').port == 7


def test_a_clock_zone_is_a_name_of_the_zone_database() -> None:
    found = robot('clock_zone = "Asia/Seoul"')
    assert str(found.clock_zone) == "Asia/Seoul"
    again = as_toml(parse(HEAD + 'clock_zone = "Asia/Seoul"', "test.toml", Registry()))
    assert 'clock_zone = "Asia/Seoul"' in again
    assert "# clock_zone is not set" in as_toml(parse(HEAD, "test.toml", Registry()))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('clock_zone = "Asia/Soul"', "no time zone that this machine knows"),
        ('clock_zone = "../etc/passwd"', "no time zone that this machine knows"),
        ('clock_zone = "UTC"\nprotocol = "status"', "does not tell the controller's time"),
        ('[robots.cnde]\nstates = ["tool"]', "is a field of the state 'tool_id'"),
        ("[robots.cnde]\nperiod_ms = 4", "period_ms"),
        ('[robots.cnde]\ntransport = "serial"', "transport"),
    ],
)
def test_what_is_wrong_is_named(text: str, problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        robot(text)


def test_states_are_a_list_of_names() -> None:
    found = robot('[robots.cnde]\nstates = ["program_state", "actual_joint_pos"]')
    assert found.signal_options["states"] == ("program_state", "actual_joint_pos")
