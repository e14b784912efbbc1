"""When forecasts are asked for, and what they may know."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.offline.backtest.forecasts import forecast_of, linear_loop, set_points
from twinmatch.forecasting import HORIZONS
from twinmatch.offline.backtest.origins import Origin, ask, mark, origins, regular, stretches
from twinmatch.offline.backtest.peer import BacktestError
from twinmatch.offline.backtest.peers import Persistence
from twinmatch.plants import Peltier
from twinmatch.signals import Sample, Window


def window(samples: int, first: int = 0, period: float = 1.0) -> Window:
    values = np.arange(first, first + samples, dtype=float)
    return Window(values, values, values, first=first, period=period)


def at(held: Sequence[Window], told: Sequence[int], every: float, horizons: Sequence[float]) -> list[Origin]:
    return origins(held, [*regular(held, every), *told], horizons)


def test_every_minute_and_every_verdict() -> None:
    found = at([window(400)], [75, 119, 380], 60.0, HORIZONS)
    assert [m.sample for m in found] == [59, 75, 119, 179, 239, 299, 359, 380]
    assert [m.count for m in found] == [300, 300, 280, 220, 160, 100, 40, 19]


def test_nothing_is_forecast_that_cannot_be_judged() -> None:
    assert [m.sample for m in at([window(70)], [65, 59, 60], 60.0, HORIZONS)] == [59]
    assert at([window(60)], [], 60.0, HORIZONS) == []


def test_stretches_are_forecast_by_themselves() -> None:
    """After a gap the past starts over, and no forecast reaches over one."""
    samples = [Sample(k, k, 50.0, float(k), 0.0) for k in (*range(100), *range(150, 400))]
    held = stretches(samples, 1.0)
    found = at(held, [], 60.0, (10.0, 60.0))
    assert [m.sample for m in found] == [59, 209, 269, 329, 389]
    assert (found[0].count, found[1].count) == (40, 60)
    assert (found[1].past.first, found[1].past.last) == (150, 209)
    np.testing.assert_array_equal(found[1].came.output, np.arange(210.0, 270.0))


def test_seconds_count_and_not_samples() -> None:
    found = at([window(100, period=3.0)], [], 60.0, (10.0, 60.0))
    assert [(m.sample, m.count) for m in found] == [(19, 20), (39, 20), (59, 20), (79, 20)]
    with pytest.raises(BacktestError, match="shorter than one sample"):
        at([window(100, period=3.0)], [], 60.0, (1.0, 60.0))


@given(st.integers(20, 500), st.lists(st.integers(0, 600), max_size=20), st.integers(1, 200))
def test_past_and_future_meet_and_nothing_is_in_both(samples: int, told: list[int], every: int) -> None:
    for origin in at([window(samples, first=7)], told, float(every), (10.0, 100.0)):
        assert origin.past.first == 7
        assert origin.past.last + 1 == origin.came.first
        assert len(origin.came) == len(origin.ahead) == origin.count
        assert 10 <= origin.count <= 100


def test_a_forecast_is_marked_at_the_horizons_that_came() -> None:
    loop = linear_loop(set_points(200, 3), np.random.default_rng(3))
    (origin,) = origins([loop], [119], HORIZONS)
    forecast = ask(Persistence(Peltier), origin)
    assert forecast is not None
    found = mark("a", "somebody", forecast, origin, horizons=HORIZONS, plant=Peltier)
    assert [(m.session, m.sample, m.who, m.horizon) for m in found] == [
        ("a", 119, "somebody", 10.0),
        ("a", 119, "somebody", 60.0),
    ]
    perfect = forecast_of(119, loop.output[120:], loop.input[120:])
    assert all(
        m.marks.error == 0.0 for m in mark("a", "s", perfect, origin, horizons=HORIZONS, plant=Peltier)
    )


def test_who_knows_too_little_says_nothing() -> None:
    (origin,) = origins([window(40)], [10], (10.0,))
    assert ask(Persistence(Peltier), origin) is None
