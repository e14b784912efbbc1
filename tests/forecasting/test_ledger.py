"""What forecasts cost, in characters, and how much better they are than a baseline's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import laplace

from twinmatch.forecasting import (
    Ledger,
)
from twinmatch.signals import FloatArray

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


def test_neither_a_ledger_nor_its_copy_takes_what_the_other_is_given() -> None:
    ledger = entered({PERSISTENCE: drawn(5.0, 60, 1), "a": drawn(0.5, 60, 2)})
    gains = ledger.gains(["a"]).copy()
    copied = ledger.copy()
    copied.add(["a"], drawn(9.0, 1, 3)[None], np.zeros((2, 2, 1)), 0)
    assert ledger.gains(["a"]) == gains
    ledger.keep([])
    assert copied.forecasts("a") == 61.0


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
