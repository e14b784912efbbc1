"""What to record first, and the PID to begin with: from a plant's file or from twins that are open."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.plants import Lag
from twinmatch.controllers import (
    ControllerError,
    Holding,
    TriedTwin,
    WholeLoop,
    as_linear,
)
from twinmatch.controllers.first_course import draws_of_file, first_course
from twinmatch.controllers.first_pid import MAX_SENSITIVITY, first_pid, reduced
from twinmatch.dynamics import Linear, Rest, begin, simulate_driven

SHAPE = ((0.0, 60.0), (1.0, 240.0))


def test_a_course_keeps_nearly_all_that_a_file_allows_in_the_range() -> None:
    """On other draws than those it was made for, nine in ten keep the range; a larger step would not."""
    draws = draws_of_file(Lag, 60)
    course = first_course(draws, 0.0, SHAPE, 1.0)
    others = draws_of_file(Lag, 100, seed=7)
    low, high = course.ends
    kept = []
    for draw in others:
        run = simulate_driven(
            draw, course.inputs(1.0), states=begin(draw, 0.0), period=1.0
        )
        kept.append(low <= run.output.min() and run.output.max() <= high)
    assert np.mean(kept) >= 0.9
    assert course.levels[0] == Lag.drive.rest
    assert course.duration == pytest.approx(300.0)


def test_a_narrower_range_asks_for_a_smaller_step() -> None:
    draws = draws_of_file(Lag, 60)
    wide = first_course(draws, 0.0, SHAPE, 1.0)
    narrow = first_course(draws, 0.0, SHAPE, 1.0, (-5.0, 2.0))
    assert abs(narrow.levels[1]) < abs(wide.levels[1])
    with pytest.raises(ControllerError, match="leaves nothing of the safe one"):
        first_course(draws, 0.0, SHAPE, 1.0, (5.0, 2.0))


def discrete(gain: float, lag: float, delay: int, period: float = 1.0) -> Linear:
    """A first-order plant behind so many samples of delay."""
    size = delay + 1
    A = np.eye(size, k=-1)
    A[-1, -1] = np.exp(-period / lag)
    B = np.zeros((size, 1))
    B[0, 0] = 1.0
    share = gain * (1.0 - np.exp(-period / lag))
    if delay:
        A[-1, -2] = share
    else:
        B[0, 0] = share
    C = np.zeros((1, size))
    C[0, -1] = 1.0
    return Linear(A, B, C, period, Rest(np.zeros(size), np.zeros(1)))


@pytest.mark.parametrize("delay", [0, 5, 20])
def test_a_first_order_plant_with_dead_time_is_reduced_to_itself(delay: int) -> None:
    plant = reduced(discrete(2.5, 50.0, delay))
    assert plant.gain == pytest.approx(2.5, rel=1e-9)
    assert plant.lag == pytest.approx(50.0, rel=0.03)
    # A sample that is held acts half a sample late; times are read between samples.
    assert plant.dead_time == pytest.approx(delay, abs=1.6)


def test_a_plant_that_does_not_come_to_rest_is_refused() -> None:
    integrator = Linear(
        np.eye(1), np.ones((1, 1)), np.ones((1, 1)), 1.0, Rest(np.zeros(1), np.zeros(1))
    )
    with pytest.raises(ControllerError, match="does not come to rest"):
        reduced(integrator)


def test_the_first_pid_keeps_below_the_ceiling_on_everything_that_is_open() -> None:
    parameters = Lag.model().parameters()
    free = Lag.model().structure.free
    deviations = np.array([0.2 * abs(parameters[name]) for name in free])
    twin = TriedTwin("open", parameters, free, np.diag(deviations**2))
    holding = Holding(None, 1.0, 240)
    level = float(np.mean(Lag.output.span)) * 0.5
    pid = first_pid([twin], [level], holding)
    assert pid.sensitivity <= MAX_SENSITIVITY
    for draw in twin.drawn(30, seed=99):
        loop = WholeLoop(holding.linear(draw, [level]), as_linear(pid.gains))
        assert loop.eigenvalue < 1.0
        assert loop.sensitivity() <= 1.1 * MAX_SENSITIVITY
    slow = first_pid([twin], [level], holding, slower=8.0)
    assert slow.loop_time > pid.loop_time
    assert slow.gains.proportional < pid.gains.proportional
