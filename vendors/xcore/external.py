"""External Communication, the vendor's text protocol: one word asked, one answer, no names and no times.

    gateway  -> controller   word suffix
    controller -> gateway    true | false | null [suffix]      to a word that asks a yes or no
                             anything suffix                   to every other word

One question is outstanding, never two: a late answer could not be told from the next one. What is asked when is a
matter of wished rates within one budget.
"""

from __future__ import annotations

import ipaddress
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal, cast

import msgspec
from msgspec import Meta

from gateway.api.asking import Rota
from gateway.api.decoder import Event, Frame, Refused, Reject
from gateway.api.vendor import DecoderFactory
from vendors.xcore.external_words import CONTROL_WORDS, FLAGS, LONGEST, RECORD, WORDS, BadAnswerError, Word

_LONGEST_SUFFIX = 8
_STRIKES = 2
_SHOWN = 40  # bytes of an answer that a message shows
_BAD_ANSWER = {"answer", "encoding"}
_GRACE_TICKS = 5  # unexplained bytes may wait so long for a rest that explains them


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
    wishes = [wish for wish in cast("ExternalOptions", options).wishes.values() if wish > 0]
    return max(1.0, sum(wishes) / rate_hz) / min(wishes)


class Answers:
    """Reads the answers to words that were asked; it is told of each one when it is sent.

    Args:
        suffix: What ends an answer, and may stand behind a yes or no; a question that ends otherwise says it anew.
        axes: How many joint values an answer has at least.
    """

    ready = True
    gaps = None

    def __init__(self, suffix: str, axes: int) -> None:
        self._suffix = suffix.encode()
        self._axes = axes
        self._buffer = b""
        self._given_up = b""  # what came of an answer before its word was asked again
        self._may_follow = False  # the suffix of a yes or no, which may come or not
        self.asked_for: Word | None = None

    @property
    def notes(self) -> Sequence[str]:
        """Nothing: who only reads knows of no session."""
        return ()

    @property
    def pending(self) -> int:
        """How many bytes wait that no question explains."""
        rest = self._behind_suffix()
        return 0 if rest is None else len(rest)

    def asked(self, data: bytes) -> None:
        """Take what was sent: one word and the suffix. An earlier question without an answer is given up.

        Raises:
            ValueError: It is no word that only asks.
        """
        text = data.decode("ascii", "replace")
        name = next((word for word in WORDS if text.startswith(word) and text != word), None)
        if name is None:
            raise ValueError(f"{text[:40]!r} is no word that only asks, with a suffix")
        if self.asked_for is not None:
            self._given_up, self._buffer, self._may_follow = self._given_up + self._buffer, b"", False
        self._suffix = data[len(name) :]
        self.asked_for = WORDS[name]

    def feed(self, data: bytes) -> list[Event]:
        """Take received bytes; at most one question is answered by them."""
        if self._given_up:
            raw, self._given_up = self._given_up, b""
            return [Reject(raw, "answer", "an answer that did not end before the next question"), *self.feed(data)]
        self._buffer += data
        word = self.asked_for
        if word is None:
            return self._unasked()
        rest = self._behind_suffix()
        if rest is None:
            return []
        skipped = len(self._buffer) - len(rest)
        length = self._flag_length(rest) if word.parse is None else self._line_length(rest)
        if (len(rest) if length is None else length) > LONGEST:
            return self._too_long()
        if length is None:
            return []
        raw, self._buffer = self._buffer[: skipped + length], self._buffer[skipped + length :]
        self.asked_for = None
        self._may_follow = word.parse is None and not raw.endswith(self._suffix)
        return [self._answer(word, raw, raw[skipped:]), *(self._unasked() if self._buffer else [])]

    def end(self) -> list[Reject]:
        """Return what is left in the buffer; the suffix of a yes or no is nothing."""
        left, self._buffer, self._given_up = self._given_up + self._buffer, b"", b""
        if not left or (self._may_follow and left == self._suffix):
            return []
        asked = f"the answer to {self.asked_for.name}" if self.asked_for else "nothing that was asked"
        return [Reject(left, "truncated", f"{len(left)} bytes of {asked}: is the suffix {self._suffix.decode()!r}?")]

    def outgoing(self) -> bytes:
        """Nothing is owed between questions."""
        return b""

    def tick(self) -> bytes | Refused:
        """Nothing is asked: who only reads is told what was."""
        return b""

    def goodbye(self) -> bytes:
        """Nothing is owed before a close."""
        return b""

    def _behind_suffix(self) -> bytes | None:
        """What stands behind a suffix left over from a yes or no; None while its bytes may still come."""
        if not self._may_follow:
            return self._buffer
        if self._buffer.startswith(self._suffix):
            return self._buffer[len(self._suffix) :]
        return None if self._suffix.startswith(self._buffer) else self._buffer

    def _flag_length(self, rest: bytes) -> int | None:
        """Bytes of a yes or no; of anything else to the suffix."""
        for text in FLAGS:
            if rest.startswith(text):
                return len(text)
        return None if any(text.startswith(rest) for text in FLAGS) else self._line_length(rest)

    def _line_length(self, rest: bytes) -> int | None:
        at = rest.find(self._suffix)
        return None if at < 0 else at + len(self._suffix)

    def _answer(self, word: Word, raw: bytes, told: bytes) -> Event:
        try:
            if word.parse is None:
                value: object = FLAGS[told] if told in FLAGS else _no_flag(told)
            else:
                value = word.parse(word.told_in(told.removesuffix(self._suffix).decode()), self._axes)
        except UnicodeDecodeError:
            return Reject(raw, "encoding", f"the answer to {word.name} is no UTF-8")
        except BadAnswerError as error:
            return Reject(raw, "answer", f"{word.name}: {error}")
        return Frame(raw, RECORD, values={word.name: value})

    def _unasked(self) -> list[Event]:
        """Bytes that nobody asked for mean that the stream is out of step; what may be a suffix waits."""
        rest = self._behind_suffix()
        if not rest:
            return []
        raw, self._buffer = self._buffer, b""
        told = self._strange(rest)
        return [Reject(raw, "unrequested", told), Refused(told, "out_of_step")]

    def _strange(self, rest: bytes) -> str:
        shown = rest if len(rest) <= _SHOWN else rest[:_SHOWN] + b"..."
        return f"{shown!r} came, which no question asked for: is the suffix {self._suffix.decode()!r}?"

    def _too_long(self) -> list[Event]:
        raw, self._buffer = self._buffer, b""
        told = (
            f"more than {LONGEST} bytes without the suffix {self._suffix.decode()!r}: is it set so on the controller?"
        )
        return [Reject(raw, "too_long", told), Refused(told, "out_of_step")]


def _no_flag(told: bytes) -> object:
    raise BadAnswerError(f"{told[:_SHOWN]!r} is neither true nor false")


@dataclass(slots=True)
class Learned:
    """What the sessions with one controller have found out, kept for the run.

    Attributes:
        rota: The words that are asked.
        answered: Words that were answered at least once.
        strikes: How often a word was left unanswered at the end of a session that answered others.
        dropped: Words that are asked no more.
    """

    rota: Rota
    answered: set[str] = field(default_factory=set)
    strikes: Counter[str] = field(default_factory=Counter)
    dropped: list[str] = field(default_factory=list)

    def unanswered(self, word: str) -> None:
        """A session that answered other words has ended over one; the second time it is asked no more.

        Not the first time: the controller may have gone just then, for another reason.
        """
        if word in self.answered:
            return
        self.strikes[word] += 1
        if self.strikes[word] >= _STRIKES:
            self.rota.drop(word)
            self.dropped.append(word)

    def notes(self) -> list[str]:
        """What the operator should know of the words."""
        if not self.dropped:
            return []
        words = ", ".join(self.dropped)
        return [
            f"the controller does not answer {words}, asked no more until the gateway starts anew; set its rate to 0"
        ]


class ExternalDecoder(Answers):
    """One session: asks the words in turn, and reads the answers.

    Args:
        options: The robot's options.
        learned: What earlier sessions have found out; completed by this one.
        rate_hz: How often it is ticked.
    """

    def __init__(self, options: ExternalOptions, learned: Learned, rate_hz: float) -> None:
        super().__init__(options.suffix, options.axes)
        self._learned = learned
        self._timeout_s = options.timeout_s
        self._patience = math.ceil(options.timeout_s * rate_hz)
        self._waited = 0
        self._fed = False
        self._heard = False
        self._strange_answers: dict[str, str] = {}  # by word: why its last answer was rejected

    @property
    def notes(self) -> list[str]:
        """What the operator should know of the words and of their answers."""
        return [*self._learned.notes(), *self._strange_answers.values()]

    def feed(self, data: bytes) -> list[Event]:
        """Take received bytes; the outstanding question may be answered by them."""
        word = self.asked_for
        self._fed = True
        events = super().feed(data)
        if word is not None and self.asked_for is None:
            self._waited = 0
            self._heard = True
            self._learned.answered.add(word.name)
            self._strange_answers.pop(word.name, None)
            bad = [event.detail for event in events if type(event) is Reject and event.reason in _BAD_ANSWER]
            if bad:
                self._strange_answers[word.name] = f"the answer is of no use: {bad[0]}"
        return events

    def end(self) -> list[Reject]:
        """The session ends: a word to which nothing ever comes, where others are answered, is asked no more."""
        if self.asked_for is not None and self._heard and not self.pending:
            self._learned.unanswered(self.asked_for.name)
        self._heard = False
        return super().end()

    def tick(self) -> bytes | Refused:
        """Return the next question; b"" while one is outstanding, or where none is due."""
        fed, self._fed = self._fed, False
        if self.asked_for is not None or self.pending:
            if fed:  # it is bytes that wake an overdue tick, not only time; who sends for ever meets the stale deadline
                return b""
            self._waited += 1
            if self.asked_for is not None and self._waited > self._patience:
                return Refused(self._unanswered(self.asked_for), "out_of_step")
            if self.asked_for is None and self._waited > _GRACE_TICKS:
                return Refused(self._strange(self._behind_suffix() or b""), "out_of_step")
            return b""
        self._waited = 0
        name = self._learned.rota.next()
        if name is None:
            return b""
        self.asked_for = WORDS[name]
        return name.encode() + self._suffix

    def _unanswered(self, word: Word) -> str:
        came = f", {len(self._buffer)} bytes came: is the suffix {self._suffix.decode()!r}?" if self._buffer else ""
        hint = "" if self._heard or came else "; is External communication on, with the same suffix?"
        return f"no answer to {word.name} within {self._timeout_s:g} s{came}{hint}"


def make_decoders(options: msgspec.Struct, rate_hz: float) -> DecoderFactory:
    """Make what makes the decoders of one robot; they share what was learned of it."""
    own = cast("ExternalOptions", options)
    learned = Learned(Rota(own.wishes, rate_hz))
    return lambda: ExternalDecoder(own, learned, rate_hz)


def make_reader() -> Answers:
    """Make a decoder that only reads, with the default options; it must be told what was asked."""
    options = ExternalOptions()
    return Answers(options.suffix, options.axes)
