"""The options of External Communication, and what may be sent with them."""

from __future__ import annotations

import ipaddress
from typing import Annotated, Literal, cast

import msgspec
from msgspec import Meta

from gateway.api.asking import turns_hz
from vendors.xcore.external_words import CONTROL_WORDS, FLAGS, KINDS, WORDS

_LONGEST_SUFFIX = 8


def _completions(word: str) -> list[str]:
    """What would complete the end of a word to one that does something: `tart` behind `jnt_pos`."""
    found = {(name[:cut], name[cut:]) for name in CONTROL_WORDS for cut in range(1, len(name))}
    return sorted(tail for head, tail in found if word.endswith(head))


def _asking(word: str) -> str:
    wrong = "|".join([*_completions(word), rf"[\s\S]*(?:{'|'.join(CONTROL_WORDS)})"])
    return f"{word}(?!{wrong})"


# A word that only asks and a suffix: no more is ever sent. Nor does a suffix hold a word that does something, or
# complete one.
OUTGOING = f"(?i:{'|'.join(map(_asking, WORDS))})[\\x00-\\x7f]{{1,{_LONGEST_SUFFIX}}}".encode()
Wish = Annotated[float, Meta(ge=0, le=100, description="How often a word is asked, in Hz; 0: never.")]


class ExternalOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the `external` protocol."""

    role: Annotated[
        Literal["client", "server"],
        Meta(description="What the gateway is: client where the controller is set to server, and the reverse."),
    ] = "client"
    listen: Annotated[
        str, Meta(description="Where a gateway that is the server listens: an address of this machine.")
    ] = "127.0.0.1"
    suffix: Annotated[
        str, Meta(min_length=1, max_length=_LONGEST_SUFFIX, description="The suffix that is set on the controller.")
    ] = "\r"
    axes: Annotated[int, Meta(ge=3, le=7, description="Axes of the arm; what is sent beyond them is external.")] = 6
    torque_unit: Annotated[
        Literal["Nm", "permille"] | None,
        Meta(description="Unit of jnt_trq, on which the manual contradicts itself. Not set: effort stays null."),
    ] = None
    timeout_s: Annotated[
        float, Meta(ge=0.1, le=60, description="How long an answer may take before the connection is made anew.")
    ] = 2.0
    words: Annotated[
        dict[str, Wish],
        Meta(description=f"How often each word is asked, in Hz; 0: never. Known: {', '.join(WORDS)}."),
    ] = {}

    def __post_init__(self) -> None:
        unknown = [word for word in self.words if word not in WORDS]
        if unknown:
            raise ValueError(f"words: {unknown[0]!r} is no word that only asks; known are {', '.join(WORDS)}")
        if not any(self.wishes.values()):
            raise ValueError("words: every rate is 0, so nothing would ever be asked")
        if not self.suffix.isascii():
            raise ValueError(f"suffix: {self.suffix!r} has characters that are not ASCII")
        if any(self.suffix in flag.decode() or self.suffix.startswith(flag.decode()) for flag in FLAGS):
            raise ValueError(f"suffix: {self.suffix!r} would be taken for an answer")
        control = next((word for word in CONTROL_WORDS if _told_with(self.suffix, word)), None)
        if control:
            raise ValueError(f"suffix: a word that only asks, with {self.suffix!r}, holds {control!r}, which does more")
        if any(character in "0123456789.+-" for character in self.suffix):
            raise ValueError(f"suffix: {self.suffix!r} would be taken for a part of a number")
        try:
            ipaddress.ip_address("127.0.0.1" if self.listen == "localhost" else self.listen)
        except ValueError:
            raise ValueError(f"listen: {self.listen!r} is no address; 0.0.0.0 is every one of this machine") from None

    @property
    def wishes(self) -> dict[str, float]:
        """How often each word is asked, in Hz."""
        return {name: self.words.get(name, word.wish_hz) for name, word in WORDS.items()}


def _told_with(suffix: str, control: str) -> bool:
    """Whether a word that does something stands in what is sent, other than inside of a word that only asks."""
    suffix, control = suffix.lower(), control.lower()
    return any(
        f"{word}{suffix}{following}".count(control) > word.count(control) + following.count(control)
        for word in WORDS
        for following in WORDS
    )


def slowest_s(options: msgspec.Struct, rate_hz: float) -> float:
    """The longest time between two questions of the same word, in s."""
    wishes = cast("ExternalOptions", options).wishes
    return max(1.0, turns_hz(wishes, KINDS) / rate_hz) / min(wish for wish in wishes.values() if wish > 0)
