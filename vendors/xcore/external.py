"""External Communication, the vendor's text protocol: one word asked, one answer, no names and no times.

    gateway  -> controller   word suffix
    controller -> gateway    true | false | null [suffix]      to a word that asks a yes or no
                             anything suffix                   to every other word

One question is outstanding, never two: a late answer could not be told from the next one. Two words whose answers look
alike are never asked one after the other, so that an answer too many is none to the word after it. What is asked when
is a matter of wished rates within one budget.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import cast

import msgspec

from gateway.api.asking import Rota
from gateway.api.decoder import Event, Frame, Refused, Reject
from gateway.api.vendor import DecoderFactory
from vendors.xcore.external_answers import OTHER_WORD, Answers
from vendors.xcore.external_options import ExternalOptions
from vendors.xcore.external_words import CART_POS, KINDS, WORDS, Word

_STRIKES = 2
_LATER_STRIKES = 5  # of a word that was answered before, one after the other


@dataclass(slots=True)
class Learned:
    """What the sessions with one controller have found out, kept for the run.

    Attributes:
        rota: The words that are asked.
        answered: Words that were answered at least once.
        strikes: How many sessions in turn have ended over a word, by no answer or by one that can only be another's.
        counts: How many joint values came last, by word.
        silent: Words that are asked no more, because nothing comes.
        odd: Words that are asked no more, because what comes is no answer to them; with what came.
    """

    rota: Rota
    answered: set[str] = field(default_factory=set)
    strikes: Counter[str] = field(default_factory=Counter)
    counts: dict[str, int] = field(default_factory=dict)
    silent: list[str] = field(default_factory=list)
    odd: dict[str, str] = field(default_factory=dict)

    def heard(self, word: str) -> None:
        """A word was answered by what may be its own."""
        self.answered.add(word)
        self.strikes.pop(word, None)

    def unanswered(self, word: str) -> None:
        """A session that answered other words has ended over one; the second time it is asked no more.

        Not the first time: the controller may have gone just then, for another reason.
        """
        if word not in self.answered and self._struck_out(word):
            self.silent.append(word)

    def mistaken(self, word: str, why: str) -> None:
        """A session has ended over an answer that can only be another word's: if each does, it is asked no more."""
        if self._struck_out(word):
            self.odd[word] = why

    def takes(self, word: str, count: int) -> bool:
        """Whether so many joint values may be the answer: as many as before, and not those of a pose."""
        known = self.counts.pop(word, None)
        a_pose = known is None and count == CART_POS and self.counts and CART_POS not in self.counts.values()
        if known not in {None, count} or a_pose:
            return False
        self.counts[word] = count
        return True

    def notes(self) -> list[str]:
        """What the operator should know of the words."""
        found = [f"{why}; asked no more until the gateway starts anew" for why in self.odd.values()]
        if self.silent:
            words = ", ".join(self.silent)
            found.append(
                f"the controller does not answer {words}, asked no more until the gateway starts anew; "
                "set its rate to 0"
            )
        return found

    def _struck_out(self, word: str) -> bool:
        self.strikes[word] += 1
        if self.strikes[word] < (_LATER_STRIKES if word in self.answered else _STRIKES):
            return False
        self.rota.drop(word)
        return True


class ExternalDecoder(Answers):
    """One session: asks the words in turn, and reads the answers.

    Until one answer has ended with the suffix nothing is asked but what must end so: a wrong suffix gives no value.

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
        self._first = _first_words(learned.rota.names)
        self._proven = False  # an answer has ended with the suffix
        self._strange_answers: dict[str, str] = {}  # by word: why its last answer was rejected

    @property
    def notes(self) -> list[str]:
        """What the operator should know of the words and of their answers."""
        return [*self._learned.notes(), *self._strange_answers.values()]

    def feed(self, data: bytes) -> list[Event]:
        """Take received bytes; the outstanding question may be answered by them."""
        word = self._turn.question
        self._turn.fed = True
        events = super().feed(data)
        if word is None or self._turn.question is not None:
            return events
        answer, others = cast("Frame | Reject", events[0]), events[1:]
        self._proven = self._proven or not self._first or answer.raw.endswith(self._suffix)
        return [*self._fitting(word, answer), *others]

    def end(self) -> list[Reject]:
        """The session ends: a word to which nothing ever comes, where others are answered, is asked no more."""
        if self._turn.question is not None and self._proven and not self.pending:
            self._learned.unanswered(self._turn.question.name)
        self._proven = False
        return super().end()

    def tick(self) -> bytes | Refused:
        """Return the next question; b"" while one is outstanding, or where none is due."""
        word = self._turn.question
        if word is not None:
            return Refused(self._unanswered(word), "out_of_step") if self._turn.overstays(self._patience) else b""
        if self.pending:
            return (
                Refused(self._strange(self._behind_suffix() or b""), "out_of_step") if self._turn.overstays() else b""
            )
        name = self._learned.rota.next(None if self._proven else self._first or None)
        if name is None:
            return b""
        self._turn.ask(WORDS[name])
        return name.encode() + self._suffix

    def _fitting(self, word: Word, answer: Frame | Reject) -> Sequence[Event]:
        """What an answer tells; one that can only be another word's ends the session."""
        if isinstance(answer, Frame) and word.kind == "joints":
            count = len(cast("list[float]", answer.values[word.name]))
            if not self._learned.takes(word.name, count):
                answer = Reject(answer.raw, OTHER_WORD, f"{word.name}: {count} numbers are more or less than before")
        self._strange_answers.pop(word.name, None)
        if isinstance(answer, Reject) and answer.reason == OTHER_WORD:
            self._learned.mistaken(word.name, answer.detail)
            return [answer, Refused(f"an answer that can only be another word's: {answer.detail}", "out_of_step")]
        self._learned.heard(word.name)
        if isinstance(answer, Reject):
            self._strange_answers[word.name] = f"the answer is of no use: {answer.detail}"
        return [answer]

    def _unanswered(self, word: Word) -> str:
        told = f"no answer to {word.name} within {self._timeout_s:g} s"
        if self._buffer:
            told = f"{told}, {len(self._buffer)} bytes came: is the suffix {self._suffix.decode()!r}?"
        elif not self._proven:
            told = f"{told}; is External communication on, with the same suffix?"
        return told if self._proven else f"connected, but {told}"


def _first_words(asked: Sequence[str]) -> list[str]:
    """Words whose answers must end with the suffix: numbers, or texts where no numbers are asked."""
    numbers = [name for name in asked if KINDS[name] in {"joints", "pose"}]
    return numbers or [name for name in asked if KINDS[name] == "text"]


def make_decoders(options: msgspec.Struct, rate_hz: float) -> DecoderFactory:
    """Make what makes the decoders of one robot; they share what was learned of it."""
    own = cast("ExternalOptions", options)
    learned = Learned(Rota(own.wishes, rate_hz, KINDS))
    return lambda: ExternalDecoder(own, learned, rate_hz)


def make_reader() -> Answers:
    """Make a decoder that only reads, with the default options; it must be told what was asked."""
    return make_observer(ExternalOptions())


def make_observer(options: msgspec.Struct) -> Answers:
    """Make a decoder that reads the sessions of a robot with given options; it must be told what was asked."""
    own = cast("ExternalOptions", options)
    return Answers(own.suffix, own.axes)
