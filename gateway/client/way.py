"""The way to a gateway: address, token and trusted certificate; and in words why it leads nowhere.

The token is in no error, no representation and no log: an address that holds one is stripped of it before it is shown.
"""

from __future__ import annotations

import re
import ssl
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote

import aiohttp

from gateway.errors import GatewayError

NOT_A_GATEWAY = "it answers, but not as a gateway does: is this the right port?"
_PERHAPS_TLS = f"{NOT_A_GATEWAY} If it speaks TLS, write wss:// instead of ws://"
_TOKEN_PARAMETER = re.compile(r"(?<=[?&])token=([^&#]*)&?")
_CREDENTIALS = re.compile(r"(?<=://)[^/?#]*@")
_TOKEN = re.compile("[!-~]+")  # what a header may hold
_WHERE_TOKEN = "--token-file FILE or $ROBOT_GATEWAY_TOKEN on the command line, token= in a program"  # noqa: S105
_WHERE_CA = "--ca FILE on the command line, ssl=trusting(FILE) in a program"
# What OpenSSL calls an answer that is no TLS.
_NO_TLS = {"WRONG_VERSION_NUMBER", "RECORD_LAYER_FAILURE", "PACKET_LENGTH_TOO_LONG", "UNKNOWN_PROTOCOL"}
# X509_V_ERR_…: where nobody who is trusted has signed
_UNKNOWN_SIGNER = {2, 18, 19, 20, 21}
_NOT_YET_VALID = 9
_EXPIRED = 10
_WRONG_NAME = {62, 64}


class ClientError(GatewayError):
    """The gateway cannot be reached, or the connection to it has ended.

    Attributes:
        url: Where it should be, without a token.
        reason: What happened and what to do.
        lasting: Whether trying again is of no use until somebody changes something.
    """

    def __init__(self, url: str, reason: str, *, lasting: bool = False) -> None:
        self.url = bare(url)
        super().__init__(f"{self.url}: {reason}")
        self.reason = reason
        self.lasting = lasting


class TrustError(GatewayError):
    """A file of trusted certificates cannot be used."""


@dataclass(frozen=True, slots=True)
class Way:
    """How a gateway is reached.

    Args:
        url: Such as `wss://cell-7:8765/ws`, without a token.
        token: Said in the handshake; None: the gateway asks for none.
        ssl: Whom to trust; None: whom this machine trusts.
    """

    url: str
    token: str | None = field(default=None, repr=False)
    ssl: ssl.SSLContext | None = field(default=None, repr=False)

    @property
    def headers(self) -> dict[str, str]:
        """What the handshake says besides."""
        return {} if self.token is None else {"Authorization": f"Bearer {self.token}"}


def way_to(url: str, token: str | None = None, context: ssl.SSLContext | None = None) -> Way:
    """The way to a gateway; a `?token=` in its address is taken out and said in the header, which no proxy logs.

    Raises:
        ClientError: The token holds what no token can.
    """
    found = _TOKEN_PARAMETER.search(url)
    said = unquote(found[1]) if token is None and found else token
    if said is not None and not _TOKEN.fullmatch(said):
        raise ClientError(url, "the token is empty or has blanks in it: a token is one word", lasting=True)
    return Way(_without_token(url), said, context)


def bare(url: str) -> str:
    """An address as it may be shown: without token, user and password."""
    return _CREDENTIALS.sub("", _without_token(url))


def _without_token(url: str) -> str:
    stripped = _TOKEN_PARAMETER.sub("", url)
    return url if stripped == url else stripped.rstrip("?&")


def trusting(ca: str | Path) -> ssl.SSLContext:
    """Trust the certificates of a file and no others: a certificate authority's, or a gateway's own self-signed one.

    Args:
        ca: Certificates in PEM.

    Raises:
        TrustError: It cannot be read, or holds no certificate.
    """
    try:
        context = ssl.create_default_context(cafile=str(ca))
    except ssl.SSLError:
        raise TrustError(f"{ca}: there is no certificate in PEM in it (-----BEGIN CERTIFICATE-----)") from None
    except OSError as error:
        raise TrustError(f"{ca}: {error.strerror or error}") from None
    # A self-signed certificate of a gateway is often neither an authority's nor as complete as newer Pythons demand.
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    context.verify_flags &= ~ssl.VERIFY_X509_STRICT
    return context


def failure(way: Way, error: Exception) -> ClientError:
    """Why a gateway cannot be reached, and what to do."""
    of_tls = isinstance(error, aiohttp.ClientConnectorCertificateError)
    no_address = isinstance(error, aiohttp.InvalidURL | aiohttp.NonHttpUrlClientError | ValueError)
    no_token = isinstance(error, aiohttp.WSServerHandshakeError) and error.status == 401  # noqa: PLR2004
    return ClientError(way.url, _advice(way, error), lasting=of_tls or no_address or no_token)


def _advice(way: Way, error: Exception) -> str:
    match error:
        case aiohttp.ClientConnectorCertificateError():  # it is a ValueError too
            return _of_certificate(error.certificate_error)
        case aiohttp.InvalidURL() | aiohttp.NonHttpUrlClientError() | ValueError():
            return "not an address of a gateway; one looks like ws://127.0.0.1:8765/ws"
        case aiohttp.WSServerHandshakeError():
            return _of_status(way, error.status)
        case aiohttp.ClientConnectorSSLError():
            return _of_tls(getattr(error.os_error, "reason", None) or str(error.os_error))
        case aiohttp.ClientConnectorDNSError():
            return "there is no host of that name"
        case aiohttp.ClientConnectorError():
            return "no gateway answers: start one with `robot-gateway run`, or name another with --url"
    return NOT_A_GATEWAY if way.url.startswith("wss:") else _PERHAPS_TLS


def _of_status(way: Way, status: int) -> str:
    match status:
        case 401 if way.token is None:
            return f"the gateway asks for a token (HTTP 401): {_WHERE_TOKEN}; `robot-gateway token new NAME` makes one"
        case 401:
            return (
                "the gateway does not know this token (HTTP 401): see whether it is the right one for this gateway, "
                "and whether its `sha256` (`robot-gateway token hash`) stands in the gateway's file of tokens"
            )
        case 403:
            return (
                "the gateway does not go by the name in this address (HTTP 403): write localhost or 127.0.0.1 on the "
                "same machine, an IP address elsewhere, or put the name into allowed_hosts of the gateway's [server]"
            )
        case 404:
            return "a server answers, but it has no such door (HTTP 404): the path of a gateway is /ws"
        case 429 | 503:
            return (
                f"the gateway takes no more from this machine for now (HTTP {status}): end other connections, "
                "or raise [server.limits] of the gateway"
            )
    return f"refused with HTTP status {status}: is this the right port and path?"


def _of_tls(reason: str) -> str:
    if reason.upper().replace(" ", "_") in _NO_TLS:
        return "it does not speak TLS: use ws:// instead of wss://"
    words = reason.lower().replace("_", " ")
    return f"TLS could not be agreed on ({words}): is this the right port, and a gateway with a certificate?"


def _of_certificate(error: Exception) -> str:
    """What is wrong with the gateway's certificate."""
    code = getattr(error, "verify_code", 0)
    words = getattr(error, "verify_message", None) or str(error)
    if code in _UNKNOWN_SIGNER:
        return f"nobody whom this machine trusts has signed its certificate ({words}): name who has by {_WHERE_CA}"
    if code == _EXPIRED:
        return "its certificate has expired: renew it on the gateway, or see whether this machine's clock is right"
    if code == _NOT_YET_VALID:
        return "its certificate is not valid yet: see whether this machine's clock is right"
    if code in _WRONG_NAME:
        return f"its certificate is for another name ({words}): write in the address the name that it is for"
    return f"its certificate cannot be trusted: {words}"
