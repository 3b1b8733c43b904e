"""External Communication out of step: answers too many, answers of other words, a suffix that does not fit."""

from __future__ import annotations

import itertools

import pytest

from gateway.api.decoder import Frame, Refused, Reject
from tests.vendors.xcore.test_external import FLAGS, Talk, answer, out_of_step, reject, right, values
from vendors.xcore.external_options import ExternalOptions, slowest_s
from vendors.xcore.external_words import KINDS, WORDS


def odd(talk: Talk, wanted: str, told: bytes) -> str:
    """Answer everything well until a word is asked, and that one oddly: why the session ends."""
    while (word := talk.ask()) != wanted:
        talk.hear(word)
    return out_of_step(talk.decoder.feed(told))


@pytest.mark.parametrize("end", [b"", b"\r"], ids=["bare", "with suffix"])
@pytest.mark.parametrize("before", range(30))
def test_an_answer_that_comes_again_behind_the_next_question_is_no_value_of_it(before: int, end: bytes) -> None:
    talk = Talk()

    def told(word: str) -> bytes:
        return right(word) + (end if word in FLAGS else b"")

    for _ in range(before):
        talk.decoder.feed(told(talk.ask()))
    coming = [told(word := talk.ask())]
    coming.append(coming[0])  # it comes twice, the second time late
    talk.decoder.feed(coming.pop(0))
    for _ in range(4):
        word = talk.ask()
        coming.append(told(word))
        while coming:
            events = talk.decoder.feed(coming.pop(0))
            found = values(events)
            assert found in ({}, {word: values_of(word)})
            if any(isinstance(event, Refused) for event in events):
                out_of_step(events)
                return
            if found:
                break
    raise AssertionError("it is never noticed")


def values_of(word: str) -> object:
    return answer(word, right(word).decode())


def test_two_words_whose_answers_look_alike_are_never_asked_one_after_the_other() -> None:
    talk, asked = Talk(), []
    for _ in range(500):
        asked.append(talk.ask(most=1))
        talk.hear(asked[-1])
    assert all(KINDS[one] != KINDS[after] for one, after in itertools.pairwise(asked))


def test_between_flags_alone_a_turn_stays_empty() -> None:
    words = dict.fromkeys(WORDS, 0.0) | {"fault_state": 5.0, "estop_state": 5.0}
    options = ExternalOptions(words=words)
    talk, asked = Talk(options), []
    for _ in range(100):
        told = talk.decoder.tick()
        assert isinstance(told, bytes)
        asked.append(told)
        if told:
            talk.decoder.feed(b"true")
    assert all(not one or not after or one == after for one, after in itertools.pairwise(asked))
    assert slowest_s(options, 10.0) == pytest.approx(0.4)


def test_each_kind_of_answer_is_none_of_the_others() -> None:
    told = {"flag": b"true\r", "joints": b"1,2,3,4,5,6\r", "pose": b"1,2,3,4,5,6,7,8,9,10\r", "text": b"prog 1\r"}
    for word, kind in KINDS.items():
        for other in told.keys() - {kind}:
            if (kind, other) == ("joints", "pose"):
                continue  # a count of its own
            talk = Talk(ExternalOptions(words={word: 5.0}))
            assert "another word's" in odd(talk, word, told[other]), (word, other)


@pytest.mark.parametrize("told", [b"true\r", b"false\r", b"null\r", b"1,2,3,4,5,6\r", b"7\r", b"\r", b"prog1\r"])
def test_a_task_is_none_of_these(told: bytes) -> None:
    assert reject("task_state", told).reason == "other_word"


def test_a_task_that_the_manual_does_not_list_is_a_task() -> None:
    assert answer("task_state", "self_test\r") == "self_test"


@pytest.mark.parametrize("word", ["current_prog", "list_prog"])
@pytest.mark.parametrize("told", [b"true\r", b"false\r", b"1,2,3\r", b"0.1 -2 3e1\r", b"Jnt_vel : 1,2,3,4,5,6\r"])
def test_a_program_is_none_of_these(word: str, told: bytes) -> None:
    assert reject(word, told).reason == "other_word"


def test_the_count_of_joint_values_never_changes() -> None:
    talk = Talk()
    talk.hear("jnt_pos" if talk.ask() == "jnt_pos" else "")
    assert "8 numbers are more or less than before" in odd(talk, "jnt_pos", b"1,2,3,4,5,6,7,8\r")
    talk.connect()  # another rail: a new session takes the new count
    while (word := talk.ask()) != "jnt_pos":
        talk.hear(word)
    assert values(talk.decoder.feed(b"1,2,3,4,5,6,7,8\r"))


def test_a_pose_is_no_joint_values_of_a_word_that_was_never_answered() -> None:
    talk = Talk()
    told = odd(talk, "jnt_vel", b"1,2,3,4,5,6,7,8,9,10\r")
    assert "jnt_vel: 10 numbers" in told


def test_nothing_is_told_of_an_answer_that_ends_the_session() -> None:
    talk = Talk()
    while (word := talk.ask()) != "fault_state":
        talk.hear(word)
    events = talk.decoder.feed(b"1,2,3,4,5,6\r")
    assert [type(event) for event in events] == [Reject, Refused]


def test_a_word_that_is_always_answered_oddly_is_dropped_the_second_time_and_noted() -> None:
    talk = Talk()
    for _ in range(2):
        assert not talk.decoder.notes
        odd(talk, "collision_state", b"unknown\r")
        talk.decoder.end()
        talk.connect()
    for _ in range(100):
        word = talk.ask()
        assert word != "collision_state"
        talk.hear(word)
    (note,) = talk.decoder.notes
    assert (
        note == "collision_state: b'unknown\\r' is neither true nor false; asked no more until the gateway starts anew"
    )


def test_a_word_that_was_answered_well_is_dropped_only_after_many_odd_answers_in_turn() -> None:
    talk = Talk()
    for _ in range(8):
        odd(talk, "fault_state", b"1,2,3,4,5,6\r")
        talk.connect()
        while (word := talk.ask()) != "fault_state":
            talk.hear(word)
        talk.hear(word)
    assert talk.decoder.notes == []
    for _ in range(5):
        assert talk.decoder.notes == []
        odd(talk, "fault_state", b"1,2,3,4,5,6\r")
        talk.connect()
    assert "fault_state" in talk.decoder.notes[0]


def test_too_few_axes_end_no_session() -> None:
    talk = Talk()
    for _ in range(20):
        word = talk.ask()
        talk.decoder.feed(b"1,2,3,4\r") if KINDS[word] == "joints" else talk.hear(word)
    assert any("if the robot has fewer, set axes" in note for note in talk.decoder.notes)


def test_until_an_answer_ended_with_the_suffix_only_numbers_are_asked() -> None:
    talk = Talk()
    assert KINDS[talk.ask()] in {"joints", "pose"}
    for _ in range(10):
        talk.connect()
        word = talk.ask()
        assert KINDS[word] in {"joints", "pose"}
        assert values(talk.decoder.feed(b"1,2,3,4,5,6\n")) == {}
        told = talk.wait().reason
        assert told == f"connected, but no answer to {word} within 2 s, 12 bytes came: is the suffix '\\r'?"
        talk.decoder.end()


def test_a_suffix_that_the_controller_never_finds_has_no_word_dropped_and_gives_no_value() -> None:
    talk = Talk(ExternalOptions(suffix="\n"))
    for _ in range(50):
        word = talk.ask()
        assert word not in FLAGS
        told = talk.wait().reason
        assert told == (
            f"connected, but no answer to {word} within 2 s; is External communication on, with the same suffix?"
        )
        assert talk.decoder.end() == []
        talk.connect()
    assert talk.decoder.notes == []


def test_a_number_word_that_is_unknown_does_not_keep_the_others_from_being_asked() -> None:
    talk = Talk()
    seen: set[str] = set()
    for _ in range(8):
        for _ in range(40):
            word = talk.ask()
            if word == "jnt_pos":
                talk.wait()
                talk.decoder.end()
                talk.connect()
                break
            seen.update(values(talk.hear(word)))
    assert "does not answer jnt_pos" in talk.decoder.notes[0]
    assert len(seen) == 11


def test_flags_alone_are_asked_without_a_proof_of_the_suffix() -> None:
    talk = Talk(ExternalOptions(words=dict.fromkeys(WORDS, 0.0) | {"fault_state": 1.0}))
    assert talk.ask() == "fault_state"
    assert isinstance(talk.decoder.feed(b"true")[0], Frame)


def test_a_yes_or_no_too_many_without_suffix_is_no_part_of_a_text() -> None:
    talk = Talk()
    while (word := talk.ask()) != "current_prog":
        talk.hear(word)
    out_of_step(talk.decoder.feed(b"truenull1\r"))
    assert answer("current_prog", "nullpunkt\r") == "nullpunkt"
