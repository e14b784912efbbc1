"""Roots that reach zero: tanks that run empty."""

from __future__ import annotations

import numpy as np
import pytest
from sympy import sqrt

from tests.support.plants import Tank
from twinmatch.dynamics import (
    Drive,
    Equations,
    Experiment,
    Output,
    Parameter,
    Plant,
    State,
    Structure,
    begin,
    maximum,
    simulate_driven,
)
from twinmatch.fitting import match
from twinmatch.signals import Window


class Cask(Plant, name="cask"):
    """A pump fills a tank, which empties through an orifice (Torricelli)."""

    level = Output(unit="cm", noise=0.1, span=(-1.0, 60.0))
    volts = Drive(unit="V", limits=(0.0, 12.0), noise=0.1)
    h = State(unit="cm", span=(0.0, 60.0))
    k = Parameter(unit="cm/(s V)", default=0.06, bounds=(0.01, 0.2), positive=True)
    a = Parameter(unit="cm^0.5/s", default=0.2, bounds=(0.02, 2.0), positive=True)
    structures = {"prompt": Structure(free=("k", "a"))}  # noqa: RUF012

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        rates = {self.h: self.k * self.volts - self.a * sqrt(maximum(self.h, 0))}
        return Equations(rates=rates, output=self.h, start={self.h: self.level})


def emptied(a: float, first: float = 25.0) -> tuple[np.ndarray, Window]:
    """Torricelli's law without inflow, √h = √h₀ − a·t/2 until empty, and the window that it gives."""
    t = np.arange(120.0)
    level = np.maximum(np.sqrt(first) - a * t / 2, 0.0) ** 2
    u = np.zeros(t.size)
    return level, Window(np.zeros(t.size), level, u)


def test_a_tank_runs_empty_by_torricellis_law() -> None:
    level, window = emptied(0.2)
    cask = Cask.model().parameters(a=0.2)
    run = simulate_driven(cask, window.input, states=begin(cask, 25.0))
    # δ is 0.06 cm: the last centimetre drains a little later than by the exact root.
    assert np.abs(run.output - level).max() < 0.02
    assert 0 <= run.output[-1] < 0.01


def test_a_match_finds_the_outflow_of_a_tank_that_ran_empty() -> None:
    """The exact root's derivative at zero is infinite, and infinity times zero is NaN."""
    _, window = emptied(0.2)
    experiment = Experiment(Cask.model().parameters(), ("k", "a"), window, gains=None)
    values = np.array([0.06, 0.21])
    exact = experiment.tangents(values)
    assert np.isfinite(exact.by).all()
    for j, step in enumerate(np.diag([1e-7, 1e-7])):
        up, down = experiment.simulate(values + step), experiment.simulate(values - step)
        np.testing.assert_allclose(exact.by[0, :, j], (up.output - down.output) / 2e-7, atol=0.02)
    low = begin(Cask.model().parameters(), -0.3)  # noise shows levels below zero
    assert np.isfinite(
        experiment.model.kernels.slopes_at(experiment.base.vector, low, 0.0, np.empty(0))[1]
    ).all()
    filled = np.repeat([0.0, 8.0, 3.0], 100)
    truth = Cask.model().parameters(k=0.08, a=0.15)
    run = simulate_driven(truth, filled, states=begin(truth, 9.0))
    noise = 0.1 * np.random.default_rng(3).standard_normal(filled.size)
    found = match(Window(np.zeros(filled.size), run.output + noise, filled), start=Cask.model().parameters())
    assert found.accepted, found.reason
    assert found.parameters["k"] == pytest.approx(0.08, rel=0.02)
    assert found.parameters["a"] == pytest.approx(0.15, rel=0.02)


def test_a_root_that_stays_above_zero_is_exact() -> None:
    """A smooth root would bend, by a little, the valley of parameters that no data can tell apart."""
    tank = Tank.model().parameters()
    slope = tank.model.kernels.slopes_at(tank.vector, np.array([4.0]), 1.0, np.empty(0))[1]
    assert slope[0, 0] == pytest.approx(-tank["hole"] / (2 * 2.0) / tank["area"], rel=1e-14)
