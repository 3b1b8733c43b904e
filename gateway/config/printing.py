"""Prints a configuration back with every default filled in, and the JSON Schema of the file."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import msgspec

from gateway.config.exports import EXPORT_TABLES
from gateway.config.keys import Recorder, RobotTable, Server
from gateway.core.settings import RobotSettings
from gateway.errors import VendorError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from gateway.api.vendor import Protocol, Vendor
    from gateway.config.file import Config
    from gateway.core.registry import Registry
    from gateway.core.settings import BrokenRobot

Schema = dict[str, object]

DRAFT = "https://json-schema.org/draft/2020-12/schema"
TITLE = "Configuration of robot-gateway"
_REFERENCE = "#/$defs/{name}"


def as_toml(config: Config) -> str:
    """The configuration as understood, in TOML that means the same."""
    lines = [f"vendor_dirs = {toml_value([str(path) for path in config.vendor_dirs])}", "", "[server]"]
    lines += _doors(config)
    lines += ["", "[recorder]", *_recorder(config)]
    lines += _exports(config)
    for robot in config.robots:
        lines += ["", "[[robots]]", *(_live(robot) if isinstance(robot, RobotSettings) else _broken(robot))]
    return "\n".join(lines) + "\n"


def robots_as_toml(robots: Iterable[RobotSettings]) -> str:
    """Some robots as understood, and nothing else: it holds no secret."""
    return "\n\n".join("\n".join(["[[robots]]", *_live(robot)]) for robot in robots) + "\n"


def _recorder(config: Config) -> Iterator[str]:
    for key, value in msgspec.structs.asdict(config.recorder).items():
        unset = key == "directory" and not value
        yield "# directory is not set" if unset else f"{key} = {toml_value(value)}"


def _doors(config: Config) -> Iterator[str]:
    """The table `[server]` and those below it; of the tokens no more than their names and what they may read."""
    values = msgspec.structs.asdict(config.server)
    tables = {key: value for key, value in values.items() if isinstance(value, msgspec.Struct)}
    for key, value in values.items():
        if key not in tables:
            yield f"# {key} is not set" if value is None else f"{key} = {toml_value(value)}"
    for token in config.tokens or ():
        yield f"# token {token.name} may read {', '.join(token.topics)}"
    for key, table in tables.items():
        yield f"[server.{_key(key)}]"
        for name, value in msgspec.structs.asdict(table).items():
            yield f"# {name} is not set" if value is None else f"{_key(name)} = {toml_value(value)}"


def _exports(config: Config) -> Iterator[str]:
    """The tables below `[export]`; of the secret files no more than their paths."""
    if config.export.nats is not None:
        yield from ("", "[export.nats]")
        table = msgspec.structs.asdict(config.export.nats.table) | {"outbox": str(config.export.nats.outbox)}
        for key, value in table.items():
            yield f"# {key} is not set" if value is None else f"{key} = {toml_value(value)}"


def _live(robot: RobotSettings) -> Iterator[str]:
    yield f"name = {toml_value(robot.name)}"
    yield f"vendor = {toml_value(robot.vendor.name)}"
    yield f"protocol = {toml_value(robot.protocol.name)}"
    yield f"host = {toml_value(robot.host)}"
    yield f"port = {toml_value(robot.port)}"
    yield "# rate_hz: the controller sets it" if robot.rate_hz is None else f"rate_hz = {toml_value(robot.rate_hz)}"
    yield f"stale_s = {toml_value(robot.stale_s)}"
    if robot.clock_zone is not None:
        yield f"clock_zone = {toml_value(str(robot.clock_zone))}"
    elif robot.protocol.wall_clock is not None and robot.protocol.wall_clock.zone is None:
        yield "# clock_zone is not set: t_src stays null"
    if robot.estop_polarity is not None:
        yield f"estop_polarity = {toml_value(robot.estop_polarity)}"
    elif any(row.key == "status.e_stopped" and "estop_polarity" in row.options for row in robot.protocol.signals):
        yield "# estop_polarity is not set: e_stopped is null where the manual does not state it"
    if robot.io_events:
        yield f"io_events = {toml_value(robot.io_events)}"
    options = msgspec.to_builtins(robot.options)
    if options:
        yield f"[robots.{_key(robot.protocol.name)}]"
    for key, value in options.items():
        yield f"# {key} is not set" if value is None else f"{_key(key)} = {toml_value(value)}"


def _broken(robot: BrokenRobot) -> Iterator[str]:
    yield f"# off, the vendor is broken: {' '.join(robot.error.reason.split())}"
    yield f"name = {toml_value(robot.name)}"
    yield f"vendor = {toml_value(robot.vendor)}"
    if robot.protocol:
        yield f"protocol = {toml_value(robot.protocol)}"
    yield f"host = {toml_value(robot.host)}"


def _key(key: str) -> str:
    return key if key.replace("-", "_").isidentifier() and key.isascii() else toml_value(key)


def toml_value(value: object) -> str:
    """A value in TOML; None, which TOML does not have, is left out of tables by the caller."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, dict):
        pairs = (f"{_key(str(key))} = {toml_value(part)}" for key, part in value.items() if part is not None)
        return f"{{ {', '.join(pairs)} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    return str(value).lower() if isinstance(value, bool) else repr(value)


def json_schema(registry: Registry) -> Schema:
    """JSON Schema (draft 2020-12) of the configuration file, with the options of every vendor that can be loaded."""
    vendors = list(_loadable(registry))
    options = [protocol.options for vendor in vendors for protocol in vendor.protocols]
    structs: list[type] = list(dict.fromkeys([Server, Recorder, *EXPORT_TABLES.values(), RobotTable, *options]))
    references, definitions = msgspec.json.schema_components(structs, ref_template=_REFERENCE)
    found: dict[type, Schema] = dict(zip(structs, references, strict=True))
    robot = definitions.pop(RobotTable.__name__)
    robot["properties"] = {key: _without_null(value) for key, value in robot["properties"].items()}
    server = definitions[Server.__name__]
    server["properties"] = {key: _without_null(value) for key, value in server["properties"].items()}
    for table in EXPORT_TABLES.values():
        one = definitions[table.__name__]
        one["properties"] = {key: _without_null(value) for key, value in one["properties"].items()}
    robot["properties"]["vendor"]["enum"] = registry.names()
    keys = list(robot["properties"])
    robot["allOf"] = [
        {"if": _chosen(vendor, protocol), "then": _table(keys, protocol, found[protocol.options])}
        for vendor in vendors
        for protocol in vendor.protocols
    ] + [
        {"if": _is("vendor", vendor.name), "then": {"properties": {"protocol": {"enum": _names(vendor)}}}}
        for vendor in vendors
    ]
    return {
        "$schema": DRAFT,
        "title": TITLE,
        "type": "object",
        "properties": {
            "vendor_dirs": {
                "description": "Folders of further vendors; refused if others may write to them.",
                "type": "array",
                "items": {"type": "string"},
                "default": [],
            },
            "server": found[Server],
            "export": {
                "description": "Where the gateway sends what it reads.",
                "type": "object",
                "properties": {name: found[table] for name, table in EXPORT_TABLES.items()},
                "additionalProperties": False,
            },
            "recorder": found[Recorder],
            "robots": {"type": "array", "items": {"$ref": _REFERENCE.format(name="Robot")}},
        },
        "additionalProperties": False,
        "$defs": {"Robot": robot, **definitions},
    }


def _loadable(registry: Registry) -> Iterator[Vendor]:
    for name in registry.names():
        try:
            yield registry.vendor(name)
        except VendorError:
            continue  # its robots are not restricted


def _names(vendor: Vendor) -> list[str]:
    return [protocol.name for protocol in vendor.protocols]


def _is(key: str, value: str) -> Schema:
    return {"properties": {key: {"const": value}}, "required": [key]}


def _chosen(vendor: Vendor, protocol: Protocol) -> Schema:
    """Matches the robots that speak a protocol; the default one also where none is named."""
    named = _is("protocol", protocol.name)
    if protocol is vendor.protocol():
        named = {"anyOf": [named, {"not": {"required": ["protocol"]}}]}
    return {"allOf": [_is("vendor", vendor.name), named]}


def _table(keys: list[str], protocol: Protocol, options: Schema) -> Schema:
    """What a robot that speaks a protocol may have."""
    properties: Schema = {
        "port": {"default": protocol.port},
        "stale_s": {"default": protocol.stale_s},
        protocol.name: options,
    }
    if protocol.rate_hz is not None:
        highest = {} if protocol.max_rate_hz is None else {"maximum": protocol.max_rate_hz}
        properties["rate_hz"] = {"default": protocol.rate_hz, **highest}
    else:
        keys = [key for key in keys if key != "rate_hz"]
    return {"properties": properties, "propertyNames": {"enum": [*keys, protocol.name]}}


def _without_null(schema: Schema) -> Schema:
    """The schema of a key that may be left out; TOML has no null to write in its place."""
    kinds = schema.pop("anyOf", None)
    if isinstance(kinds, list):
        schema.update(next(kind for kind in kinds if kind.get("type") != "null"))
    if isinstance(values := schema.get("enum"), list):
        schema["enum"] = [value for value in values if value is not None]
    if schema.get("default", "") is None:
        del schema["default"]
    return schema
