"""XML-RPC on port 20003 of the virtual controller: the few methods that vendor clients insist on, and no command.

HTTP by hand and the standard library's dispatcher: like every session of the kit it does no I/O and needs no thread.
"""

from __future__ import annotations

from collections.abc import Callable
from xmlrpc.server import SimpleXMLRPCDispatcher

import msgspec

from gateway.sim.simulator import VirtualRobot

SAMPLE_PERIOD = "sample_period_s"  # key of VirtualRobot.settings
_PERIODS_MS = range(1, 1001)
_OK, _WRONG_PARAMETER = 0, 4
_LARGEST_REQUEST = 65_536
_END_OF_HEAD = b"\r\n\r\n"


class _Methods:
    """What the controller answers; each method's first value is an error code."""

    def __init__(self, robot: VirtualRobot, address: str, sample_period: Callable[[], float]) -> None:
        self._robot = robot
        self._address = address
        self._sample_period = sample_period

    def get_controller_ip(self) -> list[object]:
        """The address in the controller's own network."""
        return [_OK, self._address]

    def get_sample_period(self) -> list[object]:
        """The period of port 20004, in ms."""
        return [_OK, round(1000 * self._sample_period())]

    def set_sample_period(self, period_ms: object) -> int:
        """Set the period of port 20004, for every client."""
        if not isinstance(period_ms, int) or period_ms not in _PERIODS_MS:
            return _WRONG_PARAMETER
        self._robot.settings[SAMPLE_PERIOD] = period_ms / 1000
        return _OK

    def get_stop_on_loss(self, _port_id: object) -> list[object]:
        """Whether the robot stops when a connection is lost: it does not."""
        return [_OK, 0, 0]


class RpcSession:
    """One HTTP connection.

    Args:
        robot: Keeps what is set.
        options: Of the simulator; not used.
        sample_period: Tells the present period of port 20004, in s.
        address: What the controller calls its own address.
    """

    period_s: float | None = None

    def __init__(
        self,
        robot: VirtualRobot,
        _options: msgspec.Struct,
        *,
        sample_period: Callable[[], float],
        address: str = "192.168.58.2",
    ) -> None:
        methods = _Methods(robot, address, sample_period)
        self._dispatcher = SimpleXMLRPCDispatcher(allow_none=False, encoding="utf-8")
        register = self._dispatcher.register_function
        register(methods.get_controller_ip, "GetControllerIP")
        register(methods.get_sample_period, "GetRobotRealtimeStateSamplePeriod")
        register(methods.set_sample_period, "SetRobotRealtimeStateSamplePeriod")
        register(methods.get_stop_on_loss, "GetRobotStopOnComDisc")
        self._rest = b""

    def received(self, data: bytes, _now_s: float) -> list[bytes]:
        """Answer every whole request."""
        self._rest += data
        answers = []
        while (request := self._request()) is not None:
            answers.append(self._answer(request))
        return answers

    def due(self, _now_s: float) -> list[bytes]:
        """Nothing is pushed."""
        return []

    def _request(self) -> bytes | None:
        """Take the body of the next whole request off what was received."""
        head, end, behind = self._rest.partition(_END_OF_HEAD)
        length = _content_length(head) if end else 0
        if len(self._rest) > _LARGEST_REQUEST or length > _LARGEST_REQUEST:
            raise ValueError(f"a request of more than {_LARGEST_REQUEST} bytes")
        if not end or len(behind) < length:
            return None
        self._rest = behind[length:]
        return behind[:length]

    def _answer(self, request: bytes) -> bytes:
        body = self._dispatcher._marshaled_dispatch(request)  # noqa: SLF001 - its documented hook for other transports
        head = f"HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\nContent-Length: {len(body)}\r\n\r\n"
        return head.encode() + body.encode() if isinstance(body, str) else head.encode() + body


def _content_length(head: bytes) -> int:
    for line in head.split(b"\r\n")[1:]:
        name, _, value = line.partition(b":")
        if name.strip().lower() == b"content-length":
            return int(value)
    return 0
