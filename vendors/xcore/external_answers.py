"""Reads the answers of External Communication, which name neither their word nor their time."""

from __future__ import annotations

from collections.abc import Sequence

from gateway.api.decoder import Event, Frame, Refused, Reject
from gateway.api.polling import Turn
from vendors.xcore.external_words import FLAGS, LONGEST, RECORD, WORDS, BadAnswerError, OtherAnswerError, Word

OTHER_WORD = "other_word"  # why an answer is rejected that can only be another word's
_SHOWN = 40  # bytes of an answer that a message shows


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
        self._bare = False  # what followed a yes or no was not the suffix
        self._turn = Turn[Word]()

    @property
    def asked_for(self) -> Word | None:
        """The word whose answer is awaited."""
        return self._turn.question

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
        if self._turn.question is not None:
            self._given_up, self._buffer, self._may_follow = self._given_up + self._buffer, b"", False
        self._suffix = data[len(name) :]
        self._turn.ask(WORDS[name])

    def feed(self, data: bytes) -> list[Event]:
        """Take received bytes; at most one question is answered by them."""
        if self._given_up:
            raw, self._given_up = self._given_up, b""
            return [Reject(raw, "answer", "an answer that did not end before the next question"), *self.feed(data)]
        self._buffer += data
        word = self._turn.question
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
        self._turn.answered()
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
        if self._suffix.startswith(self._buffer):
            return None
        self._bare = True
        return self._buffer

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
                told = told.removesuffix(self._suffix)
                value = word.parse(word.told_in(self._alone(told).decode()), self._axes)
        except UnicodeDecodeError:
            reason = "encoding" if word.parse is not None else OTHER_WORD
            return Reject(raw, reason, f"the answer to {word.name} is no UTF-8")
        except OtherAnswerError as error:
            return Reject(raw, OTHER_WORD, f"{word.name}: {error}")
        except BadAnswerError as error:
            return Reject(raw, "answer", f"{word.name}: {error}")
        return Frame(raw, RECORD, values={word.name: value})

    def _alone(self, told: bytes) -> bytes:
        """An answer before which no yes or no stands, of a controller that ends none with the suffix."""
        if self._bare and told not in FLAGS and told.startswith(tuple(FLAGS)):
            raise OtherAnswerError(f"{told[:_SHOWN]!r} begins with the answer to another word")
        return told

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
    raise OtherAnswerError(f"{told[:_SHOWN]!r} is neither true nor false")
