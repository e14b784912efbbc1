"""Where forecasts are made, how they are scored, and the figures of a report card."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.offline.backtest.forecasts import forecast_of, linear_loop, set_points
from twinmatch.dynamics import begin, simulate_closed_loop
from twinmatch.forecasting import HORIZONS, ArxForecast
from twinmatch.offline.backtest.origins import (
    PAST,
    NamedForecast,
    Origin,
    SettledStretch,
    ask,
    origins,
    scores,
)
from twinmatch.offline.backtest.run import with_constant_band
from twinmatch.offline.backtest.scoring import (
    HINDSIGHT,
    BacktestError,
    Marked,
    Marks,
    SignalMarks,
    best_in_hindsight,
    cards,
    common,
    interval_score,
    marks,
    marks_of_each,
    samples_within,
)
from twinmatch.plants import Peltier
from twinmatch.signals import Sample, Window, unbroken


def nothing_changes(origin: Origin) -> ArxForecast:
    """Who has learned nothing yet."""
    past_window = origin.past
    past = np.array([[past_window.output[-1], past_window.input[-1]]])
    return ArxForecast(
        np.zeros((0, 0)),
        np.zeros(0),
        past,
        past[0],
        np.zeros((1, 2)),
        None,
        np.zeros(0),
    )


def window(samples: int, first: int = 0, period: float = 1.0) -> Window:
    values = np.arange(first, first + samples, dtype=float)
    return Window(values, values, values, first=first, period=period)


def origins_of(
    windows: Sequence[Window],
    verdict_samples: Sequence[int],
    interval: float,
    horizons: Sequence[float],
) -> list[Origin]:
    """As a listener chooses them, sample by sample."""
    chosen = []
    for recorded in windows:
        stretch = SettledStretch(recorded.period, len(recorded))
        pace = samples_within(interval, recorded.period)
        wanted = []
        for sample in recorded.samples(0):
            stretch.push(sample)
            if stretch.is_regular(pace) or sample.index in verdict_samples:
                wanted.append(sample.index)
        chosen += origins([stretch.window()], wanted, horizons)
    return chosen


def test_forecasts_begin_at_every_minute_and_every_verdict() -> None:
    chosen = origins_of([window(400)], [75, 119, 380], 60.0, HORIZONS)
    assert [m.sample for m in chosen] == [59, 75, 119, 179, 239, 299, 359, 380]
    assert [m.count for m in chosen] == [300, 300, 280, 220, 160, 100, 40, 19]


def test_nothing_is_forecast_that_cannot_be_judged() -> None:
    assert [
        m.sample for m in origins_of([window(70)], [65, 59, 60], 60.0, HORIZONS)
    ] == [59]
    assert origins_of([window(60)], [], 60.0, HORIZONS) == []


def test_stretches_are_forecast_by_themselves() -> None:
    """After a gap the past starts over, and no forecast reaches over one."""
    samples = [
        Sample(k, k, 50.0, float(k), 0.0) for k in (*range(100), *range(150, 400))
    ]
    windows = [Window.from_samples(stretch, 1.0) for stretch in unbroken(samples)]
    chosen = origins_of(windows, [], 60.0, (10.0, 60.0))
    assert [m.sample for m in chosen] == [59, 209, 269, 329, 389]
    assert (chosen[0].count, chosen[1].count) == (40, 60)
    assert (chosen[1].past.first, chosen[1].past.last) == (150, 209)
    np.testing.assert_array_equal(chosen[1].came.output, np.arange(210.0, 270.0))


def test_the_past_of_an_origin_is_no_longer_than_that_of_any_other() -> None:
    recorded = window(PAST + 500, first=3)
    early, late = origins([recorded], [200, PAST + 300], (60.0,))
    assert (early.past.first, early.past.last) == (3, 200)
    assert (late.past.first, late.past.last) == (301, PAST + 300)


def test_a_stretch_keeps_its_newest_samples() -> None:
    recorded = window(90, first=5)
    stretch = SettledStretch(1.0, 40)
    for k, sample in enumerate(recorded.samples(0)):
        stretch.push(sample)
        if k % 7 == 0:
            newest = stretch.window()
            assert newest.last == sample.index
            assert len(newest) == min(k + 1, 40)
            np.testing.assert_array_equal(newest.output, recorded.output[: k + 1][-40:])


def test_seconds_count_and_not_samples() -> None:
    chosen = origins_of([window(100, period=3.0)], [], 60.0, (10.0, 60.0))
    assert [(m.sample, m.count) for m in chosen] == [
        (19, 20),
        (39, 20),
        (59, 20),
        (79, 20),
    ]
    with pytest.raises(BacktestError, match="shorter than one sample"):
        origins_of([window(100, period=3.0)], [], 60.0, (1.0, 60.0))


@given(
    st.integers(20, 500),
    st.lists(st.integers(0, 600), max_size=20),
    st.integers(1, 200),
)
def test_past_and_future_meet_and_nothing_is_in_both(
    samples: int, verdict_samples: list[int], interval: int
) -> None:
    for origin in origins_of(
        [window(samples, first=7)], verdict_samples, float(interval), (10.0, 100.0)
    ):
        assert origin.past.first == 7
        assert origin.past.last + 1 == origin.came.first
        assert len(origin.came) == len(origin.ahead) == origin.count
        assert 10 <= origin.count <= 100


def test_a_forecast_is_marked_at_the_horizons_that_came() -> None:
    loop = linear_loop(set_points(200, 3), np.random.default_rng(3))
    (origin,) = origins([loop], [119], HORIZONS)
    forecast = ask(nothing_changes(origin), origin)["persistence"]
    perfect = forecast_of(119, loop.output[120:], loop.input[120:])
    marked_horizons, of_perfect = scores(
        "a",
        HORIZONS,
        origin,
        Peltier,
        0,
        [NamedForecast("somebody", "", forecast), NamedForecast("s", "", perfect)],
    )
    assert [(m.session, m.sample, m.who, m.horizon) for m in marked_horizons] == [
        ("a", 119, "somebody", 10.0),
        ("a", 119, "somebody", 60.0),
    ]
    assert [m.who for m in of_perfect] == ["s", "s"]
    assert all(m.marks.error == 0.0 for m in of_perfect)


def test_forecasts_scored_together_have_the_marks_that_each_has_alone() -> None:
    random = np.random.default_rng(5)
    seen = random.random(60) < 0.8
    actual = Window(
        random.normal(50.0, 20.0, 60),
        random.normal(50.0, 20.0, 60),
        random.normal(0.0, 99.0, 60),
        first=10,
        seen=seen,
    )
    forecasts = [
        forecast_of(
            9, random.normal(50.0, 20.0, 60), random.normal(0.0, 99.0, 60), half=half
        )
        for half in ((20.0, 90.0), (np.nan, np.nan), (1.0, 2.0))
    ]
    horizons = [10.0, 59.0]
    together = marks_of_each(forecasts, actual, horizons, Peltier)
    alone = [marks(forecast, actual, horizons, Peltier) for forecast in forecasts]
    assert repr(together) == repr(alone)
    first_ten = seen[:10]
    error = (actual.output - forecasts[2].output.mean)[:10][first_ten]
    rms_of_path = np.sqrt(np.mean(np.square(error / Peltier.output.noise)))
    assert together[2][0].output.rms == pytest.approx(rms_of_path)


def test_without_a_band_there_is_no_coverage_and_no_score() -> None:
    loop = linear_loop(set_points(200, 3), np.random.default_rng(3))
    (origin,) = origins([loop], [119], HORIZONS)
    forecast = ask(nothing_changes(origin), origin)["arx"]
    named = NamedForecast("ARX", "", forecast)
    (marked,) = scores("a", HORIZONS, origin, Peltier, 0, [named])
    (card, _) = cards(marked)
    assert card.median > 0.0
    assert np.isnan([card.coverage_output, card.width_input, card.score]).all()


values = st.lists(
    st.floats(-1e3, 1e3).map(lambda x: round(x, 3)), min_size=1, max_size=40
)
ends = st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)).map(sorted)
confidences = st.floats(0.05, 0.95)


def test_what_lies_outside_an_interval_costs_by_its_distance() -> None:
    """Width 4; 1 below the band and 3 above it cost 2/0.2 = 10 times as much more."""
    score = interval_score(
        np.zeros(3), np.full(3, 4.0), np.array([2.0, -1.0, 7.0]), 0.8
    )
    np.testing.assert_allclose(score, [4.0, 14.0, 34.0], rtol=1e-12)


@given(values, ends, confidences)
def test_no_interval_costs_less_than_the_quantiles(
    came: list[float], interval: list[float], confidence: float
) -> None:
    """The rule is proper: a forecaster who knows the distribution does best by giving its quantiles."""
    x = np.array(came)
    tails = ((1.0 - confidence) / 2.0, (1.0 + confidence) / 2.0)
    low, high = np.quantile(x, tails, method="inverted_cdf")
    truth = interval_score(
        np.full(x.size, low), np.full(x.size, high), x, confidence
    ).mean()
    cost_of_interval = interval_score(
        np.full(x.size, interval[0]), np.full(x.size, interval[1]), x, confidence
    ).mean()
    assert truth <= cost_of_interval + 1e-9 * max(1.0, cost_of_interval)


@pytest.mark.parametrize("confidence", [0.0, 1.0, float("nan")])
def test_an_impossible_confidence_is_refused(confidence: float) -> None:
    with pytest.raises(BacktestError, match="must lie between 0 and 1"):
        interval_score(np.zeros(1), np.ones(1), np.zeros(1), confidence)


def test_marks_count_in_units_of_the_noise() -> None:
    """0.3 and 0.1 °C are 3 and 1 times the output's noise, 14 and 0 counts 2 and 0 times the input's."""
    forecast = forecast_of(9, [50.0, 50.0, 50.0], [20.0, 20.0, 20.0], half=(0.2, 7.0))
    came = Window([60.0] * 3, [50.3, 49.9, 80.0], [34.0, 20.0, 90.0], first=10)
    (mark,) = marks(forecast, came, [2.0], Peltier)
    assert mark.output.rms == pytest.approx(np.sqrt(5.0))
    assert mark.input.rms == pytest.approx(np.sqrt(2.0))
    assert mark.error == pytest.approx(np.sqrt(3.5))
    assert (mark.output.end, mark.input.end) == pytest.approx((-1.0, 0.0))
    assert (mark.output.coverage, mark.input.coverage) == (0.5, 0.5)
    assert (mark.output.width, mark.input.width) == pytest.approx((4.0, 2.0))
    assert mark.output.score == pytest.approx(4.0 + 20.0 * 1.0 / 2.0)
    assert mark.score == pytest.approx((mark.output.score + mark.input.score) / 2.0)


@given(st.integers(1, 30), st.integers(0, 100))
def test_a_forecast_of_the_measurements_has_no_error(count: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    y = random.normal(50.0, 20.0, count)
    u = random.uniform(-255.0, 255.0, count)
    (mark,) = marks(
        forecast_of(0, y, u), Window(y, y, u, first=1), [float(count)], Peltier
    )
    assert mark.error == mark.output.end == mark.input.end == 0.0
    assert mark.output.coverage == mark.input.coverage == 1.0


def test_samples_that_do_not_follow_the_forecast_are_refused() -> None:
    forecast = forecast_of(9, [50.0] * 5, [0.0] * 5)
    with pytest.raises(
        BacktestError, match="made at sample 9 cannot be scored from 12 on"
    ):
        marks(
            forecast,
            Window([50.0] * 5, [50.0] * 5, [0.0] * 5, first=12),
            [5.0],
            Peltier,
        )
    with pytest.raises(BacktestError, match="10 s needs 10 samples; only 5"):
        marks(
            forecast,
            Window([50.0] * 20, [50.0] * 20, [0.0] * 20, first=10),
            [10.0],
            Peltier,
        )


def test_horizons_are_rounded_down_to_whole_samples() -> None:
    assert samples_within(60.0, 1.0) == 60
    assert samples_within(60.0, 0.1) == 600
    assert samples_within(10.0, 3.0) == 3
    with pytest.raises(BacktestError, match="shorter than one sample of 3 s"):
        samples_within(2.0, 3.0)


def marked(
    forecaster: str,
    sample: int,
    error: float,
    horizon: float = 60.0,
    session: str = "a",
) -> Marked:
    signal = SignalMarks(rms=error, end=-error, coverage=0.5, width=2.0, score=3.0)
    return Marked(session, sample, horizon, forecaster, Marks(signal, signal))


def test_a_card_has_the_quantiles_of_its_marks() -> None:
    ours = [marked("leader", k, float(k)) for k in range(1, 11)]
    best = [marked(HINDSIGHT, k, k / 2.0) for k in range(1, 11)]
    card, _ = cards([*ours, *best])
    assert (card.who, card.horizon, card.count) == ("leader", 60.0, 10)
    assert (card.median, card.nine_in_ten) == pytest.approx((5.5, 9.1))
    assert card.ratio == pytest.approx(2.0)
    assert (card.end_output, card.end_input) == pytest.approx((5.5, 5.5))
    assert (card.coverage_output, card.width_output, card.score) == pytest.approx(
        (0.5, 2.0, 3.0)
    )


def test_without_candidates_there_is_no_ratio() -> None:
    (card,) = cards([marked("persistence", 1, 2.0)])
    assert math.isnan(card.ratio)


def test_sessions_and_horizons_are_kept_apart() -> None:
    marked_forecasts = [
        marked("leader", 1, 1.0),
        marked("leader", 1, 3.0, session="b"),
        marked("leader", 1, 9.0, horizon=300.0),
        marked("leader", 1, 5.0, horizon=10.0),
    ]
    assert [(c.horizon, c.count) for c in cards(marked_forecasts)] == [
        (10.0, 1),
        (60.0, 2),
        (300.0, 1),
    ]
    assert len(best_in_hindsight(marked_forecasts)) == 4


def test_all_are_compared_from_the_same_origins() -> None:
    marked_forecasts = [
        marked("one", 1, 1.0),
        marked("one", 2, 1.0),
        marked("other", 2, 1.0),
        marked("other", 3, 1.0),
    ]
    assert [(m.who, m.sample) for m in common(marked_forecasts)] == [
        ("one", 2),
        ("other", 2),
    ]


@given(
    st.lists(
        st.lists(st.floats(0.0, 100.0), min_size=3, max_size=3), min_size=1, max_size=20
    )
)
def test_nobody_beats_the_best_in_hindsight(errors: list[list[float]]) -> None:
    marked_forecasts = [
        marked(f"twin {j}", k, e)
        for k, row in enumerate(errors)
        for j, e in enumerate(row)
    ]
    card_of = {
        c.who: c
        for c in cards([*marked_forecasts, *best_in_hindsight(marked_forecasts)])
    }
    least = np.min(errors, axis=1)
    assert card_of[HINDSIGHT].ratio == 1.0
    assert card_of[HINDSIGHT].median == pytest.approx(np.median(least), rel=1e-12)
    for j in range(3):
        card = card_of[f"twin {j}"]
        assert card.ratio >= 1.0 - 1e-12
        assert card.median >= card_of[HINDSIGHT].median * (1.0 - 1e-12)


def test_the_band_is_that_of_the_residuals_so_far() -> None:
    """Residuals with standard deviations of 0.5 °C and 4 counts: a band of ±1.645 times these at any horizon.

    2000 residuals tell a quantile to some percent.
    """
    rig = Peltier.model().parameters()
    reference = set_points(2000, 5)
    run = simulate_closed_loop(rig, reference, states=begin(rig, 25.0))
    random = np.random.default_rng(6)
    y = run.output + 0.5 * random.standard_normal(2000) * (np.arange(2000) > 5)
    u = run.input + 4.0 * random.standard_normal(2000) * (np.arange(2000) > 5)
    forecast = forecast_of(1999, np.full(300, 50.0), np.full(300, 253.0))
    banded = with_constant_band(forecast, rig, Window(reference, y, u), Peltier.loop)
    np.testing.assert_array_equal(banded.output.mean, np.full(300, 50.0))
    assert np.ptp(banded.output.low) == np.ptp(banded.output.high) == 0.0
    assert banded.output.high[0] - 50.0 == pytest.approx(0.5 * 1.645, rel=0.1)
    assert banded.output.low[0] - 50.0 == pytest.approx(-0.5 * 1.645, rel=0.1)
    assert banded.input.low[0] - 253.0 == pytest.approx(-4.0 * 1.645, rel=0.1)
    assert banded.input.high[0] == 255.0
