"""Processes of the literature with several signals, simulated by their published equations, as tables."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from twinmatch.signals import FloatArray

Rates = Callable[[FloatArray, FloatArray], FloatArray]


class Recorded(NamedTuple):
    """What a logger would have recorded."""

    period: float
    """s"""
    outputs: FloatArray
    """Shape (N, o)."""
    inputs: FloatArray
    """Shape (N, m)."""

    def write(self, path: Path) -> list[str]:
        """Write it as a table, and return its map."""
        names = ["time"]
        names += [f"output.{i + 1}" for i in range(self.outputs.shape[1])]
        names += [f"input.{j + 1}" for j in range(self.inputs.shape[1])]
        titles = ["time (s)"]
        titles += [f"reading{i + 1}" for i in range(self.outputs.shape[1])]
        titles += [f"command{j + 1}" for j in range(self.inputs.shape[1])]
        times = self.period * np.arange(len(self.outputs))
        rows = np.column_stack([times, self.outputs, self.inputs]).tolist()
        lines = [",".join(f"{value:.6g}" for value in row) for row in rows]
        path.write_text("\n".join([",".join(titles), *lines]) + "\n")
        return [f"{name}={title}" for name, title in zip(names, titles, strict=True)]


def levels(
    random: np.random.Generator, samples: int, hold: int, low: float, high: float
) -> FloatArray:
    """Random levels, each held for 0.6 to 1.6 times `hold` samples."""
    values = np.empty(samples)
    k = 0
    while k < samples:
        held = int(random.uniform(0.6, 1.6) * hold)
        values[k : k + held] = random.uniform(low, high)
        k += held
    return values


def after(
    rates: Rates, states: FloatArray, inputs: FloatArray, period: float, steps: int
) -> FloatArray:
    """The states a period later, by Runge and Kutta's method."""
    h = period / steps
    for _ in range(steps):
        k1 = rates(states, inputs)
        k2 = rates(states + h / 2 * k1, inputs)
        k3 = rates(states + h / 2 * k2, inputs)
        k4 = rates(states + h * k3, inputs)
        states = states + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return states


def driven(
    rates: Rates, states: list[float], inputs: FloatArray, period: float, steps: int
) -> FloatArray:
    """The states at every sample, shape (N, n)."""
    now = np.array(states)
    visited = []
    for command in inputs:
        visited.append(now)
        now = after(rates, now, command, period, steps)
    return np.array(visited)


def quadruple_tank(samples: int = 3000) -> Recorded:
    """Two levels behind two pumps, in the minimum-phase setting (Johansson 2000), cm and V."""
    random = np.random.default_rng(19)
    inputs = np.column_stack([
        levels(random, 6000, 220, 1.5, 4.5),
        levels(random, 6000, 260, 1.5, 4.5),
    ])[:samples]  # fmt: skip
    areas = np.array([28.0, 32.0, 28.0, 32.0])
    holes = np.array([0.071, 0.057, 0.071, 0.057])

    def rates(h: FloatArray, u: FloatArray) -> FloatArray:
        out = holes * np.sqrt(2 * 981.0 * np.maximum(h, 0.0))
        first = 3.33 * u[0]
        second = 3.35 * u[1]
        flows = [
            out[2] - out[0] + 0.7 * first,
            out[3] - out[1] + 0.6 * second,
            0.4 * second - out[2],
            0.3 * first - out[3],
        ]
        return np.asarray(np.array(flows) / areas)

    states = driven(rates, [12.4, 12.7, 1.8, 1.4], inputs, 1.0, 2)
    noise = 0.03 * random.normal(size=(6000, 2))[:samples]
    return Recorded(1.0, np.round(states[:, :2] + noise, 2), inputs)


def three_tanks(samples: int = 2000) -> Recorded:
    """Three levels behind two pumps (the three-tank system DTS200 of Amira), cm and mL/s."""
    random = np.random.default_rng(11)
    inputs = np.column_stack([
        levels(random, 4000, 150, 10.0, 65.0),
        levels(random, 4000, 190, 10.0, 60.0),
    ])[:samples]  # fmt: skip

    def flow(share: float, head: float) -> float:
        return float(share * 0.5 * np.sign(head) * np.sqrt(2 * 981.0 * abs(head)))

    def rates(h: FloatArray, u: FloatArray) -> FloatArray:
        to_middle = flow(0.5, h[0] - h[2])
        from_middle = flow(0.5, h[2] - h[1])
        out = flow(0.675, max(h[1], 0.0))
        flows = [u[0] - to_middle, u[1] + from_middle - out, to_middle - from_middle]
        return np.array(flows) / 154.0

    states = driven(rates, [15.0, 8.0, 11.0], inputs, 2.0, 4)
    noise = 0.08 * random.normal(size=(4000, 3))[:samples]
    return Recorded(2.0, np.round((states + noise) / 0.05) * 0.05, inputs)


def fermenter(samples: int = 3000) -> Recorded:
    """Biomass, substrate and product of a continuous fermenter under dilution and feed (Henson and Seborg 1997, with
    growth inhibited by substrate and product), g/L and 1/h."""
    random = np.random.default_rng(18)
    inputs = np.column_stack([
        levels(random, 3000, 220, 0.12, 0.25),
        levels(random, 3000, 260, 17.0, 23.0),
    ])[:samples]  # fmt: skip

    def rates(x: FloatArray, u: FloatArray) -> FloatArray:
        biomass, substrate, product = x
        dilution, feed = u
        inhibited = 0.48 * (1.0 - product / 50.0)
        growth = inhibited * substrate / (1.2 + substrate + substrate**2 / 22.0)
        per_hour = [
            (growth - dilution) * biomass,
            dilution * (feed - substrate) - growth * biomass / 0.4,
            (2.2 * growth + 0.2) * biomass - dilution * product,
        ]
        return np.array(per_hour) / 3600.0

    states = driven(rates, [6.0, 5.0, 19.0], inputs, 360.0, 4)
    noise = np.array([0.05, 0.05, 0.15]) * random.normal(size=(3000, 3))[:samples]
    return Recorded(360.0, np.round(states + noise, 2), inputs)


def aeration_basin(samples: int = 3000) -> Recorded:
    """Oxygen, which a blower moves within minutes, and ammonia, which follows the day, of an activated sludge basin
    with Monod kinetics (as in Henze et al. 2000), mg/L and %, one a minute. The load is not in the table."""
    random = np.random.default_rng(14)
    minutes = np.arange(3000)
    inflow = 300.0 + 120.0 * np.sin(2.0 * np.pi * minutes / 1440.0)
    blower = levels(random, 3000, 90, 15.0, 95.0)
    given = np.column_stack([np.round(blower), inflow / 20000.0])[:samples]

    def rates(x: FloatArray, u: FloatArray) -> FloatArray:
        oxygen, ammonia = x
        transfer = 0.0108 * u[0] ** 0.7
        nitrified = 0.055 * ammonia / (1.0 + ammonia) * oxygen / (0.5 + oxygen)
        respired = 0.27 * oxygen / (0.2 + oxygen)
        per_minute = [
            transfer * (9.0 - oxygen) - 4.3 * nitrified - respired - u[1] * oxygen,
            u[1] * (14.0 - 0.5 * ammonia) - 3.0 * nitrified,
        ]
        return np.array(per_minute) / 60.0

    states = driven(rates, [2.0, 3.0], given, 60.0, 3)
    noise = np.array([0.03, 0.05]) * random.normal(size=(3000, 2))[:samples]
    shown = np.round((states + noise) / [0.01, 0.1]) * [0.01, 0.1]
    return Recorded(60.0, shown, given[:, :1])


def evaporator(samples: int = 600) -> Recorded:
    """Level, m, concentration, %, and pressure, kPa, of an evaporator (Newell and Lee 1989), one a minute.

    A PI controller drains the product by the level, which integrates; steam and coolant move in steps.
    """
    random = np.random.default_rng(7)
    steam = levels(random, 2400, 90, 150.0, 230.0)
    coolant = levels(random, 2400, 70, 180.0, 240.0)
    feed = 10.0

    def rates(x: FloatArray, u: FloatArray) -> FloatArray:
        product, pressure, flow = u
        boiling = 0.5616 * x[2] + 0.3126 * x[1] + 48.43
        heat = 0.16 * (feed + 50.0) * (0.1538 * pressure + 90.0 - boiling)
        vapour = (heat - 0.07 * feed * (boiling - 40.0)) / 38.5
        cooled = 6.84 * (0.507 * x[2] + 30.0) / (1 + 6.84 / (0.14 * flow)) / 38.5
        return np.array([
            (feed - vapour - product) / 20.0,
            (feed * 5.0 - product * x[1]) / 20.0,
            (vapour - cooled) / 4.0,
        ])  # fmt: skip

    states = np.array([1.0, 25.0, 50.5])
    integral = 2.0
    outputs = []
    inputs = []
    for k in range(samples):
        level = states[0] + 0.01 * random.normal()
        error = level - (1.3 if (k // 200) % 2 else 1.0)
        integral = float(np.clip(integral + 0.02 * error, 0.0, 6.0))
        product = float(np.clip(integral + 1.2 * error, 0.2, 6.0))
        rest = states[1:] + 0.1 * random.normal(size=2)
        outputs.append([round(level, 3), *np.round(rest, 2)])
        inputs.append([product, steam[k], coolant[k]])
        states = after(rates, states, np.array(inputs[-1]), 1.0, 6)
    return Recorded(60.0, np.array(outputs), np.array(inputs))


def furnace(samples: int = 1600, *, together: bool = True) -> Recorded:
    """Three zones of a furnace that radiate to a melt and exchange heat, °C and %, one reading a minute.

    Three loops hold their temperatures; set-points step together, or one after the other.
    """
    random = np.random.default_rng(10)
    set_points = np.array([1450.0, 1500.0, 1480.0])

    def rates(x: FloatArray, u: FloatArray) -> FloatArray:
        zones = x[:3]
        melt = x[3]
        radiated = 2.8e-13 * ((zones + 273.0) ** 4 - (melt + 273.0) ** 4)
        exchanged = 0.002 * np.array([
            x[1] - x[0],
            x[0] + x[2] - 2 * x[1],
            x[1] - x[2],
        ])  # fmt: skip
        heated = 0.05 * u - 0.0007 * (zones - 100.0) - radiated + exchanged
        return np.append(heated, radiated.sum() * 0.12 - 0.0002 * (melt - 200.0))

    states = np.array([1450.0, 1500.0, 1480.0, 1300.0])
    integrals = np.array([35.0, 40.0, 37.0])
    outputs = []
    inputs = []
    for k in range(samples):
        readings = np.round(states[:3] + 0.5 * random.normal(size=3))
        steps = np.full(3, 20.0 * ((k // 200) % 2))
        if not together:
            steps = np.zeros(3)
            steps[(k // 240) % 3] = 20.0 * ((k // 120) % 2)
        errors = set_points + steps - readings
        integrals = np.clip(integrals + 0.01 * errors, 0.0, 100.0)
        commands = np.clip(integrals + 0.8 * errors, 0.0, 100.0)
        outputs.append(readings)
        inputs.append(commands)
        states = after(rates, states, commands, 1.0, 4)
    return Recorded(60.0, np.array(outputs), np.array(inputs))
