"""`robot-gateway status --why ROBOT`: a link in plain words, whatever its state."""

from __future__ import annotations

import msgspec
import pytest

from gateway.api.messages import RobotInfo
from gateway.api.model import Link, LinkState, LinkStats
from gateway.cli.measured import Measured
from gateway.cli.why import explain
from gateway.core.registry import Registry
from tests.cli.command import command, running_cell

NOW = 1_700_000_000_000_000
REFUSED_NOTE = Registry().vendor("fairino").protocol("cnde").when_refused


def told(state: LinkState, reason: str | None = None, measured: Measured | None = None, **values: object) -> str:
    """The explanation of a robot at 10.0.2.7:20005, with some values of its link and of itself."""
    link = Link(state=state, reason=reason, since=NOW - 42_000_000, protocol="cnde", peer="10.0.2.7:20005")
    robot = RobotInfo(name="r1", vendor="fairino", protocol="cnde", groups=[], link=link)
    own = {key: value for key, value in values.items() if key in RobotInfo.__struct_fields__}
    of_link = {key: value for key, value in values.items() if key not in own}
    link = msgspec.structs.replace(link, **of_link)
    lines = list(explain(msgspec.structs.replace(robot, link=link, **own), NOW, 80, measured))
    assert max(map(len, lines)) <= 80
    return " ".join(" ".join(lines).split())


def test_a_refused_port_says_what_it_probably_means_and_what_to_set() -> None:
    said = told(
        LinkState.DISCONNECTED,
        "10.0.2.7:20005: connection refused: nothing listens on that port",
        notes=[REFUSED_NOTE],
        attempts=34,
        next_attempt=NOW + 2_100_000,
    )
    assert (
        "r1 is not connected (DISCONNECTED, not online for 42 s). It is read as fairino:cnde at 10.0.2.7:20005." in said
    )
    assert "nothing listens on that port" in said
    assert 'set transport = "udp" below [robots.cnde]' in said
    assert "34 attempts to connect since the last good frame. - The next attempt is due in 2.1 s." in said
    assert "Not one good frame since the gateway started." in said
    assert "Check next - Do what stands above" in said
    assert "`robot-gateway probe 10.0.2.7`" in said


@pytest.mark.parametrize(
    ("state", "reason", "says"),
    [
        (LinkState.DISCONNECTED, "not tried yet", "`ping 10.0.2.7`"),
        (LinkState.DISCONNECTED, "no answer from 10.0.2.7:20005 within 3 s", "whether it is on and its cable is in"),
        (LinkState.DISCONNECTED, "10.0.2.7:20005: no route to the controller", "this machine has an address in its"),
        (LinkState.DISCONNECTED, "10.0.2.7:20005: the name cannot be resolved (x)", "whether the name is spelt right"),
        (LinkState.DISCONNECTED, "the controller closed the connection", "another program holds the connection"),
        (
            LinkState.CONNECTING,
            "connection reset by the controller",
            "another program holds the connection",
        ),
        (LinkState.CONNECTING, "not tried yet", "Wait a moment and ask again."),
        (LinkState.HANDSHAKING, "connected, waiting for the first frame", "Wait a moment and ask again."),
        (LinkState.STALE, "connected, but not one byte came within 1 s", "nothing useful comes out of it"),
        (
            LinkState.STALE,
            "connected, 80 bytes came, but no good frame; last reject: junk",
            "no frames of this protocol",
        ),
        (LinkState.STALE, "no good frame for 1 s", "busy, restarting, or switched off"),
        (LinkState.INCOMPATIBLE, "no layout explains frames of 999 bytes", "whether the vendor's README names the"),
        (LinkState.REFUSED, "the controller refuses to start; it says ERROR", "See what the controller says above"),
    ],
)
def test_each_reason_has_its_own_next_step(state: LinkState, reason: str, says: str) -> None:
    said = told(state, reason, last_error="the controller closed the connection")
    assert f"({state.value}, not online for 42 s)" in said
    assert reason in said
    assert says in said.partition("Check next")[2]


def test_a_robot_that_works_needs_nothing() -> None:
    said = told(LinkState.ONLINE, frames=1_500, age=0.012, requested_hz=50.0, reached_hz=49.9, layout="v3.9")
    assert "r1 is online (ONLINE for 42 s)." in said
    assert "Why" not in said
    assert "1,500 good frames since the gateway started, the last one 0.012 s ago." in said
    assert "49.9 Hz are reached; 50 Hz are asked for." in said
    assert "read by the layout: v3.9." in said
    assert said.endswith("Check next - Nothing: it works. Its values: `robot-gateway tail r1/joints`.")


def test_a_robot_that_is_online_with_trouble_says_which() -> None:
    said = told(
        LinkState.ONLINE,
        frames=900,
        age=0.02,
        requested_hz=50.0,
        reached_hz=20.0,
        layout="v3.9 + 8 bytes that the layout does not explain",
        notes=["the controller refuses jt_tq; it says ERROR"],
        last_error="no good frame for 1 s",
        reject_counts={"length": 90, "junk": 10},
    )
    assert "Why - the controller refuses jt_tq; it says ERROR - The last loss: no good frame for 1 s" in said
    assert "Discarded, because it was no good frame: 10 junk, 90 length." in said
    assert "slower than asked" in said
    assert "q UNCERTAIN" in said
    assert "10% of all that came was no good frame" in said
    assert "Nothing" not in said


def watched(
    seconds: float = 2.0, *, age: float | None = 0.01, clock_offset: float | None = None, **grown: int
) -> Measured:
    """Two seconds of a link that had counted before: `frames`, `n_bytes`, and rejects by reason."""
    frames, n_bytes = grown.pop("frames", 0), grown.pop("n_bytes", 0)
    before = LinkStats(frames=1000, n_bytes=900_000, rejects=dict.fromkeys(grown, 5))
    rejects = {reason: 5 + count for reason, count in grown.items()}
    after = LinkStats(
        frames=1000 + frames, n_bytes=900_000 + n_bytes, rejects=rejects, age=age, clock_offset=clock_offset
    )
    return Measured.between(NOW, before, NOW + int(seconds * 1e6), after)


def test_a_connection_without_a_byte_says_for_how_long() -> None:
    said = told(LinkState.STALE, "no good frame for 1 s", watched(3.2, age=7.5), frames=1000)
    assert "Connected, but 0 bytes in the last 3.2 s; the last good frame came 7 s ago." in said
    assert "0 bytes in the last 2.0 s." in told(LinkState.HANDSHAKING, "waiting", watched(age=None))


def test_bytes_that_are_no_frames_are_told_from_none() -> None:
    said = told(LinkState.HANDSHAKING, "waiting", watched(n_bytes=80_000, junk=9))
    assert "80,000 bytes in the last 2.0 s, but not one good frame; rejected with `junk`." in said


def test_the_rate_and_the_share_of_what_is_rejected_are_told_and_what_to_look_at() -> None:
    values = {"frames": 1000, "reject_counts": {"checksum": 6}, "requested_hz": None}
    said = told(LinkState.ONLINE, None, watched(frames=28, n_bytes=25_000, checksum=1), **values)
    assert "14 frames a second in the last 2.0 s, 3.4 % rejected with `checksum`." in said
    assert "Frames come damaged" in said.partition("Check next")[2]
    calm = told(LinkState.ONLINE, None, watched(frames=250, n_bytes=25_000), frames=1000)
    assert "125 frames a second in the last 2.0 s." in calm
    assert calm.endswith("Nothing: it works. Its values: `robot-gateway tail r1/joints`.")


@pytest.mark.parametrize(
    ("offset_s", "says", "next_"),
    [
        (4 * 3600.0 + 1.5, "The controller's clock is 4.0 h ahead of this gateway's.", "differs by a time zone"),
        (-9 * 3600.0, "The controller's clock is 9.0 h behind this gateway's.", "set `clock_zone`"),
        (-305.0, "The controller's clock is 5.1 min behind this gateway's.", "have it follow a time server"),
        (6.0, "The controller's clock is 6.0 s ahead of this gateway's.", "have it follow a time server"),
        (86_400.0 * 400, "The controller's clock is 400.0 d ahead of this gateway's.", "clock"),
    ],
)
def test_a_clock_that_is_off_is_told_and_what_it_probably_is(offset_s: float, says: str, next_: str) -> None:
    said = told(LinkState.ONLINE, None, watched(frames=250, n_bytes=1, clock_offset=offset_s), frames=1000)
    assert says in said
    assert next_ in said.partition("Check next")[2]
    assert "Nothing" not in said


@pytest.mark.parametrize("offset_s", [None, 0.0, 4.9, -4.9])
def test_a_clock_that_is_right_or_not_told_is_not_worth_a_word(offset_s: float | None) -> None:
    said = told(LinkState.ONLINE, None, watched(frames=250, n_bytes=1, clock_offset=offset_s), frames=1000)
    assert "clock" not in said


def test_of_a_link_that_is_not_connected_nothing_is_measured() -> None:
    said = told(LinkState.DISCONNECTED, "connection refused: nothing listens on that port", watched())
    assert "0 bytes" not in said


def test_few_rejects_are_no_alarm() -> None:
    said = told(LinkState.ONLINE, frames=100_000, age=0.02, reached_hz=125.0, reject_counts={"truncated": 1})
    assert "125 Hz are reached; the controller sets the rate." in said
    assert "of all that came" not in said
    assert "some rejects at a connection's start or end are normal" in said


def test_a_plugin_that_cannot_be_loaded_is_told_from_one_that_fails_now() -> None:
    loaded = told(LinkState.FAULTED, "vendor fairino: cannot be imported: boom", peer="10.0.2.7")
    assert "cannot be read: the gateway's own plugin for it fails" in loaded
    assert "`robot-gateway vendor-check fairino`" in loaded
    assert "Then start the gateway again" in loaded
    failing = told(LinkState.FAULTED, "internal error, see the log: ValueError()", next_attempt=NOW - 1)
    assert "The next attempt is due now." in failing
    assert "Tell the author of the plugin" in failing


async def test_the_command_explains_a_robot_and_names_the_nearest_one() -> None:
    async with running_cell("cell1") as gateway:
        shown = await command("status", "--why", "cell1", "--url", gateway.url)
        wrong = await command("status", "--why", "cel1", "--url", gateway.url)
        unknown = await command("status", "--why", "zzz", "--url", gateway.url)
    assert (shown.code, shown.err) == (0, "")
    assert shown.out.startswith("cell1 is online (ONLINE for ")
    assert "Check next" in shown.out
    assert " frames a second in the last " in shown.out
    assert max(map(len, shown.out.splitlines())) <= 80
    assert (wrong.code, wrong.out) == (1, "")
    assert 'there is no robot "cel1"; did you mean "cell1"?' in wrong.err
    assert 'there is no robot "zzz"; there are: cell1' in unknown.err
    assert (await command("status", "--why", "r1", "--watch")).code == 2
