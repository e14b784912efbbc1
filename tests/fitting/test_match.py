"""Matching as a whole: every status, the real rig, repeatability."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twinmatch.dynamics import Parameters, PlantError, begin, simulate_closed_loop
from twinmatch.fitting import FittingError, GateLimits, Match, Noise, Status, match
from twinmatch.plants import Peltier
from twinmatch.signals import Window

Recorder = Callable[..., Window]

RIG = Peltier.model()
TRUTH = RIG.parameters(seebeck=0.075, conductance=0.6, heat_capacity=30.0)
START = RIG.parameters()
WITH_SINK = Peltier.model("sink with mass").parameters(
    **{**dict(TRUTH), "sink_heat_capacity": 300.0, "sink_convection": 3.0}
)
AUTHORS_BOUNDS = {"seebeck": (0.02, 0.15), "conductance": (0.0, 1.0), "heat_capacity": (10.0, 60.0)}
"""The tighter limits of the paper's matching."""
PLATE = ("seebeck", "conductance", "heat_capacity")


def test_a_good_window_is_accepted(record: Recorder) -> None:
    window = record(TRUTH, seed=4)
    result = match(window, start=START)
    assert result.accepted
    assert result.status is Status.ACCEPTED
    assert result.free == ("seebeck", "conductance", "heat_capacity")
    assert result.samples == (window.first, window.last)
    truth = np.array([TRUTH[name] for name in PLATE])
    found = np.array([result.parameters[name] for name in result.free])
    assert np.all(np.abs(found - truth) < 4.0 * result.standard_errors)
    assert 0.5 < result.chi2 < 2.0
    assert result.fit.y > 0.97
    assert np.all(np.diag(result.correlation) == pytest.approx(1.0))
    assert np.all(np.abs(result.correlation) <= 1.0 + 1e-12)
    assert np.all(result.eigenvalues > 0.0)
    assert not result.starts


def test_parameters_that_are_not_free_stay(record: Recorder) -> None:
    start = RIG.parameters(resistance=3.1, ambient=295.0)
    result = match(record(TRUTH, seed=4), free=["heat_capacity"], start=start)
    assert result.parameters == start.replace(heat_capacity=result.parameters["heat_capacity"])


def test_the_same_window_gives_the_same_bits(record: Recorder) -> None:
    window = record(WITH_SINK, seed=4)
    one, two = (match(window, free=PLATE, start=WITH_SINK) for _ in range(2))
    assert one.parameters == two.parameters
    assert one.reason == two.reason
    assert one.covariance.tobytes() == two.covariance.tobytes()


def test_a_moving_sink_brings_its_unknown_start(record: Recorder) -> None:
    window = record(WITH_SINK, seed=4)
    result = match(window, free=PLATE, start=WITH_SINK.replace(seebeck=0.06))
    assert result.accepted
    assert result.free == (*PLATE, "sink")
    assert result.covariance.shape == (4, 4)
    assert set(result.starts) == {"sink"}
    assert 285.0 < result.starts["sink"] < 300.0


def test_without_a_step_there_is_no_excitation(record: Recorder) -> None:
    result = match(record(TRUTH, levels=(30.0, 31.0), seed=1), start=START)
    assert result.status is Status.NO_EXCITATION
    assert "did not move by 2 °C within the window's 200 samples" in result.reason
    assert result.parameters == START
    assert np.isnan(result.covariance).all()
    assert np.isnan(result.standard_errors).all()
    assert np.isnan(result.correlation).all()
    assert all(map(math.isnan, (*result.fit, *result.held_back, result.chi2, result.condition)))
    assert (
        match(record(TRUTH, levels=(30.0, 31.0), seed=1), start=START, min_step=0.5).status
        is not Status.NO_EXCITATION
    )


def test_a_step_near_the_end_is_too_late(record: Recorder) -> None:
    window = record(TRUTH, levels=(30.0, 50.0))
    result = match(window.part(1060, 1190), start=START)
    assert result.status is Status.NO_EXCITATION
    assert "moved at sample 1160, too near to the window's end at 1190" in result.reason
    assert match(window.part(1060, 1210), start=START).status is not Status.NO_EXCITATION


@pytest.mark.parametrize("size", [1, 2, 5])
def test_a_handful_of_samples_is_not_excitation(size: int) -> None:
    window = Window(np.linspace(20.0, 60.0, size), np.full(size, 20.0), np.zeros(size))
    assert match(window, start=START).status is Status.NO_EXCITATION


def test_a_lost_drive_is_not_explained(record: Recorder) -> None:
    window = record(TRUTH, seed=4)
    lost = np.where(np.arange(len(window)) > 180, 30.0 + 25.0 * np.exp(-np.arange(len(window)) / 80), 0.0)
    temperature = np.where(lost > 0.0, lost, window.output)
    result = match(Window(window.reference, temperature, window.input, first=window.first), start=START)
    assert result.status is Status.NOT_EXPLAINED
    assert "the plant did something" in result.reason


def test_a_truth_outside_the_bounds_hits_them(record: Recorder) -> None:
    result = match(record(TRUTH, seed=4), start=START, bounds={"heat_capacity": (40.0, 60.0)})
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
    assert far.parameters["seebeck"] / far.parameters["heat_capacity"] == pytest.approx(0.0025, rel=0.5)


def test_a_fit_that_may_not_finish_did_not_converge(
    record: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twinmatch.fitting.estimation._MOST_EVALUATIONS", 2)
    assert match(record(TRUTH, seed=4), start=START).status is Status.DID_NOT_CONVERGE


def test_an_incumbent_that_is_the_truth_is_hard_to_beat(record: Recorder) -> None:
    window = record(TRUTH, seed=4)
    limits = GateLimits(slack=0.9)  # better by a tenth is more than noise allows
    assert match(window, start=START, incumbent=TRUTH, limits=limits).status is Status.NOT_BETTER
    poor = TRUTH.replace(seebeck=0.05)
    assert match(window, start=START, incumbent=poor, limits=limits).status is Status.ACCEPTED


def test_an_incumbent_with_a_moving_sink_gets_its_sink_fitted(record: Recorder) -> None:
    window = record(WITH_SINK, seed=4)
    truth = match(window, start=TRUTH, incumbent=WITH_SINK, limits=GateLimits(slack=0.9))
    cold = match(window, start=TRUTH, incumbent=TRUTH.replace(ambient=270.0), limits=GateLimits(slack=0.9))
    assert truth.status is Status.NOT_BETTER
    assert cold.status is Status.ACCEPTED


def test_other_periods_are_matched_as_well() -> None:
    gains = replace(Peltier.loop, proportional=20.0, back_calculation=2.0, period=0.5)
    reference = np.repeat([30.0, 50.0, 40.0], 150)
    whole = simulate_closed_loop(TRUTH, reference, states=begin(TRUTH, 30.0), gains=gains)
    window = Window(reference, whole.output, whole.input, period=0.5)
    result = match(window, start=START, gains=gains)
    assert result.parameters["heat_capacity"] == pytest.approx(30.0, rel=1e-6)
    with pytest.raises(
        FittingError, match=r"controller runs every 1\.0 s but the window's samples come every 0\.5"
    ):
        match(window, start=START, gains=Peltier.loop)


def test_questions_without_meaning_are_refused(record: Recorder) -> None:
    window = record(TRUTH)
    with pytest.raises(
        FittingError, match="'alpha' cannot be free in Peltier rig, held sink; choose from seebeck"
    ):
        match(window, start=START, free=["alpha"])
    with pytest.raises(FittingError, match="give at least one parameter and none twice"):
        match(window, start=START, free=[])
    with pytest.raises(FittingError, match="give at least one parameter and none twice"):
        match(window, start=START, free=["seebeck", "seebeck"])
    with pytest.raises(FittingError, match="'sink_convection' cannot be free in Peltier rig, held sink"):
        match(window, start=START, free=["sink_convection"])
    with pytest.raises(FittingError, match="bounds for 'alpha', which is unknown; choose from seebeck"):
        match(window, start=START, bounds={"alpha": (0.0, 1.0)})
    with pytest.raises(FittingError, match=r"the bounds of conductance are 1\.0 and 0\.0; give two finite"):
        match(window, start=START, bounds={"conductance": (1.0, 0.0)})
    with pytest.raises(PlantError, match="conductance is -1 W/K; it must be finite and at least 0"):
        match(window, start=START, bounds={"conductance": (-1.0, 1.0)})
    with pytest.raises(FittingError, match=r"noise: input is 0\.0; it must be finite and positive"):
        Noise(output=0.1, input=0.0)


def two_regime_windows(hour: Window) -> Iterator[Window]:
    """From 20 samples before a set-point step to 240 after the next, or to the one after that."""
    steps = [0, *(np.flatnonzero(np.abs(np.diff(hour.reference)) >= 2.0) + 1).tolist(), len(hour)]
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
    faulty = [result for window, result in matches(recorded_hour(27), start) if window.last > 2155]
    assert len(faulty) >= 4
    assert {result.status for result in faulty} == {Status.NOT_EXPLAINED}


def test_healthy_windows_are_accepted_or_honestly_refused(
    recordings: dict[int, Path], recorded_hour: Callable[[int], Window]
) -> None:
    count: Counter[Status] = Counter()
    for number in set(recordings) & {1, 5, 14}:
        count.update(result.status for _, result in matches(recorded_hour(number), START))
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
