"""The options of External Communication: what is refused and why, and what the configuration makes of them."""

from __future__ import annotations

import re

import msgspec
import pytest

from gateway.config import parse
from gateway.config.printing import as_toml
from gateway.core.settings import RobotSettings
from gateway.errors import ConfigError
from vendors.xcore import VENDOR
from vendors.xcore.external_options import ExternalOptions, slowest_s
from vendors.xcore.external_words import WORDS

EXTERNAL = VENDOR.protocol("external")
ROBOT = '[[robots]]\nname = "x1"\nvendor = "xcore"\nhost = "10.0.0.9"\nport = 8100\n'


def robot(text: str) -> RobotSettings:
    (found,) = parse(text, "g.toml").robots
    assert isinstance(found, RobotSettings)
    return found


def options(text: str) -> ExternalOptions:
    found = robot(text).options
    assert isinstance(found, ExternalOptions)
    return found


def problem(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        parse(text, "g.toml")
    return "\n".join(caught.value.problems)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"words": {"start": 1.0}}, "words: 'start' is no word that only asks; known are jnt_pos, "),
        ({"words": {"jnt_pos_name": 1.0}}, "words: 'jnt_pos_name' is no word"),
        ({"words": dict.fromkeys(WORDS, 0.0)}, "words: every rate is 0, so nothing would ever be asked"),
        ({"suffix": "→"}, "suffix: '→' has characters that are not ASCII"),
        ({"suffix": "stop"}, "suffix: a word that only asks, with 'stop', holds 'stop', which does more"),
        ({"suffix": "7\r"}, "suffix: '7\\r' would be taken for a part of a number"),
        ({"suffix": "-"}, "suffix: '-' would be taken for a part of a number"),
        ({"suffix": "."}, "suffix: '.' would be taken for a part of a number"),
        ({"suffix": "true"}, "suffix: 'true' would be taken for an answer"),
        ({"suffix": "e"}, "suffix: 'e' would be taken for an answer"),
        ({"suffix": "null\r"}, "suffix: 'null\\r' would be taken for an answer"),
        ({"listen": "robot.local"}, "listen: 'robot.local' is no address; 0.0.0.0 is every one of this machine"),
        ({"listen": ""}, "listen: '' is no address"),
    ],
)
def test_options_that_cannot_work_are_refused_with_the_reason(changes: dict[str, object], told: str) -> None:
    with pytest.raises(ValueError, match=re.escape(told)):
        ExternalOptions(**changes)  # type: ignore[arg-type] # that is what is tried
    with pytest.raises(msgspec.ValidationError, match=re.escape(told)):
        msgspec.convert(changes, ExternalOptions)


@pytest.mark.parametrize(
    "changes",
    [
        {"axes": 2},
        {"axes": 8},
        {"suffix": ""},
        {"suffix": "\r" * 9},
        {"torque_unit": "kNm"},
        {"timeout_s": 0.05},
        {"role": "peer"},
        {"words": {"jnt_pos": -1.0}},
        {"words": {"jnt_pos": 101.0}},
        {"allow_control": True},
    ],
)
def test_values_outside_of_their_range_are_refused(changes: dict[str, object]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(changes, ExternalOptions)


@pytest.mark.parametrize("suffix", ["\r", "\n", "\r\n", "\t", "#", "END", "<CR>", "\x03", ";"])
def test_suffixes_of_the_field_are_allowed(suffix: str) -> None:
    assert ExternalOptions(suffix=suffix).suffix == suffix


@pytest.mark.parametrize("listen", ["127.0.0.1", "0.0.0.0", "::1", "::", "localhost"])  # noqa: S104 - any may be told
def test_addresses_to_listen_on_are_allowed(listen: str) -> None:
    assert ExternalOptions(listen=listen).listen == listen


def test_the_slowest_word_says_how_long_a_value_may_stand() -> None:
    default = ExternalOptions()
    assert slowest_s(default, 10.0) == pytest.approx(2.0)  # the wishes come to 10 Hz; the slowest is 0.5 Hz
    assert slowest_s(default, 5.0) == pytest.approx(4.0)  # half the budget: twice as long
    assert slowest_s(default, 100.0) == pytest.approx(2.0)  # nothing is asked more often than wished
    assert slowest_s(ExternalOptions(words={"home_state": 0.1}), 10.0) == pytest.approx(10.1)


def test_a_port_has_to_be_configured() -> None:
    told = problem(ROBOT.replace("port = 8100\n", ""))
    assert 'port: is missing: protocol "external" has no port of its own' in told


def test_what_is_not_said_has_the_defaults_of_the_protocol() -> None:
    found = robot(ROBOT)
    assert (found.protocol.name, found.rate_hz, found.stale_s, found.estop_polarity) == ("external", 10.0, 5.0, None)
    assert options(ROBOT) == ExternalOptions()
    assert found.protocol.transport(found.options) == "tcp"


def test_everything_can_be_said_in_tables_and_is_printed_back() -> None:
    text = (
        ROBOT + 'estop_polarity = "active_low"\nrate_hz = 20\nstale_s = 30\n[robots.external]\nrole = "server"\n'
        'listen = "0.0.0.0"\nsuffix = "\\r\\n"\naxes = 7\ntorque_unit = "Nm"\ntimeout_s = 1.5\n'
        "[robots.external.words]\njnt_pos = 5\nhome_state = 0.25\njnt_trq = 0\n"
    )
    found = robot(text)
    assert found.options == ExternalOptions(
        role="server",
        listen="0.0.0.0",  # noqa: S104 - as configured
        suffix="\r\n",
        axes=7,
        torque_unit="Nm",
        timeout_s=1.5,
        words={"jnt_pos": 5.0, "home_state": 0.25, "jnt_trq": 0.0},
    )
    assert found.protocol.transport(found.options) == "tcp_server"
    printed = as_toml(parse(text, "g.toml"))
    again = robot(printed)
    assert (again.options, again.stale_s, again.port) == (found.options, 30.0, 8100)
    assert "words = { jnt_pos = 5.0, home_state = 0.25, jnt_trq = 0.0 }" in printed


def test_the_defaults_are_printed_too() -> None:
    printed = as_toml(parse(ROBOT, "g.toml"))
    assert "# torque_unit is not set" in printed
    assert 'suffix = "\\r"' in printed
    assert options(printed) == ExternalOptions()


def test_a_stale_time_that_would_null_values_between_two_answers_is_refused() -> None:
    assert "stale_s: 3 is too short for values that are asked for every 2 s: at least 4" in problem(
        ROBOT + "stale_s = 3\n"
    )
    slow = ROBOT + "[robots.external.words]\nhome_state = 0.1\n"
    assert robot(slow).stale_s == pytest.approx(20.2)


@pytest.mark.parametrize(
    ("tail", "told"),
    [
        ("[robots.external.words]\nstart = 1\n", "'start' is no word that only asks"),
        ("[robots.external.words]\njnt_pos = -1\n", "robots.external.words: Expected `float` >= 0.0"),
        ('[robots.external]\nsuffix = "1"\n', "would be taken for a part of a number"),
        ('[robots.external]\nlisten = "here"\n', "is no address"),
        ("[robots.external]\nallow_control = true\n", "allow_control"),
    ],
)
def test_a_wrong_option_is_a_problem_of_the_file(tail: str, told: str) -> None:
    assert told in problem(ROBOT + tail)


def test_two_robots_that_call_the_gateway_need_two_ports() -> None:
    server = '[robots.external]\nrole = "server"\n'
    other = ROBOT.replace('"x1"', '"x2"').replace("10.0.0.9", "10.0.0.10")
    assert "8100" in problem(ROBOT + server + other + server)


def test_the_objects_are_asked_for_only_what_is_configured() -> None:
    base = ROBOT.replace("port = 8100\n", 'protocol = "objects"\n')
    found = robot(base)
    assert (found.port, found.rate_hz, found.stale_s) == (5920, None, 3.0)
    printed = as_toml(parse(base + "[robots.objects.ask]\ntoolset = 0.5\n", "g.toml"))
    assert "ask = { toolset = 0.5 }" in printed
    assert robot(printed).options == VENDOR.protocol("objects").options(ask={"toolset": 0.5})
    for wrong in ("moveStart = 1", "toolset = 0.1", "toolset = 11"):
        assert problem(base + f"[robots.objects.ask]\n{wrong}\n")
