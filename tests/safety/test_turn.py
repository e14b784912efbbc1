"""Whose turn it is to move the plant."""

from __future__ import annotations

from twinmatch.safety import Mover, Turn


def test_one_at_a_time_until_the_turn_is_given_back() -> None:
    """Also for another of the same kind; and nobody ends the turn of another."""
    turn = Turn()
    assert turn.take(Mover.EXPERIMENT) == ""
    assert turn.take(Mover.LAW) == turn.take(Mover.EXPERIMENT) == Mover.EXPERIMENT.value
    turn.give_back(Mover.LAW)
    assert turn.mover is Mover.EXPERIMENT
    turn.give_back(Mover.EXPERIMENT)
    assert turn.take(Mover.LAW) == ""


def test_a_law_on_trial_has_the_turn_although_it_has_not_asked() -> None:
    turn = Turn()
    turn.observe(Mover.LAW)
    assert turn.take(Mover.EXPERIMENT) == Mover.LAW.value
    turn.give_back(Mover.LAW)
    assert turn.mover is None
