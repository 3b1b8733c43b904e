"""Resolves the `[[robots]]` of a configuration into what the core runs, and notes everything that is wrong."""

from __future__ import annotations

import math
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import msgspec

from gateway.api.vendor import Vendor
from gateway.config.keys import PART_PERIODS, STALE_PERIODS, RobotTable, canonical, host_fault
from gateway.config.problems import hint, quoted, read_fields
from gateway.core.registry import Registry
from gateway.core.settings import BrokenRobot, RobotSettings
from gateway.errors import UnknownVendor, VendorError

if TYPE_CHECKING:
    from gateway.api.vendor import Protocol
    from gateway.config.problems import Problems, Table
    from gateway.config.toml_lines import Path

_THIS_MACHINE = {"localhost", "127.0.0.1", "::1"}  # a listener on localhost has both addresses
_KEYS = tuple(field.encode_name for field in msgspec.structs.fields(RobotTable))


class Robots:
    """Reads all robots of one file.

    Args:
        problems: Where what is wrong is noted.
        registry: Finds the plugins; None where `vendor_dirs` are wrong, so that not all of them can be known.
        listen: Host and port of the gateway's own listener.
    """

    def __init__(self, problems: Problems, registry: Registry | None, listen: tuple[str, int]) -> None:
        self._problems = problems
        self._listen = listen
        self._complete = registry is not None
        self._registry = registry or Registry()
        self._names: dict[str, Path] = {}
        self._addresses: dict[tuple[str, int], tuple[str, Path]] = {}

    def read(self, raw: object) -> list[RobotSettings | BrokenRobot]:
        """Read the array of tables; a robot with a problem is left out."""
        if not isinstance(raw, list) or not all(isinstance(table, dict) for table in raw):
            self._problems.add(("robots",), "must be tables: write [[robots]], with two pairs of brackets, above each")
            return []
        if not raw:
            self._problems.warn((), "no robot is configured: the gateway runs, but has nothing to tell")
        robots = [self._robot(("robots", index), table) for index, table in enumerate(raw)]
        return [robot for robot in robots if robot is not None]

    def _robot(self, path: Path, raw: Table) -> RobotSettings | BrokenRobot | None:
        plugin = self._plugin(path, raw)
        if isinstance(plugin, Vendor):
            return self._live(path, raw, plugin)
        options = [name for name, value in raw.items() if isinstance(value, dict)]  # of whatever protocol it has
        values = self._common(path, raw, read_fields(self._problems, path, raw, RobotTable, also=options))
        if plugin is None or not {"name", "host"} <= values.keys():
            return None
        self._problems.warn((*path, "vendor"), f"this robot is off, its vendor is broken: {plugin.reason}")
        protocol = str(values.get("protocol") or "")
        return BrokenRobot(
            name=str(values["name"]), host=str(values["host"]), vendor=plugin.vendor, protocol=protocol, error=plugin
        )

    def _plugin(self, path: Path, raw: Table) -> Vendor | VendorError | None:
        """The robot's vendor, why it is broken, or None if that is a problem of the file."""
        name = raw.get("vendor")
        if not isinstance(name, str):
            return None
        try:
            return self._registry.vendor(name)
        except UnknownVendor:
            if self._complete:
                known = self._registry.names()
                self._problems.add(
                    (*path, "vendor"), f"unknown vendor {quoted(name)}; {hint(name, known, 'known are')}"
                )
            return None
        except VendorError as error:
            return error

    def _live(self, path: Path, raw: Table, vendor: Vendor) -> RobotSettings | None:
        """A robot whose plugin works."""
        names = [protocol.name for protocol in vendor.protocols]
        protocol = self._protocol(path, raw, vendor)
        misplaced = _options_of(protocol) if protocol else {}
        values = read_fields(self._problems, path, raw, RobotTable, also=names, elsewhere=misplaced)
        values = self._common(path, raw, values)
        if protocol is None:
            return None
        for other in (name for name in names if name in raw and name != protocol.name):
            self._problems.add(
                (*path, other),
                f"belongs to another protocol: this robot speaks {quoted(protocol.name)}; "
                f"remove the table or set protocol = {quoted(other)}",
            )
        options = self._options((*path, protocol.name), raw.get(protocol.name, {}), protocol)
        port = self._port(path, raw, values, protocol, options)
        clock_zone = self._clock_zone(path, values, protocol)
        rate_hz = self._rate_hz(path, values, protocol)
        stale_s = self._stale_s(path, values, protocol, options, rate_hz)
        self._check_io_events(path, values, protocol)
        if options is None or port is None or not {"name", "host"} <= values.keys():
            return None
        table = msgspec.convert({**values, "vendor": vendor.name}, RobotTable)
        return RobotSettings(
            name=table.name,
            host=table.host,
            port=port,
            vendor=vendor,
            protocol=protocol,
            rate_hz=rate_hz,
            stale_s=stale_s,
            clock_zone=clock_zone,
            estop_polarity=table.estop_polarity,
            io_events=tuple(table.io_events),
            options=options,
        )

    def _common(self, path: Path, raw: Table, values: Table) -> Table:
        """Check what every robot has; the values that are right come back."""
        name, host = raw.get("name"), values.get("host")
        if isinstance(name, str):
            if name in self._names:
                line = self._problems.line((*self._names[name], "name"))
                self._problems.add((*path, "name"), f"{quoted(name)} is already the name of the robot in line {line}")
            self._names.setdefault(name, path)
        if isinstance(host, str) and (fault := host_fault(host)):
            self._problems.add((*path, "host"), fault)
            return {key: value for key, value in values.items() if key != "host"}
        return values

    def _protocol(self, path: Path, raw: Table, vendor: Vendor) -> Protocol | None:
        name = raw.get("protocol")
        try:
            return vendor.protocol(name if isinstance(name, str) else None)
        except KeyError:
            known = [protocol.name for protocol in vendor.protocols]
            told = f"unknown protocol {quoted(name)} of {vendor.name}; {hint(str(name), known, 'known are')}"
            self._problems.add((*path, "protocol"), told)
            return None

    def _port(
        self, path: Path, raw: Table, values: Table, protocol: Protocol, options: msgspec.Struct | None
    ) -> int | None:
        """The port; no two robots may share a controller, which has one connection to give, nor a listener of ours."""
        given = values.get("port")
        known = options or protocol.options()
        port = given if isinstance(given, int) else protocol.port_of(known)
        if port is None:
            if "port" not in raw:
                told = f"is missing: protocol {quoted(protocol.name)} has no port of its own; give the one set there"
                self._problems.add((*path, "port"), told)
            return None
        transport = protocol.transport(known)
        host = str(getattr(known, "listen", "")) if transport == "tcp_server" else values.get("host")
        if not isinstance(host, str):
            return port
        address = (canonical(host), port)
        if transport != "udp":
            self._refuse_listener(path, address)
        if address in self._addresses:
            name, first = self._addresses[address]
            line = self._problems.line((*first, "host"))
            if transport == "tcp_server":
                told = f"{host} port {port} is already used by robot {name} (line {line}); give each its own port"
                self._problems.add((*path, "port"), told)
            else:
                told = f"{host} port {port} is already read by robot {name} (line {line}); one controller is one robot"
                self._problems.add((*path, "host"), told)
        self._addresses.setdefault(address, (quoted(values.get("name", "")), path))
        return port

    def _refuse_listener(self, path: Path, address: tuple[str, int]) -> None:
        """The gateway cannot be its own controller."""
        (host, port), mine = address, canonical(self._listen[0])
        same = host == mine or ("localhost" in {host, mine} and {host, mine} <= _THIS_MACHINE)
        if same and port == self._listen[1]:
            told = f"{host} port {port} is where the gateway itself listens (server.listen): correct one of them"
            self._problems.add((*path, "host"), told)

    def _clock_zone(self, path: Path, values: Table, protocol: Protocol) -> ZoneInfo | None:
        given = values.get("clock_zone")
        if not isinstance(given, str):
            return None
        if protocol.wall_clock is None:
            told = f"protocol {quoted(protocol.name)} does not tell the controller's time; remove the key"
            self._problems.add((*path, "clock_zone"), told)
            return None
        try:
            return ZoneInfo(given)
        except (ZoneInfoNotFoundError, ValueError, OSError):
            told = f"{quoted(given)} is no time zone that this machine knows, such as Asia/Seoul or UTC"
            self._problems.add((*path, "clock_zone"), told)
            return None

    def _check_io_events(self, path: Path, values: Table, protocol: Protocol) -> None:
        """An event of an input that the robot does not have would never come, and nobody would know."""
        given = values.get("io_events")
        if not isinstance(given, list) or not given:
            return
        banks = [".".join(row.path) for row in protocol.signals if row.group == "io"]
        if not banks:
            told = f"protocol {quoted(protocol.name)} does not tell inputs and outputs; remove the key"
            self._problems.add((*path, "io_events"), told)
        for glob in given if banks else ():
            if not any(_reaches(str(glob), bank) for bank in banks):
                told = f"no input or output is called {quoted(glob)}; {hint(str(glob), banks, 'the banks are')}"
                self._problems.add((*path, "io_events"), told)

    def _rate_hz(self, path: Path, values: Table, protocol: Protocol) -> float | None:
        given = values.get("rate_hz")
        if not isinstance(given, float):
            return protocol.rate_hz
        if protocol.rate_hz is None:
            told = f"protocol {quoted(protocol.name)} is not polled: the controller sets the rate; remove the key"
            self._problems.add((*path, "rate_hz"), told)
            return None
        if protocol.max_rate_hz is not None and given > protocol.max_rate_hz:
            told = f"{given:g} is too fast for protocol {quoted(protocol.name)}: at most {protocol.max_rate_hz:g}"
            self._problems.add((*path, "rate_hz"), told)
        return given

    def _stale_s(
        self, path: Path, values: Table, protocol: Protocol, options: msgspec.Struct | None, rate_hz: float | None
    ) -> float:
        least = STALE_PERIODS / rate_hz if rate_hz else 0.0
        why = f"for {rate_hz:g} Hz: at least {least:g}, which is {STALE_PERIODS} periods" if rate_hz else ""
        if rate_hz and protocol.slowest_s and options is not None:
            slowest_s = protocol.slowest_s(options, rate_hz)
            if PART_PERIODS * slowest_s > least:
                least = math.ceil(PART_PERIODS * slowest_s * 10) / 10
                why = f"for values that are asked for every {slowest_s:.3g} s: at least {least:g}"
        given = values.get("stale_s")
        if not isinstance(given, float):
            return max(protocol.stale_s, least)
        if given < least:
            self._problems.add((*path, "stale_s"), f"{given:g} is too short {why}")
        return given

    def _options(self, path: Path, raw: object, protocol: Protocol) -> msgspec.Struct | None:
        """The protocol's own options; None if something is wrong with them."""
        if not isinstance(raw, dict):
            self._problems.add(path, f"must be a table: write [robots.{protocol.name}] below the robot")
            return None
        before = len(self._problems)
        above = f"is a key of the robot: put it above [robots.{protocol.name}]"
        values = read_fields(self._problems, path, raw, protocol.options, elsewhere=dict.fromkeys(_KEYS, above))
        names = {field.name: field.encode_name for field in msgspec.structs.fields(protocol.options)}
        try:
            return msgspec.convert({names[name]: value for name, value in values.items()}, protocol.options)
        except msgspec.ValidationError as error:
            if len(self._problems) == before:  # what the struct itself checks
                self._problems.add(path, str(error))
            return None


def _reaches(glob: str, bank: str) -> bool:
    """Whether a glob may name an input or output of a bank: `digital_in.box.3`, of which it may leave out the end."""
    return all(fnmatchcase(one, part) for one, part in zip(bank.split("."), glob.split("."), strict=False))


def _options_of(protocol: Protocol) -> dict[str, str]:
    """What to say of an option that stands among the robot's keys."""
    told = f"is an option of the protocol: put it below [robots.{protocol.name}]"
    return {field.encode_name: told for field in msgspec.structs.fields(protocol.options) if field.name not in _KEYS}
