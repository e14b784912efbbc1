"""Models and plants without a loop: from input to output, and at rest."""

from __future__ import annotations

import control
import numpy as np
import pytest

from tests.support.box_runs import PERIOD, TRUTH, step_test, switched
from tests.support.plants import Box, Lag
from twinmatch.comparing import (
    CandidateScore,
    LoopConditions,
    identify,
    plant_gap,
    score,
    spans_of,
    with_margins,
)
from twinmatch.comparing.models import operating_level
from twinmatch.comparing.plant_gap import linearised_in_loop
from twinmatch.dynamics import begin, linearised, simulate_driven
from twinmatch.fitting import FittingError
from twinmatch.signals import Window


def lag_window(noise: float = 0.01) -> Window:
    """A lag with a gain of 1.5 and a time constant of 12 s, under three levels of its input."""
    plant = Lag.model().parameters(gain=1.5, lag=12.0)
    u = np.repeat([1.0, 4.0, -2.0, 3.0], 150)
    run = simulate_driven(plant, u, states=begin(plant, 1.5))
    y = run.output + noise * np.random.default_rng(3).standard_normal(u.size)
    return Window(np.zeros(u.size), y, u)


def test_models_go_from_the_input_to_the_output() -> None:
    """The plant's own pole and gain come out, whatever the set-points were said to be."""
    window = lag_window()
    models = identify(window, scale=1.0)
    assert [m.order for m in models] == ["22221", "33331", "44441", "55551"]
    first = models[0]
    assert first.u is None
    assert np.sum(first.y.B) / np.sum(first.y.F) == pytest.approx(1.5, rel=0.01)
    slowest = np.max(np.abs(np.roots(first.y.F)))
    assert slowest == pytest.approx(np.exp(-1.0 / 12.0), rel=0.01)
    told = score(first, window, absolute=0.0)
    assert told.u is None
    assert told.total == told.y
    assert told.y.explanation > 0.2
    with pytest.raises(FittingError, match="is constant"):
        identify(Window(np.zeros(200), window.output[:200], np.ones(200)), scale=1.0)


def test_deviations_are_from_rest_or_from_the_means() -> None:
    window = lag_window()
    at_rest = operating_level(window, driven=True)
    assert at_rest.input == 1.0
    assert at_rest.output == pytest.approx(1.5, abs=0.01)
    restless = window.part(145, 599)
    level = operating_level(restless, driven=True)
    assert level == (pytest.approx(restless.output.mean()), pytest.approx(restless.input.mean()))


def test_a_plant_is_compared_where_it_rests() -> None:
    """The gap of two lags that differ in gain alone is that of another program's frequency responses."""
    one = Lag.model().parameters(gain=1.0, lag=12.0)
    other = one.replace(gain=1.6)
    terms = LoopConditions(None, spans_of(Lag), 240, 1.0)
    np.testing.assert_array_equal(linearised_in_loop(one, 2.0, terms).A, linearised(one, 2.0, 1.0).A)
    scale = terms.scales.ratio
    z = np.exp(1j * np.geomspace(1e-4, np.pi, 2000))
    responses = []
    for plant in (one, other):
        linear = linearised(plant, 2.0, 1.0)
        system = control.ss(linear.A, linear.B, scale * linear.C, 0.0, 1.0)
        responses.append(np.array([complex(np.squeeze(system(point))) for point in z]))
    a, b = responses
    chordal = np.abs(a - b) / np.sqrt((1 + np.abs(a) ** 2) * (1 + np.abs(b) ** 2))
    assert plant_gap(one, other, (2.0,), terms) == pytest.approx(float(chordal.max()), rel=1e-4)


def test_there_is_no_margin_without_a_controller() -> None:
    bare = CandidateScore("a", 35.0, TRUTH, 0, 1, (), "", 0.0, None, None)
    assert with_margins([bare], 0, None) == (bare,)


@pytest.mark.parametrize("samples", [step_test(700, 5), switched(700, 5)], ids=["step test", "switched"])
def test_models_of_real_windows_forecast_the_window(samples: list) -> None:
    window = Window.from_samples(samples, PERIOD)
    scale = spans_of(Box).ratio
    told = [score(model, window, absolute=Box.output.absolute) for model in identify(window, scale=scale)]
    assert max(t.y.gain for t in told) > 0
    assert all(np.isfinite(t.total.naic) for t in told)
