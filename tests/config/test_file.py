"""The configuration: what is understood, and what is said of everything that is wrong."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec
import pytest

from gateway.config import Config, find_config, load, parse
from gateway.config.keys import Server
from gateway.config.printing import as_toml
from gateway.core.registry import Registry
from gateway.core.settings import BrokenRobot, RobotSettings
from gateway.errors import ConfigError

ROBOT = '[[robots]]\nname = "r1"\nvendor = "rainbow"\nhost = "10.0.2.7"\n'  # four lines
OTHER = '[[robots]]\nname = "r2"\nvendor = "rainbow"\nhost = "10.0.2.8"\n'
K = '[[robots]]\nname = "k"\nvendor = "kilo"\nhost = "h"\n'

KILO = """
from typing import Annotated
import msgspec
from gateway.api.vendor import Protocol, Vendor
from vendors.rainbow import VENDOR as _rainbow

class CndeOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    transport: str = "tcp"
    period_ms: Annotated[int, msgspec.Meta(ge=8, le=1000)] = 8
    fast: bool = False
    masks: tuple[int, ...] = (1, 2)
    note: str | None = None

    def __post_init__(self):
        if self.transport == "udp" and self.fast:
            raise ValueError("udp cannot be fast")

_framing = _rainbow.protocols[0].framing
_estop = tuple(row for row in _rainbow.protocols[0].signals if row.key == "status.e_stopped")
VENDOR = Vendor(name="kilo", title="Kilo Arms", protocols=(
    Protocol(name="cnde", title="Pushed", port=20005, framing=_framing, signals=_estop, options=CndeOptions),
    Protocol(name="legacy", title="Old", port=8083, framing=_framing, signals=(), rate_hz=10.0, stale_s=0.5),
))
"""


@pytest.fixture
def registry(tmp_path: Path) -> Registry:
    """The built-in vendors, a vendor `kilo` with two protocols, and a broken vendor `lima`."""
    folder = tmp_path / "vendors"
    for name, text in (("kilo", KILO), ("lima", "1 / 0")):
        (folder / name).mkdir(parents=True)
        (folder / name / "__init__.py").write_text(text)
        (folder / name / "__init__.py").chmod(0o644)
        (folder / name).chmod(0o755)
    folder.chmod(0o755)
    return Registry([folder])


def problems(text: str, registry: Registry | None = None) -> tuple[str, ...]:
    """What is said of a text."""
    with pytest.raises(ConfigError) as caught:
        parse(text, "g.toml", registry)
    return caught.value.problems


def robot(config: Config, index: int = 0) -> RobotSettings:
    """A robot that works."""
    found = config.robots[index]
    assert isinstance(found, RobotSettings)
    return found


def test_what_is_not_said_has_the_defaults_of_the_vendor() -> None:
    config = parse(ROBOT, "g.toml")
    assert config.server == Server(listen="127.0.0.1:8765", flush_ms=2.0, event_ring=10_000, command_ring=20_000)
    assert config.server.address == ("127.0.0.1", 8765)
    found = robot(config)
    assert (found.name, found.host, found.port) == ("r1", "10.0.2.7", 5001)
    assert (found.vendor.name, found.protocol.name) == ("rainbow", "reqdata")
    assert (found.rate_hz, found.stale_s, found.estop_polarity, found.origin) == (50.0, 1.0, None, "live")
    assert msgspec.structs.asdict(found.options) == {"terminator": "", "external_joints": 0}
    assert config.warnings == ()


def test_everything_can_be_said() -> None:
    text = (
        '[server]\nlisten = "[::1]:9000"\nflush_ms = 0\nevent_ring = 5\n'
        '[[robots]]\nname = "a-b_1"\nvendor = "rainbow"\nprotocol = "reqdata"\nhost = "fe80::1%eth0"\nport = 5002\n'
        'rate_hz = 200\nstale_s = 0.5\nestop_polarity = "active_high"\n'
        '[robots.reqdata]\nterminator = "\\n"\nexternal_joints = 2\n'
    )
    config = parse(text, "g.toml")
    assert config.server.address == ("::1", 9000)
    found = robot(config)
    assert (found.port, found.rate_hz, found.stale_s, found.estop_polarity) == (5002, 200.0, 0.5, "active_high")
    assert isinstance(found.rate_hz, float)
    assert found.signal_options == {"estop_polarity": "active_high", "terminator": "\n", "external_joints": 2}


def test_robots_may_also_be_written_inline() -> None:
    text = 'robots = [{name = "r1", vendor = "rainbow", host = "h", reqdata = {external_joints = 1}}]'
    assert robot(parse(text, "g.toml")).signal_options["external_joints"] == 1


def test_at_a_low_rate_the_default_stale_time_is_five_periods() -> None:
    assert robot(parse(f"{ROBOT}rate_hz = 0.5\n", "g.toml")).stale_s == 10.0


def test_no_robot_at_all_is_a_warning() -> None:
    config = parse("", "g.toml")
    assert config.robots == ()
    assert config.warnings == ("g.toml: no robot is configured: the gateway runs, but has nothing to tell",)


def test_a_robot_of_a_broken_vendor_is_kept_with_a_warning_and_the_others_run(registry: Registry) -> None:
    text = f'{ROBOT}[[robots]]\nname = "l"\nvendor = "lima"\nprotocol = "x"\nhost = "h"\n[robots.x]\ny = 1\n'
    config = parse(text, "g.toml", registry)
    assert robot(config).name == "r1"
    broken = config.robots[1]
    assert isinstance(broken, BrokenRobot)
    assert (broken.name, broken.host, broken.vendor, broken.protocol) == ("l", "h", "lima", "x")
    assert "ZeroDivisionError" in broken.error.reason
    (warning,) = config.warnings
    assert warning.startswith("g.toml:7: robots.vendor: this robot is off, its vendor is broken: cannot be imported")


def test_a_pushed_protocol_has_no_rate(registry: Registry) -> None:
    assert robot(parse(K, "g.toml", registry)).rate_hz is None
    assert robot(parse(f'{K}protocol = "legacy"\n', "g.toml", registry)).rate_hz == 10.0


SERVER = [
    ('listen = "0.0.0.0:8765"', 'server.listen: "0.0.0.0:8765" would be open to other machines'),
    ('listen = "[::]:8765"', "set server.tokens to a file of tokens"),
    ('listen = "10.0.0.1:8765"', "or insecure = true to let everybody read everything"),
    ('listen = "gateway.local:8765"', "would be open to other machines"),
    ('listen = "127.0.0.1"', 'server.listen: "127.0.0.1" is not an address and a port like "127.0.0.1:8765"'),
    ('listen = "::1:8765"', 'an IPv6 address stands in brackets: "[::1]:8765"'),
    ('listen = "[x]:8765"', 'server.listen: "x" is no IPv6 address'),
    ('listen = "127.0.0.1:70000"', "server.listen: 70000 is no port: the highest is 65535"),
    ('listen = "127.0.0.256:1"', 'server.listen: "127.0.0.256" is no IPv4 address'),
    ("listen = 8765", "server.listen: 8765 is not text in quotes"),
    ("flush_ms = -1", "server.flush_ms: -1 is not a number from 0 to 1000"),
    ("flush_ms = 1000.5", "server.flush_ms: 1000.5 is not a number from 0 to 1000"),
    ("flush_ms = nan", "server.flush_ms: NaN is not a number from 0 to 1000"),
    ('flush_ms = "2"', 'server.flush_ms: "2" is not a number from 0 to 1000; it stands without quotes'),
    ("flush_ms = true", "server.flush_ms: true is not a number"),
    ("event_ring = 0", "server.event_ring: 0 is not a whole number from 1 to 10000000"),
    ("event_ring = 10.5", "server.event_ring: 10.5 is not a whole number"),
    ("event_ring = 99999999999999999999999", "is not a whole number"),
    ("listn = 1", 'server.listn: unknown key; did you mean "listen"?'),
    ("zzz = 1", "server.zzz: unknown key; the keys here are: listen, insecure, tokens, "),
    ("vendor_dirs = []", "server.vendor_dirs: belongs at the top of the file, above the first [table]"),
]


@pytest.mark.parametrize(("line", "told"), SERVER)
def test_a_wrong_line_for_the_server_is_named(line: str, told: str) -> None:
    (problem,) = problems(f"# comment\n[server]\n{line}\n{ROBOT}")
    assert problem.startswith("g.toml:3: server.")
    assert told in problem


@pytest.mark.parametrize("listen", ["127.0.0.1:0", "127.9.9.9:80", "localhost:65535", "[::1]:8765"])
def test_every_address_of_this_machine_alone_may_be_listened_on(listen: str) -> None:
    assert parse(f'[server]\nlisten = "{listen}"\n{ROBOT}', "g.toml").server.listen == listen


LINES = [
    ('hosst = "x"', 'robots.hosst: unknown key; did you mean "host"?'),
    ("Rate-Hz = 3", 'robots.Rate-Hz: unknown key; did you mean "rate_hz"?'),
    ("zzz = 1", "robots.zzz: unknown key; the keys here are: name, vendor, protocol, host, port, rate_hz"),
    ("port = 0", "robots.port: 0 is not a whole number from 1 to 65535"),
    ("port = 65536", "robots.port: 65536 is not a whole number from 1 to 65535"),
    ("port = true", "robots.port: true is not a whole number"),
    ('port = "5001"', 'robots.port: "5001" is not a whole number from 1 to 65535; it stands without quotes'),
    ("port = [5001]", "robots.port: [5001] is not a whole number"),
    ("port = 1979-05-27", "robots.port: 1979-05-27 is not a whole number"),
    ("rate_hz = 0", "robots.rate_hz: 0 is not a number of at least 0.001"),
    ("rate_hz = -1", "robots.rate_hz: -1 is not a number"),
    ("rate_hz = inf", "robots.rate_hz: must be a finite number"),
    ("rate_hz = 500.1", 'robots.rate_hz: 500.1 is too fast for protocol "reqdata": at most 500'),
    ("stale_s = 0.09", "robots.stale_s: 0.09 is too short for 50 Hz: at least 0.1, which is 5 periods"),
    ("stale_s = 0", "robots.stale_s: 0 is not a number from 0.02 to 86400"),
    ('estop_polarity = "low"', 'robots.estop_polarity: "low" is not "active_high" or "active_low"'),
    ('estop_polarity = "active-low"', 'did you mean "active_low"?'),
    ('protocol = "reqdat"', 'robots.protocol: unknown protocol "reqdat" of rainbow; did you mean "reqdata"?'),
    ('protocol = "zzz"', "known are: reqdata"),
    ("protocol = 1", "robots.protocol: 1 is not text in quotes"),
    ('terminator = ""', "robots.terminator: is an option of the protocol: put it below [robots.reqdata]"),
    ("reqdata = 1", "robots.reqdata: must be a table: write [robots.reqdata] below the robot"),
    ('[robots.reqdata]\nterminatr = ""', 'robots.reqdata.terminatr: unknown key; did you mean "terminator"?'),
    ('[robots.reqdata]\nterminator = "x"', 'robots.reqdata.terminator: "x" is not "" or "\\n"'),
    ("[robots.reqdata]\nexternal_joints = 7", "robots.reqdata.external_joints: 7 is not a whole number from 0 to 6"),
    ("[robots.reqdata]\nrate_hz = 5", "robots.reqdata.rate_hz: is a key of the robot: put it above [robots.reqdata]"),
    ("[robots.reqdat]\nx = 5", 'robots.reqdat: unknown key; did you mean "reqdata"?'),
    ("reqdata.terminatr = 1", 'robots.reqdata.terminatr: unknown key; did you mean "terminator"?'),
    ('[robot]\nname = "x"', 'robot: unknown key; did you mean "robots"?'),
    ("[sever]\nx = 1", 'sever: unknown key; did you mean "server"?'),
]


@pytest.mark.parametrize(("line", "told"), LINES)
def test_a_wrong_line_for_a_robot_is_named(line: str, told: str) -> None:
    (problem,) = problems(f"{ROBOT}{line}\n{'' if '[robot]' in line or '[sever]' in line else OTHER}")
    number = 6 if "\n" in line and problem.count("robots.reqdata.") else 5
    assert problem.startswith(f"g.toml:{number}: ")
    assert told in problem


VALUES = [
    ('name = "r1"', 'name = "R 1"', 2, 'robots.name: "R 1" is not a name of 1 to 32 characters a-z, 0-9, _ and -'),
    ('name = "r1"', f'name = "{"a" * 33}"', 2, "robots.name: "),
    ('name = "r1"', 'name = ""', 2, 'robots.name: "" is not a name'),
    ('name = "r1"', 'name = "r1\\n"', 2, 'robots.name: "r1\\n" is not a name'),
    ('name = "r1"', "name = 1", 2, "robots.name: 1 is not a name"),
    ('name = "r1"\n', "", 1, "robots: name is missing"),
    ('vendor = "rainbow"\n', "", 1, "robots: vendor is missing"),
    ('host = "10.0.2.7"\n', "", 1, "robots: host is missing"),
    ('"rainbow"', '"rainbw"', 3, 'robots.vendor: unknown vendor "rainbw"; did you mean "rainbow"?'),
    ('"rainbow"', '"zzz"', 3, 'robots.vendor: unknown vendor "zzz"; known are: '),
    ('"rainbow"', "5", 3, "robots.vendor: 5 is not text in quotes"),
    ('"10.0.2.7"', '""', 4, 'robots.host: "" is neither an IP address nor a host name'),
    ('"10.0.2.7"', '"a b"', 4, 'robots.host: "a b" is neither an IP address nor a host name'),
    ('"10.0.2.7"', '"10.0.2.300"', 4, 'robots.host: "10.0.2.300" is no IPv4 address'),
    ('"10.0.2.7"', '"10.0.2"', 4, 'robots.host: "10.0.2" is no IPv4 address'),
    ('"10.0.2.7"', '"10.0.2.7:5001"', 4, "the port stands under its own key, port"),
    ('"10.0.2.7"', '"[::1]"', 4, "here an IPv6 address stands without brackets"),
    ('"10.0.2.7"', '"http://10.0.2.7"', 4, "give the name or address alone"),
]


@pytest.mark.parametrize(("right", "wrong", "line", "told"), VALUES)
def test_a_wrong_value_of_a_robot_is_named(right: str, wrong: str, line: int, told: str) -> None:
    (problem,) = problems(ROBOT.replace(right, wrong))
    assert problem.startswith(f"g.toml:{line}: ")
    assert told in problem


def test_a_misspelt_key_that_must_be_there_is_one_problem() -> None:
    assert problems(ROBOT.replace("host =", "hst =")) == ('g.toml:4: robots.hst: unknown key; did you mean "host"?',)


def test_two_robots_of_one_name_are_both_named() -> None:
    (problem,) = problems(f"{ROBOT}\n{OTHER.replace('r2', 'r1')}")
    assert problem == 'g.toml:7: robots.name: "r1" is already the name of the robot in line 2'


@pytest.mark.parametrize(("first", "second"), [("10.0.2.7", "10.0.2.7"), ("::1", "0:0::1"), ("cell.lan", "Cell.LAN.")])
def test_two_robots_on_one_controller_are_both_named(first: str, second: str) -> None:
    text = ROBOT.replace("10.0.2.7", first) + OTHER.replace("10.0.2.8", second)
    (problem,) = problems(text)
    assert problem.startswith(f'g.toml:8: robots.host: {second} port 5001 is already read by robot "r1" (line 4)')
    parse(f"{text}port = 5002\n", "g.toml")


@pytest.mark.parametrize(
    ("listen", "host"),
    [
        ("127.0.0.1:5001", "127.0.0.1"),
        ("127.0.0.1:5001", "localhost"),
        ("localhost:5001", "127.0.0.1"),
        ("localhost:5001", "::1"),
        ("[::1]:5001", "0::1"),
        ("127.0.0.9:5001", "127.0.0.9"),
    ],
)
def test_the_gateway_is_not_its_own_robot(listen: str, host: str) -> None:
    (problem,) = problems(f'{ROBOT.replace("10.0.2.7", host)}[server]\nlisten = "{listen}"\n')
    assert problem.startswith("g.toml:4: robots.host: ")
    assert "port 5001 is where the gateway itself listens (server.listen): correct one of them" in problem


@pytest.mark.parametrize(
    ("listen", "host"), [("127.0.0.1:5002", "127.0.0.1"), ("127.0.0.1:5001", "127.0.0.2"), ("[::1]:5001", "127.0.0.1")]
)
def test_a_robot_on_this_machine_beside_the_listener_is_allowed(listen: str, host: str) -> None:
    assert robot(parse(f'{ROBOT.replace("10.0.2.7", host)}[server]\nlisten = "{listen}"\n', "g.toml")).host == host


@pytest.mark.parametrize(
    ("word", "meant"), [("rat", "rate_hz"), ("rate", "rate_hz"), ("ho", "host"), ("estop", "estop_polarity")]
)
def test_the_beginning_of_a_key_is_taken_for_that_key(word: str, meant: str) -> None:
    assert problems(f"{ROBOT}{word} = 5\n") == (f'g.toml:5: robots.{word}: unknown key; did you mean "{meant}"?',)


@pytest.mark.skipif(not Path("/tmp").stat().st_mode & 0o1000, reason="/tmp is not shared here")  # noqa: S108
def test_a_folder_that_everybody_shares_is_not_to_be_made_private() -> None:
    (problem,) = problems(f'vendor_dirs = ["/tmp"]\n{ROBOT}')
    assert problem.startswith("g.toml:1: vendor_dirs: /tmp: belongs to everybody on this machine; put the plugins into")


def test_options_of_another_protocol_than_the_robot_speaks_are_refused(registry: Registry) -> None:
    text = '[[robots]]\nname = "k"\nvendor = "kilo"\nprotocol = "legacy"\nhost = "h"\n[robots.cnde]\nperiod_ms = 8\n'
    (problem,) = problems(text, registry)
    assert problem.startswith('g.toml:6: robots.cnde: belongs to another protocol: this robot speaks "legacy"')


def test_a_rate_for_a_pushed_protocol_is_refused(registry: Registry) -> None:
    (problem,) = problems(f"{K}rate_hz = 5\n", registry)
    assert problem == (
        'g.toml:5: robots.rate_hz: protocol "cnde" is not polled: the controller sets the rate; remove the key'
    )


def test_options_that_contradict_each_other_are_refused_with_the_words_of_the_plugin(registry: Registry) -> None:
    text = f'{K}[robots.cnde]\ntransport = "udp"\nfast = true\n'
    assert problems(text, registry) == ("g.toml:5: robots.cnde: udp cannot be fast",)


def test_everything_that_is_wrong_is_told_at_once_in_the_order_of_the_file() -> None:
    robots = f"{ROBOT.replace('rainbow', 'rainbw')}{OTHER}port = 0\n[robots.reqdata]\nx = 1\n"
    text = f"zzz = 1\n[server]\nflush_ms = -1\n{robots}"
    assert [problem.split(": ")[0:2] for problem in problems(text)] == [
        ["g.toml:1", "zzz"],
        ["g.toml:3", "server.flush_ms"],
        ["g.toml:6", "robots.vendor"],
        ["g.toml:12", "robots.port"],
        ["g.toml:14", "robots.reqdata.x"],
    ]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('[robots]\nname = "r1"', "g.toml:1: robots: must be tables: write [[robots]], with two pairs of brackets"),
        ("robots = 3", "g.toml:1: robots: must be tables"),
        ("\nrobots = [1]", "g.toml:2: robots: must be tables"),
        ("[[server]]", "g.toml:1: server: must be a table: write [server], with one pair of brackets"),
        ('vendor_dirs = "x"', 'g.toml:1: vendor_dirs: "x" is not a list of folders like'),
        ("vendor_dirs = [1]", "g.toml:1: vendor_dirs: [1] is not a list of folders like"),
        ("a b", "g.toml:1: a: no valid TOML at column 3: Expected '=' after a key in a key/value pair"),
        ("[server]\nlisten = 10.0.2.7:1", "g.toml:2: listen: no valid TOML at column 14: "),
        ("host = abc", "text stands in quotes, numbers do not"),
        ("a = [1,\n2", "g.toml:2: 2: no valid TOML at column 2: "),
        (f"x = {'1' * 5000}", "g.toml: Exceeds the limit"),
        (f"[server]\nevent_ring = 0x{'f' * 9000}", "g.toml:2: server.event_ring: this number is not a whole number"),
        ("x = " + "[" * 9000, "g.toml: arrays or tables are nested too deeply"),
        (f"{ROBOT}host = 'x'", "g.toml:5: robots.host: is there twice, first in line 4; remove one"),
        ("[server]\n\n[server]", "g.toml:3: server: is there twice, first in line 1; remove one"),
    ],
)
def test_what_is_no_toml_or_of_the_wrong_shape_is_told_with_its_line(text: str, told: str) -> None:
    (problem,) = problems(text)
    assert told in problem


def test_relative_vendor_dirs_start_from_the_folder_of_the_file(registry: Registry, tmp_path: Path) -> None:
    del registry  # it made the folder
    path = tmp_path / "g.toml"
    path.write_text('vendor_dirs = ["vendors"]\n[[robots]]\nname = "k"\nvendor = "kilo"\nhost = "h"\n')
    config = load(path)
    assert config.vendor_dirs == (tmp_path / "vendors",)
    assert robot(config).vendor.title == "Kilo Arms"
    assert "lima" in config.registry.names()


def test_a_refused_vendor_dir_is_told_without_blaming_the_robots_that_need_it() -> None:
    text = 'vendor_dirs = ["/nowhere/at/all"]\n[[robots]]\nname = "k"\nvendor = "kilo"\nhost = "h"\nport = 0\n'
    assert problems(text) == (
        "g.toml:1: vendor_dirs: /nowhere/at/all: does not exist",
        "g.toml:6: robots.port: 0 is not a whole number from 1 to 65535",
    )


def test_a_file_that_is_not_there_or_not_utf_8_or_a_folder_says_what_to_do(tmp_path: Path) -> None:
    latin = tmp_path / "latin.toml"
    latin.write_bytes(b"# one\n# caf\xe9\n")
    large = tmp_path / "large.toml"
    large.write_bytes(b"#" * (4 * 1024 * 1024 + 1))
    for path, told in [
        (tmp_path / "missing.toml", "missing.toml: does not exist; name another file"),
        (tmp_path, "is a folder; name the file in it"),
        (latin, "latin.toml:2: is not UTF-8 (byte 0xe9); save it as UTF-8"),
        (large, "is larger than 4194304 bytes"),
        (tmp_path / "latin.toml" / "x", "cannot be read: Not a directory"),
    ]:
        with pytest.raises(ConfigError) as caught:
            load(path)
        assert told in str(caught.value)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_file_that_may_not_be_read_says_so(tmp_path: Path) -> None:
    (tmp_path / "g.toml").write_text("")
    (tmp_path / "g.toml").chmod(0)
    with pytest.raises(ConfigError, match="may not be read by this user"):
        load(tmp_path / "g.toml")


def test_a_byte_order_mark_and_windows_line_ends_are_taken(tmp_path: Path) -> None:
    path = tmp_path / "g.toml"
    path.write_bytes(b"\xef\xbb\xbf" + ROBOT.replace("\n", "\r\n").encode() + b"port = 0\r\n")
    with pytest.raises(ConfigError, match=r"g.toml:5: robots.port: "):
        load(path)


def test_the_configuration_is_looked_for_in_order(tmp_path: Path) -> None:
    here, system, other = (tmp_path / name for name in ("gateway.toml", "system.toml", "other.toml"))
    env = {"ROBOT_GATEWAY_CONFIG": str(other)}
    with pytest.raises(ConfigError) as caught:
        find_config(None, {}, tmp_path, system)
    for place in ("$ROBOT_GATEWAY_CONFIG", str(here), str(system), "--config FILE"):
        assert place in str(caught.value)
    with pytest.raises(ConfigError, match=r"other.toml: does not exist; \$ROBOT_GATEWAY_CONFIG names it"):
        find_config(None, env, tmp_path, system)
    for path in (system, here, other):
        path.write_text("")
        assert find_config(None, env if path == other else {}, tmp_path, system) == path
    assert find_config(Path("x.toml"), env, tmp_path, system) == Path("x.toml")


def test_what_is_printed_back_means_the_same(registry: Registry, tmp_path: Path) -> None:
    text = (
        f'[server]\nlisten = "localhost:1"\nflush_ms = 0.5\n{ROBOT}estop_polarity = "active_low"\nrate_hz = 1e-3\n'
        f'[robots.reqdata]\nterminator = "\\n"\n{OTHER}'
        f'{K}[robots.cnde]\nfast = true\nmasks = [3]\nnote = "é\\u007f\\\\"\n'
    )
    config = parse(text, "g.toml", registry)
    again = parse(as_toml(config), "g.toml", registry)
    assert again == config
    assert as_toml(again) == as_toml(config)
    assert as_toml(config).startswith("vendor_dirs = []\n\n[server]\nlisten = ")
    assert str(tmp_path) not in as_toml(config)


def test_what_is_not_set_or_broken_is_printed_back_as_a_comment(registry: Registry) -> None:
    text = '[[robots]]\nname = "l"\nvendor = "lima"\nprotocol = "x"\nhost = "h"\n'
    printed = as_toml(parse(text + K, "g.toml", registry))
    for line in (
        "# off, the vendor is broken: cannot be imported: ZeroDivisionError: division by zero",
        'protocol = "x"',
        "# rate_hz: the controller sets it",
        "# estop_polarity is not set: e_stopped is null where the manual does not state it",
        "# note is not set",
        "masks = [1, 2]",
        "fast = false",
    ):
        assert line in printed
