from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.comparing import DiscriminationError, akaike_weights, identify, score_orders
from twinmatch.dynamics import begin, simulate_closed_loop
from twinmatch.plants import Peltier
from twinmatch.signals import KELVIN, Window


def test_published_weights() -> None:
    """Printed on the reference page of `ic_weights` in the R package tidySEM."""
    found = akaike_weights([100, 200, 102, 300])
    expected = [7.310586e-01, 1.410029e-22, 2.689414e-01, 2.719593e-44]
    np.testing.assert_allclose(found.weights, expected, rtol=5e-7)
    np.testing.assert_array_equal(found.differences, [0, 100, 2, 200])


def test_evidence_ratios() -> None:
    """A difference of 2 ln k makes k to 1."""
    assert akaike_weights([0.0, 2 * math.log(3)]).weights == pytest.approx([0.75, 0.25])
    assert akaike_weights([7.0]).weights == pytest.approx([1.0])


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=8), st.floats(-1e3, 1e3))
def test_weights_are_shares_that_only_differences_decide(values: list[float], shift: float) -> None:
    found = akaike_weights(values)
    assert found.weights.sum() == pytest.approx(1.0)
    assert found.differences.min() == 0.0
    assert found.weights[np.argmin(values)] == found.weights.max()
    np.testing.assert_allclose(akaike_weights(np.array(values) + shift).weights, found.weights, atol=1e-9)


def test_a_perfect_prediction_takes_all() -> None:
    assert akaike_weights([-math.inf, 3.0]).weights.tolist() == [1.0, 0.0]
    assert akaike_weights([-math.inf, 3.0, -math.inf]).weights.tolist() == [0.5, 0.0, 0.5]


@pytest.mark.parametrize("values", [[], [math.nan], [1.0, math.inf], [[1.0]]])
def test_what_is_not_a_criterion_is_refused(values: list[float]) -> None:
    with pytest.raises(DiscriminationError, match="give one number per model"):
        akaike_weights(values)


def test_orders_are_weighed_by_the_aic_of_both_outputs() -> None:
    reference = np.repeat([30.0, 50.0, 70.0], [60, 120, 150])
    rig = Peltier.model().parameters(seebeck=0.06, conductance=0.6, heat_capacity=28.0)
    sensor = Peltier.sensor.realise(len(reference), 1.0, 3)
    run = simulate_closed_loop(rig, reference, states=begin(rig, 30.0), sensor=sensor)
    window = Window(reference, run.output, run.input)
    models = identify(window)
    scores = score_orders(models, window, absolute=KELVIN)
    totals = []
    for model, s in zip(models, scores, strict=True):
        # AIC from nAIC: both differ by a constant that no order changes
        assert s.y.naic + s.u.naic == s.total.naic
        totals.append(len(window) * s.total.naic)
        assert model.order == s.order
    best = min(totals)
    assert [s.aic_difference for s in scores] == pytest.approx([t - best for t in totals])
    assert sum(s.weight for s in scores) == pytest.approx(1.0)
