"""What the gateway knows of one link, in plain words, and what to look at next: `robot-gateway status --why ROBOT`."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator

from gateway.api.messages import RobotInfo
from gateway.api.model import LinkState
from gateway.cli.measured import Measured
from gateway.cli.view import duration, spoken

_MEANING = {
    LinkState.DISCONNECTED: "is not connected",
    LinkState.CONNECTING: "is not connected; an attempt is under way",
    LinkState.HANDSHAKING: "is connected, but no good frame has come yet",
    LinkState.ONLINE: "is online",
    LinkState.STALE: "has fallen silent",
    LinkState.INCOMPATIBLE: "answers, but not in a way that this protocol can read",
    LinkState.REFUSED: "refuses to tell the gateway its state",
    LinkState.FAULTED: "cannot be read: the gateway's own plugin for it fails",
}
# Who falls so far behind the rate that was asked for is slow.
_SLOW_SHARE = 0.8
# More than this share of all that came was no frame: damage, not the odd cut at a reconnect.
_MANY_REJECTS = 0.01
# After so many attempts the last loss is what to look at, whatever the next attempt is just doing.
_AGAIN = 3
_WRAPPED = 80

_PROBE = "Ask what it speaks: `robot-gateway probe {host}`."
_NETWORK = "See whether the network reaches it: `ping {host}`."
_RIVAL = "See whether another program holds the connection: many controllers serve only one."
_CABLE = "See whether it is on and its cable is in, and whether this machine has an address in its network."
_FIREWALL = "See whether `host` is right in the configuration, and whether a firewall stands in between."
_PORT = "See whether `port` and `protocol` are right in the configuration."
_SERVICE = "The controller is there, but the port is closed: see whether its service is switched on there."
_USELESS = "The port is open, but nothing useful comes out of it."
_NAME = "See whether the name is spelt right in the configuration, or give the address instead of it."
_ITS_LOG = "See what the controller's own log says."
_STRANGE = "Bytes come, but they are no frames of this protocol."
_FIRMWARE = "See whether the vendor's README names the controller's firmware: it may be newer."
_BUSY = "See whether the controller is busy, restarting, or switched off."
_OPTIONS = "See what the controller says above, and which options the vendor's README has for it."
_CALLS = "See on the controller which address and port it calls, and whether `host` is the address that it calls from."
_SETTINGS = "Compare the protocol's options with what is set on the controller: what ends a message above all."
_WAIT = "Wait a moment and ask again."
# words of a reason -> what to look at
_BY_REASON = (
    (r"no answer from|no route|unreachable|timed out", (_NETWORK, _CABLE, _FIREWALL)),
    (r"no call from", (_CALLS, _CABLE, _FIREWALL)),
    (r"no answer to", (_SETTINGS, _BUSY)),
    (r"nothing listens|refused", (_SERVICE, _PORT, _PROBE)),
    (r"resolved", (_NAME,)),
    (r"closed the connection|closed by|connection lost|reset", (_RIVAL, _ITS_LOG)),
    (r"not one byte|handshake was not finished", (_USELESS, _PORT, _PROBE, _RIVAL)),
    (r"but no good frame|no layout", (_STRANGE, _PORT, _FIRMWARE, _PROBE)),
    (r"no good frame for", (_NETWORK, _BUSY)),
)
# states that say more than the words of their reason
_BY_STATE = {LinkState.INCOMPATIBLE: (_FIRMWARE, _PORT, _PROBE), LinkState.REFUSED: (_OPTIONS, _PROBE)}
_BUSY_STATES = {LinkState.CONNECTING, LinkState.HANDSHAKING}
_DEFAULT = (_NETWORK, _PROBE)
_STANDING = {LinkState.ONLINE, LinkState.HANDSHAKING, LinkState.STALE}
_DAMAGED = (
    "Frames come damaged: see whether cable and switch are sound, whether another program writes to the same "
    "connection, and whether the firmware is one that the vendor's README names."
)
_BY_REJECT = {"checksum": _DAMAGED, "truncated": _DAMAGED}
# The controller's clock: what is worth a word, what a time zone is a multiple of, and how near to it.
_CLOCK_S = 5.0
_ZONE_S = 900.0
_NEAR_S = 120.0
_ZONE = (
    "The clock differs by a time zone: set `clock_zone` to the controller's, where its protocol tells the time, or see "
    "whether the one that is set is right."
)
_SET_CLOCK = "Set the controller's clock, or have it follow a time server: times of its own log will not fit otherwise."


def explain(robot: RobotInfo, now_us: int, width: int, measured: Measured | None = None) -> Iterator[str]:
    """Explain a link, line by line.

    Args:
        robot: As the gateway tells it.
        now_us: Now, µs UTC.
        width: Of the terminal; longer lines than people like to read are wrapped all the same.
        measured: What has come just now, where somebody watched.
    """
    columns = min(width, _WRAPPED)
    link = robot.link
    at = f" at {link.peer}" if link.peer else ""
    since = "" if link.state is LinkState.ONLINE else ", not online"
    head = (
        f"{robot.name} {_MEANING[link.state]} ({link.state.value}{since} for {duration((now_us - link.since) / 1e6)})."
    )
    yield from textwrap.wrap(head, columns)
    yield from textwrap.wrap(f"It is read as {spoken(robot)}{at}.", columns)
    parts = (
        ("Why", _why(robot, now_us)),
        ("What has come", (*_come_now(robot, measured), *_come(robot), *_clock(measured))),
        ("Check next", _next(robot, measured)),
    )
    for title, sentences in parts:
        told = list(dict.fromkeys(sentences))
        if told:
            yield ""
            yield title
        for sentence in told:
            yield from textwrap.wrap(sentence, columns, initial_indent="  - ", subsequent_indent="    ")


def _why(robot: RobotInfo, now_us: int) -> Iterator[str]:
    link = robot.link
    if link.reason:
        yield link.reason
    yield from link.notes
    if link.last_error and link.last_error != link.reason:
        yield f"{'The last loss' if link.state is LinkState.ONLINE else 'Before that'}: {link.last_error}"
    if link.attempts:
        yield f"{_counted(link.attempts, 'attempt')} to connect since the last good frame."
    if link.next_attempt is not None:
        wait_s = (link.next_attempt - now_us) / 1e6
        yield f"The next attempt is due in {wait_s:.1f} s." if wait_s > 0 else "The next attempt is due now."


def _come(robot: RobotInfo) -> Iterator[str]:
    link = robot.link
    if not robot.frames:
        yield "Not one good frame since the gateway started."
    else:
        age = "" if robot.age is None else f", the last one {_age(robot.age)} ago"
        yield f"{_counted(robot.frames, 'good frame')} since the gateway started{age}."
    if link.reached_hz is not None:
        asked = (
            "the controller sets the rate" if link.requested_hz is None else f"{link.requested_hz:g} Hz are asked for"
        )
        yield f"{link.reached_hz:g} Hz are reached; {asked}."
    elif link.requested_hz is not None:
        yield f"{link.requested_hz:g} Hz are asked for."
    if link.parts_hz:
        rates = ", ".join(f"{name} {rate:g}" for name, rate in link.parts_hz.items())
        yield f"Each is answered so often, in Hz: {rates}."
    if link.layout:
        yield f"The frames are read by the layout: {link.layout}."
    if robot.reject_counts:
        reasons = ", ".join(f"{count} {reason}" for reason, count in sorted(robot.reject_counts.items()))
        yield f"Discarded, because it was no good frame: {reasons}."


def _come_now(robot: RobotInfo, measured: Measured | None) -> Iterator[str]:
    """What has come in the last seconds, of a connection that stands."""
    if measured is None or robot.link.state not in _STANDING:
        return
    lately = f"in the last {measured.seconds:.1f} s"
    rejected = " and ".join(f"`{reason}`" for reason in sorted(measured.rejects))
    if not measured.n_bytes:
        age = measured.stats.age
        since = "" if age is None or age < measured.seconds else f"; the last good frame came {_age(age)} ago"
        yield f"Connected, but 0 bytes {lately}{since}."
    elif not measured.frames:
        told = f"; rejected with {rejected}" if rejected else ""
        yield f"{measured.n_bytes:,} bytes {lately}, but not one good frame{told}."
    else:
        told = f", {measured.rejected * 100:.2g} % rejected with {rejected}" if rejected else ""
        yield f"{measured.frames / measured.seconds:.3g} frames a second {lately}{told}."


def _clock(measured: Measured | None) -> Iterator[str]:
    offset_s = None if measured is None else measured.stats.clock_offset
    if offset_s is not None and abs(offset_s) >= _CLOCK_S:
        ahead = "ahead of" if offset_s > 0 else "behind"
        yield f"The controller's clock is {_span(abs(offset_s))} {ahead} this gateway's."


def _next(robot: RobotInfo, measured: Measured | None) -> Iterator[str]:
    checks = [*_next_link(robot, measured), *_next_clock(measured)]
    yield from checks or [f"Nothing: it works. Its values: `robot-gateway tail {robot.name}/joints`."]


def _next_clock(measured: Measured | None) -> Iterator[str]:
    offset_s = None if measured is None else measured.stats.clock_offset
    if offset_s is not None and abs(offset_s) >= _CLOCK_S:
        zones = round(offset_s / _ZONE_S)
        yield _ZONE if zones and abs(offset_s - zones * _ZONE_S) < _NEAR_S else _SET_CLOCK


def _next_link(robot: RobotInfo, measured: Measured | None) -> Iterator[str]:
    """What to look at, the likeliest first."""
    link = robot.link
    host = _host(link.peer)
    if link.state is LinkState.ONLINE:
        yield from _next_online(robot, measured)
        return
    if link.state is LinkState.FAULTED:
        yield from _next_faulted(robot)
        return
    again = link.last_error if link.attempts >= _AGAIN else None  # it ends the same way each time
    said = filter(None, (link.reason or link.last_error, again))
    found = next((checks for one in said for words, checks in _BY_REASON if re.search(words, one)), None)
    if link.notes:
        yield "Do what stands above: the vendor's plugin knows this case."
    otherwise = (_WAIT,) if link.state in _BUSY_STATES else _DEFAULT
    yield from (check.format(host=host) for check in _BY_STATE.get(link.state) or found or otherwise)
    if robot.reject_counts and robot.frames:
        yield from _next_rejected(robot)


def _next_online(robot: RobotInfo, measured: Measured | None) -> Iterator[str]:
    link = robot.link
    if measured is not None and not measured.n_bytes:
        yield _BUSY
    for reason in measured.rejects if measured is not None and measured.rejected > _MANY_REJECTS else ():
        yield _BY_REJECT.get(reason, _STRANGE)
    if link.requested_hz and link.reached_hz is not None and link.reached_hz < _SLOW_SHARE * link.requested_hz:
        yield "The controller is slower than asked: set a lower `rate_hz`, or see what else loads it or the network."
    if link.layout and "does not explain" in link.layout:
        yield "The frames are longer than the layout: the firmware is probably newer. Samples have q UNCERTAIN."
    if link.notes:
        yield "Read what stands under Why: it is online all the same, but not everything may be told."
    if robot.reject_counts:
        yield from _next_rejected(robot)


def _next_rejected(robot: RobotInfo) -> Iterator[str]:
    rejects = sum(robot.reject_counts.values())
    if rejects > _MANY_REJECTS * (rejects + robot.frames):
        yield (
            f"{rejects / (rejects + robot.frames):.0%} of all that came was no good frame: see whether the network "
            "damages data, and whether the vendor's README names the controller's firmware."
        )
    yield (
        "Ask again in a minute: some rejects at a connection's start or end are normal, a growing number is not. "
        f"Live: `robot-gateway tail {robot.name}/link_stats`."
    )


def _next_faulted(robot: RobotInfo) -> Iterator[str]:
    yield f"Let the plugin be checked: `robot-gateway vendor-check {robot.vendor}`."
    yield "Read the gateway's log: it has the error in full."
    if robot.link.next_attempt is None:
        yield "Then start the gateway again: a plugin is loaded only once. The other robots run meanwhile."
    else:
        yield "Tell the author of the plugin; the controller is not to blame, and the other robots run."


def _host(peer: str) -> str:
    """The host of `host:port`, `[host]:port/udp` or a host alone."""
    found = re.fullmatch(r"\[(.+)\]:\d+(?:/udp)?|([^:]+):\d+(?:/udp)?", peer)
    return (found[1] or found[2]) if found else peer


def _age(seconds: float) -> str:
    return f"{seconds:.2g} s" if seconds < 1 else duration(seconds)


def _span(seconds: float) -> str:
    """A difference of clocks, with one digit behind the point: `4.0 h`."""
    for size, unit in ((86_400, "d"), (3_600, "h"), (60, "min")):
        if seconds >= size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.1f} s"


def _counted(number: int, what: str) -> str:
    return f"{number:,} {what}{'' if number == 1 else 's'}"
