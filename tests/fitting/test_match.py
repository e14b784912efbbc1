"""Matching as a whole: every status, the real rig, repeatability."""

from __future__ import annotations

import importlib
import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.support.plants import Lag, Motor
from twinmatch.dynamics import (
    Descended,
    Disturbance,
    Drive,
    Equations,
    Experiment,
    Output,
    Parameter,
    Parameters,
    Plant,
    PlantError,
    Sensor,
    State,
    Structure,
    begin,
    simulate_closed_loop,
    simulate_driven,
)
from twinmatch.fitting import (
    Expectation,
    FittingError,
    GateLimits,
    Match,
    Status,
    match,
)
from twinmatch.fitting.estimation import (
    QUANTILE,
    Effort,
    Estimate,
    Uncertainty,
    profile_intervals,
    solve,
    starts_for,
    uncertainty,
)
from twinmatch.fitting.match import explaining
from twinmatch.fitting.problem import Noise, Problem
from twinmatch.plants import Peltier, TCLab
from twinmatch.signals import FloatArray, Window
from twinmatch.twin import TwinSettings

Recorder = Callable[..., Window]

RIG = Peltier.model()
TRUTH = RIG.parameters(seebeck=0.075, conductance=0.6, heat_capacity=30.0)
START = RIG.parameters()
WITH_SINK = Peltier.model("sink with mass").parameters(
    **{**dict(TRUTH), "sink_heat_capacity": 300.0, "sink_convection": 3.0}
)
AUTHORS_BOUNDS = {
    "seebeck": (0.02, 0.15),
    "conductance": (0.0, 1.0),
    "heat_capacity": (10.0, 60.0),
}
"""The tighter limits of the paper's matching."""
PLATE = ("seebeck", "conductance", "heat_capacity")


def within(result: Match, truth: Parameters) -> bool:
    """Whether all parameters are within four of their standard errors of the truth."""
    errors = [result.parameters[name] - truth[name] for name in result.free]
    return bool(np.all(np.abs(errors) < 4.0 * result.standard_errors))


def test_a_good_window_is_accepted(record: Recorder) -> None:
    window = record(TRUTH, seed=4)
    result = match(window, start=START)
    assert result.accepted
    assert result.status is Status.ACCEPTED
    assert result.free == ("seebeck", "conductance", "heat_capacity")
    assert result.samples == (window.first, window.last)
    assert within(result, TRUTH)
    assert 0.5 < result.chi2 < 2.0
    assert result.fit.y > 0.97
    assert np.all(result.eigenvalues > 0.0)
    assert not result.starts


def test_parameters_that_are_not_free_stay(record: Recorder) -> None:
    start = RIG.parameters(resistance=3.1, ambient=295.0)
    result = match(record(TRUTH, seed=4), free=["heat_capacity"], start=start)
    assert result.parameters == start.replace(
        heat_capacity=result.parameters["heat_capacity"]
    )


def test_the_same_window_gives_the_same_bits(record: Recorder) -> None:
    window = record(WITH_SINK, seed=4)
    first, second = (match(window, free=PLATE, start=WITH_SINK) for _ in range(2))
    assert first.parameters == second.parameters
    assert first.reason == second.reason
    assert first.covariance.tobytes() == second.covariance.tobytes()


def test_a_moving_sink_brings_its_unknown_start(record: Recorder) -> None:
    window = record(WITH_SINK, seed=4)
    result = match(window, free=PLATE, start=WITH_SINK.replace(seebeck=0.06))
    assert result.accepted
    assert result.free == (*PLATE, "sink")
    assert result.covariance.shape == (4, 4)
    assert set(result.starts) == {"sink"}
    assert 285.0 < result.starts["sink"] < 300.0


def test_without_a_step_there_is_no_excitation(record: Recorder) -> None:
    result = match(record(TRUTH, levels=(30.0, 30.4), seed=1), start=START)
    assert result.status is Status.NO_EXCITATION
    assert "did not move by 0.5 °C within the window's 200 samples" in result.reason
    assert result.parameters == START
    assert np.isnan(result.covariance).all()
    assert np.isnan(result.standard_errors).all()
    assert all(
        map(math.isnan, (*result.fit, *result.held_back, result.chi2, result.condition))
    )
    assert (
        match(
            record(TRUTH, levels=(30.0, 30.4), seed=1), start=START, min_step=0.5
        ).status
        is not Status.NO_EXCITATION
    )


def test_a_step_near_the_end_is_too_late(record: Recorder) -> None:
    window = record(TRUTH, levels=(30.0, 50.0))
    result = match(window.part(1060, 1190), start=START)
    assert result.status is Status.NO_EXCITATION
    assert "moved at sample 1160, too near to the window's end at 1190" in result.reason
    assert (
        match(window.part(1060, 1210), start=START).status is not Status.NO_EXCITATION
    )


@pytest.mark.parametrize("size", [1, 2, 5])
def test_a_handful_of_samples_is_not_excitation(size: int) -> None:
    window = Window(np.linspace(20.0, 60.0, size), np.full(size, 20.0), np.zeros(size))
    assert match(window, start=START).status is Status.NO_EXCITATION


def test_a_lost_drive_is_not_explained(record: Recorder) -> None:
    window = record(TRUTH, seed=4)
    lost = np.where(
        np.arange(len(window)) > 180,
        30.0 + 25.0 * np.exp(-np.arange(len(window)) / 80),
        0.0,
    )
    temperature = np.where(lost > 0.0, lost, window.output)
    result = match(
        Window(window.reference, temperature, window.input, first=window.first),
        start=START,
    )
    assert result.status is Status.NOT_EXPLAINED
    assert "the plant did something" in result.reason


def test_a_truth_outside_the_bounds_hits_them(record: Recorder) -> None:
    result = match(
        record(TRUTH, seed=4), start=START, bounds={"heat_capacity": (40.0, 60.0)}
    )
    assert result.status is Status.BOUNDS_HIT
    assert result.bounds_hit == ("heat_capacity",)
    assert result.parameters["heat_capacity"] == 40.0
    assert "heat_capacity ended on its bound at 40" in result.reason


def test_a_small_step_does_not_determine_the_parameters(record: Recorder) -> None:
    window = record(TRUTH, levels=(30.0, 33.0), seed=4)
    result = match(window, start=TRUTH, limits=GateLimits(relative_error=0.02))
    assert result.status is Status.NOT_IDENTIFIABLE
    assert "this window does not determine it" in result.reason


def test_what_a_small_step_leaves_open_stays_where_it_stood(record: Recorder) -> None:
    window = record(TRUTH, levels=(30.0, 33.0), seed=4)
    standing = TRUTH.replace(seebeck=0.08, conductance=0.62, heat_capacity=32.0)
    result = match(window, start=standing)
    assert result.accepted
    assert "not determined and kept: seebeck at 0.08 (possible: " in result.reason
    assert result.parameters["seebeck"] == 0.08
    assert result.parameters["heat_capacity"] != 32.0
    assert "seebeck" not in result.believed
    assert np.isfinite(result.covariance).all()
    assert result.suggestion.startswith("a step from 33 to ")


def test_what_stands_is_kept_only_as_far_as_the_window_allows(record: Recorder) -> None:
    window = record(TRUTH, levels=(30.0, 33.0), seed=4)
    far = match(window, start=TRUTH.replace(seebeck=0.005))
    low, high = far.intervals[0]
    assert 0.01 < low < TRUTH["seebeck"] < high
    assert far.parameters["seebeck"] == pytest.approx(low)
    assert far.parameters["seebeck"] / far.parameters["heat_capacity"] == pytest.approx(
        0.0025, rel=0.5
    )


def test_a_fit_that_may_not_finish_did_not_converge(
    record: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    hasty = partial(solve, effort=Effort(evaluations=2))
    # `twinmatch.fitting.match` is the function once the package is imported.
    module = importlib.import_module("twinmatch.fitting.match")
    monkeypatch.setattr(module, "solve", hasty)
    assert match(record(TRUTH, seed=4), start=START).status is Status.DID_NOT_CONVERGE


def test_an_incumbent_that_is_the_truth_is_hard_to_beat(record: Recorder) -> None:
    window = record(TRUTH, seed=4)
    limits = GateLimits(slack=0.9)  # better by a tenth is more than noise allows
    assert (
        match(window, start=START, incumbent=TRUTH, limits=limits).status
        is Status.NOT_BETTER
    )
    poor = TRUTH.replace(seebeck=0.05)
    assert (
        match(window, start=START, incumbent=poor, limits=limits).status
        is Status.ACCEPTED
    )


def test_values_of_the_plant_file_that_no_fit_beats_are_the_match(
    record: Recorder,
) -> None:
    """Where nothing stands yet, refusing the fit would leave no twin although a good one is known."""
    window = record(TRUTH, seed=4)
    kept = match(window, start=TRUTH, limits=GateLimits(slack=0.9))
    assert kept.accepted
    assert kept.reason.startswith("the values of the plant file explain the window")
    assert [kept.parameters[name] for name in kept.free] == [
        TRUTH[name] for name in kept.free
    ]
    assert kept.chi2 < 1.5
    assert kept.believed == ()
    fitted = match(window, start=TRUTH)
    assert np.sqrt(np.diag(kept.covariance)) == pytest.approx(
        fitted.standard_errors, rel=0.5
    )
    # they do not stand for a window that they do not explain
    strict = GateLimits(slack=0.9, chi2=0.99 * kept.chi2)
    assert not match(window, start=TRUTH, limits=strict).accepted


def test_an_incumbent_with_a_moving_sink_gets_its_sink_fitted(record: Recorder) -> None:
    window = record(WITH_SINK, seed=4)
    truth = match(
        window, start=TRUTH, incumbent=WITH_SINK, limits=GateLimits(slack=0.9)
    )
    cold = match(
        window,
        start=TRUTH,
        incumbent=TRUTH.replace(ambient=270.0),
        limits=GateLimits(slack=0.9),
    )
    assert truth.status is Status.NOT_BETTER
    assert cold.status is Status.ACCEPTED


def test_other_periods_are_matched_as_well() -> None:
    gains = replace(Peltier.loop, proportional=20.0, back_calculation=2.0, period=0.5)
    reference = np.repeat([30.0, 50.0, 40.0], 150)
    whole = simulate_closed_loop(TRUTH, reference, states=begin(TRUTH, 30.0), law=gains)
    window = Window(reference, whole.output, whole.input, period=0.5)
    result = match(window, start=START, law=gains)
    assert result.parameters["heat_capacity"] == pytest.approx(30.0, rel=1e-6)
    with pytest.raises(
        FittingError,
        match=r"controller runs every 1\.0 s but the window's samples come every 0\.5",
    ):
        match(window, start=START, law=Peltier.loop)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (
            {"free": ["alpha"]},
            "'alpha' cannot be free in Peltier rig, held sink; choose from seebeck",
        ),
        ({"free": []}, "give at least one parameter and none twice"),
        (
            {"free": ["seebeck", "seebeck"]},
            "give at least one parameter and none twice",
        ),
        (
            {"free": ["sink_convection"]},
            "'sink_convection' cannot be free in Peltier rig, held sink",
        ),
        (
            {"bounds": {"alpha": (0.0, 1.0)}},
            "bounds for 'alpha', which is unknown; choose from seebeck",
        ),
        (
            {"bounds": {"conductance": (1.0, 0.0)}},
            r"the bounds of conductance are 1\.0 and 0\.0",
        ),
        (
            {"bounds": {"conductance": (-1.0, 1.0)}},
            "conductance is -1 W/K; it must be finite and at least 0",
        ),
    ],
)
def test_questions_without_meaning_are_refused(
    record: Recorder, asked: dict[str, Any], words: str
) -> None:
    with pytest.raises((FittingError, PlantError), match=words):
        match(record(TRUTH), start=START, **asked)


def test_impossible_noise_is_refused() -> None:
    with pytest.raises(
        FittingError, match=r"noise: input is 0\.0; it must be finite and positive"
    ):
        Noise(0.1, 0.0)


def two_regime_windows(hour: Window) -> Iterator[Window]:
    """From 20 samples before a set-point step to 240 after the next, or to the one after that."""
    steps = [
        0,
        *(np.flatnonzero(np.abs(np.diff(hour.reference)) >= 2.0) + 1).tolist(),
        len(hour),
    ]
    for before, step, after in zip(steps, steps[1:], steps[2:], strict=False):
        yield hour.part(max(before - 20, 0), min(step + 240, after - 1))


def matches(hour: Window, start: Parameters) -> Iterator[tuple[Window, Match]]:
    standing = start
    for window in two_regime_windows(hour):
        result = match(window, free=PLATE, start=standing)
        standing = result.parameters if result.accepted else standing
        yield window, result


@pytest.mark.parametrize("start", [START, WITH_SINK])
def test_no_window_with_the_lost_drive_is_accepted(
    recorded_hour: Callable[[int], Window], start: Parameters
) -> None:
    faulty = [
        result
        for window, result in matches(recorded_hour(27), start)
        if window.last > 2155
    ]
    assert len(faulty) >= 4
    assert {result.status for result in faulty} == {Status.NOT_EXPLAINED}


def test_healthy_windows_are_accepted_or_honestly_refused(
    recordings: dict[int, Path], recorded_hour: Callable[[int], Window]
) -> None:
    count: Counter[Status] = Counter()
    for number in set(recordings) & {1, 5, 14}:
        count.update(
            result.status for _, result in matches(recorded_hour(number), START)
        )
    total = sum(count.values())
    # The one suspicion is the start of recording 1, where the camera lags several seconds.
    assert count[Status.NOT_EXPLAINED] <= 1
    assert count[Status.DID_NOT_CONVERGE] == 0
    assert count[Status.ACCEPTED] + count[Status.BOUNDS_HIT] >= 0.8 * total
    assert count[Status.ACCEPTED] >= 0.5 * total


def test_the_authors_bounds_are_kept(recorded_hour: Callable[[int], Window]) -> None:
    result = match(recorded_hour(9).part(880, 1299), start=START, bounds=AUTHORS_BOUNDS)
    assert result.status is Status.BOUNDS_HIT
    for name, (low, high) in AUTHORS_BOUNDS.items():
        assert low <= result.parameters[name] <= high


# Plants that are not thermal: matched by what their files say, with their loop and without one.

MOTOR = Motor.model()
TRUTH_ANY_PLANT = MOTOR.parameters(k=0.06, j=6e-4, b=2e-4)
LAG = Lag.model()


def spun(
    levels: tuple[float, ...] = (50.0, 150.0, 90.0), seed: int | None = 3
) -> Window:
    """The motor in its speed loop, every 0.05 s, under a load that changes halfway."""
    reference = np.repeat(levels, 120)
    load = np.where(np.arange(reference.size) < reference.size // 2, 0.0, 0.05)[:, None]
    sensor = (
        None if seed is None else Sensor(noise=0.2).realise(reference.size, 0.05, seed)
    )
    run = simulate_closed_loop(
        TRUTH_ANY_PLANT,
        reference,
        states=begin(TRUTH_ANY_PLANT, 50.0),
        law=Motor.loop,
        disturbances=load,
        sensor=sensor,
    )
    return Window(reference, run.output, run.input, period=0.05, disturbances=load)


def driven(seed: int | None = 5) -> Window:
    """A lag under a staircase of voltages; nobody knows what commands them."""
    u = np.repeat([0.0, 3.0, -2.0, 4.0], 60)
    sensor = None if seed is None else Sensor(noise=0.01).realise(u.size, 1.0, seed)
    truth = LAG.parameters(gain=3.0, lag=7.0)
    run = simulate_driven(truth, u, states=begin(truth, 0.0), sensor=sensor)
    return Window(np.zeros(u.size), run.output, u)


def test_a_motor_is_found_exactly_without_noise_and_through_its_sensor() -> None:
    a_match = match(spun(seed=None), start=MOTOR.parameters())
    assert a_match.free == ("k", "j", "b")
    assert a_match.accepted
    for name in a_match.free:
        assert a_match.parameters[name] == pytest.approx(
            TRUTH_ANY_PLANT[name], rel=1e-6
        )
    a_match = match(spun(), start=MOTOR.parameters())
    assert a_match.accepted
    assert within(a_match, TRUTH_ANY_PLANT)


def test_words_use_the_plant_s_own_units() -> None:
    still = match(spun((50.0, 50.5)), start=MOTOR.parameters())
    assert still.status is Status.NO_EXCITATION
    assert (
        still.reason
        == "the set-point did not move by 1 rad/s within the window's 240 samples"
    )


def test_a_lag_without_a_known_loop_is_found_from_its_input() -> None:
    a_match = match(driven(None), start=LAG.parameters())
    assert a_match.accepted
    assert a_match.parameters["gain"] == pytest.approx(3.0, rel=1e-6)
    assert a_match.parameters["lag"] == pytest.approx(7.0, rel=1e-6)
    assert a_match.fit.y == pytest.approx(1.0, abs=1e-6)
    assert np.isnan(a_match.fit.u)
    assert a_match.suggestion == ""


def test_what_a_driven_twin_says_of_its_error_is_that_of_plain_regression() -> None:
    """Noise meets nothing on its way round, so (JᵀJ)⁻¹ of scipy's own Jacobian is the covariance."""
    window = driven()
    a_match = match(window, start=LAG.parameters())

    def residuals(x: np.ndarray) -> np.ndarray:
        plant = LAG.parameters(gain=x[0], lag=x[1])
        run = simulate_driven(
            plant, window.input[2:], states=begin(plant, float(window.output[2]))
        )
        return (window.output[2:] - run.output) / Lag.y.noise

    theirs = least_squares(residuals, [2.5, 6.0], x_scale=[1.0, 5.0], diff_step=1e-7)
    assert [a_match.parameters["gain"], a_match.parameters["lag"]] == pytest.approx(
        theirs.x, rel=1e-5
    )
    plain = np.sqrt(np.diag(np.linalg.inv(theirs.jac.T @ theirs.jac)) * a_match.chi2)
    assert a_match.standard_errors == pytest.approx(plain, rel=0.05)
    assert a_match.accepted


class Ventilated(Plant, name="ventilated"):
    """A lag that loses more while a fan runs."""

    y = Output(unit="m", noise=0.01, span=(-100.0, 100.0))
    u = Drive(unit="V", limits=(-10.0, 10.0), noise=0.1)
    fan = Disturbance(unit="1", default=0.0)
    x = State(unit="m", span=(-50.0, 50.0))
    gain = Parameter(unit="m/V", default=2.0, bounds=(0.1, 10.0), positive=True)
    lag = Parameter(unit="s", default=5.0, bounds=(0.5, 50.0), positive=True)
    blown = Parameter(unit="1", default=0.2, bounds=(0.0, 5.0), least=0.0)
    structures = {"lag": Structure(free=("gain", "lag", "blown"))}  # noqa: RUF012

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        """One line."""
        lost = (1.0 + self.blown * self.fan) * self.x
        return Equations(
            rates={self.x: (self.gain * self.u - lost) / self.lag},
            output=self.x,
            start={self.x: self.y},
        )


def test_what_a_window_does_not_show_at_all_is_kept_and_hides_nothing_else() -> None:
    """The fan rests: its parameter has no effect, and the others are those of a lag without a fan."""
    quiet = driven()
    of_lag = match(quiet, start=LAG.parameters())
    window = replace(quiet, disturbances=np.zeros((len(quiet), 1)))
    of_both = match(window, start=Ventilated.model().parameters())
    assert of_both.status is of_lag.status is Status.ACCEPTED
    assert of_both.parameters["blown"] == 0.2
    assert "not determined and kept: blown" in of_both.reason
    for name in ("gain", "lag"):
        assert of_both.parameters[name] == pytest.approx(
            of_lag.parameters[name], rel=1e-6
        )
    assert of_both.believed == of_lag.believed == ("gain", "lag")
    np.testing.assert_allclose(of_both.intervals[:2], of_lag.intervals, rtol=1e-3)
    assert of_both.intervals[2].tolist() == [0.0, math.inf]


def test_an_input_that_stands_still_excites_nothing() -> None:
    still = Window(np.zeros(100), np.full(100, 6.0), np.full(100, 2.0))
    a_match = match(still, start=LAG.parameters())
    assert a_match.status is Status.NO_EXCITATION
    far = "so far that the output would show it, by 0.05 m within the window's 100 samples"
    assert a_match.reason == f"the input did not move {far}"


class Blended(Plant, name="blended"):
    """A lag with two inputs and an unknown rest."""

    y = Output(unit="m", noise=0.01, span=(-100.0, 100.0))
    u = Drive(unit="V", limits=(-10.0, 10.0), noise=0.1)
    v = Drive(unit="V", limits=(-10.0, 10.0), noise=0.1)
    x = State(unit="m", span=(-50.0, 50.0))
    lag = Parameter(unit="s", default=5.0, bounds=(0.5, 50.0), positive=True)
    by_u = Parameter(unit="m/V", default=2.0, bounds=(0.1, 10.0), positive=True)
    by_v = Parameter(unit="m/V", default=2.0, bounds=(0.1, 10.0), positive=True)
    rest = Parameter(unit="m", default=0.0, bounds=(-9.0, 9.0), scale=1.0)
    structures = {  # noqa: RUF012
        "lag": Structure(free=("lag", "by_u", "by_v", "rest"))
    }

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        """One line."""
        driven_by = self.by_u * self.u + self.by_v * self.v
        level = self.rest + driven_by
        return Equations(
            rates={self.x: (level - self.x) / self.lag},
            output=self.x,
            start={self.x: self.y},
        )


def test_the_gain_of_an_input_that_stood_still_is_kept_and_hides_nothing_else() -> None:
    """Its effect and the rest show only together: that one is kept, and this one takes the difference."""
    by_one = driven()
    inputs = np.column_stack([by_one.input, np.ones(len(by_one))])
    window = replace(by_one, outputs=by_one.outputs + 3.0, inputs=inputs)
    a_match = match(window, start=Blended.model().parameters())
    assert a_match.status is Status.ACCEPTED
    assert "not determined and kept: by_v at 2 (possible:" in a_match.reason
    assert a_match.believed == ("lag", "by_u")
    alone = match(by_one, start=LAG.parameters())
    for name, of_lag in (("lag", "lag"), ("by_u", "gain")):
        assert a_match.parameters[name] == pytest.approx(alone.parameters[of_lag], 1e-2)
    assert a_match.parameters["rest"] == pytest.approx(1.0, abs=0.01)


def test_names_of_another_plant_are_refused() -> None:
    with pytest.raises(FittingError, match="'seebeck' cannot be free in Lag, lag"):
        match(driven(), start=LAG.parameters(), free=["seebeck"])


# Profile-likelihood intervals: against brute force, and whether they hold what they promise.

FREE = ("seebeck", "conductance", "heat_capacity")


def fitted(window: Window) -> tuple[Problem, Estimate, Uncertainty]:
    posed = Problem(window, FREE, TRUTH, Noise.of(Peltier), Peltier.loop)
    estimate = solve(posed, starts_for(posed, TRUTH))
    return posed, estimate, uncertainty(posed, estimate)


@pytest.mark.parametrize(
    ("levels", "seed"), [((30.0, 55.0, 42.0), 3), ((30.0, 45.0), 5), ((60.0, 35.0), 1)]
)
def test_the_ends_are_where_a_fit_of_the_others_has_risen_to_the_limit(
    record: Recorder, levels: tuple[float, ...], seed: int
) -> None:
    """Each finite end by brute force: the others fitted by scipy with this parameter held there."""
    posed, estimate, knowledge = fitted(record(TRUTH, levels=levels, seed=seed))
    intervals = profile_intervals(posed, estimate.values, knowledge.covariance)
    rises = (
        QUANTILE
        * np.diag(knowledge.covariance)
        / np.diag(np.linalg.inv(knowledge.fisher))
    )
    least = estimate.chi2 * estimate.residuals.size
    finite = 0
    for i, side in np.ndindex(3, 2):
        end = intervals[i, side]
        if not np.isfinite(end) or end == 0.0:
            continue
        finite += 1
        other_places = [j for j in range(3) if j != i]

        def residuals(
            x: np.ndarray,
            i: int = i,
            end: float = end,
            places: list[int] = other_places,
        ) -> np.ndarray:
            values = np.empty(3)
            values[i] = end
            values[places] = x
            return posed.residuals(values).ravel()

        fits = [
            least_squares(
                residuals,
                start[other_places],
                bounds=(posed.lower[other_places], posed.upper[other_places]),
                x_scale=posed.scales[other_places],
                diff_step=1e-6,
            ).cost
            for start in (estimate.values, *starts_for(posed, TRUTH))
        ]
        assert (2 * min(fits) - least) / rises[i] == pytest.approx(1.0, abs=0.05)
    assert finite >= 4


def test_a_well_determined_interval_is_that_of_the_variance(record: Recorder) -> None:
    posed, _, knowledge = fitted(record(TRUTH, seed=2))
    alone = Problem(
        posed.window, ("heat_capacity",), TRUTH, Noise.of(Peltier), Peltier.loop
    )
    single = solve(alone, [alone.values_of(TRUTH)])
    of_one = uncertainty(alone, single)
    (low, high) = profile_intervals(alone, single.values, of_one.covariance)[0]
    half = 1.96 * np.sqrt(of_one.covariance[0, 0])
    assert [low, high] == pytest.approx(
        [single.values[0] - half, single.values[0] + half], rel=0.01
    )
    assert high - low < 0.5 * 2 * 1.96 * np.sqrt(knowledge.covariance[2, 2])


def test_nineteen_of_twenty_intervals_hold_the_truth(record: Recorder) -> None:
    """Eighty noisy windows; 95 % of 80 is 76 ± 2, and the folded valley of conductance costs some."""
    truth = np.array([TRUTH[name] for name in FREE])
    inside = []
    for seed in range(80):
        posed, estimate, knowledge = fitted(
            record(TRUTH, levels=(30.0, 50.0), seed=seed)
        )
        low, high = profile_intervals(posed, estimate.values, knowledge.covariance).T
        inside.append((low <= truth) & (truth <= high))
    assert np.all(np.mean(inside, axis=0) >= 0.86)
    assert 0.91 <= np.mean(inside) <= 0.995


def test_what_the_window_does_not_close_is_open(record: Recorder) -> None:
    posed, estimate, knowledge = fitted(record(TRUTH, levels=(30.0, 32.0), seed=4))
    intervals = profile_intervals(posed, estimate.values, knowledge.covariance)
    # a Seebeck coefficient as small as you like
    assert np.argwhere(np.isinf(intervals)).tolist() == [[0, 0]]
    infinite = profile_intervals(posed, estimate.values, np.full((3, 3), np.inf))
    assert infinite[:, 1].tolist() == [np.inf] * 3
    assert infinite[:, 0].tolist() == [-np.inf, 0.0, -np.inf]


def test_ends_beside_an_unknown_start_are_where_the_sum_has_risen(
    record: Recorder,
) -> None:
    """A sink with mass: its start follows when the conductance is moved, by brute force too."""
    rig = Peltier.model("sink with mass").parameters(
        **{**dict(TRUTH), "sink_heat_capacity": 300.0, "sink_convection": 3.0}
    )
    posed = Problem(
        record(rig, seed=1), ("conductance",), rig, Noise.of(Peltier), Peltier.loop
    )
    assert posed.names == ("conductance", "sink")
    estimate = solve(posed, [posed.values_of(rig)])
    knowledge = uncertainty(posed, estimate)
    low, high = profile_intervals(posed, estimate.values, knowledge.covariance)[0]
    rise = QUANTILE * knowledge.covariance[0, 0] / np.linalg.inv(knowledge.fisher)[0, 0]
    least = estimate.chi2 * estimate.residuals.size
    for end in (low, high):
        fitted_start = least_squares(
            lambda x, end=end: posed.residuals(np.array([end, x[0]])).ravel(),
            [estimate.values[1]],
            diff_step=1e-6,
        )
        assert (2 * fitted_start.cost - least) / rise == pytest.approx(1.0, abs=0.05)
    assert low < estimate.values[0] < high


def test_ends_in_a_valley_that_bends_are_found_in_few_evaluations(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A heater that is switched every half minute hardly shows its neighbour: Newton's iteration fails for every
    end. Refits to the last digit, from values of the others that belong elsewhere, took 1297."""
    random = np.random.default_rng(5)
    power = np.repeat(random.choice(np.linspace(0.0, 80.0, 17), 10), 30)
    kit = TCLab.model(TCLab.followed).typical()
    run = simulate_driven(kit, power, states=begin(kit, 23.0), period=1.0)
    readings = run.output + 0.1 * random.normal(size=power.size)
    second_heater = np.zeros((power.size, 1))
    window = Window(np.zeros(power.size), readings, power, disturbances=second_heater)
    start = TCLab.model("sensor lag, neighbour").typical()
    posed = Problem(window, start.model.structure.free, start, Noise.of(TCLab), None)
    estimate = solve(posed, starts_for(posed, start))
    knowledge = uncertainty(posed, estimate)
    evaluations = []
    search = Experiment.descend
    evaluate = Experiment.normal

    def counted_search(*args: Any, **options: Any) -> Descended:
        result = search(*args, **options)
        evaluations.append(result.evaluations)
        return result

    def counted_evaluation(*args: Any) -> tuple[float, FloatArray, FloatArray]:
        evaluations.append(1)
        return evaluate(*args)

    with monkeypatch.context() as patched:
        patched.setattr(Experiment, "descend", counted_search)
        patched.setattr(Experiment, "normal", counted_evaluation)
        intervals = profile_intervals(
            posed, estimate.values, knowledge.covariance_of_shown
        )
    assert len(evaluations) > 100  # several for each end
    assert sum(evaluations) < 800
    units = np.outer(posed.scales, posed.scales)
    of_white_noise = np.diag(np.linalg.inv(knowledge.fisher * units) * units)
    rises = QUANTILE * np.diag(knowledge.covariance) / of_white_noise
    least = estimate.chi2 * estimate.residuals.size
    has_risen = []
    for i, side in np.ndindex(len(posed.names), 2):
        end = intervals[i, side]
        if not np.isfinite(end) or end == 0.0:
            continue
        held = posed.lower.copy(), posed.upper.copy()
        held[0][i] = held[1][i] = end
        begun = estimate.values.copy()
        begun[i] = end
        refit = search(posed.experiment, begun, *held, posed.scales, 200)
        has_risen.append(abs((refit.cost - least) / rises[i] - 1.0) < 0.03)
    # the valley of two ends folds back, so that a search from elsewhere ends in another one
    assert sum(has_risen) >= 9
    assert len(has_risen) == 11


# --- what is known beforehand ---


def test_with_a_prior_the_match_is_where_an_independent_search_finds_it(
    record: Recorder,
) -> None:
    window = record(TRUTH, seed=4)
    expected = {
        "conductance": Expectation(0.5, 0.02),
        "heat_capacity": Expectation(33.0, 1.0),
    }
    a_match = match(window, start=START, prior=expected)
    problem = Problem(window, PLATE, START, Noise.of(Peltier), Peltier.loop)

    def residuals(values: FloatArray) -> FloatArray:
        pulled = [  # one independent residual is 30 of those that follow one another
            math.sqrt(30.0)
            * (values[PLATE.index(name)] - expectation.mean)
            / expectation.deviation
            for name, expectation in expected.items()
        ]
        return np.concatenate([problem.residuals(values).ravel(), pulled])

    best = least_squares(
        residuals,
        problem.values_of(START),
        x_scale=[0.1, 1.0, 30.0],
        xtol=1e-12,
        ftol=1e-12,
    )
    # Both searches end where a step changes the cost by less than a part in a million.
    np.testing.assert_allclose(
        [a_match.parameters[n] for n in PLATE], best.x, rtol=2e-4
    )
    plain = match(window, start=START)
    assert abs(a_match.parameters["conductance"] - 0.5) < abs(
        plain.parameters["conductance"] - 0.5
    )
    right = match(
        window,
        start=START,
        prior={n: Expectation(TRUTH[n], 0.1 * TRUTH[n]) for n in PLATE},
    )
    # What the window leaves open is known better. The prior weighs as if the residuals were correlated
    # as on a real rig; these are not, so the conductance, which they show, gets some of the prior's error.
    assert (
        np.diag(right.covariance)
        <= np.array([0.6, 2.0, 0.6]) * np.diag(plain.covariance)
    ).all()


def test_a_vague_prior_changes_nothing_and_a_window_outweighs_a_wrong_one(
    record: Recorder,
) -> None:
    window = record(TRUTH, seed=4)
    plain = match(window, start=START)
    vague = match(
        window,
        start=START,
        prior={name: Expectation(2.0 * START[name], 1e5) for name in PLATE},
    )
    for name in PLATE:
        assert vague.parameters[name] == pytest.approx(plain.parameters[name], rel=1e-4)
    wrong = match(
        window,
        start=START,
        prior={"conductance": Expectation(1.3 * TRUTH["conductance"], 0.06)},
    )
    error = abs(wrong.parameters["conductance"] / TRUTH["conductance"] - 1.0)
    assert error < 0.1, (
        "a window of 300 samples moves a prior that is off by three deviations"
    )


def test_a_prior_that_is_right_makes_windows_that_show_little_agree(
    record: Recorder,
) -> None:
    """Small steps: what one window leaves open was accepted anywhere in its valley."""
    right = {name: Expectation(TRUTH[name], 0.1 * TRUTH[name]) for name in PLATE}

    def errors(a_match: Match) -> list[float]:
        return [a_match.parameters[name] / TRUTH[name] - 1.0 for name in PLATE]

    spread = {}
    for name, prior in (("without", {}), ("with", right)):
        matches = [
            match(
                record(TRUTH, levels=(40.0, 43.0, 40.0), seed=k),
                start=START,
                prior=prior,
            )
            for k in range(6)
        ]
        spread[name] = np.std([errors(a_match) for a_match in matches], axis=0)
    assert (spread["with"] <= 0.6 * spread["without"]).all()
    assert (spread["with"] <= 0.1).all()


@pytest.mark.parametrize(
    ("sensor_lag", "most_justified"), [(2.0, "no lag"), (5.0, "sensor lag")]
)
def test_of_two_structures_that_explain_a_window_the_larger_must_explain_more(
    sensor_lag: float, most_justified: str
) -> None:
    """A lag of a few samples leaves hardly more than noise where it is left out; a longer one shows."""
    kit = TCLab.model("sensor lag").typical().replace(sensor_lag=sensor_lag)
    law = TwinSettings.of(TCLab).law
    reference = np.repeat([35.0, 45.0], [60, 340])
    run = simulate_closed_loop(kit, reference, states=begin(kit, 25.0), law=law)
    noise = 0.12 * np.random.default_rng(1).standard_normal(run.outputs.shape)
    window = Window(reference, run.outputs + noise, run.inputs)
    starts = [TCLab.model(name).typical() for name in ("no lag", "sensor lag")]
    justified = explaining(window, starts, TwinSettings.of(TCLab).noise, law)
    assert len(justified) == 2
    assert justified[0].model.structure_name == most_justified
