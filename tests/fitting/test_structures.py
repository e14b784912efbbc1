"""Structures of the plant fitted to rigs whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.support.plants import Lag
from twinmatch.dynamics import (
    Model,
    Parameters,
    Sensor,
    begin,
    simulate_closed_loop,
    simulate_driven,
    simulate_window,
)
from twinmatch.fitting import FittingError
from twinmatch.fitting.structures import SETTLE, fit_structure
from twinmatch.plants import Peltier
from twinmatch.signals import Window

LEVELS = (50.0, 30.0, 75.0, 45.0, 90.0, 25.0)
FULL = Peltier.model("sink with mass, free ambient, switched drive")
HELD = Peltier.model("held sink")
TRUE = {"seebeck": 0.065, "conductance": 0.65, "heat_capacity": 31.0, "ambient": 291.0}
TRUE |= {"sink_heat_capacity": 280.0, "sink_convection": 2.5}
TRUTH = FULL.parameters(**TRUE)


def recorded(
    rig: Parameters, sink: float = 291.0, seed: int | None = None, levels: tuple[float, ...] = LEVELS
) -> Window:
    reference = np.repeat(levels, 200)
    sensor = None if seed is None else Peltier.sensor.realise(reference.size, 1.0, seed)
    run = simulate_closed_loop(rig, reference, states=begin(rig, 22.0, starts={"sink": sink}), sensor=sensor)
    return Window(reference, run.output, run.input)


def test_the_truth_is_found_without_noise() -> None:
    fitted = fit_structure([recorded(TRUTH, sink=299.0).part(0, 1199)], FULL)
    for name in FULL.structure.free:
        assert fitted.parameters[name] == pytest.approx(TRUTH[name], rel=1e-5), name
    assert fitted.converged
    assert fitted.cost < 1e-8
    assert fitted.fit == pytest.approx((1.0, 1.0), abs=1e-4)


def test_sensor_lag_and_slope_are_found_without_noise() -> None:
    model = Peltier.model("sink with mass, free ambient, switched drive, sensor lag, α(T)")
    fitted = fit_structure([recorded(model.parameters(**TRUE, sensor_lag=1.2, seebeck_slope=1.5e-4))], model)
    assert fitted.parameters["sensor_lag"] == pytest.approx(1.2, rel=1e-3)
    assert fitted.parameters["seebeck_slope"] == pytest.approx(1.5e-4, rel=1e-2)


def test_two_windows_share_the_rig_and_not_the_start_of_the_sink() -> None:
    windows = [recorded(TRUTH, sink=300.0, levels=LEVELS[:3]), recorded(TRUTH, sink=310.0, levels=LEVELS[3:])]
    fitted = fit_structure(windows, FULL)
    assert fitted.n_parameters == len(FULL.structure.free) + 2
    # The sink at the third sample; it has moved by less than 1 K since the first.
    starts = [start["sink"] for start in fitted.starts]
    assert starts == pytest.approx([300.0, 310.0], abs=1.0)
    assert fitted.parameters["heat_capacity"] == pytest.approx(31.0, rel=1e-5)


def test_kicks_of_the_camera_hardly_move_the_parameters() -> None:
    clean = recorded(TRUTH, seed=4)
    temperature = clean.output.copy()
    temperature[150::180] += 5.0
    kicked = Window(clean.reference, temperature, clean.input)
    one, other = (fit_structure([w], HELD).parameters for w in (clean, kicked))
    # Least squares of the same would move by as much as the six kicks of 50 σ ask: a tenth and more.
    assert other["heat_capacity"] == pytest.approx(one["heat_capacity"], rel=0.03)


def test_the_first_samples_are_not_judged() -> None:
    window = recorded(TRUTH)
    frozen = window.output.copy()
    fitted = fit_structure([window], FULL)
    assert fitted.measured[0].shape == fitted.simulated[0].shape == (2, len(window) - 2 - SETTLE)
    np.testing.assert_array_equal(fitted.measured[0][0], frozen[2 + SETTLE :])


def test_a_search_continues_from_an_earlier_fit() -> None:
    window = recorded(TRUTH, seed=2)
    thorough = fit_structure([window], FULL)
    again = fit_structure([window], FULL, start=thorough, thorough=False)
    assert again.cost == pytest.approx(thorough.cost, rel=1e-6)
    quick = fit_structure([window], FULL, thorough=False)
    assert quick.cost == pytest.approx(thorough.cost, rel=1e-2)


def test_an_independent_search_finds_the_same() -> None:
    """scipy's robust loss on the plain simulation, derivatives by differences; ours ends no higher."""
    window = recorded(TRUTH, seed=3, levels=LEVELS[:3])
    fitted = fit_structure([window], HELD)
    weights = np.array([[1.0 / Peltier.output.noise], [1.0 / Peltier.drive.noise]])
    free = HELD.structure.free

    def residuals(x: np.ndarray) -> np.ndarray:
        return (_driven_round(HELD, dict(zip(free, x, strict=True)), window) * weights).ravel()

    theirs = least_squares(
        residuals,
        [fitted.parameters[name] * 1.05 for name in free],
        x_scale=[HELD.declared[name].scale for name in free],
        loss="soft_l1",
        diff_step=1e-6,
    )
    ours = np.array([fitted.parameters[name] for name in free])
    assert ours == pytest.approx(theirs.x, rel=2e-3)
    # scipy's sum is half of ρ = 2(√(1 + e²) − 1).
    count = residuals(ours).size
    assert fitted.cost * count == pytest.approx(2 * theirs.cost, rel=1e-5)


def _driven_round(model: Model, values: dict[str, float], window: Window) -> np.ndarray:
    run = simulate_window(model.parameters(**values), window)
    left = np.stack([window.output[2:] - run.output, window.input[2:] - run.input])
    return left[:, SETTLE:]


def test_a_structure_counts_what_it_is_free_to_choose() -> None:
    assert HELD.structure.n_parameters() == 3
    assert FULL.structure.n_parameters() == 7
    assert FULL.structure.n_parameters(3) == 9


def test_a_plant_without_a_known_loop_is_fitted_by_its_output() -> None:
    truth = Lag.model().parameters(gain=3.0, lag=7.0)
    u = np.repeat([1.0, -2.0, 4.0, 0.5], 60)
    noise = Sensor(noise=0.01).realise(u.size, 1.0, 5)
    run = simulate_driven(truth, u, states=begin(truth, 0.0), sensor=noise)
    fitted = fit_structure([Window(np.zeros(u.size), run.output, u)], Lag.model())
    assert fitted.parameters["gain"] == pytest.approx(3.0, rel=5e-3)
    assert fitted.parameters["lag"] == pytest.approx(7.0, rel=1e-2)
    assert fitted.measured[0].shape == (1, u.size - 2 - SETTLE)
    assert fitted.fit[0] > 0.99
    assert np.isnan(fitted.fit[1])


def test_what_cannot_be_fitted_is_refused() -> None:
    window = recorded(TRUTH, levels=(40.0,))
    with pytest.raises(FittingError, match="there is no window"):
        fit_structure([], FULL)
    with pytest.raises(FittingError, match="has 62 samples; the first 62 are not compared"):
        fit_structure([window.part(0, 61)], FULL)
    with pytest.raises(FittingError, match=r"controller runs every 0\.5 s"):
        fit_structure([window], FULL, gains=replace(Peltier.loop, period=0.5))
