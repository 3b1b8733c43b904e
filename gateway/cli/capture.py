"""`robot-gateway capture`: what one robot said lately, into a file; from the running gateway, or without one."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated

import anyio
import msgspec
import typer

from gateway.app import connector_of, recorder_of
from gateway.cli.common import USAGE, call, fail, tell
from gateway.cli.control import Control, Rest, asked, find_socket
from gateway.config import Config, parse
from gateway.config.keys import host_fault
from gateway.config.printing import toml_value
from gateway.core.bus import Bus
from gateway.core.clock import SystemClock
from gateway.core.events import EventRing
from gateway.core.links import Links
from gateway.core.registry import Registry
from gateway.core.settings import BrokenRobot, RobotSettings
from gateway.errors import ConfigError, VendorError
from gateway.record.making import Making
from gateway.record.mcapfile import Writer
from gateway.record.settings import PART
from gateway.record.spool import Message, Raw, SpoolError, SpoolReader
from gateway.recording import Capture, Handed

_ADDRESS = re.compile(
    r"(?P<vendor>[a-z0-9_-]+)(:(?P<protocol>[a-z0-9_-]+))?://(\[(?P<six>[^\]]+)\]|(?P<host>[^:/\[\]]+))(:(?P<port>[0-9]{1,5}))?"
)
_STUCK_S = 30.0
_RING_MB = 2000
_LOOK_S = 1.0


def capture(
    robot: Annotated[str | None, typer.Argument(metavar="[ROBOT]", help="Name of a robot of the gateway.")] = None,
    *,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE", help="The file, .mcap.")],
    seconds: Annotated[float, typer.Option(min=0.1, max=3600, help="How many seconds of it.")] = 30.0,
    connect: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Without a gateway: vendor[:protocol]://host[:port], from now on."),
    ] = None,
    allow_legacy: Annotated[
        bool,
        typer.Option("--allow-legacy", help="Connect also where closing the connection may stop the robot."),
    ] = False,
    vendor_dir: Annotated[
        list[Path] | None, typer.Option("--vendor-dir", metavar="DIR", help="With --connect: further vendors.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over a file that is there.")] = False,
    control: Control = None,
) -> None:
    """Write what one robot sent and was sent lately into a file, byte for byte, with the samples that follow from it.

    The gateway keeps the last seconds of every robot (ring_s in [recorder]); it goes on undisturbed. With --connect
    the controller is called from here, for so many seconds: for a robot that is in no configuration yet.

    \b
    Examples:
      robot-gateway capture r1 -o r1.mcap
      robot-gateway capture r1 --seconds 5 -o r1.mcap
      robot-gateway capture --connect fairino://192.168.58.2 -o fr.mcap
    """  # noqa: D301 - the \b keeps the lines apart
    if (robot is None) == (connect is None):
        fail("name either a robot of the gateway or --connect ADDRESS", USAGE)
    _check_place(out, force=force)
    if connect is not None:
        messages = _without_gateway(connect, seconds, vendor_dir or [], allowed=allow_legacy)
        _write(messages, out, connect)
    elif robot is not None:
        with asked(find_socket(control, os.environ), Capture(robot=robot, seconds=seconds)) as (answer, rest):
            if not answer.ok:
                fail(answer.message)
            handed = msgspec.json.decode(answer.result, type=Handed)
            if handed.ring_s < seconds:
                tell("warning:", "yellow", f"the gateway keeps no more than {handed.ring_s:g} s: see recorder.ring_s")
            _write(_spooled(rest), out, robot)


def _check_place(out: Path, *, force: bool) -> None:
    if out.is_dir():
        fail(f"{out} is a folder; name the file in it", USAGE)
    if not out.parent.is_dir():
        fail(f"{out.parent}: there is no such folder", USAGE)
    part = out.with_name(out.name + PART)
    for path in (out, part):
        if path.exists() and not force:
            fail(f"{path} is there already; name another file, or write over it with --force", USAGE)
    part.unlink(missing_ok=True)


def _spooled(rest: Rest) -> Iterator[Message]:
    """The messages that the gateway hands out."""
    reader = SpoolReader()
    while data := rest.read(_STUCK_S):
        yield from reader.feed(data)


def _write(messages: Iterable[Message], out: Path, who: str) -> None:
    """Write the file, if anything was received at all."""
    os.umask(0o027)
    n_received = 0
    try:
        with Writer(out) as writer:
            making = Making(writer)
            kept: list[Message] = []
            for message in messages:
                if isinstance(message, Raw):
                    n_received += sum(len(chunk.data) for chunk in message.block.chunks() if chunk.kind == "received")
                kept.append(message)
                if n_received:
                    for one in kept:
                        making.take(one)
                    kept.clear()
            if not n_received and kept:
                fail(f"nothing was received from {who} in this time: no file is written; look at: robot-gateway status")
            if not making.finished:
                fail("the gateway hung up before the capture was whole: no file is written")
            notes, n_messages = making.notes, writer.n_messages
    except SpoolError as error:
        fail(f"the gateway and this command do not fit together: {error}")
    except OSError as error:
        fail(f"{out}: {error.strerror or error}: no file is written")
    for note in notes:
        tell("warning:", "yellow", note)
    size = out.stat().st_size
    tell("written:", "green", f"{out}: {n_received} bytes from {who}, {n_messages} messages, {size} bytes on the disk")


def _without_gateway(address: str, seconds: float, vendor_dirs: list[Path], *, allowed: bool) -> list[Message]:
    """Call a controller from here and listen for so long."""
    config = _config_of(address, vendor_dirs)
    robot = config.robots[0]
    if isinstance(robot, BrokenRobot):
        fail(str(robot.error))
    if robot.protocol.hazard and not allowed:
        fail(
            f"{robot.vendor.name} {robot.protocol.name} is not connected to: {robot.protocol.hazard}\n"
            "--allow-legacy does it all the same: only while the robot stands still",
            USAGE,
        )
    if robot.protocol.hazard:
        tell("danger:", "red", robot.protocol.hazard)
    found: list[Message] = []
    call(partial(_listen, config, robot, seconds, found))
    if not found:
        fail("interrupted: no file is written")
    return found


def _config_of(address: str, vendor_dirs: list[Path]) -> Config:
    match = _ADDRESS.fullmatch(address)
    if match is None:
        fail(
            f"--connect {address}: is no address like fairino://192.168.58.2 or rainbow:reqdata://10.0.2.7:5001", USAGE
        )
    host = match["six"] or match["host"]
    if fault := host_fault(host):
        fail(f"--connect {address}: {fault}", USAGE)
    entry: dict[str, object] = {"name": "robot", "vendor": match["vendor"], "host": host}
    if match["protocol"]:
        entry["protocol"] = match["protocol"]
    if match["port"]:
        entry["port"] = int(match["port"])
    text = "[[robots]]\n" + "".join(f"{key} = {toml_value(value)}\n" for key, value in entry.items())
    text += f"[recorder]\nring_s = 3600\nring_mb = {_RING_MB}\n"
    try:
        return parse(text, "--connect", Registry(vendor_dirs))
    except (ConfigError, VendorError) as error:
        fail(f"--connect {address}: {error}", USAGE)


async def _listen(config: Config, robot: RobotSettings, seconds: float, found: list[Message]) -> None:
    bus, clock = Bus(EventRing(10_000)), SystemClock()
    recorder = recorder_of(config, bus, clock, lambda: config.robots, {})
    if recorder is None:
        raise AssertionError("a recorder is on unless it is turned off")
    links = Links(config.robots, bus, clock, connector_of, tap_of=lambda one: recorder.tap(one.name))
    recorder.watch()
    async with links.running():
        links.start()
        began_s = clock.monotonic()
        while (left_s := seconds - (clock.monotonic() - began_s)) > 0:
            await anyio.sleep(min(_LOOK_S, left_s))
            _progress(clock.monotonic() - began_s, seconds, recorder.info.ring_bytes, robot)
        links.stop()
    if sys.stderr.isatty():
        sys.stderr.write("\n")
    found.extend(recorder.capture(robot.name, clock.monotonic() - began_s + _LOOK_S))


def _progress(passed_s: float, seconds: float, n_bytes: int, robot: RobotSettings) -> None:
    """One line that is written anew; into a pipe nothing."""
    if sys.stderr.isatty():
        line = f"{min(passed_s, seconds):.0f} of {seconds:g} s, {n_bytes / 1000:.0f} kB of {robot.host}"
        sys.stderr.write(f"\r{line}\x1b[K")
        sys.stderr.flush()
