"""Numbers of a rule."""

from __future__ import annotations

import pytest

from twinmatch.settings import Rule


class Waiting(Rule):
    """A rule of these tests."""

    least: float = 3.0
    """Shortest time, s."""


def test_the_numbers_of_a_rule_cannot_be_changed_by_those_who_use_it() -> None:
    waiting = Waiting()
    with pytest.raises(AttributeError, match=r"Waiting\.least cannot be changed"):
        waiting.least = 4.0
    with pytest.raises(AttributeError, match=r"Waiting\.other cannot be changed"):
        waiting.other = 4.0  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match=r"Waiting\.least cannot be removed"):
        del waiting.least
    assert waiting.least == Waiting().least == 3.0
