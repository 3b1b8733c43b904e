"""TLS of the listener: what is shown, and that a renewed certificate takes its place while clients stay."""

from __future__ import annotations

import asyncio
import ssl
import time
from pathlib import Path

import aiohttp
import anyio
import pytest
import structlog

from gateway.config.certificates import CertificateError, TlsFiles, load_certificate
from gateway.server.settings import DoorSettings
from gateway.server.tls import Tls
from tests.server.certificates import certificate
from tests.server.kit import cell
from tests.server.tokens import ALL, Browser, bearer, doors, guarded

DAY_S = 86400


def trusting(files: TlsFiles) -> ssl.SSLContext:
    """A client that trusts one certificate."""
    return ssl.create_default_context(cafile=str(files.certificate))


async def name_shown(port: int) -> str:
    """The common name of the certificate that a client is shown that names no server."""
    context = ssl.create_default_context()
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    _, writer = await asyncio.open_connection("127.0.0.1", port, ssl=context, server_hostname="")
    der = writer.get_extra_info("ssl_object").getpeercert(binary_form=True)
    writer.close()
    await writer.wait_closed()
    return next(name for name in ("first", "second") if name.encode() in der)


async def test_every_door_is_there_over_tls_and_nothing_in_the_clear(tmp_path: Path) -> None:
    files = certificate(tmp_path)
    async with doors(*cell(), guarded(tls=files)) as listener:
        connector = aiohttp.TCPConnector(ssl=trusting(files))
        async with aiohttp.ClientSession(connector=connector) as session:
            browser = Browser(session, listener.port, "https")
            answer = await browser.get("/api/v1/robots", ALL)
            assert answer.status == 200
            assert "Strict-Transport-Security" not in answer.headers
            async with browser.websocket(headers={**bearer(ALL), "Origin": browser.base}) as socket:
                assert (await socket.receive_json())["op"] == "welcome"
            http = {**bearer(ALL), "Origin": browser.base.replace("https", "http")}
            assert (await browser.get("/api/v1/robots", headers=http)).status == 403
            with pytest.raises(aiohttp.ClientError):
                await Browser(session, listener.port).get("/healthz")


async def test_old_versions_of_tls_are_refused_and_cost_the_log_no_traceback(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    files = certificate(tmp_path)
    async with doors(*cell(), guarded(tls=files)) as listener:
        old = trusting(files)
        old.set_ciphers("ALL:@SECLEVEL=0")
        with pytest.warns(DeprecationWarning, match="TLSv1_1"):
            old.maximum_version = ssl.TLSVersion.TLSv1_1
        with pytest.raises((ssl.SSLError, anyio.BrokenResourceError, OSError)):
            await anyio.connect_tcp("127.0.0.1", listener.port, tls=True, ssl_context=old)
        for rubbish in (b"GET / HTTP/1.1\r\n\r\n", b"\x16\x03\x01", b"\x00" * 500):
            async with await anyio.connect_tcp("127.0.0.1", listener.port) as stream:
                await stream.send(rubbish)
        await anyio.sleep(0.05)
    assert not [record for record in caplog.records if record.levelname in {"ERROR", "CRITICAL"}]


async def test_a_renewed_certificate_is_shown_to_the_next_client_and_costs_nobody_the_connection(
    tmp_path: Path,
) -> None:
    files = certificate(tmp_path, "first")
    later = certificate(tmp_path, "second")
    async with doors(*cell(), guarded(tls=files)) as listener:
        connector = aiohttp.TCPConnector(ssl=trusting(files))
        async with aiohttp.ClientSession(connector=connector) as session:
            browser = Browser(session, listener.port, "https")
            async with browser.websocket(headers=bearer(ALL)) as socket:
                await socket.receive()
                assert await name_shown(listener.port) == "first"
                await listener.apply(guarded(tls=later), "127.0.0.1", 0)
                assert await name_shown(listener.port) == "second"
                await socket.send_json({"op": "ping", "id": 1})
                assert (await socket.receive_json())["id"] == 1


def test_changed_files_are_taken_and_a_broken_pair_leaves_the_old_one_and_is_told_once(tmp_path: Path) -> None:
    files = certificate(tmp_path, "first", days=30)
    tls = Tls(files)
    was, context = tls.expires, tls.context
    with structlog.testing.capture_logs() as logs:
        tls.look()
        assert not logs
        good = files.key.read_bytes()
        files.key.write_bytes(certificate(tmp_path, "second").key.read_bytes())
        tls.look()
        tls.look()
    assert [line["event"] for line in logs] == ["certificate.refused"]
    assert "is not the key of the certificate" in logs[0]["reason"]
    assert (tls.expires, logs[0]["log_level"]) == (was, "error")
    with structlog.testing.capture_logs() as logs:
        files.key.write_bytes(good)
        tls.look()
        certificate(tmp_path, "first", days=90)
        tls.look()
    assert [line["event"] for line in logs] == ["certificate.loaded"] * 2
    assert was is not None
    assert tls.expires is not None
    assert tls.expires > was
    assert tls.context is context


def test_an_end_that_is_near_is_said_once_a_day(tmp_path: Path) -> None:
    files = certificate(tmp_path, days=20)
    now = [time.time()]
    tls = Tls(files, lambda: now[0])
    with structlog.testing.capture_logs() as logs:
        for days in (0, 7, 7.1, 8.1, 21):
            now[0] = time.time() + days * DAY_S
            tls.look()
    assert [line["reason"].split(";")[0] for line in logs] == [
        "it expires in 13 days",
        "it expires in 12 days",
        "it has expired: clients refuse it",
    ]


def test_tls_can_end_and_begin_again(tmp_path: Path) -> None:
    files = certificate(tmp_path)
    tls = Tls(None)
    tls.look()
    contexts = [tls.context]
    for told in (files, None, files):
        assert tls.reload(told)
        contexts.append(tls.context)
    assert [context is None for context in contexts] == [True, False, True, False]
    assert not tls.reload(TlsFiles(tmp_path / "none", files.key))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda files: files.key.unlink(), "cell.key: does not exist; put the key there"),
        (lambda files: files.certificate.write_text("x"), "cell.crt: holds no certificate in PEM"),
        (lambda files: files.key.write_text("x"), "cell.key: holds no key in PEM"),
        (lambda files: files.key.write_text("-----BEGIN ENCRYPTED PRIVATE KEY-----\n"), "the key has a password"),
        (lambda files: files.key.write_text("-----BEGIN PRIVATE KEY-----\nAAAA\n"), "cannot be used"),
        (
            lambda files: files.certificate.write_text(
                "-----BEGIN CERTIFICATE-----\nMAAA\n-----END CERTIFICATE-----\n"
            ),
            "cannot be used",
        ),
    ],
)
def test_files_that_cannot_be_used_say_why(tmp_path: Path, change: object, said: str) -> None:
    files = certificate(tmp_path)
    assert callable(change)
    change(files)
    with pytest.raises(CertificateError) as error:
        load_certificate(files)
    assert said in str(error.value)


async def test_doors_whose_certificate_is_gone_do_not_open(tmp_path: Path) -> None:
    with pytest.raises(CertificateError):
        async with doors(*cell(), DoorSettings(tls=TlsFiles(tmp_path / "a", tmp_path / "b"))):
            pass
