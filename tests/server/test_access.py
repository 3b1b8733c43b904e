"""Who may talk to the doors: tokens, Host and Origin, and what becomes of those who may not any longer."""

from __future__ import annotations

import dataclasses
import time

import aiohttp
import anyio
import pytest
import structlog
from yarl import URL

from gateway.api.messages import JSON_SUBPROTOCOL
from gateway.server import pages
from gateway.server.access import Access, Caller, is_own
from gateway.server.foxglove import SUBPROTOCOLS
from gateway.server.http import _ROUTES
from gateway.server.refusals import MOST_KINDS, Refusals
from gateway.server.settings import AccessSettings, DoorSettings
from tests.server.kit import Now, cell, publish, running_door
from tests.server.tokens import ALL, PLENTY, R1, TOKENS, WRONG, bearer, browsing, doors, guarded, token

PUBLIC = ["/", "/healthz", "/readyz", *(f"/{name}" for name in pages.load())]
PRIVATE = [
    path.replace("{name}", "r1").replace("{topic:.+}", "r1/link") for path in _ROUTES if path not in set(PUBLIC)
] + ["/zzz", "/api/v1/robots/none"]
SOCKETS = [("/ws", JSON_SUBPROTOCOL), ("/foxglove", SUBPROTOCOLS[0]), ("/", SUBPROTOCOLS[0])]
ON_SOCKETS = pytest.mark.parametrize(("path", "protocol"), SOCKETS)


async def refusal(port: int, path: str, protocol: str, headers: dict[str, str]) -> int:
    """Shake hands byte by byte; the status of the answer."""
    key = "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
    own = {"Host": f"127.0.0.1:{port}", "Sec-WebSocket-Protocol": protocol, **headers}
    lines = "".join(f"{name}: {value}\r\n" for name, value in own.items())
    async with await anyio.connect_tcp("127.0.0.1", port) as stream:
        await stream.send(
            f"GET {path} HTTP/1.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n{key}{lines}\r\n".encode()
        )
        return int((await stream.receive()).split(b" ", 2)[1])


@ON_SOCKETS
async def test_a_websocket_takes_the_token_from_each_of_the_three_places(path: str, protocol: str) -> None:
    async with doors(*cell()) as listener, browsing(listener.port) as browser:
        async with browser.websocket(path, protocol, headers=bearer(ALL)) as socket:
            assert (await socket.receive()).type is aiohttp.WSMsgType.TEXT
        async with browser.websocket(path, f"bearer.{ALL}", protocol) as socket:
            assert (await socket.receive()).type is aiohttp.WSMsgType.TEXT
            assert socket.protocol == protocol
        async with browser.websocket(f"{path}?token={ALL}&topics=*/joints", protocol) as socket:
            assert (await socket.receive()).type is aiohttp.WSMsgType.TEXT


async def test_over_http_the_token_may_stand_in_the_header_or_the_url_beside_other_parameters() -> None:
    bus, robots = cell()
    publish(bus, "r1/joints", 1)
    async with doors(bus, robots) as listener, browsing(listener.port) as browser:
        for path in PRIVATE:
            if path in {"/ws", "/foxglove"}:
                continue
            allowed = await browser.get(path, ALL)
            assert allowed.status != 401, path
        for path in ("/api/v1/topics/r1/joints?fields=position&token=", "/api/v1/stream?topics=r1/*&token="):
            assert (await browser.get(f"{path}{ALL}")).status == 200
            assert (await browser.get(f"{path}{WRONG}")).status == 401


@pytest.mark.parametrize(
    "headers", [{}, bearer(WRONG), {"Authorization": "Basic Zm9v"}, bearer("x" * 8000), bearer("")]
)
async def test_without_a_known_token_nothing_but_the_page_and_the_probes_is_answered(headers: dict[str, str]) -> None:
    async with doors(*cell()) as listener, browsing(listener.port) as browser:
        for path in PRIVATE:
            answer = await browser.get(path, headers=headers)
            assert (answer.status, '"UNAUTHORIZED"' in answer.text) == (401, True), path
            assert answer.headers["WWW-Authenticate"].startswith("Bearer")
        for path in PUBLIC:
            assert (await browser.get(path, headers=headers)).status in {200, 503}, path
        for path, protocol in SOCKETS:
            assert await refusal(listener.port, path, protocol, headers) == 401


async def test_where_no_token_is_configured_one_that_is_sent_all_the_same_does_no_harm() -> None:
    async with doors(*cell(), DoorSettings(limits=PLENTY)) as listener, browsing(listener.port) as browser:
        assert (await browser.get(f"/api/v1/robots?token={ALL}")).status == 200
        assert (await browser.get("/api/v1/robots", ALL)).status == 200
        async with browser.websocket("/ws", f"bearer.{ALL}", JSON_SUBPROTOCOL) as socket:
            assert (await socket.receive_json())["access"] == "loopback"


async def test_a_token_that_is_no_text_is_a_wrong_one() -> None:
    async with doors(*cell()) as listener, browsing(listener.port) as browser:
        for query in ("token=%ff%fe", f"token={ALL}&token={WRONG}&topics=%ff", "token="):
            async with browser.session.get(URL(f"{browser.base}/api/v1/robots?{query}", encoded=True)) as answer:
                assert answer.status in {400, 401}, query
        for bad in (b"\xff\xfe", b"bearer.\xff, robot-gateway.v1+json"):
            raw = b"GET /ws HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer \xff\xff\r\n"
            async with await anyio.connect_tcp("127.0.0.1", listener.port) as stream:
                await stream.send(raw + b"Sec-WebSocket-Protocol: " + bad + b"\r\n\r\n")
                assert (await stream.receive()).split(b" ", 2)[1] in {b"400", b"401"}


async def test_who_asks_for_readiness_without_a_token_learns_no_name() -> None:
    bus, robots = cell("r1", "r2")
    bus.add("r9", ["link"])
    async with doors(bus, robots) as listener, browsing(listener.port) as browser:
        assert "r1" not in (await browser.get("/readyz")).text


@pytest.mark.parametrize("headers", [{}, bearer(ALL)])
@ON_SOCKETS
async def test_a_page_on_another_origin_cannot_open_a_websocket(
    path: str, protocol: str, headers: dict[str, str]
) -> None:
    for settings in (guarded(origins=("https://friend.example",)), DoorSettings(limits=PLENTY)):
        async with doors(*cell(), settings) as listener:
            for origin in (
                "http://evil.example",
                "null",
                f"http://127.0.0.1:{listener.port + 1}",
                "https://x.friend.example",
            ):
                assert await refusal(listener.port, path, protocol, {"Origin": origin, **headers}) == 403
            opened = 101 if settings.access.tokens is None or headers else 401
            own = f"http://127.0.0.1:{listener.port}"
            assert await refusal(listener.port, path, protocol, {"Origin": own, **headers}) == opened


async def test_a_page_that_is_allowed_reads_with_its_token_and_the_browser_is_told_so() -> None:
    friend = "https://friend.example:8443"
    async with doors(*cell(), guarded(origins=(friend,))) as listener, browsing(listener.port) as browser:
        asked = {"Access-Control-Request-Method": "GET", "Access-Control-Request-Headers": "authorization"}
        before = await browser.get("/api/v1/robots", method="OPTIONS", headers={"Origin": friend, **asked})
        assert before.status == 204
        assert "Authorization" in before.headers["Access-Control-Allow-Headers"]
        answers = [await browser.get("/api/v1/robots", secret, headers={"Origin": friend}) for secret in (ALL, None)]
        assert [answer.status for answer in answers] == [200, 401]
        for answer in (before, *answers):
            assert answer.headers["Access-Control-Allow-Origin"] == friend
            assert answer.headers["Vary"] == "Origin"
            assert answer.headers["Cross-Origin-Resource-Policy"] == "cross-origin"
        own = await browser.get("/api/v1/robots", ALL)
        assert "Access-Control-Allow-Origin" not in own.headers
        assert (own.headers["Vary"], own.headers["Cross-Origin-Resource-Policy"]) == ("Origin", "same-origin")
        stranger = await browser.get("/api/v1/robots", method="OPTIONS", headers={"Origin": "https://x", **asked})
        assert (stranger.status, "Access-Control-Allow-Origin" in stranger.headers) == (403, False)
        async with browser.websocket("/ws", f"bearer.{R1}", JSON_SUBPROTOCOL, headers={"Origin": friend}) as socket:
            assert (await socket.receive_json())["op"] == "welcome"


async def test_with_a_star_every_page_may_read_that_has_a_token() -> None:
    async with doors(*cell(), guarded(origins=("*",))) as listener, browsing(listener.port) as browser:
        for origin in ("https://any.example", "null"):
            answer = await browser.get("/api/v1/robots", ALL, headers={"Origin": origin})
            assert (answer.status, answer.headers["Access-Control-Allow-Origin"]) == (200, origin)


async def test_behind_a_proxy_that_takes_tls_off_the_page_has_the_name_that_was_allowed() -> None:
    settings = guarded(hosts=("cell.example.com",))
    own = {"Host": "cell.example.com", "Origin": "https://cell.example.com"}
    async with doors(*cell(), settings) as listener, browsing(listener.port) as browser:
        assert (await browser.get("/api/v1/robots", ALL, headers=own)).status == 200
        assert (
            await browser.get("/api/v1/robots", ALL, headers={**own, "Host": "CELL.example.com.:443"})
        ).status == 403
        assert (await browser.get("/api/v1/robots", ALL, headers={"Host": "CELL.example.com.:443"})).status == 200
        assert (await browser.get("/api/v1/robots", ALL, headers={"Host": "evil.example.com"})).status == 403


def test_a_page_that_came_in_the_clear_is_not_our_own_where_the_gateway_speaks_tls() -> None:
    assert is_own("https://cell.example.com", "cell.example.com:443", tls=True)
    assert not is_own("http://cell.example.com", "cell.example.com", tls=True)
    assert is_own("http://cell.example.com", "cell.example.com:80")
    assert not is_own("http://cell.example.com:443", "cell.example.com:80")


def test_of_several_tokens_each_is_known_and_nothing_longer_or_near() -> None:
    access = Access(guarded().access)
    assert access.known(ALL) == Caller("hmi", None, TOKENS[0].sha256)
    assert access.known(R1) == Caller("cell-one", ("r1/*",), TOKENS[1].sha256)
    for wrong in ("", ALL[:-1], f"{ALL}x", f" {ALL}", ALL.upper(), "x" * 100_000, "\udcff"):
        assert access.known(wrong) is None
    assert "sha" not in repr(access.known(ALL))
    assert TOKENS[0].sha256.hex()[:6] not in repr(access.known(ALL))


def test_where_tokens_are_needed_and_there_are_none_nobody_comes_in() -> None:
    access = Access(AccessSettings(tokens=()))
    assert access.mode == "tokens"
    assert access.known("") is None
    assert not access.is_current(Caller(None, None))


async def test_who_reads_everything_has_the_cell_itself_and_pays_for_no_view() -> None:
    async with doors(*cell()) as listener:
        whole = object()
        access = Access(guarded().access)
        caller = access.known(ALL)
        assert caller is not None
        assert access.view(whole, caller) is whole  # type: ignore[arg-type] # any cell
        assert listener.port


async def test_the_log_says_who_has_come_and_why_others_were_turned_away() -> None:
    with structlog.testing.capture_logs() as logs:
        async with doors(*cell()) as listener, browsing(listener.port) as browser:
            async with browser.websocket("/ws", headers=bearer(R1)) as socket:
                await socket.receive()
            await browser.get(f"/api/v1/stream?topics=r1/*&token={ALL}")
            for _ in range(5):
                await browser.get("/api/v1/robots", WRONG)
                await browser.get("/api/v1/robots")
                await browser.get("/healthz", headers={"Host": "evil.example"})
    came = [line for line in logs if line["event"] == "subscriber.connected"]
    assert [(line["subscriber"], line["log_level"]) for line in came] == [("cell-one", "info"), ("hmi", "info")]
    refused = [line for line in logs if line["event"] == "request.refused"]
    assert [line["peer"] for line in refused] == ["127.0.0.1"] * 3
    assert "evil.example" in refused[2]["reason"]


async def test_refusals_are_counted_by_reason_in_the_metrics() -> None:
    async with doors(*cell()) as listener, browsing(listener.port) as browser:
        await browser.get("/api/v1/robots", WRONG)
        await browser.get("/healthz", WRONG)
        await browser.get("/api/v1/robots")
        await browser.get("/healthz", headers={"Host": "evil.example"})
        await browser.get("/healthz", headers={"Origin": "http://evil.example"})
        text = (await browser.get("/metrics", ALL)).text
    for reason, count in {"token": 2, "no_token": 1, "host": 1, "origin": 1}.items():
        assert f'robot_gateway_refused_total{{reason="{reason}"}} {count}.0' in text


def test_a_refusal_that_repeats_is_said_once_a_minute_with_how_often_it_was_left_out() -> None:
    now = Now()
    refusals = Refusals(now)
    with structlog.testing.capture_logs() as logs:
        for _ in range(10):
            refusals.add("token", "192.0.2.1", "no")
        now.at_s += 61
        refusals.add("token", "192.0.2.1", "no")
    assert [line.get("n_dropped") for line in logs] == [None, 9]


def test_however_many_addresses_try_the_log_and_the_memory_stay_bounded() -> None:
    now = Now()
    refusals = Refusals(now)
    with structlog.testing.capture_logs() as logs:
        for number in range(20_000):
            refusals.add("token", f"2001:db8::{number:x}", "no")
    assert len(logs) == len(refusals) == MOST_KINDS
    assert refusals.counts["token"] == 20_000
    now.at_s += 61
    with structlog.testing.capture_logs() as logs:
        refusals.add("token", "2001:db9::1", "no")
    assert (len(logs), len(refusals)) == (1, 1)


async def pipelined(port: int, secret: str, count: int) -> float:
    """Ask so often over one connection; the CPU time of an answer, ours included, in s."""
    ask = f"GET /api/v1/robots HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {secret}\r\n\r\n".encode()
    begun_s = time.process_time()
    async with await anyio.connect_tcp("127.0.0.1", port) as stream:
        for _ in range(count // 10):
            await stream.send(ask * 10)
            answers = b""
            while answers.count(b"HTTP/1.1 ") < 10 or not answers.endswith(b"}"):
                answers += await stream.receive()
    return (time.process_time() - begun_s) / count


@pytest.mark.limit(90)
async def test_ten_thousand_wrong_tokens_cost_little_and_are_counted() -> None:
    async with doors(*cell()) as listener, browsing(listener.port) as browser:
        healthy_s = await pipelined(listener.port, ALL, 500)
        wrong_s = await pipelined(listener.port, WRONG, 9_000)
        long_s = await pipelined(listener.port, "x" * 4000, 1_000)
        text = (await browser.get("/metrics", ALL)).text
    assert 'robot_gateway_refused_total{reason="token"} 10000.0' in text
    print(f"healthy {healthy_s * 1e6:.0f} µs, wrong {wrong_s * 1e6:.0f} µs, long {long_s * 1e6:.0f} µs")
    assert wrong_s < 3 * healthy_s
    assert long_s < 4 * healthy_s


async def test_who_has_lost_the_token_or_a_part_of_its_scope_is_sent_away_and_others_stay() -> None:
    third = "rgw_" + "third-one_" * 4 + "abc"
    before = guarded(*TOKENS, token("view", third, "*/joints"))
    bus, robots = cell()
    async with doors(bus, robots, before) as listener, browsing(listener.port) as browser:
        async with (
            browser.websocket("/ws", headers=bearer(ALL)) as stays,
            browser.websocket("/ws", headers=bearer(R1)) as gone,
            browser.websocket("/foxglove", SUBPROTOCOLS[0], headers=bearer(third)) as narrowed,
            browser.session.get(f"{browser.base}/api/v1/stream?topics=*&token={R1}") as stream,
        ):
            after = guarded(TOKENS[0], token("view", third, "r1/joints"))
            await listener.apply(after, "127.0.0.1", 0)
            for socket in (gone, narrowed):
                while (await socket.receive()).type != aiohttp.WSMsgType.CLOSE:
                    pass
                assert socket.close_code == 1008
            assert b": token revoked" in await stream.content.read()
            await stays.receive()
            await stays.send_json({"op": "ping", "id": 1})
            assert (await stays.receive_json())["id"] == 1
        assert (await browser.get("/api/v1/robots", R1)).status == 401
        assert (await browser.get("/api/v1/robots", third)).status == 200
        swapped = dataclasses.replace(TOKENS[0], sha256=token("x", WRONG).sha256)
        async with browser.websocket("/ws", headers=bearer(ALL)) as socket:
            await listener.apply(guarded(swapped), "127.0.0.1", 0)
            await socket.receive()
            assert (await socket.receive()).type is aiohttp.WSMsgType.CLOSE
        assert (await browser.get("/api/v1/robots", WRONG)).status == 200


async def test_everybody_is_let_in_where_it_is_said_out_loud_and_the_log_repeats_it() -> None:
    settings = DoorSettings(access=AccessSettings(insecure=True), limits=PLENTY)
    with structlog.testing.capture_logs() as logs:
        async with doors(*cell(), settings) as listener, browsing(listener.port) as browser:
            assert '"access":"insecure"' in (await browser.get("/api/v1/robots")).text
            async with browser.websocket() as socket:
                assert (await socket.receive_json())["access"] == "insecure"
    assert [line["event"] for line in logs if line["log_level"] == "warning"] == ["doors.insecure"]


async def test_a_health_check_that_speaks_http_1_0_and_names_no_host_is_answered() -> None:
    bus, robots = cell("r1")
    async with running_door(bus, robots) as url, await anyio.connect_tcp("127.0.0.1", URL(url).port or 0) as stream:
        await stream.send(b"GET /healthz HTTP/1.0\r\n\r\n")
        assert (await stream.receive()).split(b"\r\n")[0].endswith(b" 200 OK")
