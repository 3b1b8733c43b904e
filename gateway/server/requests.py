"""Requests of the native protocol and their answers; what a client may ask for, and what it is told when it may not."""

from __future__ import annotations

import heapq
import sys
import time
from collections.abc import Callable, Iterable
from functools import partial
from itertools import islice

import anyio.lowlevel
import msgspec

from gateway import __version__
from gateway.api import messages
from gateway.api.model import Event
from gateway.core.bus import Topic
from gateway.core.events import EventRing, parse_name
from gateway.server.cell import Cell
from gateway.server.limits import Quota
from gateway.server.outbox import QUEUED_EVENTS, QUEUED_SAMPLES, Outbox, Source, Subscription, Wish
from gateway.server.wire import Cut, Encoding

# No topic and no name of a field is nearly as long; matching longer ones would cost the other clients time.
_MAX_NAME = 256
# So many globs are matched at a time: a full request of them takes tens of ms in a large cell.
_GLOBS_A_TURN = 16
_OfTopics = messages.Subscribe | messages.Get | messages.Events


class BadRequest(Exception):  # noqa: N818 - it is an answer to the client, no error of ours
    """A request that is refused.

    Attributes:
        code: Stable, upper case.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


def decode(encoding: Encoding, data: bytes) -> messages.Request:
    """Read a request.

    Raises:
        BadRequest: It is none, or too large.
    """
    if len(data) > messages.MAX_MESSAGE_BYTES:
        raise BadRequest("TOO_MUCH", f"a message has at most {messages.MAX_MESSAGE_BYTES} bytes, not {len(data)}")
    try:
        return encoding.decode(data)
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        raise BadRequest("BAD_MESSAGE", f"{error}; see docs/protocol.md") from None


def id_of(encoding: Encoding, data: bytes) -> int | str | None:
    """Find the id of a message that is no request or too large, so that the client knows which one was refused."""
    try:
        return encoding.decode_id(data).id
    except (msgspec.DecodeError, UnicodeError, RecursionError):
        return None


class Requests:
    """Answers the requests of one client.

    Args:
        cell: What it may read.
        encoding: What its samples are encoded in.
        outbox: Where they leave.
        quota: What it may take of its peer's share; None: as much as it wants.
    """

    def __init__(self, cell: Cell, encoding: Encoding, outbox: Outbox, quota: Quota | None = None) -> None:
        self._cell = cell
        self._encoding = encoding
        self._outbox = outbox
        self._quota = quota

    def welcome(self, access: messages.AccessMode = "loopback") -> messages.Welcome:
        """What every client is told first.

        Args:
            access: Who is let in.
        """
        return messages.Welcome(
            gateway=__version__,
            robots=list(self._cell.robots),
            last_event=self._cell.last_event,
            limits=messages.Limits(queued_samples=QUEUED_SAMPLES, queued_events=QUEUED_EVENTS),
            access=access,
        )

    def answer(self, request: messages.Request) -> messages.Result:
        """Do what a request asks for.

        Raises:
            BadRequest: It cannot be done; nothing has changed.
        """
        if not isinstance(request, _OfTopics):
            return self._HANDLERS[type(request)](self, request)
        _check_names("topic", request.topics)
        return self._answer_of(request, self._cell.match(request.topics))

    async def answer_in_turns(self, request: messages.Request) -> messages.Result:
        """The same; where finding its topics takes long, the other clients have their turn.

        Raises:
            BadRequest: It cannot be done; nothing has changed.
        """
        if not isinstance(request, _OfTopics):
            return self.answer(request)
        _check_names("topic", request.topics)
        found: set[Topic] = set()
        distinct = list(dict.fromkeys(request.topics))
        before = set(self._cell.topics.values())
        for at in range(0, len(distinct), _GLOBS_A_TURN):
            found.update(self._cell.match(distinct[at : at + _GLOBS_A_TURN]))
            if at + _GLOBS_A_TURN < len(distinct):
                await anyio.lowlevel.checkpoint()
        if not before.issuperset(self._cell.topics.values()):  # some came meanwhile: the first globs have not seen them
            found.update(self._cell.match(distinct))
        return self._answer_of(request, [topic for topic in self._cell.topics.values() if topic in found])

    def _answer_of(self, request: _OfTopics, topics: list[Topic]) -> messages.Result:
        if not topics:
            raise BadRequest("UNKNOWN_TOPIC", self._cell.unknown_topic(request.topics))
        return self._TOPIC_HANDLERS[type(request)](self, request, topics)

    def _subscribe(self, request: messages.Subscribe, topics: list[Topic]) -> messages.Result:
        subscriptions = self._outbox.subscriptions
        if request.id not in subscriptions and len(subscriptions) >= messages.MAX_SUBSCRIPTIONS:
            raise BadRequest("TOO_MUCH", f"a client has at most {messages.MAX_SUBSCRIPTIONS} subscriptions")
        if request.mode == "all" and request.rate_hz is not None:
            raise BadRequest("BAD_REQUEST", 'mode "all" takes every sample: leave rate_hz out')
        cut = Cut(self._encoding, None if request.fields is None else self._paths(topics, request.fields))
        resumed = None if request.since is None else self._read_back(request.since, sys.maxsize, topics)
        period_s = None if request.rate_hz is None else 1 / request.rate_hz
        wish = Wish(period_s=period_s, every=request.mode == "all", cut=cut)
        if self._quota is not None and request.id not in subscriptions and not self._quota.take():
            raise BadRequest("TOO_MUCH", self._quota.words)
        cell = self._cell
        source = Source(bus=cell.bus, patterns=tuple(sorted(set(request.topics))), scope=cell.scope)
        self._outbox.add(request.id, Subscription(wish, topics, self._outbox, source))
        if resumed is not None:
            self._outbox.resume(*resumed)
        last_events = [ring.last_name for ring in _rings(topics)]
        return messages.Result(id=request.id, topics=[topic.name for topic in topics], last_events=last_events or None)

    def _unsubscribe(self, request: messages.Unsubscribe) -> messages.Result:
        if not self._outbox.remove(request.id):
            raise BadRequest("BAD_REQUEST", f"there is no subscription {request.id!r}")
        if self._quota is not None:
            self._quota.give()
        return messages.Result(id=request.id)

    def _get(self, request: messages.Get, topics: list[Topic]) -> messages.Result:
        return messages.Result(id=request.id, samples=self._cell.latest(topics, self._encoding))

    def _events(self, request: messages.Events, topics: list[Topic]) -> messages.Result:
        events, missed = self._read_back(request.since, request.limit, topics)
        return messages.Result(id=request.id, events=events, missed=-1 if missed is None else missed)

    def _robots(self, request: messages.Robots) -> messages.Result:
        cell = self._cell
        return messages.Result(
            id=request.id, robots=cell.infos(), exports=cell.exports() or None, recorder=cell.recorder
        )

    def _describe(self, request: messages.Describe) -> messages.Result:
        topic = self._cell.topics.get(request.topic)
        if topic is None:
            _check_names("topic", [request.topic])
            raise BadRequest("UNKNOWN_TOPIC", self._cell.unknown_topic([request.topic]))
        return messages.Result(id=request.id, description=self._cell.describe(topic))

    def _ping(self, request: messages.Ping) -> messages.Result:
        return messages.Result(id=request.id, t=time.time_ns() // 1000)

    def _paths(self, topics: list[Topic], fields: list[str]) -> tuple[tuple[str, ...], ...]:
        _check_names("field", fields)
        unknown = self._cell.unknown_fields(topics, fields)
        if unknown is not None:
            raise BadRequest("UNKNOWN_FIELD", unknown)
        return tuple(tuple(field.split(".")) for field in dict.fromkeys(fields))

    def _read_back(
        self, since: messages.Since | None, limit: int, topics: list[Topic]
    ) -> tuple[list[Event], int | None]:
        """The events of some topics after the named ones, and how many are gone; None: nobody can know.

        A ring that no name belongs to is read from its beginning.
        """
        names = [since] if isinstance(since, str) else since or []
        try:
            boots = {parse_name(name)[0]: name for name in names}
        except ValueError as error:
            raise BadRequest("BAD_REQUEST", str(error)) from None
        if len(boots) < len(names):
            raise BadRequest("BAD_REQUEST", "since names a ring more than once: give the last event of each ring")
        all_known = boots.keys() <= {ring.boot for ring in _rings(self._cell.topics.values())}
        found: list[list[Event]] = []
        gone: int | None = 0
        for ring, robots in _rings(topics).items():
            named = boots.get(ring.boot) or (f"{ring.boot}:0" if all_known else names[0]) if names else None
            events, missed = ring.since(named, limit, partial(_is_of, robots))
            found.append(events)
            gone = None if gone is None or missed is None else gone + missed
        merged = heapq.merge(*found, key=lambda event: event.t)  # each ring stays in its own order
        return list(islice(merged, limit)), gone

    _HANDLERS: dict[type, Callable[..., messages.Result]] = {  # noqa: RUF012 - a table, never changed
        messages.Unsubscribe: _unsubscribe,
        messages.Robots: _robots,
        messages.Describe: _describe,
        messages.Ping: _ping,
    }
    _TOPIC_HANDLERS: dict[type, Callable[..., messages.Result]] = {  # noqa: RUF012 - the same
        messages.Subscribe: _subscribe,
        messages.Get: _get,
        messages.Events: _events,
    }


def _check_names(kind: str, names: list[str]) -> None:
    longest = max(names, key=len)
    if len(longest) > _MAX_NAME:
        raise BadRequest("TOO_MUCH", f"a {kind} has at most {_MAX_NAME} characters: {longest[:20]!r}… has more")


def _is_of(robots: set[str], event: Event) -> bool:
    return event.robot in robots


def _rings(topics: Iterable[Topic]) -> dict[EventRing, set[str]]:
    """The rings of some topics, each with the robots that are asked for."""
    found: dict[EventRing, set[str]] = {}
    for topic in topics:
        if topic.ring is not None:
            found.setdefault(topic.ring, set()).add(topic.robot)
    return found
