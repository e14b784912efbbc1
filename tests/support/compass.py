"""A ship whose compass begins again after 360°, and a table of its course."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twinmatch.dynamics import (
    Disturbance,
    Drive,
    Equations,
    Output,
    Parameter,
    Plant,
    State,
    Structure,
)
from twinmatch.signals import FloatArray


class Ship(Plant, name="ship-with-compass"):
    """Its rate of turn follows the rudder with a lag."""

    title = "Ship"
    heading = Output(unit="deg", noise=0.1, span=(0.0, 360.0), turn=360.0)
    rudder = Drive(unit="deg", limits=(-30.0, 30.0), noise=0.5)
    wind = Disturbance(unit="deg", default=0.0)
    psi = State(unit="deg", span=(-720.0, 720.0))
    rate = State(unit="deg/s", span=(-5.0, 5.0))
    gain = Parameter(unit="1/s", default=0.05, bounds=(0.005, 0.5), positive=True)
    lag = Parameter(unit="s", default=30.0, bounds=(3.0, 300.0), positive=True)
    structures = {"first order": Structure(free=("gain", "lag"))}  # noqa: RUF012

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        return Equations(
            rates={
                self.psi: self.rate,
                self.rate: (self.gain * self.rudder - self.rate) / self.lag,
            },
            output=self.psi,
            start={self.psi: self.heading, self.rate: 0},
        )


class UncountedShip(Ship, name="ship-with-uncounted-compass"):
    """The ship, whose file does not say that its compass begins again."""

    heading = Output(unit="deg", noise=0.1, span=(-10.0, 370.0))


def course(samples: int = 600) -> tuple[FloatArray, FloatArray]:
    """Headings, deg, counted on, and rudder, deg, one a second; shape (N,) each."""
    rng = np.random.default_rng(3)
    rudder = np.repeat(rng.choice([-10.0, 20.0, 25.0, 30.0, 30.0], samples // 40), 40)
    rate = 0.0
    heading = 340.0
    headings = []
    for angle in rudder:
        headings.append(heading)
        heading += rate
        rate += (0.05 * angle - rate) / 30.0
    return np.round(headings, 1), rudder


def written_course(path: Path, *, left_out: range = range(0)) -> FloatArray:
    """Write the course as a table whose headings begin again; returns the counted headings, shape (N,)."""
    headings, rudder = course()
    rows = ["time (s),heading (deg),set (deg),rudder (deg),wind (deg)"]
    for k, (heading, angle) in enumerate(zip(headings, rudder, strict=True)):
        if k not in left_out:
            values = (heading % 360.0, (heading + 170.0) % 360.0, angle)
            cells = ",".join(f"{value:.1f}" for value in values)
            rows.append(f"{k},{cells},{(2 * k) % 360}")
    path.write_text("\n".join(rows) + "\n")
    return headings
