"""A twin that is asked again and again is prepared for its forecasts once."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from twinmatch.comparing import Candidate
from twinmatch.dynamics import Foresight, begin, law_of, simulate_closed_loop
from twinmatch.forecasting import Outlook, outlook
from twinmatch.plants import Peltier
from twinmatch.sessions import samples_of
from twinmatch.signals import Window
from twinmatch.twin import Forecaster

RIG = Peltier.model("sink with mass").parameters()


@pytest.fixture(scope="module")
def asked() -> Outlook:
    """That of the plant itself, after a minute at one set-point."""
    held = np.full(60, 50.0)
    course = simulate_closed_loop(RIG, held, states=begin(RIG, 22.85))
    forecaster = Forecaster(law_of(Peltier, 1.0))
    forecaster.enter([Candidate("rig", 50.0, RIG, None)])
    for sample in samples_of(Window(held, course.output, course.input)):
        forecaster.push(sample)
    return forecaster.outlook()


def test_forecasts_of_one_twin_are_prepared_once_and_those_of_another_apart(
    asked: Outlook, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepared: list[Any] = []

    def preparing(twins: Any, *arguments: Any, **options: Any) -> Foresight:
        prepared.append(twins)
        return Foresight(twins, *arguments, **options)

    monkeypatch.setattr(outlook, "Foresight", preparing)
    other = replace(asked, parameters=RIG.replace(conductance=0.7654321))
    once_more = replace(other, parameters=RIG.replace(conductance=0.7654321))
    for k in range(3):
        other.forecast(np.full(10, 50.0 + k))
        once_more.forecast(np.full(10 + k, 50.0))
    assert len(prepared) == 1
    first = other.forecast(np.full(10, 50.0)).output.mean
    assert not np.array_equal(first, asked.forecast(np.full(10, 50.0)).output.mean)
    np.testing.assert_array_equal(
        first, once_more.forecast(np.full(10, 50.0)).output.mean
    )
