"""What the tests of tokens and certificates share: two clients' tokens, a certificate, and doors that ask for them."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from pathlib import Path

import pytest

from gateway.config.certificates import TlsFiles
from gateway.config.tokens import Token
from gateway.server.settings import AccessSettings, DoorSettings

ALL = "rgw_" + "A" * 43
ONLY_R1 = "rgw_" + "B" * 43
WRONG = "rgw_" + "C" * 43
OPENSSL = shutil.which("openssl")
needs_openssl = pytest.mark.skipif(OPENSSL is None, reason="openssl is missing: apt-get install openssl")


def asking(tls: TlsFiles | None = None, *, without: str | None = None) -> DoorSettings:
    """Doors that ask for a token; `ALL` may read everything, `ONLY_R1` the joints and the link of r1.

    Args:
        tls: Certificate and key; None: they speak in the clear.
        without: A token that they do not know.
    """
    topics = {ALL: ("*",), ONLY_R1: ("r1/joints", "r1/link")}
    tokens = tuple(
        Token(f"client-{number}", hashlib.sha256(token.encode()).digest(), globs)
        for number, (token, globs) in enumerate(topics.items())
        if token != without
    )
    return DoorSettings(access=AccessSettings(tokens=tokens), tls=tls)


def certificate(folder: Path, name: str = "IP:127.0.0.1") -> TlsFiles:
    """Make a self-signed certificate.

    Args:
        folder: Where its files go.
        name: Whom it is for, as OpenSSL writes it.
    """
    made = TlsFiles(folder / "gateway.pem", folder / "gateway.key")
    command = [
        *(str(OPENSSL), "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"),
        *("-keyout", str(made.key), "-out", str(made.certificate), "-days", "2", "-subj", "/CN=gateway"),
        *("-addext", f"subjectAltName={name}"),
    ]
    subprocess.run(command, check=True, capture_output=True, timeout=15)  # noqa: S603
    return made
