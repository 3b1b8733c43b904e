"""The commands of the gateway: one result each, and every refusal."""
# ruff: noqa: ANN401 - the stand-in is typed as little as the SDK

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from robot_gateway_xcore_agent import sdk as calls
from robot_gateway_xcore_agent.commands import COMMANDS, RESERVED
from robot_gateway_xcore_agent.desk import Desk
from robot_gateway_xcore_agent.reader import Identity, LogBook, Reader
from robot_gateway_xcore_agent.service import Service
from robot_gateway_xcore_agent.worker import Worker

from tests.vendors.xcore.agent.kit import Client, wait_for
from tests.vendors.xcore.agent.test_owner import READING


@contextmanager
def served(sdk: Any, *, call_timeout_s: float = 3.0, timeout_s: float = 5.0, most: int = 8) -> Iterator[Client]:
    """A gateway at an agent whose worker does nothing by itself but read states."""
    identity = Identity()
    service = Service(identity)
    robot = sdk.xMateRobot()
    reader = Reader(robot, sdk, identity, service.offer, period_s=1.0)
    worker = Worker(iter(()), call_timeout_s)  # type: ignore[arg-type]  # a program without a step
    reader.attach(worker, call_timeout_s)
    identity.info = {"joint_num": 6}
    desk = Desk(reader, worker, service.stream.wake, most=most, timeout_s=timeout_s)
    service.attach(desk, lambda: None)
    service.stream.listen("127.0.0.1", 0)
    worker.start()
    going = [True]

    def loop() -> None:
        while going:
            service.step()

    thread = threading.Thread(target=loop, daemon=True)
    thread.start()
    try:
        with Client(service.stream.address) as client:
            yield client
    finally:
        going.clear()
        thread.join(5)
        worker.end()
        service.stream.close()


def test_every_reading_command_has_its_value(sdk: Any) -> None:
    pose = {"ct": "endInRef"}
    port = {"board": 0, "port": 1}
    asked: list[tuple[str, dict[str, Any], Any]] = [
        ("robotInfo", {}, {"id": "u1", "mac": "", "version": "3.2.1", "type": "stand-in", "joint_num": 6}),
        ("jointPos", {}, {"joints": pytest.approx([0, 0.1, 0.2, 0.3, 0.4, 0.5]), "external": [9, 9]}),
        ("posture", pose, [1.0, 0, 0.5, 3.1, 0, 3.1]),
        ("baseFrame", {}, [0] * 6),
        ("projectsInfo", {}, [{"name": "p", "taskList": ["t1", "t2"]}]),
        ("getDI", port, True),
        ("getDO", port, True),
        ("getAI", port, 2.5),
        ("readRegister", {"name": "r", "index": 2, "type": "float"}, 2.5),
        ("readRegister", {"name": "rs", "type": "int", "array": True}, [1, 2, 3]),
        ("getSoftLimit", {}, {"enabled": True, "limits": [[-3, 3]] * 6}),
    ]
    sdk.BEHAVIOUR["external"] = 2
    with served(sdk) as client:
        for number, (name, args, value) in enumerate(asked):
            result = client.ask(name, f"c{number}", **args)
            assert result == {"type": "result", "id": f"c{number}", "ok": True, "ec": 0, "message": "", "value": value}
        assert client.ask("cartPosture", **pose)["value"]["trans"] == [0.4, 0, 0.5]
        assert client.ask("toolset")["value"]["load"]["mass"] == 1.5
        assert client.ask("toolsInfo")["value"][0]["name"] == "tool0"
        assert client.ask("wobjsInfo")["value"][0]["robotHeld"] is True
        assert client.ask("getKeypadState")["value"]["key1_state"] is True
        assert client.ask("queryControllerLog", count=3, level=["error"], offset=10)["value"][0]["id"] == 50002
        assert client.ask("queryControllerLog", level=["info"])["value"] == []
    assert set(sdk.CALLS) == set(COMMANDS)


def test_the_reserved_names_are_refused_and_nothing_is_called(sdk: Any) -> None:
    with served(sdk) as client:
        for name in sorted(RESERVED):
            result = client.ask(name, f"c-{name}", anything=1)
            assert result == {
                "type": "result",
                "id": f"c-{name}",
                "ok": False,
                "ec": 0,
                "message": "agent is read-only",
                "error": "read_only",
            }
    assert sdk.CALLS == []


@pytest.mark.parametrize(
    ("name", "args", "error"),
    [
        ("startJog", {}, "unsupported"),
        ("disconnectFromRobot", {}, "unsupported"),
        ("setEventWatcher", {}, "unsupported"),
        ("__class__", {}, "unsupported"),
        (7, {}, "bad_request"),
        ("jointPos", {"more": 1}, "bad_request"),
        ("posture", {}, "bad_request"),
        ("posture", {"ct": "world"}, "bad_request"),
        ("getDI", {"board": 0, "port": True}, "bad_request"),
        ("getDI", {"board": 0, "port": 1.0}, "bad_request"),
        ("getDI", {"board": -1, "port": 0}, "range"),
        ("getAI", {"board": 0, "port": 10**12}, "range"),
        ("readRegister", {"name": "", "type": "int"}, "bad_request"),
        ("readRegister", {"name": "r", "type": "double"}, "bad_request"),
        ("readRegister", {"name": "r", "type": "int", "array": 1}, "bad_request"),
        ("queryControllerLog", {"count": 11}, "range"),
        ("queryControllerLog", {"level": "error"}, "bad_request"),
        ("queryControllerLog", {"level": ["fatal"]}, "bad_request"),
    ],
)
def test_what_may_not_be_asked_is_refused(sdk: Any, name: object, args: dict[str, Any], error: str) -> None:
    with served(sdk) as client:
        assert client.ask(name, **args)["error"] == error
    assert sdk.CALLS == []


def test_malformed_commands_have_one_result_each_and_other_lines_none(sdk: Any) -> None:
    lines: list[Any] = [
        {"type": "command", "name": "jointPos", "args": {}},
        {"type": "command", "id": 5, "name": "jointPos"},
        {"type": "command", "id": "x" * 300, "name": "jointPos"},
        {"type": "command", "id": "a", "name": "jointPos", "args": []},
        {"type": "command", "id": "b", "name": "jointPos", "hurry": True},
        {"type": "unheard"},
    ]
    with served(sdk) as client:
        client.send(
            b"garbage\n" + b"y" * 70_000 + b"\n" + b"".join(json.dumps(line).encode() + b"\n" for line in lines)
        )
        found = [client.until("result") for _ in range(5)]
        assert [result["id"] for result in found] == ["", "", "", "a", "b"]
        assert {result["error"] for result in found} == {"bad_request"}
        assert client.ask("jointPos", "last")["ok"] is True


def test_what_the_sdk_refuses_has_its_number_and_no_error(sdk: Any) -> None:
    sdk.BEHAVIOUR.update({"fail": {"toolset": [266, "not authorised"]}, "raise": {"baseFrame": "gone"}})
    with served(sdk) as client:
        answer = {"type": "result", "id": "c1", "ok": False}
        assert client.ask("toolset") == {**answer, "ec": 266, "message": "not authorised"}
        assert client.ask("baseFrame") == {**answer, "ec": -1, "message": "NetworkException: gone"}


def test_a_value_that_is_longer_than_a_line_is_refused(sdk: Any) -> None:
    sdk.BEHAVIOUR["tools"] = 1000
    with served(sdk) as client:
        assert client.ask("toolsInfo")["error"] == "range"


def test_a_call_that_the_robot_lacks_is_unsupported(sdk: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(sdk.xMateRobot.__mro__[1], "getKeypadState")
    with served(sdk) as client:
        assert client.ask("getKeypadState")["error"] == "unsupported"


def test_past_its_deadline_a_command_times_out_once_and_too_many_are_busy(sdk: Any) -> None:
    sdk.BEHAVIOUR["hang"] = {"toolset": 1.0}
    with served(sdk, timeout_s=0.4, most=2) as client:
        for number in range(4):
            client.command("toolset" if number == 0 else "baseFrame", f"c{number}")
        found = {result["id"]: result.get("error") for result in (client.until("result") for _ in range(4))}
        assert found == {"c0": "timeout", "c1": "timeout", "c2": "busy", "c3": "busy"}
        wait_for(lambda: "toolset" in sdk.CALLS)
        sdk.BEHAVIOUR.clear()
        while client.ask("getDO", "late", board=0, port=0).get("error") == "timeout":
            pass  # it waited for the call that was left to finish
    assert "baseFrame" not in sdk.CALLS  # what timed out while it waited is never carried out


def test_while_a_call_hangs_commands_are_busy(sdk: Any) -> None:
    sdk.BEHAVIOUR["hang"] = {"toolset": 2.0}
    with served(sdk, call_timeout_s=0.2, timeout_s=0.3) as client:
        assert client.ask("toolset")["error"] == "timeout"
        assert client.ask("baseFrame")["error"] == "busy"
    assert sdk.CALLS == ["toolset"]


def test_a_call_that_is_not_on_the_list_is_never_made(sdk: Any) -> None:
    robot = sdk.xMateRobot()
    for name in [name for name in dir(robot) if not name.startswith("_") and name not in calls.ALLOWED]:
        with pytest.raises(calls.NotAllowedError):
            calls.call(robot, name)
    assert sdk.CALLS == []
    assert READING | {"disconnectFromRobot"} == calls.ALLOWED
    assert not calls.ALLOWED & RESERVED


def test_a_repeated_log_is_known(sdk: Any) -> None:
    book = LogBook()
    entry = {"id": 1, "timestamp": "t", "content": ""}
    assert book.is_new("error", entry, 0)
    assert not book.is_new("error", entry, 100)
    assert book.is_new("error", {**entry, "timestamp": "u"}, 100)
    textless = {**entry, "timestamp": ""}
    assert [book.is_new(None, textless, now) for now in (0.0, 5.0, 16.0)] == [True, False, True]
