"""The virtual FAIRINO controller: what a firmware offers, on its ports, from one motion and scenario.

Ports 20004 and 8083 push as soon as somebody connects, each frame in one send; CNDE stands in `cnde.py`. Port 8080 is
there because some clients insist on connecting to it.
"""

from __future__ import annotations

from functools import partial
from typing import Annotated, Literal, cast, get_args

import msgspec
from msgspec import Meta

from gateway.api.layout import Layout
from gateway.sim.packing import Word
from gateway.sim.simulator import Demo, Port, Simulator, VirtualRobot
from vendors.fairino.cnde_states import ALL_STATES
from vendors.fairino.cnde_states import HEADER as CNDE_HEADER
from vendors.fairino.layouts import CHECKSUM_SIZE, LEGACY_LAYOUTS, STATUS_357, STATUS_433
from vendors.fairino.pushed import HEADER, LENGTH_ADDS, sum16
from vendors.fairino.simulator.cnde import FILLERS, CndeBehaviour, CndeSession, known_states
from vendors.fairino.simulator.rpc import SAMPLE_PERIOD, RpcSession
from vendors.fairino.simulator.values import Writer, as_status

ALL = "all"
Firmware = Literal[
    "all", "3.6", "3.7.1", "3.7.2", "3.7.3", "3.7.4", "3.7.5", "3.7.6", "3.7.7", "3.7.8", "3.8.0", "3.8.1", "3.8.2",
    "3.8.3", "3.8.4", "3.8.5", "3.8.6", "3.8.7", "3.9.0", "3.9.1", "3.9.2", "3.9.3", "3.9.4", "3.9.5", "3.9.6", "3.9.7",
    "3.9.8",
]  # fmt: skip
Version = tuple[int, ...]

# The first firmware with a legacy frame of so many bytes.
_LEGACY_SIZES: dict[Version, int] = {
    (3, 6): 584,
    (3, 7, 2): 609,
    (3, 7, 4): 777,
    (3, 7, 6): 888,
    (3, 7, 7): 900,
    (3, 7, 8): 902,
    (3, 8, 2): 954,
    (3, 8, 3): 960,
    (3, 8, 6): 1184,
    (3, 8, 7): 1236,
    (3, 9, 5): 2073,
    (3, 9, 6): 2074,
    (3, 9, 8): 2075,
}
_USUAL_LEGACY_SIZE = 1236  # the size on which all of the vendor's clients agree
_STATUS_433_SINCE = (3, 7, 6)
_CNDE_UDP_SINCE = (3, 8, 2)
_CNDE_TCP_SINCE = (3, 9, 5)
_STATUS_PERIOD_S = 0.1
_STATUS_LEASE = "status_client"  # key of VirtualRobot.settings
_LEASE_S = 0.5

_LEGACY_BY_SIZE = {layout.size + CHECKSUM_SIZE: layout for layout in LEGACY_LAYOUTS}


class FairinoOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options of the virtual FAIRINO controller."""

    firmware: Annotated[
        Firmware,
        Meta(
            description="What the controller runs: it decides which ports and frames there are. "
            "all: every port, with the frames that most clients read. "
            f"One of {', '.join(get_args(Firmware))}.",
        ),
    ] = "all"
    legacy: Annotated[
        bool,
        Meta(description="Serve port 20004 with firmware 3.9.5 and later too, with the whole struct."),
    ] = False
    period_ms: Annotated[
        int,
        Meta(ge=1, le=1000, description="Period of port 20004 until a client sets another, in ms."),
    ] = 8

    @property
    def version(self) -> Version:
        """The firmware as numbers."""
        return tuple(int(part) for part in self.firmware.split(".")) if self.firmware != ALL else (99,)

    @property
    def legacy_size(self) -> int:
        """Bytes of a frame on port 20004."""
        if self.firmware == ALL:
            return _USUAL_LEGACY_SIZE
        return max(size for since, size in _LEGACY_SIZES.items() if since <= self.version)

    @property
    def offers_legacy(self) -> bool:
        """Whether port 20004 is open."""
        return self.legacy or self.firmware == ALL or self.version < _CNDE_TCP_SINCE

    @property
    def offers_cnde(self) -> bool:
        """Whether TCP port 20005 is open."""
        return self.version >= _CNDE_TCP_SINCE

    @property
    def offers_cnde_udp(self) -> bool:
        """Whether UDP port 20006 answers."""
        return self.version >= _CNDE_UDP_SINCE

    @property
    def states(self) -> tuple[str, ...]:
        """The states that CNDE knows."""
        return tuple(ALL_STATES) if self.firmware == ALL else known_states(self.legacy_size)


class _Pushing:
    """What both pushing ports share: numbered frames of one layout."""

    def __init__(self, robot: VirtualRobot, layout: Layout, writer: Writer) -> None:
        self.robot = robot
        self._writer = writer
        self._slots = writer.packer.slots
        self._data_len = layout.size + CHECKSUM_SIZE - LENGTH_ADDS
        self._number = 0

    def received(self, _data: bytes, _now_s: float) -> list[bytes]:
        """What a client sends is ignored."""
        return []

    def frame(self, now_s: float) -> bytes:
        """Return one frame, and count it."""
        words = self._writer.words(self.robot.state(now_s))
        words[self._slots["frame_cnt"].start] = self._number
        words[self._slots["data_len"].start] = self._data_len
        self._number = (self._number + 1) & 0xFF
        data = _sealed(self._writer, words)
        self.robot.count(data, now_s, partial(self._writer.packer.named, words))
        return data


class LegacySession(_Pushing):
    """Port 20004: a frame every period, which any client may change for all."""

    def __init__(self, robot: VirtualRobot, options: msgspec.Struct) -> None:
        self._options = cast("FairinoOptions", options)
        layout = _LEGACY_BY_SIZE[self._options.legacy_size]
        super().__init__(robot, layout, Writer(layout))
        self.period_s: float | None = sample_period(robot, self._options)

    def due(self, now_s: float) -> list[bytes]:
        """Push a frame."""
        self.period_s = sample_period(self.robot, self._options)
        return [self.frame(now_s)]


class StatusSession(_Pushing):
    """Port 8083: ten frames a second, to one client; a second one is accepted and hears nothing."""

    period_s: float | None = _STATUS_PERIOD_S

    def __init__(self, robot: VirtualRobot, options: msgspec.Struct) -> None:
        version = cast("FairinoOptions", options).version
        layout = STATUS_433 if version >= _STATUS_433_SINCE else STATUS_357
        super().__init__(robot, layout, Writer(layout, as_status))

    def due(self, now_s: float) -> list[bytes]:
        """Push a frame, if this is the client that is served: the first one, until it is gone."""
        holder, since_s = cast("tuple[object, float]", self.robot.settings.get(_STATUS_LEASE, (self, now_s)))
        if holder is not self and now_s - since_s < _LEASE_S:
            return []
        self.robot.settings[_STATUS_LEASE] = (self, now_s)
        return [self.frame(now_s)]


class SilentSession:
    """Port 8080: accepts, and says nothing."""

    period_s: float | None = None

    def __init__(self, _robot: VirtualRobot, _options: msgspec.Struct) -> None:
        pass

    def received(self, _data: bytes, _now_s: float) -> list[bytes]:
        """Ignore what comes."""
        return []

    def due(self, _now_s: float) -> list[bytes]:
        """Nothing is pushed."""
        return []


def sample_period(robot: VirtualRobot, options: FairinoOptions) -> float:
    """The period of port 20004, in s."""
    return cast("float", robot.settings.get(SAMPLE_PERIOD, options.period_ms / 1000))


def _sealed(writer: Writer, words: list[Word]) -> bytes:
    data = writer.packer.pack(words)
    return data + sum16(data).to_bytes(CHECKSUM_SIZE, "little")


def _rpc(robot: VirtualRobot, options: msgspec.Struct) -> RpcSession:
    period = partial(sample_period, robot, cast("FairinoOptions", options))
    return RpcSession(robot, options, sample_period=period)


def _cnde(robot: VirtualRobot, options: msgspec.Struct) -> CndeSession:
    own = cast("FairinoOptions", options)
    return CndeSession(robot, CndeBehaviour(known=own.states, version=f"FR5,V{own.firmware},virtual"))


def _offers_legacy(options: msgspec.Struct) -> bool:
    return cast("FairinoOptions", options).offers_legacy


def _offers_cnde(options: msgspec.Struct) -> bool:
    return cast("FairinoOptions", options).offers_cnde


def _offers_cnde_udp(options: msgspec.Struct) -> bool:
    return cast("FairinoOptions", options).offers_cnde_udp


SIMULATOR = Simulator(
    ports=(
        Port(
            protocol="cnde",
            port=20005,
            session=_cnde,
            header=CNDE_HEADER,
            fillers=FILLERS,
            offered=_offers_cnde,
        ),
        Port(
            protocol="cnde",
            port=20006,
            session=_cnde,
            transport="udp",
            header=CNDE_HEADER,
            fillers=FILLERS,
            offered=_offers_cnde_udp,
        ),
        Port(protocol="legacy", port=20004, session=LegacySession, header=HEADER, offered=_offers_legacy),
        Port(protocol="status", port=8083, session=StatusSession, header=HEADER),
        Port(protocol=None, port=20003, session=_rpc),
        Port(protocol=None, port=8080, session=SilentSession),
    ),
    options=FairinoOptions,
    demos=(
        Demo(protocol="cnde"),
        Demo(protocol="cnde", robot={"cnde": {"transport": "udp"}}),
        Demo(protocol="legacy"),
        Demo(protocol="status"),
    ),
)
