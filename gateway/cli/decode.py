"""`robot-gateway decode`: what the bytes of a recording, a network capture or a raw stream say."""

from __future__ import annotations

import contextlib
import json as jsons
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from gateway.api.decoder import AskedDecoder
from gateway.api.model import FRAME_GROUPS
from gateway.api.vendor import Protocol
from gateway.cli.check import fail as fail_config
from gateway.cli.common import USAGE, fail, tell
from gateway.cli.decoded import Asked, Spoken, print_all
from gateway.cli.recorded import opened
from gateway.config.problems import fault_of
from gateway.core.registry import Registry
from gateway.errors import ConfigError, VendorError
from gateway.record.captures import Capture
from gateway.record.decoding import recorded_pieces
from gateway.record.pieces import Conversation, FileError, kind_of, raw_pieces
from gateway.record.robots import robots_of


def decode(
    what: Annotated[
        str, typer.Argument(metavar="VENDOR[:PROTOCOL]", help="What it speaks; may be left out for a recording (MCAP).")
    ],
    file: Annotated[Path | None, typer.Argument(metavar="FILE", help="MCAP, pcap, pcapng, or a raw stream.")] = None,
    *,
    values: Annotated[bool, typer.Option("--values", help="The values of each frame, with units.")] = False,
    group: Annotated[
        list[str] | None, typer.Option("--group", "-g", metavar="GROUP", help="Only this group, also `vendor`.")
    ] = None,
    rejects: Annotated[bool, typer.Option("--rejects", help="Only what is no frame, and why.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print a JSON object a line.")] = False,
    csv_: Annotated[
        str | None,
        typer.Option(
            "--csv", metavar="F,F…", help="Print these values as CSV, such as joints.position,vendor.data_len."
        ),
    ] = None,
    option: Annotated[
        list[str] | None, typer.Option("--option", "-o", metavar="KEY=VALUE", help="An option of the protocol.")
    ] = None,
    robot: Annotated[
        list[str] | None, typer.Option("--robot", "-r", metavar="NAME", help="Of a recording, only this robot.")
    ] = None,
    host: Annotated[
        list[str] | None, typer.Option(metavar="ADDRESS", help="Of a capture, the controller's address.")
    ] = None,
    port: Annotated[
        list[int] | None, typer.Option(metavar="PORT", help="Of a capture, the controller's port, if not the vendor's.")
    ] = None,
    datagrams: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Of a raw file: datagrams of so many bytes, no stream.")
    ] = None,
    vendor_dir: Annotated[
        list[Path] | None,
        typer.Option("--vendor-dir", metavar="DIR", help="A folder of further vendors; may be repeated."),
    ] = None,
) -> None:
    """Decode the bytes of a recording, of a network capture or of a raw stream: frames, rejects and values.

    Every byte that was received stands in exactly one row. Exit code 1: the file cannot be read, or has no frame.

    \b
    Examples:
      robot-gateway decode stop.mcap --robot r1 --rejects
      robot-gateway decode fairino:cnde field.pcapng --group joints
      robot-gateway decode rainbow dump.bin --csv joints.position,joints.current
      robot-gateway decode xcore:external field.pcap --port 8080 --option axes=7
    """  # noqa: D301 - the \b keeps the lines apart
    path, spec = (Path(what), None) if file is None else (file, what)
    if csv_ is not None and (json or rejects):
        fail("--csv prints values of frames alone: leave out --json and --rejects", USAGE)
    fields = None if csv_ is None else [one.strip() for one in csv_.split(",") if one.strip()]
    asked = Asked(values, group or [], rejects, json, fields)
    for name in asked.groups:
        if name not in {*FRAME_GROUPS, "vendor"}:
            fail(f"--group {name}: there is no such group; there are {', '.join((*FRAME_GROUPS, 'vendor'))}", USAGE)
    try:
        registry = Registry(vendor_dir or [])
        kind = kind_of(path)
        if kind == "mcap":
            spoken = list(_of_recording(path, spec, registry, robot or [], option or []))
        else:
            protocol, options = _protocol(path, spec, registry, option or [])
            if kind == "capture":
                conversations = _of_capture(path, protocol, options, host or [], port or [])
            else:
                datagram = datagrams is not None
                conversations = [Conversation("", raw_pieces(path, datagrams), datagram)]
                _without_questions(protocol)
            spoken = [_spoken(one, protocol, options) for one in conversations]
    except ConfigError as error:
        fail_config(error)
    except (FileError, VendorError) as error:
        fail(str(error))
    print_all(path, spoken, asked)


def _protocol(path: Path, spec: str | None, registry: Registry, told: list[str]) -> tuple[Protocol, msgspec.Struct]:
    if spec is None:
        known = ", ".join(registry.names())
        fail(f"{path} does not say what it holds: name it, decode VENDOR[:PROTOCOL] FILE; vendors are {known}", USAGE)
    name, _, protocol_name = spec.partition(":")
    vendor = registry.vendor(name)
    try:
        protocol = vendor.protocol(protocol_name or None)
    except KeyError:
        known = ", ".join(one.name for one in vendor.protocols)
        fail(f"{name} has no protocol {protocol_name!r}; it has {known}", USAGE)
    return protocol, _options(protocol, told)


def _options(protocol: Protocol, told: list[str]) -> msgspec.Struct:
    """The options of a protocol as they stand on the command line."""
    fields = {field.name: field for field in msgspec.structs.fields(protocol.options)}
    values: dict[str, object] = {}
    for text in told:
        key, equals, value = text.partition("=")
        if not equals or key not in fields:
            known = ", ".join(fields) or "none"
            fail(f"--option {text}: write KEY=VALUE; the options of {protocol.name} are {known}", USAGE)
        values[key] = _value(key, value, fields[key].type)
    try:
        return msgspec.convert(values, protocol.options)
    except ValueError as error:
        fail(f"--option: {error}", USAGE)


def _value(key: str, text: str, kind: object) -> object:
    """A value as JSON, else as text, else as a list of texts."""
    choices: list[object] = [text, text.split(",")]
    with contextlib.suppress(ValueError):
        choices.insert(0, jsons.loads(text))
    fitting = [choice for choice in choices if not fault_of(choice, kind)]
    if not fitting:
        fail(f"--option {key}: {fault_of(choices[0], kind)}", USAGE)
    return fitting[0]


def _of_recording(
    path: Path, spec: str | None, registry: Registry, names: list[str], told: list[str]
) -> Iterator[Spoken]:
    """The robots of a recording, as they were configured or as the command line says."""
    recording = opened(path)
    for name in names:
        if name not in recording.names:
            fail(f"{path} holds nothing of a robot {name!r}: it has {', '.join(recording.names)}", USAGE)
    if spec is not None:
        protocol, options = _protocol(path, spec, registry, told)
        for name in names or recording.names:
            datagrams = protocol.transport(options) == "udp"
            conversation = Conversation(name, recorded_pieces(recording, name), datagrams)
            yield _spoken(conversation, protocol, options)
        return
    if told:
        fail("--option belongs to a protocol: name it too, decode VENDOR[:PROTOCOL] FILE", USAGE)
    found = robots_of(recording, names=names, registry=registry)
    for name, reason in found.left_out.items():
        tell("left out:", "yellow", f"{name}: {reason}")
    if not found.usable:
        fail(f"{path}: none of its robots can be decoded; name what it speaks, decode VENDOR[:PROTOCOL] FILE")
    for name, robot in found.usable.items():
        datagrams = robot.protocol.transport(robot.options) == "udp"
        conversation = Conversation(name, recorded_pieces(recording, name), datagrams)
        make = partial(robot.protocol.observer, robot.options)
        title = f"{name}  {robot.vendor.name}:{robot.protocol.name}"
        yield Spoken(conversation, robot.protocol, make, robot.signal_options, title)


def _of_capture(
    path: Path, protocol: Protocol, options: msgspec.Struct, hosts: list[str], ports: list[int]
) -> list[Conversation]:
    known = {port for port in (protocol.port, protocol.udp_port) if port is not None}
    if not ports and not known and not hosts:
        fail(f"{protocol.name} has no port of its own: say which is the controller with --port or --host", USAGE)
    capture = Capture(
        path, frozenset(ports or (known if protocol.port_of(options) is not None else ())), frozenset(hosts)
    )
    for note in capture.notes:
        tell("noted:", "yellow", f"{path}: {note}")
    if not capture.conversations:
        looked = [f"port {port}" for port in ports or sorted(known)] + [f"host {host}" for host in hosts]
        has = f"it has {capture.others_listed}" if capture.others else "it has no TCP and no UDP at all"
        fail(f"{path}: no connection with a controller at {', '.join(looked)}; {has}: choose with --port or --host")
    return capture.conversations


def _without_questions(protocol: Protocol) -> None:
    if isinstance(protocol.reader(), AskedDecoder) and protocol.framing is None:
        tell(
            "note:",
            "yellow",
            f"answers of {protocol.name} do not say what they answer, and a raw stream holds no questions: "
            "use a recording or a capture",
        )


def _spoken(conversation: Conversation, protocol: Protocol, options: msgspec.Struct) -> Spoken:
    """How a conversation is read with some options; in one without a name nobody was seen to ask anything."""
    signal_options = {"estop_polarity": None, **msgspec.structs.asdict(options)}
    polled = protocol.request is not None and not conversation.name
    make = protocol.reader if polled else partial(protocol.observer, options)
    return Spoken(conversation, protocol, make, signal_options, conversation.name)
