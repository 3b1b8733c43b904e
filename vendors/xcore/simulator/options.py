"""The options of the virtual xCore controller, for both of its protocols."""

from __future__ import annotations

import re
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

HIGHEST_PORT = 65535
_ESCAPES = {"b": "\b", "t": "\t", "n": "\n", "f": "\f", "r": "\r", '"': '"', "\\": "\\"}
_ESCAPE = re.compile(r"\\(?:u([0-9A-Fa-f]{4})|(.?))", re.DOTALL)
_HOST_PORT = re.compile(r"(?:\[([0-9A-Fa-f:.]+)\]|([^\s:\[\]]+)):([0-9]{1,5})")


class XcoreOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options of the virtual xCore controller."""

    axes: Annotated[int, Meta(ge=6, le=7, description="Axes of the arm; the seventh stays still.")] = 6
    extra_joints: Annotated[
        int, Meta(ge=0, le=7, description="Further values behind those of the axes, as of external axes.")
    ] = 0
    external_calls: Annotated[
        str,
        Meta(
            description="External communication: the gateway, as HOST:PORT, that the controller calls over TCP; "
            "it does not listen then."
        ),
    ] = ""
    suffix: Annotated[
        str,
        Meta(min_length=1, description=r"External communication: what ends a word; \r, \n, \t and \u0020 are escapes."),
    ] = r"\r"
    suffix_after_booleans: Annotated[
        bool, Meta(description="External communication: true and false have the suffix too.")
    ] = False
    separator: Annotated[
        Literal[",", ";", " ", "、"], Meta(description="External communication: what stands between numbers.")
    ] = ","
    estop_level: Annotated[
        Literal["high", "low"],
        Meta(description="External communication: high: true is a pressed emergency stop; low: true is none."),
    ] = "high"
    torque_unit: Annotated[
        Literal["Nm", "permille"],
        Meta(description="External communication: unit of the torques; permille of the rated motor torque."),
    ] = "Nm"
    unknown_words: Annotated[
        str, Meta(description="External communication: words, with commas, that this controller does not know.")
    ] = ""
    slow_ms: Annotated[
        int, Meta(ge=0, le=60_000, description="External communication: time that each answer takes, in ms.")
    ] = 0
    objects_hz: Annotated[float, Meta(ge=1, le=1000, description="Objects: states a second.")] = 50.0
    commands_hz: Annotated[
        float,
        Meta(ge=0, le=5000, description="Objects: command objects a second while the program runs; 0: none."),
    ] = 0.5
    commands_per_list: Annotated[
        int, Meta(ge=1, le=100, description="Objects: commands of one moveAppend; a MoveWait stands alone.")
    ] = 5
    overlong_s: Annotated[
        float, Meta(ge=0, description="Objects: time between lines that are too long, in s; 0: there are none.")
    ] = 0.0

    def __post_init__(self) -> None:
        """Check what types cannot say.

        Raises:
            ValueError: The suffix has an unknown escape, or the gateway's address is none.
        """
        _ = self.ending, self.gateway

    @property
    def ending(self) -> bytes:
        """What ends a word, on the wire."""
        return _unescaped(self.suffix).encode("utf-8")

    @property
    def gateway(self) -> tuple[str, int] | None:
        """Whom External Communication calls: host and port; None: it listens."""
        if not self.external_calls:
            return None
        found = _HOST_PORT.fullmatch(self.external_calls)
        if found is None or not 0 < int(found[3]) <= HIGHEST_PORT:
            raise ValueError(f"external_calls is {self.external_calls!r}: it is HOST:PORT, with a port of 1 to 65535")
        return found[1] or found[2], int(found[3])

    @property
    def unknown(self) -> frozenset[str]:
        """The words that this controller does not know."""
        return frozenset(filter(None, (word.strip() for word in self.unknown_words.split(","))))


def _unescaped(text: str) -> str:
    """Read the escapes of a TOML string."""

    def one(found: re.Match[str]) -> str:
        if found[1]:
            return chr(int(found[1], 16))
        if found[2] not in _ESCAPES:
            raise ValueError(rf"suffix {text!r} has an unknown escape; there are \b \t \n \f \r \" \\ and \u0020")
        return _ESCAPES[found[2]]

    return _ESCAPE.sub(one, text)
