from __future__ import annotations

from gateway.core.repeats import QUIET_S, Repeats


def test_a_loss_is_said_once_a_minute_with_how_many_were_left_out() -> None:
    repeats = Repeats()
    said = [repeats.loss("stale", second) for second in (0.0, 2.0, 4.0, QUIET_S, QUIET_S + 1)]
    assert said == [0, None, None, 2, None]


def test_another_loss_is_said_at_once() -> None:
    repeats = Repeats()
    assert repeats.loss("stale", 0.0) == 0
    assert repeats.loss("refused", 1.0) == 0


def test_losses_that_take_turns_are_each_said_once_a_minute() -> None:
    repeats = Repeats()
    said = [repeats.loss(what, second) for second, what in enumerate(["stale", "refused"] * 10)]
    assert said == [0, 0] + [None] * 18


def test_a_recovery_is_said_when_its_loss_was() -> None:
    repeats = Repeats()
    assert repeats.recovery()
    repeats.loss("stale", 0.0)
    assert repeats.recovery()
    repeats.loss("stale", 1.0)
    assert not repeats.recovery()
