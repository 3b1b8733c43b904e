"""The certificate and the key that the listener shows: where they are, whether they can be used, and until when."""

from __future__ import annotations

import re
import ssl
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from gateway.config.reading import read_file
from gateway.errors import ConfigError

_LARGEST = 1024 * 1024  # bytes
_FIRST = re.compile(r"-----BEGIN CERTIFICATE-----\s.*?-----END CERTIFICATE-----", re.DOTALL)
_UTC_TIME, _CONTEXT_0 = 0x17, 0xA0  # tags of DER


class CertificateError(ValueError):
    """A certificate or its key cannot be used; the text says which and what to do."""


@dataclass(frozen=True, slots=True)
class TlsFiles:
    """Where the certificate (with its chain) and its key are, both PEM."""

    certificate: Path
    key: Path


@dataclass(frozen=True, slots=True)
class Certificate:
    """A certificate and a key that fit each other.

    Attributes:
        context: For the listener.
        expires: Until when it is valid, UTC.
    """

    context: ssl.SSLContext
    expires: datetime


def load_certificate(files: TlsFiles) -> Certificate:
    """Read a certificate with its key.

    Raises:
        CertificateError: One of them cannot be used, or they do not belong together.
    """
    text = _read(files.certificate, "certificate")
    key = _read(files.key, "key")
    if "ENCRYPTED" in key:
        raise CertificateError(f"{files.key}: the key has a password; the gateway takes one without")
    if "PRIVATE KEY-----" not in key:
        raise CertificateError(f"{files.key}: holds no key in PEM (-----BEGIN PRIVATE KEY-----)")
    first = _FIRST.search(text)
    if first is None:
        raise CertificateError(f"{files.certificate}: holds no certificate in PEM (-----BEGIN CERTIFICATE-----)")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.options |= ssl.OP_NO_RENEGOTIATION
    context.set_alpn_protocols(["http/1.1"])
    try:
        context.load_cert_chain(files.certificate, files.key)
        expires = _expires(ssl.PEM_cert_to_DER_cert(first[0]))
    except ssl.SSLError as error:
        if error.reason == "KEY_VALUES_MISMATCH":
            raise CertificateError(f"{files.key}: is not the key of the certificate in {files.certificate}") from None
        raise CertificateError(f"{files.certificate}, {files.key}: cannot be used: {error.reason or error}") from None
    except (OSError, ValueError, IndexError) as error:
        raise CertificateError(f"{files.certificate}, {files.key}: cannot be used: {error}") from None
    return Certificate(context, expires)


def _read(path: Path, what: str) -> str:
    try:
        data, _ = read_file(path, _LARGEST, absent=f"put the {what} there in PEM", kind=what)
    except ConfigError as error:
        raise CertificateError(error.problems[0]) from None
    return data.decode("ascii", "replace")


def _expires(der: bytes) -> datetime:
    """Until when a certificate is valid: the standard library reads that only of certificates that it trusts.

    Certificate ::= SEQUENCE { tbs SEQUENCE { [0] version, serial, algorithm, issuer, SEQUENCE { begin, end }, … }, … }
    (RFC 5280, 4.1).
    """
    _, certificate, _ = _element(der, 0)
    _, tbs, _ = _element(certificate, 0)
    tag, _, at = _element(tbs, 0)
    if tag == _CONTEXT_0:
        _, _, at = _element(tbs, at)
    for _ in range(2):
        _, _, at = _element(tbs, at)
    _, validity, _ = _element(tbs, at)
    _, _, at = _element(validity, 0)
    tag, end, _ = _element(validity, at)
    digits = end.decode("ascii").removesuffix("Z")
    if tag == _UTC_TIME:  # of two digits, 50 and above are of the last century (RFC 5280, 4.1.2.5.1)
        digits = f"{'19' if digits >= '50' else '20'}{digits}"
    return datetime.strptime(digits, "%Y%m%d%H%M%S").replace(tzinfo=UTC)


def _element(der: bytes, at: int) -> tuple[int, bytes, int]:
    """The element at a place: tag, content, and where the next begins."""
    tag, length, at = der[at], der[at + 1], at + 2
    if length & 0x80:
        n_bytes = length & 0x7F
        length, at = int.from_bytes(der[at : at + n_bytes], "big"), at + n_bytes
    return tag, der[at : at + length], at + length
