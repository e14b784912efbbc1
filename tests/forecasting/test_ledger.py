"""What forecasts cost, in characters."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import laplace, norm

from tests.support.plants import Tank
from twinmatch.dynamics import Controller, PidGains
from twinmatch.forecasting import (
    CONFIDENCE,
    Arx,
    Calibration,
    Ledger,
    StateFilter,
    leads_of,
)
from twinmatch.signals import FloatArray, Sample

NOISE = np.array([0.1, 7.0])
PERSISTENCE = "nothing changes"
ARX = "a small model"


def entered(
    errors: dict[str, FloatArray],
    forgetting: float = 1.0,
    noise: FloatArray = NOISE,
    horizons: int = 1,
) -> Ledger:
    """A ledger after one forecast for each column, shape (2, n) by name; the baselines may be the same."""
    ledger = Ledger(np.ones(horizons), noise, forgetting)
    names = [name for name in errors if name not in {PERSISTENCE, ARX}]
    came = np.array([errors[name] for name in names])
    baselines = np.array([errors[PERSISTENCE], errors.get(ARX, errors[PERSISTENCE])])
    for column in range(came.shape[2]):
        for horizon in range(horizons):
            ledger.add(
                names,
                came[..., column : column + 1],
                baselines[..., column : column + 1],
                horizon,
            )
    return ledger


def drawn(scale: float, samples: int, seed: int) -> FloatArray:
    return np.random.default_rng(seed).laplace(
        0.0, scale * NOISE[:, None], (2, samples)
    )


def test_the_price_is_minus_the_logarithm_of_the_density() -> None:
    """Many errors of known width: the mean price is the entropy of Laplace's distribution in digits, and the
    gain the difference of two of them, by scipy's density."""
    n = 2000
    good = drawn(0.5, n, 1)
    poor = drawn(4.0, n, 2)
    gain = entered({PERSISTENCE: poor, "a": good}).gains(["a"])[0, 0]
    priced = sum(
        np.mean(-laplace.logpdf(e[k], scale=s * NOISE[k]) / np.log(10.0)) * sign
        for sign, e, s in ((1.0, poor, 4.0), (-1.0, good, 0.5))
        for k in range(2)
    )
    # Widths are learned on the way: that costs some half log10(n) characters in all.
    assert gain == pytest.approx(priced, abs=5 * np.log10(n) / n + 0.01)
    # standard error of the mean price 0.019
    assert gain == pytest.approx(2 * np.log10(8.0), abs=0.06)


def test_who_forecasts_better_saves_more_and_persistence_saves_nothing() -> None:
    poor = drawn(4.0, 200, 1)
    ledger = entered(
        {
            PERSISTENCE: poor,
            "a": drawn(0.5, 200, 2),
            "b": drawn(0.6, 200, 3),
            "same": poor,
        }
    )
    a, b, as_persistence = ledger.gains(["a", "b", "same"])[:, 0]
    assert a > b > as_persistence
    only = entered({PERSISTENCE: poor, "same": poor}).gains(["same"])
    assert only[0, 0] == pytest.approx(0.0, abs=1e-12)


def test_a_boast_does_not_pay() -> None:
    """The width follows from earlier errors, so a single large error after many small ones costs dearly."""
    steady = drawn(1.0, 100, 1)
    calm = np.append(drawn(0.31, 99, 1), 40.0 * NOISE[:, None], axis=1)
    ledger = entered(
        {PERSISTENCE: drawn(5.0, 100, 2), "steady": steady, "calm": calm},
        forgetting=0.9,
    )
    steady_gain, calm_gain = ledger.gains(["steady", "calm"])[:, 0]
    assert steady_gain > calm_gain


@settings(deadline=None, max_examples=30)
@given(st.floats(1e-3, 1e3))
def test_units_do_not_matter(unit: float) -> None:
    errors = {PERSISTENCE: drawn(3.0, 20, 1), "a": drawn(1.0, 20, 2)}
    scaled = {name: unit * e for name, e in errors.items()}
    ledger = entered(errors)
    scaled_ledger = entered(scaled, noise=unit * NOISE)
    assert scaled_ledger.gains(["a"])[0, 0] == pytest.approx(
        ledger.gains(["a"])[0, 0], abs=1e-9
    )


def test_the_past_is_forgotten() -> None:
    early = drawn(0.5, 100, 1)
    late = drawn(5.0, 100, 2)
    turned = np.concatenate([late, early], axis=1)
    fallen = np.concatenate([early, late], axis=1)
    persistence = drawn(8.0, 200, 3)
    ledger = entered(
        {PERSISTENCE: persistence, "fallen": fallen, "turned": turned}, forgetting=0.97
    )
    fallen_gain, turned_gain = ledger.gains(["fallen", "turned"])[:, 0]
    assert turned_gain > fallen_gain
    assert ledger.forecasts("turned") == pytest.approx(1 / 0.03, rel=0.01)


def test_a_newcomer_has_saved_nothing_yet_and_an_heir_continues() -> None:
    ledger = entered(
        {PERSISTENCE: drawn(5.0, 60, 1), "a": drawn(0.5, 60, 2), "b": drawn(1.0, 60, 3)}
    )
    ledger.inherit("heir", "a")
    ledger.inherit("nobody's", "gone")
    a, b, new, heir = ledger.gains(["a", "b", "new", "heir"])[:, 0]
    assert a > b > new == 0.0
    assert heir == a
    ledger.keep(["b"])
    assert ledger.forecasts("a") == 0.0
    assert ledger.forecasts("b") > 0.0


def test_nothing_is_said_before_a_forecast_has_come_true() -> None:
    ledger = Ledger(np.ones(2), NOISE, 1.0)
    assert np.isnan(ledger.gains(["a"])).all()
    ledger.add(["a"], np.zeros((1, 2, 3)), np.ones((2, 2, 3)), 0)
    first, second = ledger.gains(["a"])[0]
    assert first > 0.0
    assert np.isnan(second), "of the longer horizon nothing has come"


def test_skill_is_the_share_of_a_baselines_error_that_is_saved() -> None:
    """Of two signals the geometric mean counts; the prior, three forecasts off by the noise, fades."""
    n = 2000
    noise_sized = np.array([[1.0], [1.0]]) * NOISE[:, None] * np.ones(n)
    ledger = entered(
        {
            PERSISTENCE: 4.0 * noise_sized,
            ARX: [[0.5], [0.25]] * noise_sized,
            "a": [[2.0], [0.5]] * noise_sized,
        }
    )
    [[[by_persistence], [by_arx]]] = ledger.skills(["a"])[0]
    assert by_persistence == pytest.approx(1 - 1 / 4, abs=3 * 4 / n)
    assert by_arx == pytest.approx(1 - np.sqrt(4 * 2), abs=0.02)


def test_skill_is_given_after_some_forecasts_only_and_is_inherited() -> None:
    few = {PERSISTENCE: drawn(4.0, 3, 1), "a": drawn(1.0, 3, 2)}
    assert np.isnan(entered(few).skills(["a"])).all()
    assert np.isnan(Ledger(np.ones(1), NOISE, 1.0).skills(["a"])).all()
    ledger = entered({PERSISTENCE: drawn(4.0, 9, 1), "a": drawn(1.0, 9, 2)})
    ledger.inherit("heir", "a")
    np.testing.assert_array_equal(ledger.skills(["heir"]), ledger.skills(["a"]))
    assert (ledger.skills(["a"])[0] > 0).all()


@pytest.mark.parametrize("signal", [None, 0, 1])
def test_skills_of_several_are_those_of_each(signal: int | None) -> None:
    ledger = entered(
        {PERSISTENCE: drawn(4.0, 9, 1), "a": drawn(1.0, 9, 2), "b": drawn(2.0, 9, 3)}
    )
    names = ["b", "nobody", "a"]
    of_each = [ledger.skills([name], signal) for name in names]
    np.testing.assert_array_equal(
        ledger.skills(names, signal), np.concatenate(of_each, axis=1)
    )
    assert not np.array_equal(of_each[0], of_each[2])
    assert np.isnan(of_each[1]).all()


def moving(rng: np.random.Generator, samples: int, overlap: int) -> FloatArray:
    """Errors of forecasts of which each covers most of what the one before did; of unit size."""
    steps = rng.normal(0.0, 1.0, (2, samples + overlap - 1))
    errors = np.apply_along_axis(
        np.convolve, 1, steps, np.full(overlap, overlap**-0.5), "valid"
    )
    return np.asarray(10.0 * NOISE[:, None] * errors)


@pytest.mark.parametrize("overlap", [1, 10])
def test_of_two_that_are_equally_good_none_is_better_but_by_chance(
    overlap: int,
) -> None:
    """The promise is one in twenty. The one with twice the error is found out."""
    rng = np.random.default_rng(7)
    alarms = 0
    worse_found = 0
    runs = 100
    for _ in range(runs):
        shared, *own_parts = (moving(rng, 150, overlap) for _ in range(4))
        candidate, rival, baseline = (shared + 0.5 * part for part in own_parts)
        ledger = Ledger(np.array([1.0 / overlap]), NOISE, 0.98)
        for k in range(150):
            errors = np.array([candidate, 2.0 * rival])[..., k : k + 1]
            ledger.add(
                ["equal", "worse"], errors, np.array([baseline] * 2)[..., k : k + 1], 0
            )
        alarms += ledger.skills(["equal"])[1][0, 0, 0] < 0.0
        worse_found += ledger.skills(["worse"])[1][0, 0, 0] < 0.0
    assert alarms <= 0.06 * runs
    assert worse_found > 0.9 * runs


# How wide a band has to be to hold what it promises.


MEAN = float(norm.expect(abs))
MEMORY = float(np.exp(-1 / 60))
RECENT = float(np.exp(-1 / 10))


def learned(
    quotients: FloatArray, forgetting: float = MEMORY, recent: float = RECENT
) -> tuple[FloatArray, FloatArray]:
    """The widths before each of the quotients, shape (n, signals), and whether it lay within."""
    calibration = Calibration((1,), forgetting, recent, quotients.shape[1])
    widths = []
    for row in quotients:
        widths.append(calibration.widths[:, 0])
        calibration.add([0], row[:, None])
    return np.array(widths), quotients <= np.array(widths)


def test_it_begins_as_a_normal_distribution_would_have_it() -> None:
    """Of twelve points of |z| the greatest is taken, ⌈0.9·13⌉ being twelve: its level is 12/13."""
    expected = norm.ppf(0.5 + 0.5 * 12 / 13)
    assert Calibration((1, 10), 1.0, 1.0).widths == pytest.approx(
        np.full((2, 2), expected), rel=1e-12
    )


@pytest.mark.parametrize("kind", ["normal", "laplace", "narrow", "wide"])
def test_it_holds_what_it_promises_whatever_the_errors_are_like(kind: str) -> None:
    """In 1000 draws the share within has a standard error of 0.01; what is learned first costs some more."""
    random = np.random.default_rng(7)
    draws = {
        "normal": random.normal(size=(1000, 2)),
        "laplace": random.laplace(size=(1000, 2)),
        "narrow": 0.1 * random.normal(size=(1000, 2)),
        "wide": 7.0 * random.standard_t(3, size=(1000, 2)),
    }[kind]
    _, inside = learned(np.abs(draws), forgetting=0.99)
    assert inside.mean(axis=0) == pytest.approx([CONFIDENCE, CONFIDENCE], abs=0.025)


def test_it_follows_errors_that_grow() -> None:
    """They are three times as large from the 200th of 240 forecasts on, in 50 signals: the share of a
    thousand readings has a standard error of 0.01."""
    sizes = np.abs(np.random.default_rng(8).normal(size=(240, 50)))
    sizes[200:] *= 3.0
    _, inside = learned(sizes)
    assert inside[200:210].mean() < 0.75, "this test has to see the change"
    assert inside[220:240].mean() == pytest.approx(CONFIDENCE, abs=0.02)
    _, slow = learned(sizes, recent=MEMORY)
    assert slow[210:240].mean() < inside[210:240].mean() - 0.05


def test_it_holds_while_the_noise_drifts() -> None:
    """Noise that grows to four times and falls again within 120 forecasts, an hour: the share held in the
    worst twenty minutes, and the interval score over that of the true quantile, with a local scale and with
    one that is as slow as the quantile."""
    sizes = np.exp(np.log(2.0) * np.sin(2.0 * np.pi * np.arange(480) / 120.0))[:, None]
    drawn = np.abs(sizes * np.random.default_rng(9).normal(size=(480, 40)))

    def scored(widths: FloatArray) -> float:
        return float(np.mean(2.0 * widths + 20.0 * np.maximum(drawn - widths, 0.0)))

    def share_and_loss(recent: float) -> tuple[float, float]:
        widths, inside = learned(drawn, recent=recent)
        rolling = np.convolve(inside[60:].mean(axis=1), np.full(40, 1 / 40), "valid")
        return rolling.min(), scored(widths) / scored(norm.ppf(0.95) * sizes) - 1.0

    worst, lost = share_and_loss(RECENT)
    worst_without, lost_without = share_and_loss(MEMORY)
    assert worst > max(0.8, worst_without + 0.04)
    assert lost < min(0.13, lost_without - 0.1)


def test_a_long_lead_begins_with_what_the_shorter_one_has_shown() -> None:
    calibration = Calibration((1, 10), 1.0, 1.0, 1)
    for _ in range(997):
        calibration.add([0], np.array([[3.0]]))
    # The mean of 997 quotients of 3, and of three as expected, in units of the mean of |z|.
    scale = (997 * 3.0 / norm.expect(abs) + 3.0) / 1000
    assert calibration.widths[0, 1] == pytest.approx(
        norm.ppf(0.5 + 0.5 * 12 / 13) * scale, rel=1e-9
    )


@settings(deadline=None, max_examples=40)
@given(st.lists(st.floats(0.0, 100.0), max_size=120), st.sampled_from([1, 2, 20]))
def test_it_is_the_empirical_quantile_in_units_of_a_mean(
    values: list[float], lead: int
) -> None:
    """With equal weights, by independent formulas. The scale is the mean of the past quotients and of three
    forecasts as expected, where of forecasts that reach over `lead` of their intervals each counts a
    `lead`-th; the quantile leaves room for the next, which overlaps: rank ⌈0.9·(n + √`lead`)⌉ (with 1 for the
    root: Vovk et al.)."""
    calibration = Calibration((lead,), 1.0, 1.0, 1)
    scaled = norm.ppf(0.5 + 0.5 * np.arange(1, 13) / 13).tolist()
    for n, value in enumerate([*values, 0.0]):
        weights = np.array([3.0, *[1.0 / lead] * n])
        scale = np.average([MEAN, *values[:n]], weights=weights) / MEAN
        rank = min(
            int(np.ceil(CONFIDENCE * (len(scaled) + math.sqrt(lead)) - 1e-9)),
            len(scaled),
        )
        assert calibration.widths[0, 0] == pytest.approx(
            np.sort(scaled)[rank - 1] * scale, rel=1e-9
        )
        calibration.add([0], np.array([[value]]))
        scaled.append(value / scale)


@pytest.mark.parametrize("size", [0.1, 1.0, 4.0])
def test_a_twin_that_misjudges_its_errors_soon_holds(size: float) -> None:
    """300 twins whose errors are so many times what they expect, forecasts 20 to 60 of each.

    The share is known to 0.3 %; a prior that still counts costs up to 8 % (without a scale 10 %).
    """
    widths, inside = learned(
        np.abs(size * np.random.default_rng(4).normal(size=(60, 300)))
    )
    assert 0.88 < inside[20:].mean() < 0.985
    assert np.median(widths[-1]) / size == pytest.approx(norm.ppf(0.95), rel=0.3)


def test_a_copy_learns_on_its_own() -> None:
    first = Calibration((1,), MEMORY, RECENT, 1)
    for _ in range(500):  # until the prior is forgotten
        first.add([0], np.array([[0.3]]))
    second = first.copy()
    before = first.widths
    for _ in range(30):
        second.add([0], np.array([[9.0]]))
    np.testing.assert_array_equal(first.widths, before)
    assert second.widths[0, 0] > 9.0


def test_leads_fit_the_sample_time() -> None:
    assert leads_of(1.0, 300) == (1, 3, 10, 30, 60, 120, 300)
    assert leads_of(3.0, 20) == (1, 3, 10, 20)
    assert leads_of(0.1, 50) == (10, 30, 50)


# The forecasts that need no twin.

GAINS = PidGains(2.0, 0.4, 0.1, 1.0, -5.0, 5.0)


def plant(y: float, y_before: float, u: float, u_before: float, room: float) -> float:
    return (
        y
        + 0.3
        - 0.1 * y
        + 0.4 * (y - y_before)
        + 0.2 * u
        + 0.05 * u_before
        + 0.02 * room
    )


def record(
    n: int, gains: PidGains | None, seed: int = 1
) -> tuple[list[Sample], list[np.ndarray]]:
    """An exact run of `plant`: of the loop if there are gains, otherwise under random inputs."""
    random = np.random.default_rng(seed)
    y = y_before = u_before = 0.0
    pid = Controller(gains or GAINS)
    samples = []
    states = []
    for k in range(n):
        room = 20.0 + random.uniform()
        reference = (
            float(random.integers(0, 8)) if k % 25 == 0 else samples[-1].reference
        )
        u = float(pid.step(reference, y)[0]) if gains else random.uniform(-1.0, 1.0)
        samples.append(Sample(k, 0, reference, y, u, (room,)))
        states.append(pid.state)
        y_next = plant(y, y_before, u, u_before, room)
        y_before = y
        u_before = u
        y = y_next
    return samples, states


def fed(samples: list[Sample], gains: PidGains | None, forgetting: float = 1.0) -> Arx:
    arx = Arx(gains, forgetting)
    for sample in samples:
        arx.push(sample)
    return arx


def future(
    samples: list[Sample], newest: int, gains: PidGains | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Condition, disturbances and measured signals after the sample `newest`."""
    later = samples[newest + 1 :]
    condition = np.array([s.reference if gains else s.input for s in later])
    return (
        condition,
        np.array([s.disturbances for s in samples[newest:]]),
        np.array([[s.output, s.input] for s in later]).T,
    )


@pytest.mark.parametrize("gains", [GAINS, None], ids=["closed loop", "given inputs"])
def test_a_plant_of_its_form_is_forecast_exactly(gains: PidGains | None) -> None:
    samples, states = record(300, gains)
    given_ahead, rows, came = future(samples, 199, gains)
    forecast = (
        fed(samples[:200], gains).departure(states[199]).forecast(given_ahead, rows)
    )
    np.testing.assert_allclose(forecast, came, atol=1e-6)


def test_a_plant_of_its_form_with_several_signals_is_forecast_exactly() -> None:
    """Three outputs that act on one another, two inputs and a disturbance."""
    random = np.random.default_rng(2)
    by_y, by_step, by_u = (
        random.uniform(-0.1, 0.1, shape) for shape in ((3, 3), (3, 3), (3, 2))
    )
    u = random.uniform(-1.0, 1.0, (300, 2))
    room = random.uniform(size=300)
    y = np.zeros((300, 3))
    for k in range(1, 299):
        rate = (
            by_y @ y[k]
            + by_step @ (y[k] - y[k - 1])
            + by_u @ (u[k] + 0.5 * u[k - 1])
            + 0.1 * room[k]
        )
        y[k + 1] = 0.9 * y[k] + rate
    rows = zip(y.tolist(), u.tolist(), room.tolist(), strict=True)
    samples = [
        Sample(k, 0, (0.0,) * 3, tuple(y), tuple(u), (d,))
        for k, (y, u, d) in enumerate(rows)
    ]
    forecast = (
        fed(samples[:200], None)
        .departure(np.zeros(0))
        .forecast(u[200:], room[199:, None])
    )
    np.testing.assert_allclose(forecast, np.hstack([y[200:], u[200:]]).T, atol=1e-9)


@given(st.sets(st.integers(0, 119)), st.booleans())
@settings(max_examples=20, deadline=None)
def test_who_asks_in_between_changes_no_bit(asked: set[int], gap: bool) -> None:
    """Forecasts asked for beside a run, on a page or by a service, are not in its verdicts."""
    samples = [s for s in record(120, GAINS)[0] if not (gap and 60 <= s.index < 63)]
    quiet = Arx(GAINS, 0.99)
    curious = Arx(GAINS, 0.99)
    for sample in samples:
        quiet.push(sample)
        curious.push(sample)
        if sample.index in asked:
            curious.departure(np.zeros(2))
    for quiet_part, curious_part in zip(
        quiet.departure(np.zeros(2)), curious.departure(np.zeros(2)), strict=True
    ):
        if isinstance(quiet_part, np.ndarray):
            np.testing.assert_array_equal(quiet_part, curious_part)


def test_until_there_are_enough_samples_nothing_changes() -> None:
    samples, states = record(12, GAINS)
    forecast = (
        fed(samples, GAINS).departure(states[11]).forecast(np.ones(4), np.ones((5, 1)))
    )
    np.testing.assert_array_equal(
        forecast, np.repeat([[samples[-1].output], [samples[-1].input]], 4, axis=1)
    )


def test_it_does_not_leave_what_was_visited_by_more_than_its_width() -> None:
    """A plant that runs away while it is watched."""
    samples = [
        Sample(k, 0, 0.0, float(np.exp(0.05 * k)), 0.1 * (k % 3)) for k in range(80)
    ]
    forecast = fed(samples, None).departure(np.zeros(0)).forecast(np.zeros(400), None)
    low = samples[0].output
    high = samples[-1].output
    assert forecast[0, -1] == pytest.approx(2.0 * high - low)


@settings(max_examples=20)
@given(st.sets(st.integers(3, 195), max_size=60), st.integers(0, 3))
def test_lost_samples_and_gaps_teach_nothing_wrong(lost: set[int], seed: int) -> None:
    """Values of stand-ins are nonsense here; whatever is learned comes from the others."""
    samples, states = record(400, GAINS, seed)
    with_gap = [
        Sample(s.index, 0, s.reference, 1e3, -1e3, s.disturbances, seen=False)
        if k in lost and k % 2
        else s
        for k, s in enumerate(samples[:250])
        if k not in lost or k % 2
    ]
    given_ahead, rows, came = future(samples, 249, GAINS)
    arx = fed(with_gap, GAINS)
    forecast = arx.departure(states[249]).forecast(given_ahead, rows)
    np.testing.assert_allclose(forecast, came, atol=1e-4)


def test_older_samples_weigh_less() -> None:
    """The plant doubles its input's effect in the middle."""
    samples, _ = record(400, None)
    doubled = []
    y = y_before = u_before = 0.0
    for k, s in enumerate(samples):
        factor = 2.0 if k >= 200 else 1.0
        doubled.append(Sample(k, 0, 0.0, y, s.input, s.disturbances))
        y_next = plant(
            y, y_before, factor * s.input, factor * u_before, s.disturbances[0]
        )
        y_before = y
        u_before = s.input
        y = y_next
    slopes = [
        fed(doubled, None, forgetting).departure(np.zeros(0)).coefficients[0, 2]
        for forgetting in (1.0, 0.97)
    ]
    assert slopes[1] == pytest.approx(0.4, abs=0.01)
    assert slopes[0] < 0.38


# A twin carried beside the plant.


def test_a_twin_whose_states_are_lost_starts_over() -> None:
    """One reading far below zero empties the tank beyond what its equations can say."""
    state_filter = StateFilter(Tank.model().parameters(), 1.0, states=np.array([1.0]))
    for index, output in enumerate((-3.0, 0.1, 0.12)):
        state_filter.push(Sample(index, index * 10**9, 0.1, output, 0.1))
        if index == 0:
            assert state_filter.states[0] < 0.0
    assert np.isfinite(state_filter.states).all()
    assert np.isfinite(state_filter.joint).all()
    assert 0.0 < state_filter.states[0] < 0.5


def resonator(size: int, lost: frozenset[int]) -> list[Sample]:
    """A weakly damped mass on a spring under a random force; where a reading is lost, something far off
    stands in for it."""
    random = np.random.default_rng(11)
    forces = np.cumsum(random.standard_normal(size)) * 0.05
    place = np.zeros(size)
    for k in range(2, size):
        place[k] = 1.6 * place[k - 1] - 0.96 * place[k - 2] + 0.3 * forces[k - 1]
    read = place + 0.001 * random.standard_normal(size)
    return [
        Sample(k, k * 10**9, 0.0, 9.0 if k in lost else y, u, seen=k not in lost)
        for k, (y, u) in enumerate(zip(read.tolist(), forces.tolist(), strict=True))
    ]


def test_behind_lost_readings_arx_continues_from_its_own_expectation_and_persistence_from_what_was_read() -> (
    None
):
    """Without that, what stands in for a reading is a blow to a model of differences."""
    lost = frozenset({290, 291, 292, 297, 299})
    whole = fed(resonator(320, frozenset())[:300], None).departure(np.zeros(0))
    with_lost = fed(resonator(320, lost)[:300], None).departure(np.zeros(0))
    samples = resonator(320, lost)
    given_ahead = np.array([sample.inputs for sample in samples[300:]])
    of_whole = whole.referees(given_ahead, None)
    of_lost = with_lost.referees(given_ahead, None)
    assert of_lost[0, 0, 0] == samples[298].outputs[0]
    true = np.array([sample.outputs[0] for sample in samples[300:]])
    error = np.sqrt(np.mean(np.square(of_lost[1, 0] - true)))
    error_of_whole = np.sqrt(np.mean(np.square(of_whole[1, 0] - true)))
    # Five expectations in place of five readings: a few of its one-step errors, which are its noise.
    assert error < error_of_whole + 0.02
    assert error < np.sqrt(np.mean(np.square(of_lost[0, 0] - true)))
