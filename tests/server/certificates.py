"""Certificates for tests, made with the openssl command."""

from __future__ import annotations

import re
import shutil
import ssl
import subprocess
from pathlib import Path

import pytest

from gateway.config.certificates import TlsFiles


def certificate(folder: Path, name: str = "cell", *, days: int = 30) -> TlsFiles:
    """A self-signed certificate for 127.0.0.1 and a key of its own; with 0 days it has expired.

    It takes the place of one of the same name at once, as renewals do.
    """
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("the openssl command is not there to make a certificate with")
    files = TlsFiles(folder / f"{name}.crt", folder / f"{name}.key")
    new = TlsFiles(folder / f"{name}.crt.new", folder / f"{name}.key.new")
    make = [openssl, "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    about = ["-subj", f"/CN={name}", "-addext", "subjectAltName=IP:127.0.0.1,DNS:localhost", "-days", str(days or 1)]
    out = ["-keyout", str(new.key), "-out", str(new.certificate)]
    subprocess.run([*make, *about, *out], check=True, capture_output=True)  # noqa: S603 - our own words
    new.key.chmod(0o600)
    if (
        not days
    ):  # openssl makes none that has expired: the last day is rewritten, which nobody's signature is asked about
        der = ssl.PEM_cert_to_DER_cert(new.certificate.read_text())
        past = re.sub(rb"(\x17\x0d\d{12}Z\x17\x0d)\d{12}Z", rb"\g<1>200101000000Z", der, count=1)
        new.certificate.write_text(ssl.DER_cert_to_PEM_cert(past))
    new.certificate.replace(files.certificate)
    new.key.replace(files.key)
    return files
