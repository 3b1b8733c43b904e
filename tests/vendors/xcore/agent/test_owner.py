"""The owner as a process: what it publishes, what it survives, how it ends."""

from __future__ import annotations

import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.vendors.xcore.agent.kit import OWNING, Client, running_agent

READING = {
    "connectToRobot",
    "sdkVersion",
    "robotInfo",
    "jointPos",
    "jointVel",
    "jointTorque",
    "posture",
    "cartPosture",
    "powerState",
    "operateMode",
    "operationState",
    "getKeypadState",
    "getDI",
    "getDO",
    "getAI",
    "queryControllerLog",
    "baseFrame",
    "toolset",
    "toolsInfo",
    "wobjsInfo",
    "projectsInfo",
    "getSoftLimit",
    "readRegister",
    "setEventWatcher",
    "setNoneEventWatcher",
    "setConnectionHandler",
}


def pythons() -> list[str]:
    """Every Python from 3.8 that this machine has and that runs."""
    found = {sys.executable}
    for minor in range(8, 14):
        versions = sorted(Path.home().glob(f".pyenv/versions/3.{minor}.*/bin/python"))
        candidates = [shutil.which(f"python3.{minor}"), *map(str, versions)]
        for candidate in filter(None, candidates):
            asked = [candidate, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
            answer = subprocess.run(asked, capture_output=True, text=True, check=False, timeout=5)  # noqa: S603
            if answer.stdout.strip() == f"3.{minor}" and (minor, sys.version_info[1]) != (sys.version_info[1], minor):
                found.add(candidate)
                break
    return sorted(found)


@pytest.mark.parametrize("python", pythons())
def test_every_python_publishes_hello_and_state_and_lets_go_on_sigterm(python: str, tmp_path: Path) -> None:
    calls = tmp_path / "calls"
    ports = ("--di", "door=1,3", "--do", "lamp=0,0", "--ai", "force=2,1")
    with running_agent(*OWNING, *ports, python=python, behaviour={"external": 6}, calls=calls) as agent:
        with Client(agent.address) as client:
            hello = client.next()
            assert hello is not None
            assert hello["type"] == "hello"
            assert hello["schema"] == "xcore-objects/1"
            assert hello["sdkVersion"] == "0.7.1"
            assert hello["readOnly"] is True
            assert hello["units"]["zone"] == "mm"
            assert hello["info"] == {"id": "u1", "mac": "", "version": "3.2.1", "type": "stand-in", "joint_num": 6}
            assert "seq" not in hello
            state = client.until("state", lambda message: "jointPos" in message)
            assert state["jointPos"] == pytest.approx([0, 0.1, 0.2, 0.3, 0.4, 0.5])
            assert len(state["jointVel"]) == 6
            assert state["external"] == [9.0] * 6
            assert state["jointTorque"] == [1.0] * 6
            assert state["posture"]["endInRef"][0] == 1.0
            assert state["posture"]["flangeInBase"][0] == 0.0
            assert state["cartPosture"]["trans"] == [0.4, 0.0, 0.5]
            assert "pos" not in state["cartPosture"]
            names = [state[key] for key in ("powerState", "operateMode", "operationState")]
            assert names == ["on", "automatic", "idle"]
            assert state["keypad"]["key1_state"] is True
            assert (state["di"], state["do"], state["ai"]) == ({"door": True}, {"lamp": True}, {"force": 2.5})
            assert "errors" not in state
            assert abs(state["ts"] / 1e6 - time.time()) < 60
            after = client.until("state")
            assert after["seq"] == state["seq"] + 1
            assert client.ask("getDI", board=0, port=1)["value"] is True
            agent.terminate()
            client.until("closing")
        assert agent.wait() == 0
    noted = calls.read_text().split()
    assert noted.count("connectToRobot") == 1
    assert noted.count("setEventWatcher") == noted.count("setNoneEventWatcher") == 4
    assert set(noted) <= READING


def test_the_connection_to_the_robot_outlives_the_gateways(tmp_path: Path) -> None:
    calls = tmp_path / "calls"
    with running_agent(*OWNING, calls=calls) as agent:
        for _ in range(3):
            with Client(agent.address) as client:
                assert client.until("state")["seq"] == 1
        agent.terminate()
        assert agent.wait() == 0
    noted = calls.read_text().split()
    assert noted.count("connectToRobot") == 1
    assert "disconnectFromRobot" not in noted


def test_disconnecting_at_the_end_must_be_asked_for(tmp_path: Path) -> None:
    calls = tmp_path / "calls"
    with running_agent(*OWNING, "--disconnect-on-exit", calls=calls) as agent, Client(agent.address) as client:
        client.until("state")
        agent.terminate()
        assert agent.wait() == 0
    assert calls.read_text().split()[-1] == "disconnectFromRobot"


def test_a_hanging_call_is_reported_and_left_to_finish() -> None:
    behaviour = {"hang": {"jointVel": 30.0}}
    with (
        running_agent(*OWNING, "--call-timeout", "0.3", behaviour=behaviour) as agent,
        Client(agent.address) as client,
    ):
        state = client.until("state", lambda message: "errors" in message)
        assert state["jointPos"] is None
        assert state["errors"]["jointVel"]["error"] == "timeout"
        assert state["errors"]["jointPos"]["error"] == "busy"
        assert client.ask("jointPos")["error"] == "busy"
        again = client.until("state")
        assert again["seq"] > state["seq"]
        assert any("has not returned" in line for line in agent.log)
        agent.terminate()
        assert agent.wait() == 0  # though the call still hangs


def test_an_sdk_that_aborts_takes_the_agent_along() -> None:
    with running_agent(*OWNING, behaviour={"abort": "toolset"}) as agent:
        with Client(agent.address) as client:
            client.command("toolset")
            while client.next() is not None:
                pass
        assert agent.wait() == -signal.SIGABRT


def test_failed_reads_are_null_with_their_reason() -> None:
    behaviour = {
        "fail": {"jointPos": [261, "length"], "getKeypadState": [5, "no keypad"]},
        "raise": {"posture": "gone"},
    }
    with running_agent(*OWNING, behaviour=behaviour) as agent, Client(agent.address) as client:
        state = client.until("state", lambda message: "jointPos" in message)
        assert state["jointPos"] is None
        assert state["errors"]["jointPos"] == {"ec": 261, "message": "length"}
        assert state["errors"]["posture"] == {"ec": -1, "message": "NetworkException: gone"}
        assert "keypad" not in client.until("state", lambda message: "jointPos" in message and "keypad" not in message)
        assert state["jointTorque"] == [1.0] * 6


def test_values_that_are_no_numbers_are_null() -> None:
    with running_agent(*OWNING, behaviour={"nan": True}) as agent, Client(agent.address) as client:
        state = client.until("state", lambda message: "jointPos" in message)
        assert state["jointPos"] is state["jointVel"] is None
        assert "no finite number" in state["errors"]["jointPos"]["message"]
        assert state["jointTorque"] == [1.0] * 6


def test_events_come_and_a_log_comes_once_with_its_text() -> None:
    with running_agent(*OWNING, behaviour={"events": True}) as agent, Client(agent.address) as client:
        kinds: list[str] = []
        while kinds.count("event") < 8:
            message = client.next()
            assert message is not None
            kinds.append(message["type"])
            if message["type"] == "log":
                assert message["level"] == "error"
                assert message["log"] == {
                    "id": 50002,
                    "timestamp": "2026-01-01 00:00:00",
                    "content": "servo",
                    "repair": "reset",
                }
            if message["type"] == "event":
                assert message["event"] == "moveExecution"
                assert message["data"]["cmdID"] == "7"
        assert kinds.count("log") == 1


def test_without_the_flag_nothing_is_touched(tmp_path: Path) -> None:
    calls = tmp_path / "calls"
    with running_agent("--class", "xMateRobot", "--port", "0", calls=calls) as agent:
        assert agent.wait() == 3
        assert "resets the controller's motion buffer" in " ".join(agent.log)
    assert not calls.exists()


@pytest.mark.parametrize(
    "options",
    [
        (),
        ("--class", "Nobody"),
        ("--class", "xMateRobot", "--rate", "0.1"),
        ("--class", "xMateRobot", "--di", "door"),
        ("--class", "xMateRobot", "--port", "70000"),
        ("--class", "xMateRobot", "--call-timeout", "nan"),
    ],
)
def test_wrong_options_exit_with_2(options: tuple[str, ...]) -> None:
    with running_agent(*options) as agent:
        assert agent.wait() == 2


def test_without_the_sdk_it_says_what_to_do() -> None:
    with running_agent(*OWNING, sdk=False) as agent:
        assert agent.wait() == 69
        assert "not installed for this Python" in " ".join(agent.log)
        assert not any("Traceback" in line for line in agent.log)


def test_a_class_that_the_sdk_lacks_exits_with_70() -> None:
    with running_agent("--class", "PCB3Robot", "--connecting-may-stop-the-robot", "--port", "0") as agent:
        assert agent.wait() == 70


def test_a_taken_port_is_found_before_the_robot_is_touched(tmp_path: Path) -> None:
    calls = tmp_path / "calls"
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        with running_agent(*OWNING, "--port", port, calls=calls) as agent:
            assert agent.wait() == 73
    assert not calls.exists()


def test_a_robot_that_cannot_be_reached_exits_with_75(tmp_path: Path) -> None:
    calls = tmp_path / "calls"
    with running_agent(*OWNING, behaviour={"raise": {"connectToRobot": "nobody"}}, calls=calls) as agent:
        assert agent.wait() == 75
        assert "nobody" in " ".join(agent.log)
    assert calls.read_text().split() == ["sdkVersion", "connectToRobot"]


def test_with_reconnect_it_keeps_trying_and_serves_meanwhile() -> None:
    behaviour = {"raise": {"connectToRobot": "nobody"}}
    with running_agent(*OWNING, "--reconnect", behaviour=behaviour) as agent, Client(agent.address) as client:
        hello = client.next()
        assert hello is not None
        assert hello["info"] is None
        assert client.until("state").keys() == {"type", "seq", "ts"}
        agent.terminate()
        assert agent.wait() == 0
