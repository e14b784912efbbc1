"""Twins of an integrating plant: their responses at frequency zero are infinite."""

from __future__ import annotations

import numpy as np

from tests.support.servo import PERIOD, Servo
from twinmatch.comparing import LoopConditions, Uncertain, family_uncertainty, plant_gaps, spans_of
from twinmatch.comparing.plant_gap import ANGLES, response_slopes

TERMS = LoopConditions(None, spans_of(Servo), 240, PERIOD)
POINTS = (0.0, 90.0)


def test_responses_are_those_of_an_integrator() -> None:
    """By formula: k/(s (1 + t s)) with a hold, at frequencies at which the hold does not matter."""
    servo = Servo.model("free").parameters(k=50.0, t=0.12)
    response, slopes = response_slopes(servo, ("k", "t"), 0.0, TERMS)
    assert np.isfinite(response).all()
    assert np.isfinite(slopes).all()
    s = 1j * ANGLES[1:3] / PERIOD
    expected = TERMS.scales.ratio * 50.0 / (s * (1.0 + 0.12 * s))
    np.testing.assert_allclose(response[1:3], expected, rtol=0.01)
    np.testing.assert_allclose(slopes[0], response / 50.0, rtol=1e-6)


def test_a_family_of_integrators_has_distances_with_intervals() -> None:
    """Twins with the same integrator differ at higher frequencies only."""
    one = Servo.model("free").parameters(k=50.0, t=0.12)
    other = one.replace(t=0.2)
    known = np.diag([0.1, 1e-3]) ** 2
    twins = [Uncertain(one, ("k", "t"), known), Uncertain(other, ("k", "t"), known)]
    gaps = plant_gaps([one, other], POINTS, TERMS)
    found = family_uncertainty(twins, gaps, TERMS, seed=1)
    low, high = found.nu_gap_low[0, 1], found.nu_gap_high[0, 1]
    assert 0.0 < low < gaps.matrix[0, 1] < high < 1.0
