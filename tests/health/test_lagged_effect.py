"""The effect of a drive behind lags: what is expected of it, and of a reading that is repeated."""

from __future__ import annotations

import math

import numpy as np
import pytest

from twinmatch.dynamics import Observer, begin, simulate_driven
from twinmatch.health.lagged_effect import ErrorModel, LaggedEffect, Past
from twinmatch.plants import TCLab
from twinmatch.signals import Sample

KIT = TCLab.model("sensor lag").typical()
LONGEST = 4


def test_the_newest_samples_are_kept_in_order() -> None:
    """So that stretches of up to `LONGEST` samples have as many before them, however many came."""
    observer = Observer(KIT, 30.0, period=1.0, drift=[0.1, 0.1], start=[1.0, 1.0])
    past = Past(KIT.model, LONGEST)
    row = KIT.model.disturbances
    for k in range(40):
        observer.correct(30.0, row)
        states = np.array([300.0 + k, 200.0 + k])
        errors = (ErrorModel(float(k)),)
        past.append(
            observer, states, float(k), 10.0 + k, row, errors, settled=k % 3 == 0
        )
        newest = range(max(0, k - 2 * LONGEST), k + 1)
        assert len(past) == len(newest)
        arrays = past.arrays
        assert arrays.inputs.tolist() == [*newest]
        assert arrays.states[:, 1].tolist() == [200.0 + i for i in newest]
        assert arrays.stood[-1] == np.mean(newest[-1 - LONGEST :])
        assert past.outputs.tolist() == [10.0 + i for i in newest]
        for place, i in enumerate(newest):
            assert past.errors_at(place) == (ErrorModel(float(i)),)
            assert past.settled_at(place) == (i % 3 == 0)
    assert (arrays.vectors == KIT.vector).all()
    assert (arrays.steps == KIT.steps(1.0)).all()


def test_the_expected_effect_is_what_the_drive_adds_to_the_output() -> None:
    """Of a kit without noise, whose simulation is the truth, at each sample at which an effect is judged."""
    inputs = np.where(np.arange(400) < 150, 20.0, 80.0)
    inputs[300:] = 0.0
    run = simulate_driven(KIT, inputs, states=begin(KIT, 40.0), period=1.0)
    effect = LaggedEffect(KIT, 1.0)
    lengths = set()
    for k, output in enumerate(run.output.tolist()):
        effect.push(Sample(k, k * 10**9, 40.0, output, float(inputs[k])))
        if math.isnan(effect.share):
            continue
        lengths.add(effect.length)
        first = k - effect.length
        driven, at_rest = (
            simulate_driven(KIT, commands, states=run.states[first], period=1.0).output[
                -1
            ]
            for commands in (inputs[first : k + 1], np.zeros(effect.length + 1))
        )
        assert effect.expected == pytest.approx(driven - at_rest, rel=1e-3)
        assert effect.share == pytest.approx(1.0, abs=1e-3)
    assert len(lengths) > 1


def test_movement_is_expected_of_a_reading_that_is_repeated() -> None:
    """It adds up to what the plant does meanwhile; of readings that change nobody needs it."""
    inputs = np.full(90, 60.0)
    run = simulate_driven(KIT, inputs, states=begin(KIT, 40.0), period=1.0)
    shown = run.output.copy()
    shown[80:] = shown[80]
    effect = LaggedEffect(KIT, 1.0)
    moved = [
        effect.push(Sample(k, k * 10**9, 40.0, float(shown[k]), 60.0))
        for k in range(90)
    ]
    assert moved[:81] == [0.0] * 81
    assert sum(moved) == pytest.approx(run.output[89] - run.output[80], rel=5e-2)
