"""The tap: what it publishes, and that the application notices nothing."""
# ruff: noqa: ANN401 - the stand-in is typed as little as the SDK

from __future__ import annotations

import datetime as dt
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Self

import pytest
from robot_gateway_xcore_agent import tap, tap_of, untap
from robot_gateway_xcore_agent.outbox import Limits
from robot_gateway_xcore_agent.service import HANDED_OVER

from tests.vendors.xcore.agent.kit import AGENT, Client, wait_for
from tests.vendors.xcore.agent.test_owner import pythons


@contextmanager
def tapped(robot: Any, **options: Any) -> Iterator[Any]:
    found = tap(robot, port=0, **options)
    try:
        yield found
    finally:
        tap_of(found).close()
        wait_for(lambda: tap_of(found).address is None)


@contextmanager
def gateway(robot: Any, **options: Any) -> Iterator[Client]:
    with Client(tap_of(robot).address, **options) as client:
        hello = client.next()
        assert hello is not None
        assert hello["type"] == "hello"
        yield client


def line_to(sdk: Any, speed: float = 100) -> Any:
    return sdk.MoveLCommand(sdk.CartesianPosition([0.4, 0, 0.5, 3.1, 0, 3.1]), speed)


def test_what_is_appended_is_published_with_its_id(sdk: Any) -> None:
    with tapped(sdk.xMateRobot()) as robot, gateway(robot) as client:
        box, ec = sdk.PyString(), dict[str, Any]()
        moves = [line_to(sdk, 100), line_to(sdk, 200)]
        assert robot.moveAppend(moves, box, ec) is None
        moves[0].speed = moves[0].target.trans[0] = 7777
        moves.clear()
        assert (box.content(), ec) == ("id1", {"ec": 0, "message": ""})
        issued = client.until("issued")
        assert issued["cmdID"] == "id1"
        assert issued["class"] == "MoveLCommand"
        assert [command["speed"] for command in issued["commands"]] == [100, 200]
        assert issued["commands"][0]["target"] == {"trans": [0.4, 0, 0.5], "rpy": [3.1, 0, 3.1]}
        robot.moveAppend(sdk.MoveWaitCommand(dt.timedelta(milliseconds=500)), cmdID=box, ec=ec)
        wait = client.until("issued")
        assert (wait["cmdID"], wait["class"], wait["commands"]) == ("id2", "MoveWaitCommand", [{"duration_": 0.5}])
        assert robot.executeCommand([sdk.MoveAbsJCommand(sdk.JointPosition([0.0] * 6))], ec) == "ran"
        assert client.until("issued")["class"] == "MoveAbsJCommand"
        assert wait["seq"] > issued["seq"]
    assert sdk.CALLS == ["moveAppend", "moveAppend", "executeCommand"]  # the application's own, and no other


def test_the_sdks_exceptions_and_refusals_pass_and_are_not_published(sdk: Any) -> None:
    with tapped(sdk.xMateRobot()) as robot, gateway(robot) as client:
        sdk.BEHAVIOUR["raise"] = {"moveAppend": "gone"}
        with pytest.raises(sdk.NetworkException, match="gone"):
            robot.moveAppend([line_to(sdk)], sdk.PyString(), {})
        sdk.BEHAVIOUR.clear()
        sdk.BEHAVIOUR["fail"] = {"moveAppend": [-2, "no"]}
        ec: dict[str, Any] = {}
        robot.moveAppend([line_to(sdk)], sdk.PyString(), ec)
        assert ec == {"ec": -2, "message": "no"}
        sdk.BEHAVIOUR.clear()
        robot.moveAppend([line_to(sdk, 5)], sdk.PyString(), {})
        assert client.until("issued")["commands"][0]["speed"] == 5


def test_what_cannot_be_encoded_is_announced_as_lost(sdk: Any) -> None:
    class Unheard:
        pass

    class Hostile(sdk.MoveLCommand):  # type: ignore[misc]
        @property
        def speed(self) -> float:
            raise RuntimeError("do not look")

        @speed.setter
        def speed(self, value: float) -> None:
            pass

    with tapped(sdk.xMateRobot()) as robot, gateway(robot) as client:
        long = line_to(sdk)
        long.customInfo = "x" * 70_000
        for wrong in (Unheard(), Hostile(sdk.CartesianPosition()), [line_to(sdk), sdk.MoveWaitCommand(1)], long):
            robot.moveAppend(wrong, sdk.PyString(), {})
        count = 0
        while count < 4:
            count += client.until("lost")["count"]
        assert count == 4


def test_a_list_that_is_longer_than_a_line_comes_in_parts(sdk: Any) -> None:
    with tapped(sdk.xMateRobot()) as robot, gateway(robot) as client:
        moves = [line_to(sdk, 100 + number) for number in range(100)]
        for move in moves:
            move.customInfo = "i" * 900
        robot.moveAppend(moves, sdk.PyString(), {})
        first, second = client.until("issued"), client.until("issued")
        assert first["cmdID"] == second["cmdID"] == "id1"
        assert (first["firstIndex"], second["firstIndex"]) == (0, len(first["commands"]))
        speeds = [command["speed"] for command in first["commands"] + second["commands"]]
        assert speeds == [100 + number for number in range(100)]


def test_watched_events_are_published_and_the_callback_is_called_as_before(sdk: Any) -> None:
    heard: list[Any] = []

    def callback(info: Any) -> None:
        heard.append((threading.current_thread(), info))
        info["changed"] = True

    with tapped(sdk.xMateRobot()) as robot, gateway(robot) as client:
        robot.setEventWatcher(sdk.Event.moveExecution, callback, {})
        robot.setEventWatcher(sdk.Event.logReporter, callback, {})
        robot.setConnectionHandler(heard.append)
        info = {"cmdID": "id1", "reachTarget": True, "wayPointIndex": 0, "error": 0, "remark": "", "customInfo": "x"}
        robot.fire("moveExecution", info)
        event = client.until("event")
        assert (event["event"], event["data"]) == (
            "moveExecution",
            {"cmdID": "id1", "reachTarget": True, "wayPointIndex": 0, "error": 0, "remark": "", "customInfo": "x"},
        )
        assert heard[0][1] is info
        assert heard[0][0] is not threading.current_thread()
        for spelling in ({"Ecode": "50002", "Edetail": "why"}, {"ecode": 50002, "edetail": "why"}, {"ecode": 50003}):
            robot.fire("logReporter", dict(spelling))
        logs = [client.until("log"), client.until("log")]
        assert [log["log"]["id"] for log in logs] == [50002, 50003]
        assert (logs[0]["level"], logs[0]["log"]["content"]) == (None, "why")
        robot.fire("connection", 0)
        assert client.until("event")["data"] == {"connected": False}
        assert heard[-1] == 0
    assert "queryControllerLog" not in sdk.CALLS


def test_a_callbacks_exception_and_value_pass() -> None:
    class Robot:
        def setEventWatcher(self, _event: object, callback: Any, _ec: object) -> None:  # noqa: N802
            self.callback = callback

    def callback(*args: object, **kwargs: object) -> object:
        if not args:
            raise KeyError("mine")
        return args, kwargs

    with tapped(Robot()) as robot:
        robot.setEventWatcher("safety", callback, {})
        assert robot.callback(1, a=2) == ((1,), {"a": 2})
        with pytest.raises(KeyError, match="mine"):
            robot.callback()
        robot.setEventWatcher("safety", None, {})
        assert robot.callback is None
        assert not hasattr(robot, "moveAppend")


def test_the_stand_in_for_the_robot_looks_like_it(sdk: Any) -> None:
    class Listed(list[int]):
        answer = 42

        def __enter__(self) -> Self:
            return self

        def __exit__(self, *_args: object) -> None:
            pass

    real = sdk.xMateRobot()
    with tapped(real) as robot:
        assert isinstance(robot, sdk.xMateRobot)
        assert robot == real
        assert (repr(robot), hash(robot), dir(robot)) == (repr(real), hash(real), dir(real))
        assert untap(robot) is real
        assert untap(real) is real
        robot.n_issued = 5
        robot.extra = 1
        assert (real.n_issued, real.extra) == (5, 1)
        del robot.extra
        assert not hasattr(real, "extra")
        assert robot.moveAppend.__name__ == "moveAppend"
        with pytest.raises(AttributeError):
            _ = robot.nothing
    with tapped(Listed([1, 2])) as listed:
        assert (len(listed), list(listed), listed[1], listed.answer) == (2, [1, 2], 2, 42)
        with listed as inside:
            assert inside is listed
        with pytest.raises(TypeError):
            hash(listed)
    with tapped(7) as seven:
        assert seven == 7
        assert bool(seven)


def test_a_second_gateway_is_told_why_and_the_first_stays(sdk: Any) -> None:
    with tapped(sdk.xMateRobot()) as robot, gateway(robot) as client:
        with Client(tap_of(robot).address) as second:
            closing = second.next()
            assert closing is not None
            assert (closing["type"], closing["reason"][:13]) == ("closing", "one gateway a")
            assert second.next() is None
        assert client.until("state")


def test_without_a_period_states_are_heartbeats_and_no_call_is_made(sdk: Any) -> None:
    with tapped(sdk.xMateRobot()) as robot, gateway(robot) as client:
        began = time.monotonic()
        states = [client.until("state") for _ in range(4)]
        assert [state["seq"] for state in states] == [1, 2, 3, 4]
        assert all(state.keys() == {"type", "seq", "ts"} for state in states)
        assert time.monotonic() - began < 4  # at least one a second
        assert client.ask("jointPos")["error"] == "unsupported"
        assert client.ask("moveStart")["error"] == "read_only"
    assert sdk.CALLS == []


def test_with_a_period_it_reads(sdk: Any) -> None:
    with tapped(sdk.xMateRobot(), state_period_s=0.02) as robot:
        wait_for(lambda: "operationState" in sdk.CALLS)
        with gateway(robot) as client:
            assert client.until("state", lambda message: "jointPos" in message)["powerState"] == "on"
            robot.setEventWatcher(sdk.Event.logReporter, lambda _info: None, {})
            robot.fire("logReporter", {"Ecode": 50002})
            found = client.until("log")
            assert (found["level"], found["log"]["content"]) == ("error", "servo")
    with pytest.raises(ValueError, match="state_period_s"):
        tap(sdk.xMateRobot(), port=0, state_period_s=5)


def test_when_the_info_becomes_known_the_gateway_is_asked_to_come_again(sdk: Any) -> None:
    sdk.BEHAVIOUR["fail"] = {"robotInfo": [-1, "not yet"]}
    with tapped(sdk.xMateRobot(), state_period_s=0.05) as robot:
        with Client(tap_of(robot).address) as client:
            hello = client.next()
            assert hello is not None
            assert hello["info"] is None
            state = client.until("state", lambda message: "jointPos" in message)
            assert (state["jointPos"], state["powerState"]) == (None, "on")
            assert "robotInfo failed" in state["errors"]["jointPos"]["message"]
            sdk.BEHAVIOUR.clear()
            assert "Info" in client.until("closing")["reason"]
            assert client.next() is None
        with Client(tap_of(robot).address) as client:
            hello = client.next()
            assert hello is not None
            assert hello["info"]["joint_num"] == 6


def test_what_happened_without_a_gateway_is_announced_as_lost(sdk: Any) -> None:
    with tapped(sdk.xMateRobot()) as robot:
        for _ in range(3):
            robot.moveAppend([line_to(sdk)], sdk.PyString(), {})
        wait_for(lambda: tap_of(robot).n_lost == 3)
        with gateway(robot) as client:
            assert client.until("lost")["count"] == 3
            robot.moveAppend([line_to(sdk)], sdk.PyString(), {})
            assert client.until("issued")["cmdID"] == "id4"
        assert tap_of(robot).n_lost == 3


def test_a_gateway_that_does_not_read_delays_no_call_and_is_let_go(sdk: Any) -> None:
    with tapped(sdk.xMateRobot(), limits=Limits(state_bytes=1000, owed_bytes=200_000)) as robot:
        with gateway(robot, receive_buffer=4096) as client:
            moves = [line_to(sdk) for _ in range(100)]
            for move in moves:
                move.customInfo = "x" * 500
            calls = 0
            while tap_of(robot).connected:  # it is never read: all of it piles up
                robot.moveAppend(moves, sdk.PyString(), {})
                calls += 1
                time.sleep(0.001)
                assert calls < 5000
            sequence = []
            while True:
                try:
                    message = client.next()
                except ValueError:  # the last line is cut where the connection ended
                    break
                except AssertionError:
                    break
                if message is None:
                    break
                sequence.append(message["seq"])
            assert sequence == sorted(set(sequence))
        with gateway(robot) as client:  # and the next one is served
            assert client.until("state")


def test_when_the_tap_has_no_time_calls_go_on_and_the_oldest_are_counted(
    sdk: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    with tapped(sdk.xMateRobot()) as robot, gateway(robot) as client:
        service = tap_of(robot)._service
        stopped, go_on = threading.Event(), threading.Event()
        step = service.step

        def stuck(**options: Any) -> None:
            stopped.set()
            go_on.wait(8)
            step(**options)

        monkeypatch.setattr(service, "step", stuck)
        assert stopped.wait(8)
        for _ in range(HANDED_OVER + 50):
            robot.moveAppend(line_to(sdk), sdk.PyString(), {})
        assert len(sdk.CALLS) == HANDED_OVER + 50  # none of them waited
        monkeypatch.undo()
        go_on.set()
        found, lost = 0, 0
        while found + lost < HANDED_OVER + 50:
            message = client.next()
            assert message is not None
            found += message["type"] == "issued"
            lost += message.get("count", 0)
        assert (found, lost) == (HANDED_OVER, 50)


def test_a_taken_port_fails_no_application(sdk: Any) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        robot = tap(sdk.xMateRobot(), port=taken.getsockname()[1])
        assert tap_of(robot).address is None
        robot.moveAppend([line_to(sdk)], sdk.PyString(), {})
        assert sdk.CALLS == ["moveAppend"]
        tap_of(robot).close()
    with pytest.raises(ValueError, match="port"):
        tap(sdk.xMateRobot(), port=70_000)


FORKING = """
import json, os, socket, sys, time, warnings
warnings.simplefilter("ignore", DeprecationWarning)
from robot_gateway_xcore_agent import tap, tap_of
class Robot:
    def moveAppend(self, cmds, cmdID, ec):
        return "went"
robot = tap(Robot(), port=0)
address = tap_of(robot).address
gateway = socket.create_connection(address, 5)
lines = gateway.makefile("rb")
assert json.loads(lines.readline())["type"] == "hello"
class MoveWaitCommand:
    duration_ = 2
assert robot.moveAppend(MoveWaitCommand(), None, {}) == "went"
issued = {}
while issued.get("type") != "issued":
    issued = json.loads(lines.readline())
assert (issued["cmdID"], issued["commands"]) == ("went", [{"duration_": 2}])
read, write = os.pipe()
child = os.fork()
if child == 0:
    os.close(write)  # so that it ends with its parent, whatever happens there
    assert tap_of(robot).address is None
    for _ in range(1000):
        assert robot.moveAppend([], None, {}) == "went"
    os.read(read, 1)  # as long as this child lives
    sys.exit(0)
tap_of(robot).close()
gateway.settimeout(5)
while lines.readline():
    pass
for attempt in range(200):  # the child lets go of its copies as soon as it runs
    try:
        socket.create_server(address).close()
        break
    except OSError:
        time.sleep(0.05)
else:
    raise SystemExit("the child holds the port")
os.write(write, b"x")
assert os.waitpid(child, 0)[1] == 0
print("ended")
"""


@pytest.mark.parametrize("python", pythons())
@pytest.mark.limit(90)
def test_on_every_python_a_fork_and_the_programs_end_hang_nowhere(python: str) -> None:
    command = [python, "-c", FORKING]
    environment = {"PYTHONPATH": str(AGENT), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)  # noqa: S603
    assert (done.stdout, done.returncode) == ("ended\n", 0), done.stderr
