"""No token, no part of one and no hash comes into a log, an answer, the metrics or a traceback, whatever goes wrong."""

from __future__ import annotations

import io
import json
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import aiohttp
import anyio
import pytest
import structlog

from gateway.api.messages import JSON_SUBPROTOCOL
from gateway.config.file import parse
from gateway.config.printing import as_toml
from gateway.errors import ConfigError
from gateway.logs import _TRACEBACK
from gateway.server.access import Access
from gateway.server.cell import Cell
from gateway.server.foxglove import SUBPROTOCOLS
from tests.server.kit import cell, publish
from tests.server.tokens import ALL, R1, TOKENS, WRONG, Browser, bearer, browsing, doors, guarded, token

SECRETS = [
    *(secret[start : start + 12] for secret in (ALL, R1, WRONG) for start in (4, 20, 34)),
    *(known.sha256.hex()[:16] for known in (*TOKENS, token("x", WRONG))),
    *(repr(known.sha256)[2:20] for known in TOKENS),
]
PATHS = [
    "/api/v1/robots",
    "/api/v1/zzz",
    "/zzz",
    "/metrics",
    "/readyz",
    "/api/v1/events?zzz=1",
    "/api/v1/stream",
    "/ws?zzz=1",
]


@contextmanager
def everything_logged() -> Iterator[io.StringIO]:
    """What the gateway and its libraries log at every level, with tracebacks, as a terminal shows it."""
    log = io.StringIO()
    handler = logging.StreamHandler(log)
    root, level = logging.getLogger(), logging.getLogger().level
    root.addHandler(handler)
    root.setLevel(logging.DEBUG)
    shown = structlog.dev.ConsoleRenderer(exception_formatter=_TRACEBACK, colors=False)
    structlog.configure(
        processors=[structlog.processors.add_log_level, shown], logger_factory=structlog.PrintLoggerFactory(file=log)
    )
    try:
        yield log
    finally:
        structlog.reset_defaults()
        root.removeHandler(handler)
        root.setLevel(level)


async def said(browser: Browser, secret: str) -> str:
    """Everything that is answered to a token in every place, with every mistake beside it."""
    heard: list[object] = []
    for path in PATHS:
        joint = "&" if "?" in path else "?"
        for where, headers in (
            (path, bearer(secret)),
            (f"{path}{joint}token={secret}", {}),
            (f"{path}{joint}token={secret}&token=2", {}),
        ):
            methods = ("GET", "HEAD", "OPTIONS", "POST")
            heard += [await browser.get(where, method=method, headers=headers) for method in methods]
            heard.append(await browser.get(where, headers={**headers, "Host": "evil.example"}))
            heard.append(await browser.get(where, headers={**headers, "Origin": "http://evil.example"}))
    for path in ("/ws", "/foxglove", "/"):
        for offered in (
            [f"bearer.{secret}"],
            [f"bearer.{secret}", "zzz"],
            [f"bearer.{secret}", JSON_SUBPROTOCOL, SUBPROTOCOLS[0]],
        ):
            try:
                async with browser.session.ws_connect(browser.base + path, protocols=offered) as socket:
                    await socket.send_str("{}")
                    heard.append(await socket.receive(1))
                    heard.append(await socket.receive(1))
                    heard.append(socket.protocol)
            except aiohttp.WSServerHandshakeError as error:
                heard.append((error.status, error.message))
    return "\n".join(map(str, heard))


async def broken(port: int, secret: str) -> str:
    """The answers to requests that are none, with a token in each."""
    heard = b""
    for raw in (
        f"GET /ws?token={secret} HTTP/9.9\r\nHost: localhost\r\n\r\n",
        f"GET /ws?token={secret}\r\n\r\n",
        f"GET /ws HTTP/1.1\r\nHost: localhost\r\nAuthorization Bearer {secret}\r\n\r\n",
        f"GET /ws HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {secret}\x00\r\n\r\n",
        f"GET /ws HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {secret}\r\nContent-Length: x\r\n\r\n",
        f"GET /ws HTTP/1.1\r\nHost: localhost\r\nBearer {secret}: \r\n\r\n",
        f"{secret} / HTTP/1.1\r\nHost: localhost\r\n\r\n",
        f"GET /ws HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {secret * 400}\r\n\r\n",
    ):
        async with await anyio.connect_tcp("127.0.0.1", port) as stream:
            await stream.send(raw.encode())
            with anyio.move_on_after(0.3):
                heard += await stream.receive()
    return heard.decode("latin-1")


class FailingCell(Cell):
    """A mistake of ours in the middle of a request."""

    def unknown_topic(self, patterns: object) -> str:  # noqa: ARG002 - as its base
        """Fail."""
        raise RuntimeError("a mistake")


@pytest.mark.limit(60)
async def test_no_secret_is_in_any_log_answer_metric_or_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    bus, robots = cell()
    publish(bus, "r1/joints", 1)
    heard = ""
    with everything_logged() as log:
        async with doors(bus, robots) as listener, browsing(listener.port) as browser:
            for secret in (ALL, R1, WRONG):
                heard += await said(browser, secret)
            monkeypatch.setattr(Access, "view", lambda *_: FailingCell(robots, bus))
            failed = await browser.get(f"/api/v1/topics/r9/joints?token={R1}")
            monkeypatch.undo()
            for robot in ("*", "r1/*"):
                socket_failed = await browser.get(f"/api/v1/stream?topics={robot}&token={WRONG}")
                heard += str(socket_failed)
            await listener.apply(guarded(TOKENS[1]), "127.0.0.1", 0)
            heard += str(failed) + (await browser.get("/metrics", R1)).text
        told = log.getvalue()
    assert failed.status == 500
    assert "a mistake" in told
    assert "subscriber.connected" in told
    assert "cell-one" in told
    for secret in SECRETS:
        assert secret not in told
        assert secret not in heard


async def test_requests_that_are_none_put_no_token_into_the_log() -> None:
    with everything_logged() as log:
        async with doors(*cell()) as listener:
            await broken(listener.port, ALL)
        told = log.getvalue()
    for secret in SECRETS:
        assert secret not in told


def test_no_secret_is_in_what_is_printed_of_a_configuration(tmp_path: Path) -> None:
    path = tmp_path / "tokens.toml"
    tables = "".join(f'[[tokens]]\nname = "{one.name}"\nsha256 = "{one.sha256.hex()}"\n' for one in TOKENS)
    path.write_text(tables)
    path.chmod(0o600)
    config = parse('[server]\ntokens = "tokens.toml"\n', "g.toml", folder=tmp_path)
    printed = as_toml(config) + "\n".join(config.warnings) + json.dumps([token.name for token in config.tokens or ()])
    path.write_text(f"{tables}{ALL}\n")
    with pytest.raises(ConfigError) as error:
        parse('[server]\ntokens = "tokens.toml"\n', "g.toml", folder=tmp_path)
    for secret in SECRETS:
        assert secret not in printed + str(error.value)
