"""A toy plant with two heaters, two sensors and exchange between them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import ClassVar

import numpy as np

from twinmatch.dynamics import (
    Drive,
    Equations,
    Output,
    Parameter,
    Plant,
    State,
    Structure,
    begin,
    simulate_driven,
)
from twinmatch.signals import Window


class Heaters(Plant):
    """Two bodies that exchange heat, lose some by radiation, and are heated each by its own heater."""

    title = "Heaters"
    one, two = (State(unit="°C", span=(0.0, 120.0)) for _ in range(2))
    first_power, second_power = (
        Drive(unit="%", limits=(0.0, 100.0), noise=1.0) for _ in range(2)
    )
    first, second = (Output(unit="°C", noise=0.1, span=(0.0, 150.0)) for _ in range(2))
    loss = Parameter(unit="1/s", default=0.01, bounds=(1e-3, 0.1), positive=True)
    exchange = Parameter(unit="1/s", default=0.02, bounds=(1e-3, 0.5), positive=True)
    first_gain = Parameter(
        unit="°C/s/%", default=0.015, bounds=(1e-3, 0.3), positive=True
    )
    second_gain = Parameter(
        unit="°C/s/%", default=0.01, bounds=(1e-3, 0.3), positive=True
    )
    structures: ClassVar = {
        "all": Structure(free=("loss", "exchange", "first_gain", "second_gain")),
        "apart": Structure(
            free=("loss", "first_gain", "second_gain"), fixed={"exchange": 1e-3}
        ),
    }

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        first_rate, second_rate = self.rates_of(
            {name: getattr(self, name) for name in self.parameters}
        )((self.one, self.two), (self.first_power, self.second_power))
        return Equations(
            rates={self.one: first_rate, self.two: second_rate},
            output={self.first: self.one, self.second: self.two},
            start={self.one: self.first, self.two: self.second},
        )

    @staticmethod
    def rates_of(p: Mapping[str, float]) -> Callable[..., tuple[float, float]]:
        """The rates of both temperatures, from these and the two powers."""

        def rates(
            x: tuple[float, float], u: tuple[float, float]
        ) -> tuple[float, float]:
            lost = [
                p["loss"] * (temperature - 23.0) * (1.0 + 0.003 * (temperature - 23.0))
                for temperature in x
            ]
            exchanged = p["exchange"] * (x[1] - x[0])
            return p["first_gain"] * u[0] - lost[0] + exchanged, p["second_gain"] * u[
                1
            ] - lost[1] - exchanged

        return rates


def heated(samples: int) -> Window:
    """Both heaters at random levels of 50 samples each, of 2 s, with a noise of 0.1 °C."""
    truth = Heaters.model().parameters()
    rng = np.random.default_rng(5)
    u = np.repeat(rng.uniform(0.0, 60.0, (samples // 50, 2)), 50, axis=0)
    run = simulate_driven(truth, u, states=begin(truth, [23.0, 23.0]), period=2.0)
    return Window(
        np.zeros_like(u),
        run.outputs + 0.1 * rng.standard_normal(u.shape),
        u,
        period=2.0,
    )


def heated_with_a_lie(samples: int, begins: int, ends: int) -> Window:
    """The same, but the second sensor reads 4 °C too much from sample `begins` on, until `ends`."""
    right = heated(samples)
    readings = right.outputs.copy()
    readings[begins:ends, 1] += 4.0
    return Window(right.references, readings, right.inputs, period=right.period)
