"""What each door has delivered since the gateway started: plain numbers that `/metrics` reads."""

from __future__ import annotations

from dataclasses import dataclass

from aiohttp import web

from gateway.api.messages import Missed


@dataclass(slots=True)
class Traffic:
    """The numbers of one door.

    Attributes:
        clients: How many are connected now.
        n_bytes: Bytes sent.
        missed_samples: Samples that clients asked for and did not get.
        missed_events: Events that clients asked for and that were gone, where their number was known.
        sent_away: Clients that were cut off for not reading.
    """

    clients: int = 0
    n_bytes: int = 0
    missed_samples: int = 0
    missed_events: int = 0
    sent_away: int = 0

    def miss(self, told: Missed) -> None:
        """A client is told what it missed."""
        self.missed_samples += sum(told.samples.values())
        self.missed_events += told.events or 0


class Doors(dict[str, Traffic]):
    """The traffic by the door's name, made when first asked for."""

    def __missing__(self, door: str) -> Traffic:
        self[door] = made = Traffic()
        return made


DOORS = web.AppKey("doors", Doors)
