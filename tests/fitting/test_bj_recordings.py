"""On the real rig: r → y and r → u, windows that begin in the middle of a transient."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from twinmatch.fitting import BoxJenkins, estimate, estimate_ladder
from twinmatch.signals import Window

Hour = Callable[[int], Window]
SPANS = [
    (1, 0, 500),
    (1, 0, 3600),
    (2, 300, 800),
    (5, 1000, 1500),
    (9, 200, 800),
    (14, 900, 1800),
    (27, 0, 700),
]


@pytest.mark.parametrize(("number", "first", "last"), SPANS)
@pytest.mark.parametrize("output", ["output", "input"])
def test_loss_never_grows_up_the_ladder(
    recorded_hour: Hour, number: int, first: int, last: int, output: str
) -> None:
    window = recorded_hour(number).part(first, last)
    models = list(estimate_ladder(window.reference, getattr(window, output)).values())
    losses = [model.variance for model in models]
    assert all(b <= a * (1.0 + 1e-9) for a, b in pairwise(losses))
    for model in models:
        assert max(np.max(np.abs(np.roots(p))) for p in (model.D, model.F)) < 1.0
        assert np.max(np.abs(np.roots(model.C))) < 1.0 - 5.9 / len(window)  # forgets within the window
        assert np.all(np.isfinite(model.standard_errors))
        assert np.max(np.abs(model.simulate(window.reference))) < 1e4


@pytest.mark.parametrize(("last", "bound"), [(500, 0.09), (3600, 0.045)])
def test_the_estimated_start_brings_the_loss_near_the_noise(
    recorded_hour: Hour, last: int, bound: float
) -> None:
    window = recorded_hour(1).part(0, last)
    loss = {
        how: estimate(window.reference, window.output, "22221", initial=how).variance
        for how in ("estimate", "zero")
    }
    assert loss["estimate"] < bound
    assert loss["zero"] > 2.0 * loss["estimate"]


def test_closed_loop_gain_is_one(recorded_hour: Hour) -> None:
    window = recorded_hour(5)
    model = estimate(window.reference, window.output, "33331")
    # The PID integrates: what is left is the noise of an hour over steps of some ten degrees.
    assert model.B.sum() / model.F.sum() == pytest.approx(1.0, abs=0.01)


def test_a_model_judges_itself_on_the_next_window(recorded_hour: Hour) -> None:
    hour = recorded_hour(5)
    here, there = hour.part(200, 1400), hour.part(1401, 2600)
    model: BoxJenkins = estimate(here.reference, here.output, "22221")
    assert model.loss(there.reference, there.output) < 1.5 * model.variance
    assert model.loss(there.reference, there.output, "zero") > model.loss(there.reference, there.output)
