"""Inputs as they may act: at once, later or through a lag, and where another drive acts."""

from __future__ import annotations

import numpy as np
import pytest

from twinmatch.health.acting_inputs import CROSSING, ActingInputs

SECOND = 2.0
"""Samples in a second."""
BEFORE = np.array([10.0, 0.0])
AFTER = np.array([50.0, 20.0])


def stepped(samples: int) -> tuple[ActingInputs, list[np.ndarray]]:
    """What acts at samples behind a step of two inputs that had been what they were."""
    inputs = ActingInputs(2, SECOND, SECOND)
    inputs.take(BEFORE, BEFORE)
    return inputs, [inputs.take(AFTER, AFTER) for _ in range(samples)]


def test_before_a_step_every_way_acts_alike() -> None:
    inputs = ActingInputs(2, SECOND, SECOND)
    np.testing.assert_array_equal(inputs.take(BEFORE, BEFORE), np.tile(BEFORE, (10, 1)))
    assert inputs.ways == 10


@pytest.mark.parametrize(("way", "seconds"), [*enumerate([0, 1, 2, 3, 5, 8, 12])])
def test_a_delayed_input_acts_after_its_delay(way: int, seconds: int) -> None:
    _, acting = stepped(30)
    acts = [bool((ways[way] == AFTER).all()) for ways in acting]
    assert acts.index(True) == seconds * SECOND
    assert all(acts[acts.index(True) :])


@pytest.mark.parametrize(("way", "lag"), [(7, 2.0), (8, 5.0), (9, 10.0)])
def test_a_lagging_input_approaches_the_step_exponentially(
    way: int, lag: float
) -> None:
    samples = 17
    _, acting = stepped(samples)
    left = np.exp(-samples / (lag * SECOND))
    np.testing.assert_allclose(acting[-1][way], AFTER + left * (BEFORE - AFTER))


def test_what_crosses_follows_sooner_than_what_is_usual() -> None:
    samples = 40
    inputs, _ = stepped(samples)
    for followed, lasts in (
        (inputs.crossing, CROSSING.lag),
        (inputs.usual, CROSSING.usual),
    ):
        left = (1.0 - 1.0 / (lasts * SECOND)) ** samples
        np.testing.assert_allclose(followed, AFTER + left * (BEFORE - AFTER))


def test_nothing_crosses_of_an_input_that_does_not_arrive() -> None:
    inputs = ActingInputs(2, SECOND, SECOND)
    inputs.take(BEFORE, np.zeros(2))
    ways = inputs.take(AFTER, np.zeros(2))
    np.testing.assert_array_equal(ways[0], AFTER)
    np.testing.assert_array_equal(inputs.crossing, np.zeros(2))
    np.testing.assert_array_equal(inputs.usual, np.zeros(2))


def test_after_a_gap_nothing_is_known_of_inputs_before_it() -> None:
    inputs, _ = stepped(3)
    inputs.restart()
    np.testing.assert_array_equal(inputs.take(BEFORE, BEFORE), np.tile(BEFORE, (10, 1)))
    np.testing.assert_array_equal(inputs.usual, BEFORE)


def test_delays_that_are_the_same_number_of_samples_are_one_way() -> None:
    """At a sample in five seconds, a delay of two seconds is none, and one of three is one sample."""
    inputs = ActingInputs(1, 0.2, 0.2)
    assert inputs.ways == 3 + 3
    assert inputs.latest == 2
