from __future__ import annotations

import dataclasses
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

import anyio
import msgspec
import pytest
from anyio.abc import SocketAttribute, SocketStream
from typer.testing import CliRunner

from gateway.api.decoder import Event
from gateway.api.framing import FramedDecoder
from gateway.api.vendor import Protocol, Vendor
from gateway.app import connector
from gateway.cli.main import app
from gateway.cli.probe import stanza
from gateway.core.probe import Finding, Verdict, probe, questions
from tests.core import toy


class Controller:
    """What listens, and what it was sent."""

    def __init__(self, answer: bytes) -> None:
        self.answer = answer
        self.heard: list[bytes] = []
        self.connections = self.open = self.most_open = 0

    async def serve(self, stream: SocketStream) -> None:
        """Answer whatever comes."""
        self.connections += 1
        self.open += 1
        self.most_open = max(self.most_open, self.open)
        async with stream:
            try:
                while True:
                    self.heard.append(await stream.receive())
                    await stream.send(self.answer)
            except (anyio.EndOfStream, anyio.BrokenResourceError):
                self.open -= 1


@asynccontextmanager
async def listening(answer: bytes) -> AsyncIterator[tuple[Controller, int]]:
    controller = Controller(answer)
    async with await anyio.create_tcp_listener(local_host="127.0.0.1") as listener, anyio.create_task_group() as tasks:
        tasks.start_soon(listener.serve, controller.serve)
        yield controller, listener.extra_attributes[SocketAttribute.local_port]()
        tasks.cancel_scope.cancel()


def at(port: int | None, name: str = "polled", **changes: object) -> Protocol:
    return dataclasses.replace(toy.POLLED, name=name, port=port, **changes)  # type: ignore[arg-type] # fields of any type


async def ask(protocols: Sequence[Protocol], *, allow_hazards: bool = False) -> list[Finding]:
    vendor = Vendor(name="toy", title="Toy", protocols=tuple(protocols))
    findings = probe([vendor], "127.0.0.1", connector, timeout_s=0.3, allow_hazards=allow_hazards)
    return [finding async for finding in findings]


async def test_a_polled_protocol_is_asked_once_and_found() -> None:
    async with listening(toy.frame()) as (controller, port):
        (finding,) = await ask([at(port)])
        await anyio.sleep(0.05)
    assert (finding.verdict, finding.reason) == (Verdict.SPEAKS, "20 bytes came: toy")
    assert controller.heard == [b"ask"]
    assert controller.open == 0


async def test_a_vendor_that_is_found_is_asked_no_further_and_never_twice_at_a_time() -> None:
    async with listening(b"HTTP/1.1 400 Bad Request\r\n") as (other, wrong), listening(toy.frame()) as (right, port):
        found = await ask([at(wrong, "first"), at(port, "second"), at(port, "third")])
    assert [(finding.question.protocol.name, finding.verdict) for finding in found] == [
        ("first", Verdict.SILENT),
        ("second", Verdict.SPEAKS),
    ]
    assert "no good frame; last reject: junk" in found[0].reason
    assert (other.connections, right.connections, right.most_open) == (1, 1, 1)


async def test_a_closed_port_says_what_that_probably_means() -> None:
    async with listening(b"") as (_, port):
        pass
    (finding,) = await ask([at(port, when_refused="the firmware is probably older")])
    assert finding.verdict is Verdict.REFUSED
    assert finding.reason.endswith("nothing listens on that port. the firmware is probably older")


async def test_a_hazard_is_left_alone_unless_it_is_allowed() -> None:
    async with listening(toy.frame()) as (controller, port):
        (finding,) = await ask([at(port, hazard="the robot may stop")])
        assert (finding.verdict, finding.reason) == (Verdict.HAZARD, "the robot may stop")
        assert controller.connections == 0
        (finding,) = await ask([at(port, hazard="the robot may stop")], allow_hazards=True)
    assert finding.verdict is Verdict.SPEAKS


class Asking(FramedDecoder):
    """Asks who is there."""

    def __init__(self) -> None:
        super().__init__(toy.FRAMING)
        self._owed = b"who"

    def feed(self, data: bytes) -> list[Event]:
        """Take the answer."""
        events = super().feed(data)
        self.notes = ("it says hello",) if events else ()  # type: ignore[assignment] # empty elsewhere
        return events

    def outgoing(self) -> bytes:
        """Ask once."""
        owed, self._owed = self._owed, b""
        return owed


async def test_a_protocol_may_say_how_it_is_asked() -> None:
    async with listening(toy.OTHER) as (controller, port):
        (finding,) = await ask([at(port, probe=Asking, request=None, rate_hz=None, outgoing=(b"who",))])
    assert (finding.verdict, finding.reason) == (Verdict.SPEAKS, "it says hello")
    assert controller.heard == [b"who"]


class Ways(msgspec.Struct, frozen=True):
    """Options with a choice of the transport."""

    transport: str = "tcp"
    period_ms: int = 8


def test_a_protocol_over_udp_too_is_asked_over_both() -> None:
    both = at(20005, "cnde", udp_port=20006, options=Ways)
    found = list(questions([Vendor(name="toy", title="Toy", protocols=(both, at(5001)))]))
    assert [(one.protocol.name, one.transport, one.port) for one in found] == [
        ("cnde", "tcp", 20005),
        ("cnde", "udp", 20006),
        ("polled", "tcp", 5001),
    ]
    assert stanza("192.0.2.1", found[0]) == (
        '[[robots]]\nname = "r1"\nvendor = "toy"\nprotocol = "cnde"\nhost = "192.0.2.1"'
    )
    assert stanza("192.0.2.1", found[1], 2).splitlines()[-2:] == ["[robots.cnde]", 'transport = "udp"']


def kilo_at(tmp_path: Path, port: int, hazard: str = "") -> Path:
    """A plugin on a port of our choice."""
    folder = tmp_path / "lima"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text(
        "import dataclasses\n"
        "from tests.core.toy import POLLED\n"
        "from gateway.api.vendor import Vendor\n"
        f"protocol = dataclasses.replace(POLLED, port={port}, hazard={hazard!r})\n"
        "VENDOR = Vendor(name='lima', title='Lima', protocols=(protocol,))\n"
    )
    return tmp_path


async def run(*arguments: str) -> tuple[int, str, str]:
    result = await anyio.to_thread.run_sync(lambda: CliRunner().invoke(app, ["probe", *arguments]))
    return result.exit_code, result.stdout, result.stderr


async def test_the_command_prints_the_stanza_and_nothing_else_on_stdout(tmp_path: Path) -> None:
    async with listening(toy.frame()) as (_, port):
        folder = str(kilo_at(tmp_path / "v", port))
        code, out, err = await run("127.0.0.1", "--vendor-dir", folder, "--vendor", "lima")
    assert code == 0, err
    assert out == '[[robots]]\nname = "r1"\nvendor = "lima"\nprotocol = "polled"\nhost = "127.0.0.1"\n\n'
    assert "found: 127.0.0.1 port" in err


async def test_the_command_says_why_before_it_does_what_may_harm(tmp_path: Path) -> None:
    async with listening(toy.frame()) as (controller, port):
        arguments = ("127.0.0.1", "--vendor-dir", str(kilo_at(tmp_path / "v", port, "it may stop")), "--vendor", "lima")
        code, out, err = await run(*arguments)
        assert (code, out, controller.connections) == (1, "", 0)
        assert "it may stop" in err
        assert "--allow-legacy" in err
        code, out, err = await run(*arguments, "--allow-legacy")
    assert code == 0
    assert err.index("danger:") < err.index("found:")
    assert "[[robots]]" in out


@pytest.mark.parametrize("arguments", [["http://x"], ["127.0.0.1", "--vendor", "nobody"]])
async def test_wrong_usage_is_named(arguments: list[str]) -> None:
    code, _, err = await run(*arguments)
    assert code == 2
    assert "HOST" in err or "nobody" in err


def test_a_question_knows_its_port_and_without_a_port_there_is_none() -> None:
    both = dataclasses.replace(toy.VENDOR, protocols=(at(7, udp_port=8, options=Ways), at(None)))
    assert [(one.transport, one.port) for one in questions([both])] == [("tcp", 7), ("udp", 8)]
