"""The client that goes on for ever: it reconnects by itself, subscribes again and reads on in every ring of events.

It says when its connection is lost and when there is one again: what came before is old from that moment on.
"""

from __future__ import annotations

import random
from collections import Counter, deque
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from ssl import SSLContext

import anyio

from gateway.api import messages
from gateway.api.model import Event, Sample
from gateway.client.connection import Client, Pushed, RequestError, connect
from gateway.client.rings import Rings, boots_of
from gateway.client.typed import typed as as_typed
from gateway.client.way import ClientError, Way, way_to

_HEARTBEAT_S = 5.0
_FIRST_DELAY_S = 0.2
_LONGEST_DELAY_S = 5.0


@dataclass(frozen=True, slots=True)
class Connected:
    """There is a connection, and every subscription has been asked for in it.

    Attributes:
        welcome: What the gateway said first.
    """

    welcome: messages.Welcome


@dataclass(frozen=True, slots=True)
class Disconnected:
    """There is no connection: everything that came before is old.

    Attributes:
        reason: Why, for people.
        attempts: How often connecting has failed since; 0: a connection has just been lost.
        retry_s: How long the next attempt waits, in s.
    """

    reason: str
    attempts: int
    retry_s: float


@dataclass(frozen=True, slots=True)
class Refused:
    """The gateway does not take a subscription, for example because it has no such robot now.

    It is asked for again with each new connection.

    Attributes:
        topics: Its globs.
        code: Stable, upper case.
        reason: For people.
    """

    topics: tuple[str, ...]
    code: str
    reason: str


Item = Sample | Event | messages.Missed | Connected | Disconnected | Refused


@dataclass(slots=True)
class _Wish:
    """One subscription, for every connection to come.

    Attributes:
        since: What its first answer is to read on after; None: nothing.
        answered: Whether it was ever accepted: from then on it reads on.
    """

    topics: tuple[str, ...]
    rate_hz: float | None
    mode: messages.Mode
    fields: tuple[str, ...] | None
    since: list[str] | None
    answered: bool = False


def backoff() -> Iterator[float]:
    """Delays in s before the next attempts: 0.2 to 5, doubled, with jitter, without end."""
    delay_s = _FIRST_DELAY_S
    while True:
        yield delay_s * random.uniform(0.8, 1.2)  # noqa: S311 - no secret: clients shall not come back all at once
        delay_s = min(_LONGEST_DELAY_S, 2 * delay_s)


class Follower:
    """Follows topics through every cut; made by `follow`. Iterate over it to receive; one task at a time may use it.

    It receives only while it is iterated over. A step may be cancelled, by a timeout for example, without a loss.

    Attributes:
        client: The connection of this moment, for requests; None: there is none.
        topics: The names that the subscriptions matched last.
        missed_samples: By topic, how many samples the gateway had to leave out so far.
        missed_events: How many events are lost so far; None: their number is not known.
    """

    def __init__(self, way: Way, *, typed: bool, delays: Callable[[], Iterator[float]]) -> None:
        self._way = way
        self._welcomed = False  # whether there ever was a connection
        self._typed = typed
        self._new_delays = delays
        self._delays = delays()
        self._tried = False  # whether a delay was taken since something was received
        self._attempts = 0
        self._due_s = 0.0  # when the next attempt may begin, by the loop's clock
        self._wishes: list[_Wish] = []
        self._rings = Rings()
        self._ready: deque[Item] = deque()
        self._stack = AsyncExitStack()
        self.client: Client | None = None
        self.topics: list[str] = []
        self.missed_samples: Counter[str] = Counter()
        self.missed_events: int | None = 0

    @property
    def n_ready(self) -> int:
        """How many items are at hand, without waiting."""
        return len(self._ready)

    async def subscribe(
        self,
        topics: Sequence[str],
        *,
        rate_hz: float | None = None,
        mode: messages.Mode = "latest",
        fields: Sequence[str] | None = None,
        since: messages.Since | None = None,
    ) -> None:
        """Ask for topics, now and with every new connection.

        Raises:
            RequestError: The gateway refuses it; it is not asked for again. Without a connection `Refused` says so.
        """
        named = [since] if isinstance(since, str) else since
        wish = _Wish(tuple(topics), rate_hz, mode, None if fields is None else tuple(fields), named)
        if self.client is not None:
            try:
                await self._ask(self.client, wish, resume=False)
            except ClientError as error:
                await self._lose(error.reason)
        self._wishes.append(wish)

    def __aiter__(self) -> Follower:
        """What comes, for ever."""
        return self

    async def __anext__(self) -> Item:
        """The next sample, event or word about the connection.

        Raises:
            ClientError: It has never been connected, and what is in the way will not go by itself: the address is none,
                or the gateway's certificate or the client's token is not accepted.
        """
        while not self._ready:
            if self.client is None:
                await anyio.sleep(max(0.0, self._due_s - anyio.current_time()))
                await self.open(patient=True)
            else:
                await self._receive(self.client)
        return self._ready.popleft()

    async def open(self, *, patient: bool) -> None:
        """Connect once.

        Args:
            patient: Whether a gateway that cannot be reached is waited for.

        Raises:
            ClientError: It cannot be reached, and is not waited for.
        """
        try:
            async with AsyncExitStack() as stack:
                client = await stack.enter_async_context(connect(self._way, heartbeat_s=_HEARTBEAT_S))
                refused = await self._subscribe_again(client)
                self._stack = stack.pop_all()
        except ClientError as error:
            if not patient or (error.lasting and not self._welcomed):  # a token may be let in again, once it was
                raise
            self._attempts += 1
            self._wait(error.reason)
            return
        self.client = client
        self._welcomed = True
        self._attempts = 0
        self._ready.append(Connected(client.welcome))
        self._ready.extend(refused)

    async def aclose(self) -> None:
        """End the connection."""
        self.client = None
        await self._stack.aclose()

    async def _subscribe_again(self, client: Client) -> list[Refused]:
        """Ask for everything in a new connection; returns what is refused."""
        refused = []
        self.topics.clear()
        current: set[str] = set()
        for wish in self._wishes:
            try:
                current |= await self._ask(client, wish, resume=wish.answered)
            except RequestError as error:
                refused.append(Refused(wish.topics, error.code, str(error)))
        if not refused:
            self._rings.keep(current)
        return refused

    async def _ask(self, client: Client, wish: _Wish, *, resume: bool) -> set[str]:
        """Ask for one subscription; returns its rings."""
        names = self._rings.names or None if resume else wish.since
        answer = await client.ask_for(
            wish.topics, rate_hz=wish.rate_hz, mode=wish.mode, fields=wish.fields, since=names
        )
        rings = answer.last_events or []
        self._rings.subscribed(rings, names)
        wish.answered = True
        self.topics += [topic for topic in answer.topics or () if topic not in self.topics]
        return boots_of(rings)

    async def _receive(self, client: Client) -> None:
        try:
            message = await client.next_pushed()
        except ClientError as error:
            await self._lose(error.reason)
            return
        if self._tried:
            self._tried = False
            self._delays = self._new_delays()
        self._take(message)

    def _take(self, message: Pushed) -> None:
        if isinstance(message, messages.Data):
            self._ready.extend(map(as_typed, message.samples) if self._typed else message.samples)
        elif isinstance(message, messages.EventMessage):
            self._ready.extend(event for event in message.events if self._rings.take(event))
        else:
            self.missed_samples.update(message.samples)
            known = message.events is not None and self.missed_events is not None
            self.missed_events = (self.missed_events or 0) + (message.events or 0) if known else None
            self._ready.append(message)

    async def _lose(self, reason: str) -> None:
        """The connection has ended."""
        self.client = None
        self._wait(reason)
        stack, self._stack = self._stack, AsyncExitStack()
        await stack.aclose()

    def _wait(self, reason: str) -> None:
        delay_s = next(self._delays)
        self._tried = True
        self._due_s = anyio.current_time() + delay_s
        self._ready.append(Disconnected(reason, self._attempts, delay_s))


@asynccontextmanager
async def follow(
    url: str | Way,
    *,
    token: str | None = None,
    ssl: SSLContext | None = None,
    patient: bool = True,
    typed: bool = True,
    delays: Callable[[], Iterator[float]] = backoff,
) -> AsyncIterator[Follower]:
    """Follow a gateway for as long as the context lasts, through every cut.

    Args:
        url: Such as `ws://127.0.0.1:8765/ws` or `wss://cell-7:8765/ws`; or a way made by `way_to`.
        token: For a gateway that asks for one.
        ssl: Whom to trust in a `wss` connection, such as `trusting("cell-7.pem")`; None: whom this machine trusts.
        patient: Whether a gateway that is not there yet is waited for; later cuts are waited for in any case.
        typed: Whether the data of samples is the model's struct of its group (`Joints`, `Status` …) where it is whole.
        delays: Makes the delays between attempts, in s; begun anew whenever something was received.

    Raises:
        ClientError: The address is none, the gateway's certificate or this client's token is not accepted, or nobody
            answers and that is not waited for.
    """
    way = url if isinstance(url, Way) else way_to(url, token, ssl)
    follower = Follower(way, typed=typed, delays=delays)
    try:
        await follower.open(patient=patient)
        yield follower
    finally:
        await follower.aclose()
