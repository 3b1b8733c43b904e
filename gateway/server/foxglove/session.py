"""What a Foxglove client says and is answered; no socket and no clock.

Whatever a client sends, nothing but a status can follow, and what it has stays as it was.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from gateway import __version__
from gateway.api.messages import MAX_MESSAGE_BYTES
from gateway.api.model import SAFETY_NOTICE
from gateway.server.cell import Cell
from gateway.server.foxglove.channels import Channel, Channels
from gateway.server.foxglove.messages import (
    CAPABILITIES,
    ERROR,
    OPS,
    WARNING,
    Advertise,
    Response,
    ServerInfo,
    Status,
    Subscribe,
    Unadvertise,
    Unsubscribe,
    decode,
    op_of,
)
from gateway.server.foxglove.outbox import Outbox
from gateway.server.limits import Quota

_NAMED = 8  # so many refused subscriptions are named
_LONGEST_OP = 40  # so much of an unknown op is repeated


class Session:
    """The talk with one client.

    Args:
        cell: What it may read.
        globs: Which channels it is offered.
        outbox: Where they leave.
        quota: What it may take of its peer's share; None: as much as it wants.

    Attributes:
        wrong_in_a_row: How many messages in a row were wrong.
    """

    def __init__(self, cell: Cell, globs: list[str], outbox: Outbox, quota: Quota | None = None) -> None:
        self._cell = cell
        self._globs = globs
        self._outbox = outbox
        self._quota = quota
        self._channels = Channels(cell, globs)
        self._wanted: dict[int, Channel] = {}  # by subscription
        self.wrong_in_a_row = 0

    def hello(self) -> Iterator[Response]:
        """What every client is told first; robot by robot, so that a large cell holds up nobody."""
        yield ServerInfo(
            name=f"robot-gateway {__version__}",
            metadata={"gateway": __version__, "robots": ",".join(self._cell.robots), "notice": SAFETY_NOTICE},
            session_id=self._cell.bus.events.boot,
        )
        new, _ = self._channels.refresh()
        yield from (_advertise(channels) for channels in new or [[]])
        if not new:
            yield Status(level=ERROR, message=f"no channel matches topics={','.join(self._globs)[:200]}")

    def refresh(self) -> Iterator[Response]:
        """What has come and gone since."""
        new, gone = self._channels.refresh()
        if gone:
            ids = {channel.id for channel in gone}
            for name in [name for name, channel in self._wanted.items() if channel.id in ids]:
                self._drop(name)
            yield Unadvertise([channel.id for channel in gone])
        yield from (_advertise(channels) for channels in new)

    def take_binary(self, data: bytes) -> Status:
        """Refuse a binary message: there is none that a client could want."""
        return self._wrong(f"a binary message of {len(data)} bytes was passed over: this server only sends them")

    def take(self, text: bytes) -> Status | None:
        """Do what a text message asks for; returns what there is to say about it."""
        if len(text) > MAX_MESSAGE_BYTES:
            return self._wrong(f"a message has at most {MAX_MESSAGE_BYTES} bytes, not {len(text)}")
        try:
            op = op_of(text)
            if op not in OPS:
                return _unsupported(op)
            request = decode(text)
        except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
            return self._wrong(f"not understood: {error}")
        refused = self._subscribe(request) if isinstance(request, Subscribe) else self._unsubscribe(request)
        if refused:
            return self._wrong(f"{op}: {_listed(refused)}")
        self.wrong_in_a_row = 0
        return None

    def _subscribe(self, request: Subscribe) -> list[str]:
        """Take each subscription that can be had; returns why the others cannot."""
        refused = []
        taken = {channel.id: name for name, channel in self._wanted.items()}
        for wanted in request.subscriptions:
            channel = self._channels.by_id.get(wanted.channel_id)
            if wanted.id in self._wanted:
                refused.append(f"there is a subscription {wanted.id} already")
            elif channel is None:
                refused.append(f"subscription {wanted.id}: there is no channel {wanted.channel_id}")
            elif channel.id in taken:
                refused.append(f"subscription {wanted.id}: {channel.name} has subscription {taken[channel.id]} already")
            elif self._quota is not None and not self._quota.take():
                refused.append(f"subscription {wanted.id}: {self._quota.words}")
            else:
                taken[channel.id] = wanted.id
                self._wanted[wanted.id] = channel
                self._outbox.subscribe(wanted.id, channel)
        return refused

    def _unsubscribe(self, request: Unsubscribe) -> list[str]:
        """End each subscription that there is; returns which there are not."""
        return [f"there is no subscription {name}" for name in request.subscription_ids if not self._drop(name)]

    def _drop(self, name: int) -> bool:
        channel = self._wanted.pop(name, None)
        if channel is not None:
            self._outbox.unsubscribe(name, channel)
            if self._quota is not None:
                self._quota.give()
        return channel is not None

    def _wrong(self, text: str) -> Status:
        self.wrong_in_a_row += 1
        return Status(level=ERROR, message=text)


def _unsupported(op: str) -> Status:
    """Say that an op is not for this server: a client of a later version may well send it."""
    capability = CAPABILITIES.get(op)
    if capability is None:
        return Status(level=WARNING, message=f"unknown op {op[:_LONGEST_OP]!r} was passed over")
    return Status(level=WARNING, message=f"{op} was passed over: this server only sends, it has no {capability}")


def _advertise(channels: list[Channel]) -> Advertise:
    return Advertise([channel.advertised for channel in channels])


def _listed(refused: list[str]) -> str:
    more = f"; and {len(refused) - _NAMED} more" if len(refused) > _NAMED else ""
    return "; ".join(refused[:_NAMED]) + more
