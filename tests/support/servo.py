"""A DC motor whose shaft angle is measured: an integrating plant, sampled a hundred times a second."""

from __future__ import annotations

import numpy as np

from twinmatch.dynamics import (
    Drive,
    Equations,
    Output,
    Parameter,
    Parameters,
    Plant,
    State,
    Structure,
    begin,
    simulate_driven,
)
from twinmatch.signals import Window

PERIOD = 0.01
"""Sample time, s."""


class Servo(Plant, name="servo"):
    """Nothing returns the shaft to an angle; its loop is not known."""

    title = "servo"
    parts = ("friction",)
    angle = Output(unit="deg", noise=0.06, span=(-1e5, 1e5), text="angle")
    pwm = Drive(unit="%", limits=(-100.0, 100.0), noise=0.5)
    phi = State(unit="deg", span=(-1e5, 1e5))
    omega = State(unit="deg/s", span=(-1e4, 1e4))
    k = Parameter(unit="deg/(s %)", default=30.0, bounds=(3.0, 300.0), positive=True)
    t = Parameter(unit="s", default=0.3, bounds=(0.02, 3.0), positive=True)
    dry = Parameter(unit="deg/s^2", default=500.0, bounds=(0.0, 20000.0), least=0.0)
    soft = Parameter(unit="deg/s", default=10.0, bounds=(1.0, 100.0), positive=True)
    structures = {  # noqa: RUF012
        "with friction": Structure(
            free=("k", "t", "dry"), parts=frozenset({"friction"})
        ),
        "free": Structure(free=("k", "t")),
    }

    def equations(self, parts: frozenset[str]) -> Equations:
        acceleration = (self.k * self.pwm - self.omega) / self.t
        if "friction" in parts:
            acceleration -= self.dry * self.omega / (self.soft + abs(self.omega))
        return Equations(
            rates={self.phi: self.omega, self.omega: acceleration},
            output=self.phi,
            start={self.phi: self.angle, self.omega: 0},
        )


def turns(truth: Parameters, samples: int, seed: int = 5) -> Window:
    """A record of a servo under steps of its input, read by an encoder of 2000 counts per turn."""
    rng = np.random.default_rng(seed)
    levels = [-80.0, -60.0, -40.0, -20.0, -8.0, 0.0, 10.0, 25.0, 45.0, 65.0, 85.0]
    u = np.zeros(samples)
    row = 300
    while row < samples:
        hold = int(rng.integers(30, 200))
        u[row : row + hold] = rng.choice(levels)
        row += hold
    run = simulate_driven(truth, u, states=begin(truth, 0.0), period=PERIOD)
    return Window(
        np.zeros(samples), 0.18 * np.round(run.output / 0.18), u, period=PERIOD
    )
