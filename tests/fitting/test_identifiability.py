"""What a match reports about itself: which parameters are determined, which combination, which step next."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest

from twinmatch.dynamics import PidState, Sensor, begin, simulate_closed_loop
from twinmatch.fitting import Match, match
from twinmatch.plants import Peltier
from twinmatch.signals import Window

Recorder = Callable[..., Window]

RIG = Peltier.model()
TRUTH = RIG.parameters(seebeck=0.075, conductance=0.6, heat_capacity=30.0)


@pytest.fixture(scope="module")
def small_step(record: Recorder) -> Match:
    return match(record(TRUTH, levels=(30.0, 36.0), seed=4), start=TRUTH)


def test_directions_are_the_eigenvectors_of_the_scaled_information(small_step: Match) -> None:
    scales = np.array([RIG.declared[name].scale for name in small_step.free])
    scaled = small_step.fisher * np.outer(scales, scales)
    np.testing.assert_allclose(
        scaled @ small_step.directions,
        small_step.directions * small_step.eigenvalues,
        atol=1e-6 * scaled.max(),
    )
    np.testing.assert_allclose(small_step.directions.T @ small_step.directions, np.eye(3), atol=1e-12)
    # Along the valley Seebeck coefficient and heat capacity grow together.
    seebeck, _, heat_capacity = small_step.directions[:, 0]
    assert seebeck > 0.3
    assert heat_capacity > 0.3


def test_the_ratio_is_known_where_its_parts_are_not(small_step: Match) -> None:
    assert "seebeck" not in small_step.believed
    assert "heat_capacity" not in small_step.believed
    assert "best known is the ratio seebeck / heat_capacity (± " in small_step.determined
    assert "left open: " in small_step.determined
    low, high = small_step.intervals[0]
    assert f"seebeck ({low:.3g} to {high:.3g})" in small_step.determined


def test_a_rich_window_determines_all(record: Recorder) -> None:
    result = match(record(TRUTH, levels=(30.0, 80.0, 35.0), seed=4), start=RIG.parameters())
    assert result.believed == result.free
    assert result.suggestion == ""
    assert "left open" not in result.determined
    for low, value, high in zip(
        result.intervals[:, 0], (0.075, 0.6, 30.0), result.intervals[:, 1], strict=True
    ):
        assert low < value < high < 2 * low


def test_the_suggested_step_keeps_its_promise(small_step: Match) -> None:
    """It is made on the simulated rig, forty times, and the spread of the estimates compared."""
    said = re.fullmatch(
        r"a step from 36 to (\d+) °C would determine (\w+) about (\d+(?:\.\d)?) times better",
        small_step.suggestion,
    )
    assert said is not None
    level, name, promised = float(said[1]), said[2], float(said[3])
    place = small_step.free.index(name)
    before = small_step.standard_errors[place]
    reference = np.concatenate([np.full(60, 36.0), np.full(240, level)])
    found = []
    for seed in range(12):
        sensor = Sensor(noise=0.1).realise(reference.size, 1.0, seed)
        response = simulate_closed_loop(
            TRUTH, reference, states=begin(TRUTH, 36.0), controller=PidState(integral=40.0), sensor=sensor
        )
        after = match(Window(reference, response.output, response.input), start=TRUTH)
        found.append(before / after.standard_errors[place])
    assert promised > 2.0
    assert np.median(found) == pytest.approx(promised, rel=0.5)


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
