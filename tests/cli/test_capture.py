"""`robot-gateway capture`: the bytes of one robot in a file, from the running gateway or straight from a controller."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import pytest
from mcap.reader import make_reader

from gateway.core.registry import Registry
from gateway.sim.server import serve
from gateway.sim.simulator import Simulator
from tests.cli.command import command
from tests.cli.recorded import recorded_cell, topics

pytestmark = pytest.mark.limit(40)


async def test_a_robot_of_the_gateway_is_captured_with_bytes_samples_and_link(tmp_path: Path) -> None:
    path = tmp_path / "r1.mcap"
    async with recorded_cell(tmp_path, count=2) as cell:
        done = await command("capture", "r1", "--seconds", "20", "-o", str(path), "--control", cell.control)
        assert done.code == 0, done.err
        assert "written:" in done.err
        found = topics(path)
        assert {"r1/raw/received", "r1/raw/sent", "r1/session", "r1/joints", "r1/link"} <= set(found)
        assert not [topic for topic in found if topic.startswith("r2/")]
        assert path.stat().st_mode & 0o777 == 0o640
        with path.open("rb") as file:
            attached = [one.data.decode() for one in make_reader(file).iter_attachments()]
        assert 'name = "r1"' in attached[0]
        assert "server" not in attached[0]
        again = await command("capture", "r1", "-o", str(path), "--control", cell.control)
        assert again.code == 2
        assert "--force" in again.err
        forced = await command("capture", "r1", "-o", str(path), "--control", cell.control, "--force")
        assert forced.code == 0, forced.err


async def test_what_cannot_be_captured_is_said_and_leaves_no_file(tmp_path: Path) -> None:
    path = tmp_path / "r1.mcap"
    async with recorded_cell(tmp_path) as cell:
        unknown = await command("capture", "r11", "-o", str(path), "--control", cell.control)
        assert unknown.code == 1
        assert "did you mean" in unknown.err
        nowhere = await command("capture", "r1", "-o", str(tmp_path / "no" / "x.mcap"), "--control", cell.control)
        assert nowhere.code == 2
        neither = await command("capture", "-o", str(path), "--control", cell.control)
        assert neither.code == 2
        folder = await command("capture", "r1", "-o", str(tmp_path), "--control", cell.control)
        assert "is a folder" in folder.err
    async with recorded_cell(tmp_path, enabled=False) as cell:
        off = await command("capture", "r1", "-o", str(path), "--control", cell.control)
        assert off.code == 1
        assert "the recorder is off" in off.err
    assert not list(tmp_path.glob("*.mcap*"))  # noqa: ASYNC240


async def test_a_controller_is_captured_without_a_gateway(tmp_path: Path) -> None:
    path = tmp_path / "new.mcap"
    simulator = cast("Simulator", Registry().simulator("rainbow"))
    async with serve(simulator, host="127.0.0.2", port=0, scenario="steady") as (controller,):
        address = f"rainbow://{controller.host}:{controller.port}"
        done = await command("capture", "--connect", address, "--seconds", "1.5", "-o", str(path))
    assert done.code == 0, done.err
    assert {"robot/raw/received", "robot/raw/sent", "robot/joints", "robot/link"} <= set(topics(path))


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("192.168.58.2", "is no address like"),
        ("fairno://192.168.58.2", "fairino"),
        ("rainbow:nothing://192.168.58.2", "reqdata"),
        ("rainbow://192.168.58.2:99999", "65535"),
        ("fairino:legacy://192.168.58.2", "--allow-legacy"),
    ],
)
async def test_a_wrong_address_is_refused_before_anything_is_called(tmp_path: Path, address: str, said: str) -> None:
    done = await command("capture", "--connect", address, "-o", str(tmp_path / "x.mcap"))
    assert done.code == 2
    assert said in done.err
    assert not list(tmp_path.iterdir())  # noqa: ASYNC240


async def test_a_controller_that_says_nothing_leaves_no_file_and_a_reason(tmp_path: Path) -> None:
    done = await command(
        "capture", "--connect", "rainbow://127.0.0.3:9", "--seconds", "1", "-o", str(tmp_path / "x.mcap")
    )
    assert done.code == 1
    assert "nothing was received" in done.err
    assert not list(tmp_path.iterdir())  # noqa: ASYNC240
