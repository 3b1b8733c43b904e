"""One connection to a NATS server: opened once, with errors in words, and never reconnected behind our back.

nats-py would reconnect by itself and keep what is sent meanwhile. Here a connection that has ended is over: what may
not be lost is in the outbox, and samples are not kept.
"""

from __future__ import annotations

import asyncio
import socket
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

import anyio
import nats
import nats.errors
import nats.js.errors
from nats.aio.client import Client, RawCredentials
from nats.js import JetStreamContext

from gateway.config.exports import NatsAccess

CONNECT_S = 5.0
ANSWER_S = 5.0
_CLOSE_S = 0.5
_PING_S = 5
_PENDING_BYTES = 1 << 20
# JetStream's error codes that are worth words of their own.
_WORDS = {
    10077: "the stream is full and takes no more: make room in it, or let it discard old messages",
    10047: "JetStream has no room left: give the server or the account more storage",
    10028: "the account has no room left: give it more storage",
    10023: "JetStream has no room left: give the server more storage",
    10039: "JetStream is not enabled for this account",
    10076: "JetStream is not enabled on this server: start it with jetstream {}",
    10065: "its subjects are already another stream's: name that stream in export.nats.stream",
    10074: "the bucket or stream exists with another configuration",
    10058: "the bucket or stream exists with another configuration",
}
MESSAGE_TOO_LARGE = 10054
WRONG_LAST = (10071, 10164)


class Trouble(Exception):  # noqa: N818 - what has happened, told to the operator
    """Something on the other side does not work.

    Attributes:
        reason: What, and what to do about it.
    """

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class Connection:
    """An open connection.

    Args:
        client: Of nats-py.
        address: Of the server, without secrets.

    Attributes:
        ended: Set when it is over.
        denied: What the server has not permitted last; None: nothing.
        n_slow: How often something came that nobody had room for.
        failure: What nats-py has told last.
        has_bucket: Set when the bucket is found or made.
        troubles: What does not work on it, by kind of work.
    """

    def __init__(self, client: Client, address: str) -> None:
        self.client = client
        self.address = address
        self.ended = anyio.Event()
        self.denied: str | None = None
        self.failure: Exception | None = None
        self.has_bucket = anyio.Event()
        self.n_slow = 0
        self.troubles: dict[str, str] = {}
        self.jetstream: JetStreamContext = client.jetstream(timeout=ANSWER_S)

    @property
    def backed_up(self) -> bool:
        """Whether the server takes less than it is given."""
        return self.client.pending_data_size > _PENDING_BYTES // 8

    async def on_error(self, error: Exception) -> None:
        """Take note of what nats-py tells."""
        text = str(error)
        if isinstance(error, nats.errors.SlowConsumerError):
            self.n_slow += 1
        elif "permissions violation" in text.lower():
            self.denied = text.removeprefix("nats: ")
        else:
            self.failure = error

    async def on_closed(self) -> None:
        """It is over."""
        self.ended.set()

    def well(self, work: str) -> None:
        """A kind of work goes well."""
        self.troubles.pop(work, None)

    def why_ended(self) -> str:
        """Why it is over."""
        error = self.client.last_error or self.failure
        return "the server has closed the connection" if error is None else reason_of(error)

    def trouble(self, error: BaseException, what: str) -> Trouble:
        """An error of JetStream in words.

        Args:
            error: As nats-py raised it.
            what: What was asked for.
        """
        if self.denied is not None and isinstance(error, nats.errors.TimeoutError | TimeoutError):
            denied, self.denied = self.denied, None
            return Trouble(f"{what}: the server does not permit it: {denied}")
        return Trouble(f"{what}: {reason_of(error)}")


@asynccontextmanager
async def connected(access: NatsAccess, server: str, name: str) -> AsyncIterator[Connection]:
    """Connect to one server for as long as the context lasts.

    Args:
        access: How.
        server: One of its servers.
        name: What the server shows of us.

    Raises:
        Trouble: It cannot be reached, or does not let us in.
    """
    client = Client()
    connection = Connection(client, server.rpartition("@")[2])
    try:
        try:
            with anyio.fail_after(CONNECT_S):
                await _connect(client, connection, access, server, name)
        except Exception as error:  # noqa: BLE001 - whatever it is, it did not work
            raise Trouble(_why_not(error, connection)) from None
        yield connection
    finally:
        with anyio.CancelScope(shield=True), anyio.move_on_after(_CLOSE_S), suppress(Exception):
            await client.close()


async def _connect(client: Client, connection: Connection, access: NatsAccess, server: str, name: str) -> None:
    await client.connect(
        server,
        name=name,
        error_cb=connection.on_error,
        closed_cb=connection.on_closed,
        allow_reconnect=False,
        max_reconnect_attempts=1,
        reconnect_time_wait=0,
        connect_timeout=int(CONNECT_S),
        ping_interval=_PING_S,
        max_outstanding_pings=2,
        pending_size=_PENDING_BYTES,
        flush_timeout=CONNECT_S,
        tls=access.tls(),
        user=_part(access, "user"),
        password=_part(access, "password"),
        token=_part(access, "token"),
        user_credentials=_creds(access),
        nkeys_seed_str=_part(access, "seed"),
    )


def _creds(access: NatsAccess) -> RawCredentials | None:
    text = _part(access, "creds")
    return None if text is None else RawCredentials(text)


def _part(access: NatsAccess, part: str) -> str | None:
    """The secret, if it is of a kind: a .creds file, an nkey seed, `user:password`, or a token."""
    secret = access.secret
    if secret is None:
        return None
    kind, _, rest = "token", "", ""
    if "-----BEGIN NATS USER JWT-----" in secret:
        kind = "creds"
    elif secret.startswith("SU") and len(secret) == 58 and secret.isalnum():  # noqa: PLR2004 - as nkeys are
        kind = "seed"
    elif ":" in secret:
        user, _, rest = secret.partition(":")
        return {"user": user, "password": rest}.get(part)
    return secret if part == kind else None


def reason_of(error: BaseException) -> str:
    """An error of nats-py in words."""
    if isinstance(error, nats.js.errors.ServiceUnavailableError) and not error.description:
        return _WORDS[10076]
    if isinstance(error, nats.js.errors.NotFoundError) and not error.description:
        return "there is none on this server"
    if isinstance(error, nats.js.errors.APIError):
        return _WORDS.get(error.err_code or 0) or error.description or f"error {error.err_code or error.code}"
    if isinstance(error, nats.js.errors.NoStreamResponseError | nats.errors.NoRespondersError):
        return "nobody answers: JetStream is not enabled there, or no stream takes this subject"
    if isinstance(error, nats.errors.TimeoutError | TimeoutError):
        return f"no answer within {ANSWER_S:g} s"
    if isinstance(error, nats.errors.StaleConnectionError):
        return "the server does not answer any more"
    if isinstance(error, nats.errors.UnexpectedEOF | ConnectionResetError | BrokenPipeError):
        return "the server has gone"
    if isinstance(error, nats.errors.ConnectionClosedError):
        return "the connection has ended"
    text = str(error).removeprefix("nats: ").strip("'\" ")
    return text or type(error).__name__


def _why_not(error: Exception, connection: Connection) -> str:
    where = connection.address
    if isinstance(error, nats.errors.NoServersError) and connection.failure is not None:
        error = connection.failure
    told = f"{error} {connection.failure or ''}".lower()
    if isinstance(error, nats.errors.AuthorizationError) or "authorization" in told or "authentication" in told:
        return f"{where}: the server does not let us in: look at the file that credentials names"
    if isinstance(error, nats.errors.NoServersError | TimeoutError | asyncio.TimeoutError):
        return f"{where}: no answer; look at the address and the firewall, and whether it is a NATS server"
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"{where}: its certificate is not trusted: {error.verify_message}; name its CA in tls_ca"
    if isinstance(error, ssl.SSLError):
        return f"{where}: TLS does not come about: {error.reason or error}"
    if isinstance(error, ConnectionRefusedError):
        return f"{where}: nothing listens there; start the server, or correct the address"
    if isinstance(error, socket.gaierror):
        return f"{where}: the name is not known: {error.strerror}"
    if "secure connection" in told or "tls" in told:
        return f"{where}: the server wants TLS: write tls:// in front of the address, or set tls_ca"
    if isinstance(error, OSError):
        return f"{where}: {error.strerror or error}"
    return f"{where}: {reason_of(error)}"
