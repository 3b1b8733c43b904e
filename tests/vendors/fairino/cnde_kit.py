"""What the tests of CNDE share: a virtual session with known values, and a conversation without sockets."""

from __future__ import annotations

from collections.abc import Mapping

from gateway.api.decoder import Event, Frame, Refused, Reject, Skipped
from gateway.api.layout import Layout
from gateway.sim.packing import Word
from gateway.sim.scenario import RobotState, find_scenario
from gateway.sim.simulator import VirtualRobot
from vendors.fairino.cnde import CndeDecoder, CndeOptions, Learned
from vendors.fairino.cnde_narrowing import Narrowing
from vendors.fairino.simulator.cnde import CndeBehaviour, CndeSession
from vendors.fairino.simulator.values import Writer

VALUES: Mapping[str, object] = {
    "jt_cur_pos": [10.0, -20.5, 30.25, -40.0, 50.0, 60.0],
    "tl_cur_pos": [100.0, 200.0, 300.0, 0.0, 90.0, 0.0],
    "program_state": 2,
    "main_code": -7,
    "cl_dgt_input_l": 0b101,
    "cl_analog_input_0": 4095,
    "currentLuaFileName": "/fruser/weld.lua",
    "robotTime_year": 2026,
    "robotTime_mouth": 5,
    "robotTime_day": 17,
    "robotTime_hour": 12,
    "robotTime_minute": 34,
    "robotTime_second": 56,
    "robotTime_millisecond": 789,
    "extAxisStatus_1_pos": 12.5,
}


class FixedWriter(Writer):
    """Writes the same values at any time."""

    def __init__(self, layout: Layout) -> None:
        super().__init__(layout)
        self._fixed = self.packer.words({name: value for name, value in VALUES.items() if name in layout.by_name})

    def words(self, _state: RobotState) -> list[Word]:
        """All words, in wire order."""
        return self._fixed


def virtual(behaviour: CndeBehaviour | None = None, robot: VirtualRobot | None = None) -> CndeSession:
    """A virtual session that always tells the same."""
    found = robot or VirtualRobot(find_scenario("steady"))
    return CndeSession(found, behaviour or CndeBehaviour(), FixedWriter)


class Talk:
    """A conversation between a decoder and a virtual session, tick by tick, without sockets."""

    def __init__(self, decoder: CndeDecoder, session: CndeSession) -> None:
        self.decoder = decoder
        self.session = session
        self.sent: list[bytes] = []
        self.events: list[Event] = []
        self.now_s = 0.0
        self.deaf = 0  # how many further messages of the decoder are lost
        self.say(decoder.outgoing())

    def say(self, data: bytes) -> None:
        """Let the decoder send something, and hear the answers."""
        if not data:
            return
        self.sent.append(data)
        if self.deaf:
            self.deaf -= 1
            return
        for answer in self.session.received(data, self.now_s):
            self.hear(answer)

    def hear(self, data: bytes) -> list[Event]:
        """Let the decoder receive something."""
        events = self.decoder.feed(data)
        self.events += events
        self.say(self.decoder.outgoing())
        return events

    def tick(self, count: int = 1) -> None:
        """Let time go on: the decoder's tick, and one period of the session."""
        for _ in range(count):
            self.now_s += 0.1
            asked = self.decoder.tick()
            if isinstance(asked, Refused):
                self.events.append(asked)
                return
            self.say(asked)
            for data in self.session.due(self.now_s):
                self.hear(data)

    @property
    def frames(self) -> list[Frame]:
        """The frames so far."""
        return [event for event in self.events if isinstance(event, Frame)]

    @property
    def rejects(self) -> list[str]:
        """The reasons of the rejects so far."""
        return [event.reason for event in self.events if isinstance(event, Reject)]

    @property
    def skipped(self) -> list[str]:
        """The reasons of the skipped frames so far."""
        return [event.reason for event in self.events if isinstance(event, Skipped)]

    @property
    def refusals(self) -> list[Refused]:
        """The refusals so far."""
        return [event for event in self.events if isinstance(event, Refused)]

    @property
    def configurations(self) -> list[tuple[str, ...]]:
        """The states that were asked for, configuration after configuration."""
        return [tuple(data[8:-2].decode().split(",")) for data in self.sent if data[3] == 1]


def talk(
    options: CndeOptions | None = None, behaviour: CndeBehaviour | None = None, learned: Learned | None = None
) -> Talk:
    """Begin a conversation."""
    options = options or CndeOptions()
    return Talk(CndeDecoder(options, learned or Learned(Narrowing(options.wanted))), virtual(behaviour))


def running(options: CndeOptions | None = None, behaviour: CndeBehaviour | None = None) -> Talk:
    """A conversation that has come to data."""
    found = talk(options, behaviour)
    found.tick(4)
    assert found.decoder.ready
    return found
