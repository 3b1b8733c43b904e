"""`robot-gateway health`: an exit code for supervisors, from whatever answers on the configured address."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from tests.cli.command import command, command_here, running_cell


@contextmanager
def answering(status: int, body: bytes) -> Iterator[tuple[str, list[str]]]:
    """An HTTP server with one answer to everything; gives its URL and the paths that it was asked for."""
    asked: list[str] = []

    class _Fake(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            self.send_response(status)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002
            pass

    with HTTPServer(("127.0.0.1", 0), _Fake) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}", asked
        finally:
            server.shutdown()
            thread.join()


async def test_a_gateway_that_lives_is_told_with_exit_code_0() -> None:
    async with running_cell() as gateway:
        url = f"http://127.0.0.1:{gateway.port}"
        done = await command("health", "--url", url)
        assert (done.code, done.out, done.err) == (0, f"{url}: ok\n", "")
        done = await command("health", "--ready", "--url", url)
        assert (done.code, done.out) == (0, f"{url}: ready\n")


@pytest.mark.parametrize("written", ["127.0.0.1", "0.0.0.0", "localhost"])  # noqa: S104 - what may be configured
def test_the_address_comes_from_the_configuration(tmp_path: Path, written: str) -> None:
    with answering(200, b'{"status":"ok"}') as (url, asked):
        file = tmp_path / "gateway.toml"
        file.write_text(f'[server]\nlisten = "{written}:{url.rsplit(":", 1)[1]}"\n')
        assert command_here("health", cwd=tmp_path).code == 0
        assert command_here("health", "--ready", "--config", str(file)).code == 0
        assert command_here("health", env={"ROBOT_GATEWAY_CONFIG": str(file)}).code == 0
    assert asked == ["/healthz", "/readyz", "/healthz"]


def test_with_certificates_it_asks_over_tls(tmp_path: Path) -> None:
    with answering(200, b'{"status":"ok"}') as (url, asked):
        text = f'[server]\nlisten = "127.0.0.1:{url.rsplit(":", 1)[1]}"\n[server.tls]\ncertificate = "c"\nkey = "k"\n'
        (tmp_path / "gateway.toml").write_text(text)
        done = command_here("health", cwd=tmp_path)
    assert done.code == 1
    assert "https://127.0.0.1:" in done.err
    assert asked == []


def test_what_the_gateway_says_is_told_with_exit_code_1() -> None:
    with answering(503, b'{"code":"NOT_READY","message":"not tried yet: r1"}') as (url, _):
        done = command_here("health", "--ready", "--url", url)
    assert (done.code, done.err) == (1, f"error: {url}: not tried yet: r1\n")


@pytest.mark.parametrize("body", [b"", b"hello", b"[]", b'{"x":1}', b"\xff"])
def test_something_else_on_the_port_is_no_gateway(body: bytes) -> None:
    with answering(404, body) as (url, _):
        done = command_here("health", "--url", url)
    assert (done.code, done.err) == (1, f"error: {url}: HTTP status 404, which is not a gateway's answer\n")


def test_no_answer_is_told_with_exit_code_1() -> None:
    done = command_here("health", "--url", "http://127.0.0.1:1")
    assert done.code == 1
    assert "no answer" in done.err


@pytest.mark.parametrize("text", ["[server", "server = 1", "[server]\nlisten = 5", '[server]\nlisten = "x"'])
def test_a_broken_configuration_is_told_and_is_not_healthy(tmp_path: Path, text: str) -> None:
    (tmp_path / "gateway.toml").write_text(text)
    done = command_here("health", cwd=tmp_path)
    assert done.code == 1
    assert "where the gateway listens is not known" in done.err
    assert "Traceback" not in done.err


@pytest.mark.parametrize("url", ["x", "ws://127.0.0.1:8765", "http://", "http://h:99999"])
def test_an_address_that_is_none_is_wrong_usage(url: str) -> None:
    assert command_here("health", "--url", url).code == 2
