"""The client and a gateway that asks for a token: it is let in, or told what to do; and no word of it is ever shown."""

from __future__ import annotations

import ssl
import traceback
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import aiohttp
import anyio
import pytest
import yarl
from aiohttp import web
from aiohttp.client_reqrep import ConnectionKey
from multidict import CIMultiDict, CIMultiDictProxy

from gateway.client import ClientError, Connected, Disconnected, RequestError, TrustError, connect, follow, trusting
from gateway.client.way import Way, bare, failure, way_to
from gateway.server.cell import Cell
from gateway.server.http import listening
from gateway.server.settings import DoorSettings
from gateway.testing.cell import free_port
from tests.client.secured import ALL, ONLY_R1, WRONG, asking, certificate, needs_openssl
from tests.client.test_following import at_once
from tests.server.kit import cell, publish

URL = "ws://127.0.0.1:8765/ws"


@asynccontextmanager
async def doors(settings: DoorSettings, port: int = 0) -> AsyncIterator[str]:
    """The doors of a gateway with the robots r1 and r2; yields the address of the native one."""
    bus, robots = cell("r1", "r2")
    publish(bus, "r1/joints", 1)
    async with listening(Cell(robots, bus), "127.0.0.1", port, settings) as one:
        yield f"{'ws' if settings.tls is None else 'wss'}://127.0.0.1:{one.port}/ws"


def told(error: BaseException) -> str:
    """Everything that is shown of an error."""
    return "".join(traceback.format_exception(error)) + repr(error) + repr(vars(error)) + repr(error.__context__)


async def test_a_token_lets_in_and_shows_what_it_may_read() -> None:
    async with doors(asking()) as url:
        async with connect(url, token=ALL) as client:
            assert client.welcome.access == "tokens"
            assert client.welcome.robots == ["r1", "r2"]
        async with connect(url, token=ONLY_R1) as client:
            assert [robot.name for robot in await client.robots()] == ["r1"]
            assert await client.subscribe(["*"]) == ["r1/joints", "r1/link"]
            with pytest.raises(RequestError, match="no topic matches r2/joints"):
                await client.subscribe(["r2/joints"])
        async with follow(url, token=ONLY_R1, delays=at_once) as follower:
            assert isinstance(await anext(follower), Connected)


async def test_a_token_in_the_address_is_said_in_the_header_instead() -> None:
    asked: list[str] = []

    async def refuse(request: web.Request) -> web.Response:
        asked.append(f"{request.path_qs} {request.headers.get('Authorization')}")
        return web.Response(status=401)

    app = web.Application()
    app.router.add_get("/ws", refuse)
    runner = web.AppRunner(app)
    await runner.setup()
    try:
        site = web.TCPSite(runner, "127.0.0.1", 0)
        await site.start()
        base = f"ws://127.0.0.1:{runner.addresses[0][1]}/ws"
        for query in (f"?token={WRONG}", f"?topics=*/joints&token={WRONG}", f"?token={WRONG}&topics=*/joints"):
            with pytest.raises(ClientError) as refused:
                async with connect(base + query):
                    pass
            assert WRONG not in told(refused.value)
    finally:
        await runner.cleanup()
    said = f"Bearer {WRONG}"
    assert asked == [f"/ws {said}", f"/ws?topics=*/joints {said}", f"/ws?topics=*/joints {said}"]


@pytest.mark.parametrize(
    ("token", "says"), [(None, "asks for a token.*--token-file"), (WRONG, "does not know this token.*token hash")]
)
async def test_who_is_not_let_in_is_told_what_to_do_and_the_token_is_not_shown(token: str | None, says: str) -> None:
    async with doors(asking()) as url:
        with pytest.raises(ClientError, match=says) as refused:
            async with connect(url, token=token):
                pass
        assert refused.value.lasting
        with pytest.raises(ClientError, match=says):  # however patient: it would be of no use
            async with follow(url, token=token, delays=at_once):
                pass
    assert WRONG not in told(refused.value)


@pytest.mark.parametrize("token", ["", "rgw_a b", "rgw_a\r\nX: y", "rgw_ä"])
async def test_what_cannot_be_a_token_is_not_even_sent(token: str) -> None:
    with pytest.raises(ClientError, match="a token is one word") as refused:
        async with connect(URL, token=token):
            pass
    assert not token or token not in told(refused.value)


async def test_a_token_that_is_withdrawn_is_told_and_asked_for_again() -> None:
    port = free_port()
    async with doors(asking(), port) as url:
        manager = follow(url, token=ALL, delays=at_once)
        follower = await manager.__aenter__()
        assert isinstance(await anext(follower), Connected)
    try:
        async with doors(asking(without=ALL), port):
            with anyio.fail_after(5):
                while "does not know this token" not in (item := await anext(follower)).reason:  # type: ignore[union-attr]
                    assert isinstance(item, Disconnected)
        async with doors(asking(), port):
            with anyio.fail_after(5):
                while not isinstance(await anext(follower), Connected):
                    pass
    finally:
        await manager.__aexit__(None, None, None)
    assert ALL not in repr(follower)


async def test_a_name_that_the_gateway_does_not_have_says_so() -> None:
    async with doors(DoorSettings()) as url:
        port = url.rsplit(":", 1)[1]
        connector = aiohttp.TCPConnector(resolver=_Here())
        async with aiohttp.ClientSession(connector=connector) as session:
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                await session.ws_connect(f"ws://cell-7.example:{port}")
    assert "allowed_hosts" in str(failure(Way("ws://cell-7.example/ws"), refused.value))


class _Here(aiohttp.abc.AbstractResolver):
    """Finds every name on this machine."""

    async def resolve(self, host: str, port: int = 0, family: int = 0) -> list[aiohttp.abc.ResolveResult]:
        """This machine's address."""
        return [{"hostname": host, "host": "127.0.0.1", "port": port, "family": family, "proto": 0, "flags": 0}]

    async def close(self) -> None:
        """Nothing is open."""


@needs_openssl
async def test_a_self_signed_certificate_is_trusted_when_it_is_named(tmp_path: Path) -> None:
    files = certificate(tmp_path)
    async with doors(asking(files)) as url:
        async with connect(url, token=ALL, ssl=trusting(files.certificate)) as client:
            assert client.welcome.robots == ["r1", "r2"]
        with pytest.raises(ClientError, match=r"nobody whom this machine trusts.*--ca FILE") as refused:
            async with connect(url, token=ALL):
                pass
        assert refused.value.lasting
        assert ALL not in told(refused.value)


@needs_openssl
async def test_a_certificate_for_another_name_says_so(tmp_path: Path) -> None:
    files = certificate(tmp_path, "DNS:cell-7.example")
    async with doors(asking(files)) as url:
        with pytest.raises(ClientError, match="certificate is for another name"):
            async with connect(url, token=ALL, ssl=trusting(files.certificate)):
                pass


@needs_openssl
async def test_plain_words_to_a_port_that_speaks_tls_say_which_address_to_take(tmp_path: Path) -> None:
    async with doors(asking(certificate(tmp_path))) as url:
        with pytest.raises(ClientError, match="If it speaks TLS, write wss:// instead of ws://"):
            async with connect(url.replace("wss://", "ws://"), token=ALL):
                pass


async def test_tls_to_a_port_that_does_not_speak_it_says_which_address_to_take() -> None:
    async with doors(asking()) as url:
        with pytest.raises(ClientError, match="use ws:// instead of wss://"):
            async with connect(url.replace("ws://", "wss://"), token=ALL):
                pass


@pytest.mark.parametrize(
    ("code", "says"),
    [
        (10, "its certificate has expired: renew it"),
        (9, "not valid yet: see whether this machine's clock"),
        (18, "name who has by --ca FILE"),
        (62, "for another name"),
        (64, "for another name"),
        (79, "cannot be trusted: why"),
    ],
)
def test_each_fault_of_a_certificate_has_its_words(code: int, says: str) -> None:
    fault = ssl.SSLCertVerificationError(1, "why")
    fault.verify_code = code
    fault.verify_message = "why"
    key = ConnectionKey("cell-7", 443, True, True, None, None, None)  # noqa: FBT003 - aiohttp's own
    error = aiohttp.ClientConnectorCertificateError(key, fault)
    assert says in str(failure(Way(URL), error))


@pytest.mark.parametrize(
    ("status", "says"), [(429, r"[server.limits]"), (503, r"[server.limits]"), (500, "status 500")]
)
def test_other_refusals_have_their_words(status: int, says: str) -> None:
    said = CIMultiDictProxy(CIMultiDict({"Authorization": f"Bearer {WRONG}"}))
    info = aiohttp.RequestInfo(yarl.URL(URL), "GET", said)
    error = failure(Way(URL, WRONG), aiohttp.WSServerHandshakeError(info, (), status=status))
    assert says in str(error)
    assert not error.lasting
    assert WRONG not in told(error)


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        (f"{URL}?token={WRONG}", URL),
        (f"{URL}?a=b&token={WRONG}", f"{URL}?a=b"),
        (f"{URL}?token={WRONG}&a=b", f"{URL}?a=b"),
        (f"ws://me:{WRONG}@cell-7/ws", "ws://cell-7/ws"),
        (f"ws://[::1/?token={WRONG}", "ws://[::1/"),
        (URL, URL),
        (f"{URL}?", f"{URL}?"),
    ],
)
def test_an_address_is_shown_without_what_is_secret_in_it(url: str, shown: str) -> None:
    assert bare(url) == shown
    assert str(ClientError(url, "why")) == f"{shown}: why"
    assert WRONG not in repr(way_to(url.replace(f"me:{WRONG}@", "")))


@pytest.mark.parametrize(("besides", "said"), [(None, "rgw_a"), ("rgw_b", "rgw_b")])
def test_a_token_of_the_address_may_be_percent_encoded_and_one_beside_it_counts(besides: str | None, said: str) -> None:
    assert way_to(f"{URL}?token=rgw%5Fa", besides).token == said


@pytest.mark.parametrize(("text", "says"), [("no certificate", "no certificate in PEM"), (None, "No such file")])
def test_a_file_of_certificates_that_is_none_says_so(text: str | None, says: str, tmp_path: Path) -> None:
    file = tmp_path / "ca.pem"
    if text is not None:
        file.write_text(text)
    with pytest.raises(TrustError, match=says):
        trusting(file)
