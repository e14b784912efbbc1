"""Structures of the plant fitted to rigs whose truth is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from twinmatch.matching import MatchingError
from twinmatch.matching.structures import SETTLE, STRUCTURES, Structure, fit_structure
from twinmatch.plant import Camera, PidGains, RigParameters, simulate_closed_loop
from twinmatch.signals import Window

BY_NAME = {s.name: s for s in STRUCTURES}
LEVELS = (50.0, 30.0, 75.0, 45.0, 90.0, 25.0)
TRUTH = RigParameters(
    seebeck=0.065,
    conductance=0.65,
    heat_capacity=31.0,
    ambient=291.0,
    sink_heat_capacity=280.0,
    sink_convection=2.5,
    drive_ripple=1.0,
)
FULL = BY_NAME["sink with mass, free ambient, switched drive"]


def recorded(
    rig: RigParameters, sink: float | None = None, seed: int | None = None, levels: tuple[float, ...] = LEVELS
) -> Window:
    reference = np.repeat(levels, 200)
    camera = None
    if seed is not None:
        camera = Camera().realise(reference.size, 1.0, seed)
    run = simulate_closed_loop(rig, reference, plate=295.0, sink=sink, camera=camera)
    return Window(reference, run.output, run.input)


def test_the_truth_is_found_without_noise() -> None:
    fitted = fit_structure([recorded(TRUTH, sink=299.0).part(0, 1199)], FULL)
    for name in FULL.free:
        # Celsius to kelvin and back, and differences of 1e-4 of a scale, leave a few parts in 1e4.
        assert getattr(fitted.parameters, name) == pytest.approx(getattr(TRUTH, name), rel=2e-3), name
    assert fitted.converged
    assert fitted.cost < 1e-6
    assert fitted.fit == pytest.approx((1.0, 1.0), abs=1e-4)


def test_sensor_lag_and_slope_are_found_without_noise() -> None:
    truth = TRUTH.replace(sensor_lag=1.2, seebeck_slope=1.5e-4)
    structure = BY_NAME["sink with mass, free ambient, switched drive, sensor lag, α(T)"]
    fitted = fit_structure([recorded(truth)], structure)
    assert fitted.parameters.sensor_lag == pytest.approx(1.2, rel=0.01)
    assert fitted.parameters.seebeck_slope == pytest.approx(1.5e-4, rel=0.05)


def test_two_windows_share_the_rig_and_not_the_start_of_the_sink() -> None:
    windows = [recorded(TRUTH, sink=300.0, levels=LEVELS[:3]), recorded(TRUTH, sink=310.0, levels=LEVELS[3:])]
    fitted = fit_structure(windows, FULL)
    assert fitted.n_parameters == len(FULL.free) + 2
    # The sink at the third sample; it has moved by less than 1 K since the first.
    assert fitted.sink_starts == pytest.approx((300.0, 310.0), abs=1.0)
    assert fitted.parameters.heat_capacity == pytest.approx(TRUTH.heat_capacity, rel=5e-3)


def test_kicks_of_the_camera_hardly_move_the_parameters() -> None:
    clean = recorded(TRUTH, seed=4)
    temperature = clean.output.copy()
    temperature[150::180] += 5.0
    kicked = Window(clean.reference, temperature, clean.input)
    one, other = (fit_structure([w], BY_NAME["held sink"]).parameters for w in (clean, kicked))
    # Least squares of the same would move by as much as the six kicks of 50 σ ask: a tenth and more.
    assert other.heat_capacity == pytest.approx(one.heat_capacity, rel=0.03)


def test_the_first_samples_are_not_judged() -> None:
    window = recorded(TRUTH)
    frozen = window.output.copy()
    fitted = fit_structure([window], FULL)
    assert fitted.measured[0].shape == fitted.simulated[0].shape == (2, len(window) - 2 - SETTLE)
    np.testing.assert_array_equal(fitted.measured[0][0], frozen[2 + SETTLE :])


def test_a_search_goes_on_from_an_earlier_fit() -> None:
    window = recorded(TRUTH, seed=2)
    thorough = fit_structure([window], FULL)
    again = fit_structure([window], FULL, start=thorough, thorough=False)
    assert again.cost == pytest.approx(thorough.cost, rel=1e-6)
    quick = fit_structure([window], FULL, thorough=False)
    assert quick.cost == pytest.approx(thorough.cost, rel=1e-2)


def test_a_structure_counts_what_it_is_free_to_choose() -> None:
    assert BY_NAME["held sink"].n_parameters() == 3
    assert FULL.n_parameters() == 7
    assert FULL.n_parameters(3) == 9
    assert len(BY_NAME) == len(STRUCTURES)
    assert not any(math.isinf(s.start.sink_heat_capacity) for s in STRUCTURES if "mass" in s.name)


def test_what_cannot_be_fitted_is_refused() -> None:
    window = recorded(TRUTH, levels=(40.0,))
    with pytest.raises(MatchingError, match="no window was given"):
        fit_structure([], FULL)
    with pytest.raises(MatchingError, match="has 62 samples; the first 62 are not judged"):
        fit_structure([window.part(0, 61)], FULL)
    with pytest.raises(MatchingError, match=r"controller runs every 0\.5 s"):
        fit_structure([window], FULL, gains=PidGains(period=0.5))
    with pytest.raises(MatchingError, match="sink_convection is free but the sink has no mass"):
        Structure("odd", ("sink_convection",), RigParameters())
