"""The topics that the gateway itself speaks on: `link` and `link_stats`."""

from __future__ import annotations

import secrets

import msgspec

from gateway.api.model import Quality, Sample
from gateway.core.bus import Bus, Origin, Topic, ValueReading


class OwnTopic:
    """A topic that the gateway itself speaks on."""

    def __init__(self, topic: Topic, bus: Bus, origin: Origin) -> None:
        self._topic = topic
        self._bus = bus
        self._origin: Origin = origin
        self.begin_epoch()

    def begin_epoch(self) -> None:
        """Begin anew: time has gone back."""
        self._epoch = secrets.token_hex(4)
        self._seq = 0

    def publish(self, data: msgspec.Struct, t: int) -> None:
        """Publish the topic's next sample."""
        self._seq += 1
        sample = Sample(
            topic=self._topic.name,
            seq=self._seq,
            epoch=self._epoch,
            t=t,
            q=Quality.GOOD,
            origin=self._origin,
            data=data,
        )
        self._bus.publish(self._topic, ValueReading(sample))
