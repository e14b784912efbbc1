"""The gate, asked question by question."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

from tests.support.plants import Lag
from twinmatch.dynamics import (
    Model,
    Parameters,
    PidState,
    Sensor,
    begin,
    simulate_closed_loop,
    simulate_driven,
    simulate_window,
)
from twinmatch.fitting import FittingError, GateLimits, Match, Status, match
from twinmatch.fitting.gate import FitEvidence, first_excited, judge
from twinmatch.fitting.problem import Unknown, unknown_parameters
from twinmatch.fitting.structures import fit_structure, settling_samples
from twinmatch.plants import Peltier
from twinmatch.signals import Window


def unknown(*names: str) -> tuple[Unknown, ...]:
    return unknown_parameters(Peltier.model(), names)


GOOD = FitEvidence(
    free=unknown("seebeck", "conductance", "heat_capacity"),
    values=np.array([0.075, 0.6, 30.0]),
    standard_errors=np.array([0.005, 0.03, 2.0]),
    condition=30.0,
    bounds_hit=(),
    converged=True,
    chi2=1.2,
    held_back_chi2=1.0,
    incumbent_chi2=1.5,
)

FLAWS = {
    Status.NOT_EXPLAINED: {"chi2": 130.0},
    Status.DID_NOT_CONVERGE: {"converged": False},
    Status.BOUNDS_HIT: {"bounds_hit": ("seebeck",)},
    Status.NOT_IDENTIFIABLE: {"condition": 1e5},
    Status.NOT_BETTER: {"held_back_chi2": 1.7},
}


@pytest.mark.parametrize(
    ("flaw", "status", "reason"),
    [
        ({}, Status.ACCEPTED, "1.2 times the noise variance"),
        (
            {"chi2": 41.0},
            Status.NOT_EXPLAINED,
            "even the best fit leaves residuals of 41 times",
        ),
        (
            {"chi2": float("nan")},
            Status.NOT_EXPLAINED,
            "even the best fit leaves residuals of nan",
        ),
        ({"converged": False}, Status.DID_NOT_CONVERGE, "did not converge within"),
        (
            {"bounds_hit": ("seebeck",)},
            Status.BOUNDS_HIT,
            "seebeck ended on its bound at 0.075",
        ),
        (
            {"condition": 1001.0},
            Status.NOT_IDENTIFIABLE,
            "condition number 1e+03 is above 1000",
        ),
        ({"condition": float("inf")}, Status.NOT_IDENTIFIABLE, "condition number inf"),
        (
            {"condition": 5e3, "confused": ("seebeck",)},
            Status.NOT_IDENTIFIABLE,
            "is above 1000: seebeck hardly shows in this window",
        ),
        (
            {
                "condition": 5e3,
                "confused": ("seebeck", "conductance"),
                "still": "power stood at 5 %",
            },
            Status.NOT_IDENTIFIABLE,
            "combination of seebeck, conductance hardly shows in this window; power stood at 5 %",
        ),
        (
            {"standard_errors": np.array([0.005, 0.4, 2.0])},
            Status.NOT_IDENTIFIABLE,
            "conductance is 0.6 ± 0.4: this window does not determine it",
        ),
        (
            {"standard_errors": np.array([np.inf, 0.1, 2])},
            Status.NOT_IDENTIFIABLE,
            "seebeck is 0.075 ± inf",
        ),
        ({"held_back_chi2": 1.7}, Status.NOT_BETTER, "residuals are 1.7 times"),
        (
            {"held_back_chi2": float("nan")},
            Status.NOT_BETTER,
            "residuals are nan times",
        ),
        # by chance
        (
            {"held_back_chi2": 1.64},
            Status.ACCEPTED,
            "predicts the held-back samples (1.64",
        ),
    ],
)
def test_each_flaw_has_its_status(
    flaw: dict[str, object], status: Status, reason: str
) -> None:
    judged_status, sentence = judge(replace(GOOD, **flaw), GateLimits())
    assert judged_status is status
    assert reason in sentence


def test_the_first_flaw_in_order_names_the_status() -> None:
    order = list(FLAWS)
    for i, status in enumerate(order):
        flaws = {
            name: value for later in order[i:] for name, value in FLAWS[later].items()
        }
        assert judge(replace(GOOD, **flaws), GateLimits())[0] is status


def test_without_slack_the_held_back_part_may_not_be_worse() -> None:
    assert (
        judge(replace(GOOD, held_back_chi2=1.64), GateLimits(slack=1.0))[0]
        is Status.NOT_BETTER
    )


def test_a_temperature_is_not_measured_by_its_distance_from_absolute_zero() -> None:
    ambient = replace(
        GOOD,
        free=unknown("seebeck", "conductance", "ambient"),
        values=np.array([0.075, 0.6, 296.0]),
    )
    for error, status in ((4.0, Status.ACCEPTED), (6.0, Status.NOT_IDENTIFIABLE)):
        with_error = replace(ambient, standard_errors=np.array([0.005, 0.03, error]))
        assert judge(with_error, GateLimits())[0] is status


def test_a_state_at_the_start_need_not_be_known_well() -> None:
    """What is not known of it has made the errors of the parameters larger already."""
    start = Unknown("sink", "K", (263.0, 423.0), 10.0, relative=False, initial=True)
    with_start = replace(
        GOOD,
        free=(*unknown("seebeck", "conductance"), start),
        values=np.array([0.075, 0.6, 296.0]),
        standard_errors=np.array([0.005, 0.03, 9.0]),
    )
    assert judge(with_start, GateLimits())[0] is Status.ACCEPTED
    parameter = replace(start, initial=False)
    as_parameter = replace(
        with_start, free=(*unknown("seebeck", "conductance"), parameter)
    )
    assert judge(as_parameter, GateLimits())[0] is Status.NOT_IDENTIFIABLE


def test_what_was_kept_is_said_and_not_asked_for_its_error() -> None:
    two = replace(
        GOOD,
        free=unknown("seebeck", "heat_capacity"),
        values=np.array([0.13, 60.0]),
        standard_errors=np.array([0.01, 3.0]),
        kept="conductance at 0.35 (possible: 0 to 0.4)",
    )
    status, reason = judge(two, GateLimits())
    assert status is Status.ACCEPTED
    assert reason.endswith(
        "not determined and kept: conductance at 0.35 (possible: 0 to 0.4)"
    )
    assert (
        judge(replace(two, bounds_hit=("seebeck",)), GateLimits())[0]
        is Status.BOUNDS_HIT
    )
    loose = replace(two, standard_errors=np.array([0.01, 40.0]))
    assert judge(loose, GateLimits())[0] is Status.NOT_IDENTIFIABLE


@given(
    chi2=st.floats(0.0, 1e6),
    condition=st.floats(1.0, 1e9),
    errors=st.lists(st.floats(0.0, 100.0), min_size=3, max_size=3),
    held_back=st.floats(0.0, 100.0),
    stands=st.floats(0.0, 100.0),
)
def test_only_what_passes_every_limit_is_accepted(
    chi2: float, condition: float, errors: list[float], held_back: float, stands: float
) -> None:
    evidence = replace(
        GOOD,
        chi2=chi2,
        condition=condition,
        standard_errors=np.array(errors),
        held_back_chi2=held_back,
        incumbent_chi2=stands,
    )
    passes = (
        chi2 <= 40.0
        and condition <= 1000.0
        and bool(np.all(np.array(errors) <= 0.5 * GOOD.values))
        and held_back <= 1.1 * stands
    )
    assert (judge(evidence, GateLimits())[0] is Status.ACCEPTED) == passes


@pytest.mark.parametrize(
    ("reference", "excited_at"),
    [
        ([30.0, 30.0, 30.0, 32.0, 32.0], 3),
        ([30.0, 30.0, 31.0, 30.5, 29.0], 4),
        ([30.0, 30.5, 31.0, 31.5, 32.0, 32.5, 33.0], 5),  # a ramp excites as well
        ([30.0, 40.0, 40.0, 40.0], None),  # stepped before the twin starts
        ([30.0, 31.9, 30.0], None),
        ([30.0], None),
    ],
)
def test_excitation_is_a_movement_of_the_set_point(
    reference: list[float], excited_at: int | None
) -> None:
    assert first_excited(np.array(reference), 2.0) == excited_at


def test_limits_without_a_meaning_are_refused() -> None:
    with pytest.raises(
        FittingError, match="the limit condition is 0; it must be positive"
    ):
        GateLimits(condition=0)
    with pytest.raises(
        FittingError, match=r"held_back is 1\.0; give a share of the window"
    ):
        GateLimits(held_back=1.0)


def test_status_values_are_words() -> None:
    assert {status.value for status in Status} == {
        status.name.lower() for status in Status
    }


# What a match reports about itself: which parameters are determined, which combination, which step next.

Recorder = Callable[..., Window]

RIG = Peltier.model()
TRUTH = RIG.parameters(seebeck=0.075, conductance=0.6, heat_capacity=30.0)


@pytest.fixture(scope="module")
def small_step(record: Recorder) -> Match:
    return match(record(TRUTH, levels=(30.0, 36.0), seed=4), start=TRUTH)


def test_directions_are_the_eigenvectors_of_the_scaled_information(
    small_step: Match,
) -> None:
    scales = np.array([RIG.declared[name].scale for name in small_step.free])
    scaled = small_step.fisher * np.outer(scales, scales)
    np.testing.assert_allclose(
        scaled @ small_step.directions,
        small_step.directions * small_step.eigenvalues,
        atol=1e-6 * scaled.max(),
    )
    np.testing.assert_allclose(
        small_step.directions.T @ small_step.directions, np.eye(3), atol=1e-12
    )
    # Along the valley Seebeck coefficient and heat capacity grow together.
    seebeck, _, heat_capacity = small_step.directions[:, 0]
    assert seebeck > 0.3
    assert heat_capacity > 0.3


def test_the_ratio_is_known_where_its_parts_are_not(small_step: Match) -> None:
    assert "seebeck" not in small_step.believed
    assert "heat_capacity" not in small_step.believed
    assert (
        "best known is the ratio seebeck / heat_capacity (± " in small_step.determined
    )
    assert "left open: " in small_step.determined
    low, high = small_step.intervals[0]
    assert f"seebeck ({low:.3g} to {high:.3g})" in small_step.determined


def test_a_rich_window_determines_all(record: Recorder) -> None:
    result = match(
        record(TRUTH, levels=(30.0, 80.0, 35.0), seed=4), start=RIG.parameters()
    )
    assert result.believed == result.free
    assert result.suggestion == ""
    assert "left open" not in result.determined
    for (low, high), value in zip(result.intervals, (0.075, 0.6, 30.0), strict=True):
        assert low < value < high < 2 * low


def test_the_suggested_step_keeps_its_promise(small_step: Match) -> None:
    """It is made on the simulated rig, forty times, and the spread of the estimates compared."""
    suggestion = re.fullmatch(
        r"a step from 36 to (\d+) °C would determine (\w+) about (\d+(?:\.\d)?) times better",
        small_step.suggestion,
    )
    assert suggestion is not None
    level = float(suggestion[1])
    name = suggestion[2]
    promised = float(suggestion[3])
    place = small_step.free.index(name)
    before = small_step.standard_errors[place]
    reference = np.concatenate([np.full(60, 36.0), np.full(240, level)])
    improvements = []
    for seed in range(12):
        sensor = Sensor(noise=0.1).realise(reference.size, 1.0, seed)
        response = simulate_closed_loop(
            TRUTH,
            reference,
            states=begin(TRUTH, 36.0),
            controller=PidState(integral=40.0),
            sensor=sensor,
        )
        after = match(Window(reference, response.output, response.input), start=TRUTH)
        improvements.append(before / after.standard_errors[place])
    assert promised > 2.0
    assert np.median(improvements) == pytest.approx(promised, rel=0.5)


def test_without_a_fit_nothing_is_said(record: Recorder) -> None:
    result = match(record(TRUTH, levels=(30.0, 30.0), seed=1), start=TRUTH)
    assert (result.believed, result.determined, result.suggestion) == ((), "", "")
    assert np.isnan(result.intervals).all()
    assert result.intervals.shape == (3, 2)
    assert result.directions.shape == (3, 3)


def test_what_a_step_from_a_hot_start_shows_is_reported_in_a_sentence(
    recorded_hour: Callable[[int], Window],
) -> None:
    """A window of the real rig whose conductance the fit drives to zero: used, but not believed."""
    result = match(recorded_hour(20).part(1500 - 440, 1500), start=RIG.parameters())
    assert result.accepted
    assert "conductance" not in result.believed
    assert result.parameters["conductance"] > 0.0
    assert "not determined and kept: conductance at " in result.reason


# Structures of the plant fitted to rigs whose truth is known.

LEVELS = (50.0, 30.0, 75.0, 45.0, 90.0, 25.0)
FULL = Peltier.model("sink with mass, free ambient, switched drive")
HELD = Peltier.model("held sink")
TRUE = {"seebeck": 0.065, "conductance": 0.65, "heat_capacity": 31.0, "ambient": 291.0}
TRUE |= {"sink_heat_capacity": 280.0, "sink_convection": 2.5}
TRUTH_STRUCTURES = FULL.parameters(**TRUE)


def recorded(
    rig: Parameters,
    sink: float = 291.0,
    seed: int | None = None,
    levels: tuple[float, ...] = LEVELS,
) -> Window:
    reference = np.repeat(levels, 200)
    sensor = None if seed is None else Peltier.sensor.realise(reference.size, 1.0, seed)
    run = simulate_closed_loop(
        rig, reference, states=begin(rig, 22.0, starts={"sink": sink}), sensor=sensor
    )
    return Window(reference, run.output, run.input)


def test_the_truth_is_found_without_noise() -> None:
    fitted = fit_structure([recorded(TRUTH_STRUCTURES, sink=299.0).part(0, 1199)], FULL)
    for name in FULL.structure.free:
        assert fitted.parameters[name] == pytest.approx(
            TRUTH_STRUCTURES[name], rel=1e-5
        ), name
    assert fitted.converged
    assert fitted.cost < 1e-8
    assert fitted.fit == pytest.approx((1.0, 1.0), abs=1e-4)


def test_sensor_lag_and_slope_are_found_without_noise() -> None:
    model = Peltier.model(
        "sink with mass, free ambient, switched drive, sensor lag, α(T)"
    )
    fitted = fit_structure(
        [recorded(model.parameters(**TRUE, sensor_lag=1.2, seebeck_slope=1.5e-4))],
        model,
    )
    assert fitted.parameters["sensor_lag"] == pytest.approx(1.2, rel=1e-3)
    assert fitted.parameters["seebeck_slope"] == pytest.approx(1.5e-4, rel=1e-2)


def test_two_windows_share_the_rig_and_not_the_start_of_the_sink() -> None:
    windows = [
        recorded(TRUTH_STRUCTURES, sink=300.0, levels=LEVELS[:3]),
        recorded(TRUTH_STRUCTURES, sink=310.0, levels=LEVELS[3:]),
    ]
    fitted = fit_structure(windows, FULL)
    assert fitted.n_parameters == len(FULL.structure.free) + 2
    # The sink at the third sample; it has moved by less than 1 K since the first.
    starts = [start["sink"] for start in fitted.starts]
    assert starts == pytest.approx([300.0, 310.0], abs=1.0)
    assert fitted.parameters["heat_capacity"] == pytest.approx(31.0, rel=1e-5)


def test_kicks_of_the_camera_hardly_move_the_parameters() -> None:
    clean = recorded(TRUTH_STRUCTURES, seed=4)
    temperature = clean.output.copy()
    temperature[150::180] += 5.0
    kicked = Window(clean.reference, temperature, clean.input)
    clean_fit, kicked_fit = (
        fit_structure([w], HELD).parameters for w in (clean, kicked)
    )
    # Least squares of the same would move by as much as the six kicks of 50 σ ask: a tenth and more.
    assert kicked_fit["heat_capacity"] == pytest.approx(
        clean_fit["heat_capacity"], rel=0.03
    )


def test_the_first_samples_are_not_judged() -> None:
    window = recorded(TRUTH_STRUCTURES)
    frozen = window.output.copy()
    fitted = fit_structure([window], FULL)
    left_out = 2 + settling_samples(Peltier, window.period)
    assert (
        fitted.measured[0].shape
        == fitted.simulated[0].shape
        == (2, len(window) - left_out)
    )
    np.testing.assert_array_equal(fitted.measured[0][0], frozen[left_out:])


def test_a_search_continues_from_an_earlier_fit() -> None:
    window = recorded(TRUTH_STRUCTURES, seed=2)
    thorough = fit_structure([window], FULL)
    continued = fit_structure([window], FULL, start=thorough, thorough=False)
    assert continued.cost == pytest.approx(thorough.cost, rel=1e-6)
    quick = fit_structure([window], FULL, thorough=False)
    assert quick.cost == pytest.approx(thorough.cost, rel=1e-2)


def test_a_quick_search_ends_within_a_tenth_of_the_standard_errors() -> None:
    """From a fit to a part of the window, as a running twin repeats its fits."""
    window = recorded(TRUTH_STRUCTURES, seed=2)
    of_part = fit_structure([window.part(0, 4 * len(window) // 5)], HELD)
    thorough = fit_structure([window], HELD, start=of_part)
    quick = fit_structure([window], HELD, start=of_part, thorough=False)
    free = HELD.structure.free
    way = np.array(
        [quick.parameters[name] - thorough.parameters[name] for name in free]
    )
    assert quick.converged
    # a thorough search would have gone on
    assert 0.0 < way @ np.linalg.solve(thorough.covariance, way) <= 0.1**2


def test_an_independent_search_finds_the_same() -> None:
    """scipy's robust loss on the plain simulation, derivatives by differences; ours ends no higher."""
    window = recorded(TRUTH_STRUCTURES, seed=3, levels=LEVELS[:3])
    fitted = fit_structure([window], HELD)
    weights = np.array([[1.0 / Peltier.output.noise], [1.0 / Peltier.drive.noise]])
    free = HELD.structure.free

    def residuals(x: np.ndarray) -> np.ndarray:
        return (
            _driven_round(HELD, dict(zip(free, x, strict=True)), window) * weights
        ).ravel()

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
    residuals = np.stack([window.output[2:] - run.output, window.input[2:] - run.input])
    return residuals[:, settling_samples(Peltier, window.period) :]


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
    assert fitted.measured[0].shape == (1, u.size - 2 - settling_samples(Lag, 1.0))
    assert fitted.fit[0] > 0.99
    assert np.isnan(fitted.fit[1])


def test_what_cannot_be_fitted_is_refused() -> None:
    window = recorded(TRUTH_STRUCTURES, levels=(40.0,))
    with pytest.raises(FittingError, match="there is no window"):
        fit_structure([], FULL)
    with pytest.raises(
        FittingError, match="has 62 samples; the first 62 are not compared"
    ):
        fit_structure([window.part(0, 61)], FULL)
    with pytest.raises(FittingError, match=r"controller runs every 0\.5 s"):
        fit_structure([window], FULL, law=replace(Peltier.loop, period=0.5))
