"""A reading that stands although its plant is expected to move: frozen, unless such expectations were wrong before."""

from __future__ import annotations

from itertools import cycle, islice

import numpy as np
import pytest

from twinmatch.health.traces import Repeats

COARSE = 1.0
"""Step of the readings, K."""
NOISE = 0.4 * COARSE
"""Noise of the readings, K."""


def at_rest(repeats: Repeats, samples: int, expected: float) -> int:
    """How many samples of a loop at rest show a frozen sensor: readings stand for five samples, and move by a step.

    Each sample that repeats a reading was expected to have moved by `expected`.
    """
    changes = cycle([0.0] * 5 + [COARSE] + [0.0] * 5 + [-COARSE])
    shown = 0
    for change in islice(changes, samples):
        repeats.push(change, 0.0 if change else expected)
        shown += repeats.stands
    return shown


def stand(repeats: Repeats, samples: int, expected: float) -> int:
    """The number of repeats of a reading after which it shows a frozen sensor; 0 if it does not."""
    for count in range(1, samples + 1):
        repeats.push(0.0, expected)
        if repeats.stands:
            return count
    return 0


@pytest.mark.parametrize("expected", [2.2, -2.2])
def test_expectations_that_were_missed_before_show_no_frozen_sensor(
    expected: float,
) -> None:
    """As of a drive that has 70 % of its effect: at rest its equations expect 22 °C in ten samples."""
    repeats = Repeats(10.0, 100.0, NOISE)
    assert at_rest(repeats, 204, expected) == 0
    assert stand(repeats, 15, expected) == 0


@pytest.mark.parametrize("missed", [0.0, 1.0])
def test_a_sensor_that_stands_while_its_plant_moves_is_frozen(missed: float) -> None:
    """More than 30 noises, 12 °C, beyond what is surely missed; what is missed the other way adds nothing."""
    for usual in (missed, -missed):
        repeats = Repeats(10.0, 100.0, NOISE)
        at_rest(repeats, 204, usual)
        beyond = 3.0 - max(usual - NOISE, 0.0)
        assert stand(repeats, 40, 3.0) == max(9, int(12.0 / beyond) + 1)


def test_what_noise_may_have_missed_hides_no_frozen_sensor() -> None:
    """Readings repeat themselves now and then, and none of them is missed by as much as they are noisy."""
    draw = np.random.default_rng(0)
    repeats = Repeats(1.0, 100.0, NOISE)
    for reading in np.diff(np.round(draw.normal(0.0, NOISE, 300))):
        repeats.push(float(reading), 0.01)
    assert (
        stand(repeats, 200, 0.1) == stand(Repeats(1.0, 100.0, NOISE), 200, 0.1) == 121
    )


def test_what_a_frozen_sensor_showed_teaches_nothing() -> None:
    repeats = Repeats(10.0, 100.0, NOISE)
    at_rest(repeats, 204, 0.0)
    assert stand(repeats, 60, 2.0) == 9
    repeats.push(40.0, 0.0)
    assert stand(repeats, 15, 2.0) == 9
