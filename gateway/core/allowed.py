"""The written list of what may be sent to a controller, held to while the gateway runs: anything else stays here."""

from __future__ import annotations

import re
from collections.abc import Sequence

from gateway.api.decoder import Decoder, Refused
from gateway.errors import VendorError

_SHOWN = 40  # bytes of what was not sent


class AllowedDecoder:
    """Wraps a plugin's decoder: bytes that no pattern of its protocol matches whole are never sent.

    Args:
        decoder: Reads one session.
        vendor: Name of the plugin.
        patterns: `Protocol.outgoing`.
    """

    __slots__ = ("_decoder", "_patterns", "_vendor", "end", "feed")

    def __init__(self, decoder: Decoder, vendor: str, patterns: Sequence[bytes]) -> None:
        self._decoder = decoder
        self._vendor = vendor
        self._patterns = [re.compile(pattern, re.DOTALL) for pattern in patterns]
        self.feed = decoder.feed
        self.end = decoder.end

    @property
    def ready(self) -> bool:
        """Whether the handshake is done."""
        return self._decoder.ready

    @property
    def notes(self) -> Sequence[str]:
        """What the operator should know of this session."""
        return self._decoder.notes

    @property
    def gaps(self) -> int | None:
        """How many frames are missing."""
        return self._decoder.gaps

    def outgoing(self) -> bytes:
        """Return the bytes owed to the controller now.

        Raises:
            VendorError: They may not be sent.
        """
        return self._checked(self._decoder.outgoing())

    def tick(self) -> bytes | Refused:
        """Return the next request or a retry.

        Raises:
            VendorError: It may not be sent.
        """
        asked = self._decoder.tick()
        return asked if isinstance(asked, Refused) else self._checked(asked)

    def goodbye(self) -> bytes:
        """Return the bytes owed before a wanted close.

        Raises:
            VendorError: They may not be sent.
        """
        return self._checked(self._decoder.goodbye())

    def _checked(self, data: bytes) -> bytes:
        if data and not any(pattern.fullmatch(data) for pattern in self._patterns):
            more = "…" if len(data) > _SHOWN else ""
            raise VendorError(
                self._vendor,
                f"it would send {data[:_SHOWN]!r}{more}, which its protocol's list `outgoing` does not allow: not sent",
            )
        return data
