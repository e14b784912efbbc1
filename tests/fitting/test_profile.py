"""Profile-likelihood intervals: against brute force, and whether they hold what they promise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import least_squares

from twinmatch.fitting.estimation import (
    QUANTILE,
    Estimate,
    Uncertainty,
    profile_intervals,
    solve,
    starts_for,
    uncertainty,
)
from twinmatch.fitting.problem import Noise, Problem
from twinmatch.plants import Peltier
from twinmatch.signals import Window

Recorder = Callable[..., Window]

RIG = Peltier.model()
TRUTH = RIG.parameters(seebeck=0.075, conductance=0.6, heat_capacity=30.0)
FREE = ("seebeck", "conductance", "heat_capacity")


def fitted(window: Window) -> tuple[Problem, Estimate, Uncertainty]:
    posed = Problem(window, FREE, TRUTH, Noise.of(Peltier), Peltier.loop)
    found = solve(posed, starts_for(posed, TRUTH))
    return posed, found, uncertainty(posed, found)


@pytest.mark.parametrize(("levels", "seed"), [((30.0, 55.0, 42.0), 3), ((30.0, 45.0), 5), ((60.0, 35.0), 1)])
def test_the_ends_are_where_a_fit_of_the_others_has_risen_to_the_limit(
    record: Recorder, levels: tuple[float, ...], seed: int
) -> None:
    """Each finite end by brute force: the others fitted by scipy with this parameter held there."""
    posed, found, known = fitted(record(TRUTH, levels=levels, seed=seed))
    intervals = profile_intervals(posed, found.values, known.covariance)
    rises = QUANTILE * np.diag(known.covariance) / np.diag(np.linalg.inv(known.fisher))
    least = found.chi2 * found.residuals.size
    finite = 0
    for i, side in np.ndindex(3, 2):
        end = intervals[i, side]
        if not np.isfinite(end) or end == 0.0:
            continue
        finite += 1
        others = [j for j in range(3) if j != i]

        def residuals(x: np.ndarray, i: int = i, end: float = end, others: list[int] = others) -> np.ndarray:
            values = np.empty(3)
            values[i], values[others] = end, x
            return posed.residuals(values)

        fits = [
            least_squares(
                residuals,
                start[others],
                bounds=(posed.lower[others], posed.upper[others]),
                x_scale=posed.scales[others],
                diff_step=1e-6,
            ).cost
            for start in (found.values, *starts_for(posed, TRUTH))
        ]
        assert (2 * min(fits) - least) / rises[i] == pytest.approx(1.0, abs=0.05)
    assert finite >= 4


def test_a_well_determined_interval_is_that_of_the_variance(record: Recorder) -> None:
    posed, _, known = fitted(record(TRUTH, seed=2))
    alone = Problem(posed.window, ("heat_capacity",), TRUTH, Noise.of(Peltier), Peltier.loop)
    single = solve(alone, [alone.values_of(TRUTH)])
    of_one = uncertainty(alone, single)
    (low, high) = profile_intervals(alone, single.values, of_one.covariance)[0]
    half = 1.96 * np.sqrt(of_one.covariance[0, 0])
    assert [low, high] == pytest.approx([single.values[0] - half, single.values[0] + half], rel=0.01)
    assert high - low < 0.5 * 2 * 1.96 * np.sqrt(known.covariance[2, 2])


def test_nineteen_of_twenty_intervals_hold_the_truth(record: Recorder) -> None:
    """Eighty noisy windows; 95 % of 80 is 76 ± 2, and the folded valley of conductance costs some."""
    truth = np.array([TRUTH[name] for name in FREE])
    inside = []
    for seed in range(80):
        posed, found, known = fitted(record(TRUTH, levels=(30.0, 50.0), seed=seed))
        low, high = profile_intervals(posed, found.values, known.covariance).T
        inside.append((low <= truth) & (truth <= high))
    assert np.all(np.mean(inside, axis=0) >= 0.86)
    assert 0.91 <= np.mean(inside) <= 0.995


def test_what_the_window_does_not_close_is_open(record: Recorder) -> None:
    posed, found, known = fitted(record(TRUTH, levels=(30.0, 32.0), seed=4))
    intervals = profile_intervals(posed, found.values, known.covariance)
    assert np.argwhere(np.isinf(intervals)).tolist() == [[0, 0]]  # a Seebeck coefficient as small as you like
    infinite = profile_intervals(posed, found.values, np.full((3, 3), np.inf))
    assert infinite[:, 1].tolist() == [np.inf] * 3
    assert infinite[:, 0].tolist() == [-np.inf, 0.0, -np.inf]


def test_ends_beside_an_unknown_start_are_where_the_sum_has_risen(record: Recorder) -> None:
    """A sink with mass: its start follows when the conductance is moved, by brute force too."""
    rig = Peltier.model("sink with mass").parameters(
        **{**dict(TRUTH), "sink_heat_capacity": 300.0, "sink_convection": 3.0}
    )
    posed = Problem(record(rig, seed=1), ("conductance",), rig, Noise.of(Peltier), Peltier.loop)
    assert posed.names == ("conductance", "sink")
    found = solve(posed, [posed.values_of(rig)])
    known = uncertainty(posed, found)
    low, high = profile_intervals(posed, found.values, known.covariance)[0]
    rise = QUANTILE * known.covariance[0, 0] / np.linalg.inv(known.fisher)[0, 0]
    least = found.chi2 * found.residuals.size
    for end in (low, high):
        fitted_start = least_squares(
            lambda x, end=end: posed.residuals(np.array([end, x[0]])), [found.values[1]], diff_step=1e-6
        )
        assert (2 * fitted_start.cost - least) / rise == pytest.approx(1.0, abs=0.05)
    assert low < found.values[0] < high
