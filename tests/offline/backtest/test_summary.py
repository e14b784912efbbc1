"""Report cards: figures by hand, and what holds of any marks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.offline.backtest.scoring import (
    HINDSIGHT,
    Marked,
    Marks,
    SignalMarks,
    best_in_hindsight,
    cards,
    common,
)


def marked(who: str, sample: int, error: float, horizon: float = 60.0, session: str = "a") -> Marked:
    signal = SignalMarks(rms=error, end=-error, coverage=0.5, width=2.0, score=3.0)
    return Marked(session, sample, horizon, who, Marks(signal, signal))


def test_a_card_by_hand() -> None:
    ours = [marked("leader", k, float(k)) for k in range(1, 11)]
    best = [marked(HINDSIGHT, k, k / 2.0) for k in range(1, 11)]
    card, _ = cards([*ours, *best])
    assert (card.who, card.horizon, card.count) == ("leader", 60.0, 10)
    assert (card.median, card.nine_in_ten) == pytest.approx((5.5, 9.1))
    assert card.ratio == pytest.approx(2.0)
    assert (card.end_output, card.end_input) == pytest.approx((5.5, 5.5))
    assert (card.coverage_output, card.width_output, card.score) == pytest.approx((0.5, 2.0, 3.0))


def test_without_candidates_there_is_no_ratio() -> None:
    (card,) = cards([marked("persistence", 1, 2.0)])
    assert math.isnan(card.ratio)


def test_sessions_and_horizons_are_kept_apart() -> None:
    held = [
        marked("leader", 1, 1.0),
        marked("leader", 1, 3.0, session="b"),
        marked("leader", 1, 9.0, horizon=300.0),
        marked("leader", 1, 5.0, horizon=10.0),
    ]
    assert [(c.horizon, c.count) for c in cards(held)] == [(10.0, 1), (60.0, 2), (300.0, 1)]
    assert len(best_in_hindsight(held)) == 4


def test_all_are_compared_from_the_same_origins() -> None:
    held = [marked("one", 1, 1.0), marked("one", 2, 1.0), marked("other", 2, 1.0), marked("other", 3, 1.0)]
    assert [(m.who, m.sample) for m in common(held)] == [("one", 2), ("other", 2)]


@given(st.lists(st.lists(st.floats(0.0, 100.0), min_size=3, max_size=3), min_size=1, max_size=20))
def test_nobody_beats_the_best_in_hindsight(errors: list[list[float]]) -> None:
    held = [marked(f"twin {j}", k, e) for k, row in enumerate(errors) for j, e in enumerate(row)]
    found = {c.who: c for c in cards([*held, *best_in_hindsight(held)])}
    least = np.min(errors, axis=1)
    assert found[HINDSIGHT].ratio == 1.0
    assert found[HINDSIGHT].median == pytest.approx(np.median(least), rel=1e-12)
    for j in range(3):
        card = found[f"twin {j}"]
        assert card.ratio >= 1.0 - 1e-12
        assert card.median >= found[HINDSIGHT].median * (1.0 - 1e-12)
