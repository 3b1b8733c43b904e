"""External Communication: what each word answers, and what never becomes an answer. Source: manual V2.2_A, 10.3."""

from __future__ import annotations

import random
import re
from collections import Counter
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.api.decoder import Event, Frame, Refused, Reject
from vendors.xcore import VENDOR
from vendors.xcore.external import ExternalDecoder, make_decoders, make_reader
from vendors.xcore.external_answers import Answers
from vendors.xcore.external_options import ExternalOptions

EXTERNAL = VENDOR.protocol("external")
ASKING = (
    "motor_on_state", "robot_running_state", "estop_state", "fault_state", "operating_mode", "home_state",
    "collision_state", "task_state", "jnt_pos", "jnt_vel", "jnt_trq", "cart_pos", "list_prog", "current_prog",
    "state", "alarm_info",
)  # fmt: skip
CONTROL = (
    "start", "stop", "clear_alarm", "pp_to_main", "motor_on", "motor_off", "switch_mode", "open_drag", "close_drag",
    "load_prog", "SocketInterface",
)  # fmt: skip
FLAGS = ASKING[:7]
SIX = [0.1, -0.2, 0.3, 0.0, 1.5, -3.0]
TOLD = {
    "cart_pos": "1,2,3,4,5,6,7,8,9,10", "task_state": "ready", "current_prog": "weld", "list_prog": "weld, glue",
    "state": "ready", "alarm_info": "none",
}  # fmt: skip
Values = dict[str, object]


def reader(word: str, suffix: str = "\r", axes: int = 6) -> Answers:
    found = Answers(suffix, axes)
    found.asked(f"{word}{suffix}".encode())
    return found


def values(events: list[Event]) -> Values:
    return {name: value for event in events if isinstance(event, Frame) for name, value in event.values.items()}


def answer(word: str, told: str, suffix: str = "\r", axes: int = 6) -> object:
    (event,) = reader(word, suffix, axes).feed(told.encode())
    assert isinstance(event, Frame)
    assert list(event.values) == [word]
    return event.values[word]


def reject(word: str, told: bytes, axes: int = 6) -> Reject:
    (event,) = reader(word, axes=axes).feed(told)
    assert isinstance(event, Reject)
    assert event.raw == told
    return event


def out_of_step(events: list[Event]) -> str:
    """Why the session ends: the last event says so, and those before it tell no value that was not asked for."""
    assert isinstance(events[-1], Refused)
    assert events[-1].kind == "out_of_step"
    return events[-1].reason


class Talk:
    """A decoder of a robot, and a controller that answers what it likes."""

    def __init__(self, options: ExternalOptions | None = None, rate_hz: float = 10.0) -> None:
        self.make = make_decoders(options or ExternalOptions(), rate_hz)
        self.suffix = (options or ExternalOptions()).suffix
        self.connect()

    def connect(self) -> None:
        decoder = self.make()
        assert isinstance(decoder, ExternalDecoder)
        self.decoder = decoder

    def ask(self, most: int = 100) -> str:
        """Tick until a question is asked."""
        for _ in range(most):
            asked = self.decoder.tick()
            assert isinstance(asked, bytes)
            if asked:
                assert asked.endswith(self.suffix.encode())
                return asked.decode().removesuffix(self.suffix)
        raise AssertionError("nothing is asked")

    def wait(self, most: int = 1000) -> Refused:
        """Tick until the decoder gives up."""
        for _ in range(most):
            told = self.decoder.tick()
            if isinstance(told, Refused):
                return told
            assert told == b""
        raise AssertionError("it waits for ever")

    def hear(self, word: str) -> list[Event]:
        """Answer a word as it should be."""
        return self.decoder.feed(right(word, self.suffix))


def right(word: str, suffix: str = "\r") -> bytes:
    if word in FLAGS:
        return b"true"
    return (TOLD.get(word, "1,2,3,4,5,6") + suffix).encode()


@pytest.mark.parametrize("word", FLAGS)
@pytest.mark.parametrize(("told", "value"), [("true", True), ("false", False), ("null", None)])
def test_a_yes_or_no_is_complete_without_its_suffix(word: str, told: str, value: object) -> None:
    assert answer(word, told) is value


@pytest.mark.parametrize("suffix", ["\r", "\n", "\t", "\r\n", "#END#", ";"])
@pytest.mark.parametrize("cut", range(6))
def test_a_suffix_behind_a_yes_or_no_may_come_late_and_in_pieces(suffix: str, cut: int) -> None:
    found = reader("fault_state", suffix)
    events = found.feed(b"true")
    tail = suffix.encode()
    events += found.feed(tail[:cut]) if tail[:cut] else []
    found.asked(f"task_state{suffix}".encode())
    for byte in tail[cut:] + f"ready{suffix}".encode():
        events += found.feed(bytes([byte]))
    assert values(events) == {"fault_state": True, "task_state": "ready"}
    assert not [event for event in events if not isinstance(event, Frame)]
    assert found.end() == []


def test_a_yes_or_no_with_its_suffix_is_followed_by_one_without() -> None:
    found = reader("fault_state")
    events = found.feed(b"true\r")
    for word in ("estop_state", "home_state", "motor_on_state"):
        found.asked(word.encode() + b"\r")
        events += found.feed(b"false")
    assert values(events) == {
        "fault_state": True,
        "estop_state": False,
        "home_state": False,
        "motor_on_state": False,
    }


def test_a_suffix_that_was_never_completed_is_no_part_of_the_next_answer() -> None:
    found = reader("fault_state", "\r\n")
    assert found.feed(b"true\r")[1:] == []
    assert found.pending == 0
    found.asked(b"task_state\r\n")
    assert values(found.feed(b"ready\r\n")) == {"task_state": "ready"}


@pytest.mark.parametrize(
    ("told", "expected"),
    [
        ("0.1,-0.2,0.3,0,1.5,-3\r", SIX),
        ("0.1;-0.2;0.3;0;1.5;-3\r", SIX),
        ("0.1 -0.2 0.3 0 1.5 -3\r", SIX),
        ("0.1\u3001-0.2\u30010.3\u30010\u30011.5\u3001-3\r", SIX),
        ("0.1, -0.2,\t0.3 ,0;1.5\u3001 -3.\r", SIX),
        ("+.1,-2e-1,3E-1,0.0,15e-1,-3,\r", SIX),
        ("jnt_pos : 0.1,-0.2,0.3,0,1.5,-3\r", SIX),
        ("jnt_pos:0.1,-0.2,0.3,0,1.5,-3\r", SIX),
        ("0.1,-0.2,0.3,0,1.5,-3,0.75,9\r", [*SIX, 0.75, 9.0]),
    ],
)
def test_joint_values_are_found_whatever_separates_them(told: str, expected: list[float]) -> None:
    assert answer("jnt_pos", told) == expected


@pytest.mark.parametrize(
    ("word", "prefix"), [("jnt_vel", "Jnt_vel : "), ("jnt_trq", "Jnt_trq : "), ("jnt_pos", "jnt_pos : ")]
)
def test_the_name_before_joint_values_is_left_out(word: str, prefix: str) -> None:
    assert answer(word, f"{prefix}0.1,-0.2,0.3,0,1.5,-3\r") == SIX


@pytest.mark.parametrize(
    ("word", "told"),
    [
        ("jnt_pos", "Jnt_vel : 0.1,-0.2,0.3,0,1.5,-3\r"),
        ("jnt_trq", "jnt_pos : 0.1,-0.2,0.3,0,1.5,-3\r"),
        ("jnt_pos", "cart_pos : 1,2,3,4,5,6,7,8,9,10\r"),
    ],
)
def test_the_answer_to_another_word_is_rejected_by_its_name(word: str, told: str) -> None:
    assert "the answer to another word" in reject(word, told.encode()).detail


def test_a_pose_has_ten_numbers() -> None:
    told = "cart_pos : 450,-120.5,600.25,180,0,90,0,0.70711,0.70711,0\r"
    assert answer("cart_pos", told) == [450, -120.5, 600.25, 180, 0, 90, 0, 0.70711, 0.70711, 0]
    for wrong in (b"1,2,3,4,5,6\r", b"1,2,3,4,5,6,7,8,9\r", b"1,2,3,4,5,6,7,8,9,10,11\r"):
        assert "not 10" in reject("cart_pos", wrong).detail


def test_fewer_numbers_than_axes_are_rejected_with_what_to_do() -> None:
    found = reject("jnt_pos", b"0.1,0.2,0.3,0.4\r")
    assert found.reason == "answer"
    assert found.detail == "jnt_pos: 4 numbers for 6 axes: if the robot has fewer, set axes"
    assert answer("jnt_pos", "0.1,0.2,0.3,0.4\r", axes=4) == [0.1, 0.2, 0.3, 0.4]


@pytest.mark.parametrize(
    ("word", "told", "expected"),
    [
        ("current_prog", "weld 1\r", "weld 1"),
        ("current_prog", "null\r", None),
        ("current_prog", "\r", None),
        ("list_prog", "weld,焊接\r", "weld,焊接"),
        ("list_prog", "weld\u3000pick\tplace\r", "weld\u3000pick\tplace"),
        ("task_state", " load_identify \r", "load_identify"),
        ("state", "ready\r", "ready"),
        ("alarm_info", "30001\r", "30001"),
    ],
)
def test_a_text_is_told_as_it_is(word: str, told: str, expected: object) -> None:
    assert answer(word, told) == expected


@pytest.mark.parametrize(
    ("word", "told", "reason"),
    [
        ("jnt_pos", b"true\r", "other_word"),
        ("jnt_pos", b"null\r", "other_word"),
        ("jnt_pos", b"\r", "other_word"),
        ("jnt_pos", b"nan,nan,nan,nan,nan,nan\r", "answer"),
        ("jnt_pos", b"inf,1,2,3,4,5\r", "answer"),
        ("jnt_pos", b"1e999,1,2,3,4,5\r", "answer"),
        ("jnt_pos", b"1e10,1,2,3,4,5\r", "answer"),
        ("jnt_pos", b"1,2,3,4,5,6x\r", "answer"),
        ("jnt_pos", b"1,2,,,3,4,5,6 7 8-9\r", "answer"),
        ("jnt_pos", b"1,2,3,4,5,\xff6\r", "encoding"),
        ("current_prog", b"\xe7\x84\r", "encoding"),
        ("current_prog", b"we\x00ld\r", "answer"),
        ("fault_state", b"1,2,3\r", "other_word"),
        ("fault_state", b"TRUE\r", "other_word"),
        ("fault_state", b"\r", "other_word"),
    ],
)
def test_what_is_no_answer_to_its_word_is_rejected(word: str, told: bytes, reason: str) -> None:
    assert reject(word, told).reason == reason


def test_an_answer_without_end_is_bounded_and_names_the_suffix() -> None:
    for chunk in (1, 100, 100_000):
        found = reader("jnt_pos")
        events: list[Event] = []
        stream = b"1," * 50_000
        for at in range(0, len(stream), chunk):
            events += found.feed(stream[at : at + chunk])
            assert found.pending <= 4096
            if events:
                break
        assert values(events) == {}
        assert "'\\r'" in out_of_step(events)


def test_a_long_answer_is_taken_or_not_however_it_is_cut() -> None:
    for length in (4095, 4096, 4097, 5000):
        stream = b"a" * (length - 1) + b"\r"
        whole = values(reader("list_prog").feed(stream))
        found, cut = reader("list_prog"), {}
        for byte in stream:
            events = found.feed(bytes([byte]))
            cut.update(values(events))
            if any(isinstance(event, Refused) for event in events):
                break
        assert whole == cut == ({"list_prog": "a" * (length - 1)} if length <= 4096 else {})


@pytest.mark.parametrize(
    "stray", [b"true", b"1,2,3,4,5,6\r", b"\r", b"\xff", b"x" * 5000], ids=["flag", "numbers", "suffix", "bad", "long"]
)
def test_an_answer_without_a_question_ends_the_session(stray: bytes) -> None:
    events = Talk().decoder.feed(stray)
    assert isinstance(events[0], Reject)
    assert (events[0].raw, events[0].reason) == (stray, "unrequested")
    assert "no question asked for: is the suffix '\\r'?" in out_of_step(events)


@pytest.mark.parametrize(("word", "told"), [("jnt_pos", b"1,2,3,4,5,6\r"), ("fault_state", b"true\r")])
def test_an_answer_that_comes_twice_is_told_once_and_ends_the_session(word: str, told: bytes) -> None:
    joined = reader(word).feed(told * 2)
    found = reader(word)
    apart = [*found.feed(told), *found.feed(told)]
    for events in (joined, apart):
        assert len([event for event in events if isinstance(event, Frame)]) == 1
        assert len(values(events)) == 1
        out_of_step(events)


def test_an_answer_joined_to_the_next_ones_is_never_taken_for_them() -> None:
    events = reader("jnt_pos").feed(b"1,2,3,4,5,6\r9,9,9,9,9,9\rtrue")
    assert values(events) == {"jnt_pos": [1, 2, 3, 4, 5, 6]}
    assert isinstance(events[1], Reject)
    assert events[1].raw == b"9,9,9,9,9,9\rtrue"
    out_of_step(events)


def test_an_answer_after_its_time_is_answered_by_a_new_session_only() -> None:
    talk = Talk()
    word = talk.ask()
    why = talk.wait()
    assert why.kind == "out_of_step"
    assert word in why.reason
    assert "within 2 s" in why.reason
    assert "is External communication on, with the same suffix?" in why.reason


def test_the_reason_of_a_silence_says_when_bytes_came_without_the_suffix() -> None:
    talk = Talk()
    talk.ask()
    assert talk.decoder.feed(b"1,2,3,4,5,6\n") == []
    assert "12 bytes came: is the suffix '\\r'?" in talk.wait().reason


def test_a_slow_answer_in_many_pieces_is_waited_for() -> None:
    talk = Talk()
    word = talk.ask()
    events: list[Event] = []
    for byte in b" " * 200 + right(word):
        assert talk.decoder.tick() == b""  # the link ticks whenever bytes come, once an answer is overdue
        events += talk.decoder.feed(bytes([byte]))
    assert list(values(events)) == [word]


def test_every_cut_tells_the_same() -> None:
    turns = [
        ("jnt_pos", "0.1\u30010.2\u30010.3\u30010.4\u30010.5\u30010.6\r\n", [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]),
        ("fault_state", "false\r\n", False),
        ("current_prog", "焊接\r\n", "焊接"),
        ("estop_state", "true", True),
        ("cart_pos", "cart_pos : 1,2,3,4,5,6,7,8,9,10\r\n", [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]),
    ]
    chance = random.Random(1)  # noqa: S311 - test data
    for size in (1, 2, 3, 0, 0, 0, 0):
        found, events = Answers("\r\n", 6), list[Event]()
        for word, told, _ in turns:
            found.asked(f"{word}\r\n".encode())
            stream = told.encode()
            while stream:
                step = size or chance.randint(1, 9)
                events += found.feed(stream[:step])
                stream = stream[step:]
        assert values(events) == {word: value for word, _, value in turns}
        assert [type(event) for event in events] == [Frame] * len(turns)
        joined = b"".join(event.raw for event in events if isinstance(event, Frame))
        assert joined == "".join(told for _, told, _ in turns).encode()


@pytest.mark.parametrize(
    ("word", "told"),
    [
        ("jnt_pos", b"jnt_pos : 0.1,-0.2,0.3,0,1.5,-3\r"),
        ("cart_pos", b"1,2,3,4,5,6,7,8,9,10\r"),
        ("fault_state", b"true\r"),
        ("task_state", b"ready\r"),
    ],
)
def test_damage_of_any_byte_raises_nothing_and_tells_of_no_other_word(word: str, told: bytes) -> None:
    for at in range(len(told)):
        for byte in range(256):
            found = reader(word)
            hurt = told[:at] + bytes([byte]) + told[at + 1 :]
            events = found.feed(hurt)
            events += found.end()
            assert values(events).keys() <= {word}
            seen = b"".join(event.raw for event in events if not isinstance(event, Refused))
            assert seen == hurt or (word == "fault_state" and seen + b"\r" == hurt)  # the suffix behind a yes or no


def test_one_question_is_outstanding_never_two() -> None:
    talk = Talk()
    for _ in range(30):
        word = talk.ask(most=1)
        for _ in range(5):
            assert talk.decoder.tick() == b""
        talk.hear(word)


def test_questions_share_the_budget_by_their_rates() -> None:
    talk = Talk()
    asked = []
    for _ in range(100):  # ten seconds
        asked.append(talk.ask(most=1))
        talk.hear(asked[-1])
    assert Counter(asked) == {
        "jnt_pos": 20, "cart_pos": 20, "estop_state": 10, "fault_state": 10, "jnt_vel": 5, "jnt_trq": 5,
        "collision_state": 5, "motor_on_state": 5, "robot_running_state": 5, "operating_mode": 5, "task_state": 5,
        "current_prog": 5,
    }  # fmt: skip
    assert set(asked[:20]) == set(asked)  # within the 2 s of the slowest, everything was asked once


def test_nothing_is_asked_more_often_than_wished() -> None:
    words = dict.fromkeys(ASKING, 0.0) | {"jnt_pos": 2.0, "estop_state": 0.5}
    talk = Talk(ExternalOptions(words=words))
    asked = Counter[bytes]()
    for _ in range(200):  # twenty seconds
        found = talk.decoder.tick()
        assert isinstance(found, bytes)
        asked[found] += 1
        if found:
            talk.hear(found.decode().strip())
    assert 39 <= asked[b"jnt_pos\r"] <= 42
    assert 9 <= asked[b"estop_state\r"] <= 12
    assert len(asked) == 3


def test_a_word_that_is_never_answered_while_others_are_is_dropped_and_noted() -> None:
    talk = Talk(ExternalOptions(words={"alarm_info": 1.0}))
    sessions = 0
    while "alarm_info" not in " ".join(talk.decoder.notes):
        sessions += 1
        assert sessions < 5
        for _ in range(40):
            word = talk.ask()
            if word == "alarm_info":
                talk.wait()
                talk.decoder.end()
                break
            talk.hear(word)
        talk.connect()
    assert sessions == 2
    for _ in range(200):
        word = talk.ask()
        assert word != "alarm_info"
        talk.hear(word)
    assert "does not answer alarm_info" in talk.decoder.notes[0]


def test_a_controller_that_closes_at_an_unknown_word_has_it_dropped_the_second_time() -> None:
    talk = Talk(ExternalOptions(words={"alarm_info": 1.0}))
    for _ in range(2):
        while (word := talk.ask()) != "alarm_info":
            talk.hear(word)
        talk.decoder.end()  # it has closed
        talk.connect()
    assert "alarm_info" in talk.decoder.notes[0]


def test_a_word_that_was_answered_once_is_never_dropped() -> None:
    talk = Talk()
    for _ in range(6):
        while (word := talk.ask()) != "jnt_vel":
            talk.hear(word)
        talk.wait()
        talk.decoder.end()
        talk.connect()
        while (word := talk.ask()) != "jnt_vel":
            talk.hear(word)
        talk.hear(word)
    assert talk.decoder.notes == []


def test_a_dead_controller_has_no_word_dropped() -> None:
    talk = Talk()
    talk.hear(talk.ask())
    talk.ask()
    talk.wait()  # it dies over a word that was never answered
    talk.decoder.end()
    for _ in range(20):
        talk.connect()
        talk.ask()
        talk.wait()
        talk.decoder.end()
    assert talk.decoder.notes == []


def test_an_answer_with_another_suffix_has_no_word_dropped() -> None:
    talk = Talk()
    for _ in range(5):
        while (word := talk.ask()) != "jnt_pos":
            talk.hear(word)
        talk.decoder.feed(b"1,2,3,4,5,6\n")
        talk.wait()
        talk.decoder.end()
        talk.connect()
        talk.hear(talk.ask())
    assert talk.decoder.notes == []


def test_a_reader_learns_the_suffix_from_the_question() -> None:
    found = make_reader()
    assert isinstance(found, Answers)
    found.asked(b"task_state#\n")
    assert values(found.feed(b"drag#\n")) == {"task_state": "drag"}


@pytest.mark.parametrize("sent", [b"start\r", b"motor_on\r", b"", b"jnt_pos", b"load_prog x\r", b"\xff\r"])
def test_a_reader_takes_no_other_question(sent: bytes) -> None:
    with pytest.raises(ValueError, match="no word that only asks"):
        Answers("\r", 6).asked(sent)


def test_a_question_that_is_asked_anew_gives_the_earlier_answer_up() -> None:
    found = reader("jnt_pos")
    assert found.feed(b"1,2,3") == []
    found.asked(b"jnt_vel\r")
    events = found.feed(b"1,2,3,4,5,6\r")
    assert isinstance(events[0], Reject)
    assert events[0].raw == b"1,2,3"
    assert values(events) == {"jnt_vel": [1, 2, 3, 4, 5, 6]}


def test_what_is_left_at_the_end_is_a_reject_that_names_the_suffix() -> None:
    found = reader("jnt_pos")
    found.feed(b"1,2,3")
    (left,) = found.end()
    assert (left.raw, left.reason) == (b"1,2,3", "truncated")
    assert "jnt_pos" in left.detail
    assert "'\\r'" in left.detail


def _suffixes() -> st.SearchStrategy[str]:
    return st.one_of(
        st.sampled_from(["\r", "\n", "\r\n", "\t", ";", "#", "op\r", "tart\r", "top", "art", "clear_", "m", "_on\r"]),
        st.text(st.characters(max_codepoint=127), min_size=1, max_size=8),
        st.sampled_from(CONTROL).map(lambda word: word[-8:]),
        st.sampled_from(CONTROL).flatmap(lambda word: st.integers(1, len(word)).map(lambda at: word[at:][:8] or "\r")),
    )


@given(
    suffix=_suffixes(),
    words=st.dictionaries(st.sampled_from(ASKING), st.floats(0, 100), max_size=16),
    axes=st.integers(3, 7),
    answers=st.lists(
        st.one_of(
            st.binary(max_size=60),
            st.sampled_from([b"true", b"false", b"null", b"1,2,3,4,5,6", b"start", b"motor_on", None]),
        ),
        max_size=40,
    ),
)
def test_only_words_that_ask_are_ever_sent(
    suffix: str, words: dict[str, float], axes: int, answers: list[bytes | None]
) -> None:
    try:
        options = ExternalOptions(suffix=suffix, words=words, axes=axes, timeout_s=0.3)
    except ValueError:
        return
    decoder = make_decoders(options, 10.0)()
    sent = b""
    for told in answers:
        asked = decoder.tick()
        if isinstance(asked, Refused):
            decoder.end()
            decoder = make_decoders(options, 10.0)()
            continue
        everything = asked + decoder.outgoing()
        if everything:
            assert re.fullmatch(EXTERNAL.outgoing[0], everything, re.DOTALL)
            assert any(everything == (word + suffix).encode() for word in ASKING)
        sent += everything
        decoder.feed(b"" if told is None else told + suffix.encode())
    sent += decoder.goodbye()
    rest = sent.decode()
    for word in sorted(ASKING, key=len, reverse=True):
        rest = rest.replace(word, "\x00")
    assert not any(control in rest for control in CONTROL)


@pytest.mark.parametrize("suffix", ["start", "\rstop\r", "top", "tart\r", "clear_", "motor_on", "STOP", "op\rstart"])
def test_no_suffix_holds_or_completes_a_word_that_does_something(suffix: str) -> None:
    def sent(word: str) -> bytes:
        return f"{word}{suffix}".encode()

    with pytest.raises(ValueError, match=r"suffix: a word that only asks, with .*, holds '\w+', which does more"):
        ExternalOptions(suffix=suffix)
    if suffix != "clear_":  # it does so with the next question only
        assert not all(re.fullmatch(EXTERNAL.outgoing[0], sent(word)) for word in ASKING)


@pytest.mark.parametrize("control", CONTROL)
def test_no_word_that_does_something_is_among_what_may_be_sent(control: str) -> None:
    for sent in (control, f"{control}\r", f"{control}:auto\r", f"jnt_pos\r{control}\r"):
        assert re.fullmatch(EXTERNAL.outgoing[0], sent.encode(), re.DOTALL) is None
    matches: Callable[[str], object] = lambda word: re.fullmatch(EXTERNAL.outgoing[0], f"{word}\r".encode())  # noqa: E731
    assert all(map(matches, ASKING))
