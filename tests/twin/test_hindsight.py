"""How often the leader turned out to be right."""

from __future__ import annotations

import pytest

from twinmatch.twin.hindsight import Hindsight


def test_it_begins_undecided_and_counts() -> None:
    """With Jeffreys' half a case of either kind, nine right ones and one wrong come to 9.5 of 11."""
    hindsight = Hindsight(1.0)
    assert hindsight.share == 0.5
    for _ in range(9):
        hindsight.add(1.0, 1.0)
    hindsight.add(1.2, 1.0)
    assert hindsight.share == pytest.approx(9.5 / 11.0)


def test_within_three_per_cent_counts_as_right() -> None:
    right, wrong = Hindsight(1.0), Hindsight(1.0)
    right.add(1.029, 1.0)
    wrong.add(1.031, 1.0)
    assert right.share > 0.5 > wrong.share


def test_the_past_is_forgotten() -> None:
    hindsight = Hindsight(0.9)
    for error in (2.0,) * 50 + (1.0,) * 50:
        hindsight.add(error, 1.0)
    assert hindsight.share > 0.98
