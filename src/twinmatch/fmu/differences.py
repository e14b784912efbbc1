"""Points for the finite differences of an FMU, and its initial states."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics import Parameter, Plant, State
from twinmatch.fmu.mapping import Formula
from twinmatch.signals import FloatArray

STEP: Final = 1e-4
"""Half width of a central difference, relative to the size of the variable: the truncation error is 1e-8;
with a variable-step solver accurate to 1e-8, the derivative is accurate to 1e-4."""
_LEAST: Final = 0.1
"""The size of a parameter near zero is this share of its scale."""


class Points(NamedTuple):
    """A point, and points on both sides of it in several directions."""

    fixed: FloatArray
    """Parameters and states, shape (1 + 2·k, n), the point itself first; or (2·k, n) without it."""
    drive: FloatArray
    """Shape (1 + 2·k,)."""
    widths: FloatArray
    """Distance between both sides, shape (k,)."""

    def slopes(self, values: FloatArray) -> FloatArray:
        """Derivatives along each direction, shape (m, k), from values at the points, shape (points, m)."""
        first = len(values) - 2 * self.widths.size
        return np.asarray((values[first::2] - values[first + 1 :: 2]).T / self.widths)


class Differences:
    """Widths of finite differences within the possible values of parameters; and initial states."""

    def __init__(
        self,
        plant: type[Plant],
        parameters: Sequence[Parameter],
        states: Sequence[State],
        starts: Mapping[str, Formula],
    ) -> None:
        """Set up for a structure with these parameters and states."""
        self._parameters, self._states, self._starts = tuple(parameters), tuple(states), starts
        self._output, self._drive, self._others = (
            plant.output.name,
            plant.drive.name,
            tuple(plant.disturbances),
        )
        self.rest = float(plant.drive.rest)
        self.period = 1.0 if plant.loop is None else float(plant.loop.period)
        """Time over which the rate of a co-simulation FMU is taken, s."""
        low, high = plant.drive.limits
        self._drive_step = STEP * (high - low)
        self._spans = STEP * np.array([state.span[1] - state.span[0] for state in states])

    def begin(
        self, vector: FloatArray, y: float, u: float, d: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Initial states at an output y after a drive u, (nx,); their derivatives by y and parameters."""
        names = [parameter.name for parameter in self._parameters]
        values = {
            self._output: float(y),
            self._drive: float(u),
            **dict(zip(self._others, np.asarray(d, dtype=np.float64).tolist(), strict=True)),
            **dict(zip(names, vector.tolist(), strict=True)),
        }
        x = self._at(values)
        by_y = self._slope(values, self._output, STEP * (1.0 + abs(y)))
        by_parameters = np.zeros((x.size, vector.size))
        named = {name for formula in self._starts.values() for name in formula.names}
        for k, name in enumerate(names):
            if name in named:
                by_parameters[:, k] = self._slope(values, name, self._reach(k, float(vector[k])))
        return x, by_y, by_parameters

    def around(
        self, at: FloatArray, drive: float, directions: Iterable[int], *, drive_too: bool = False
    ) -> Points:
        """The point, and both sides of it along single parameters and states, optionally also the drive."""
        m = len(self._parameters)
        rows, widths = [at], []
        for k in directions:
            size = self._reach(k, float(at[k])) if k < m else self._spans[k - m]
            high, low = at.copy(), at.copy()
            high[k] += size
            low[k] -= size
            if k < m:
                high[k], low[k] = self._inside(k, high[k], at[k]), self._inside(k, low[k], at[k])
            rows += [high, low]
            widths.append(high[k] - low[k])
        drives = np.full(len(rows), drive)
        if drive_too:
            rows += [at, at]
            drives = np.append(drives, [drive + self._drive_step, drive - self._drive_step])
            widths.append(2.0 * self._drive_step)
        return Points(np.array(rows), drives, np.array(widths))

    def along(self, at: FloatArray, directions: FloatArray) -> Points:
        """Both sides of a point along arbitrary directions, shape (k, n)."""
        m = len(self._parameters)
        sizes = np.array([*(self._reach(k, float(at[k])) for k in range(m)), *self._spans])
        rows, widths = [], []
        for direction in directions:
            own = np.abs(direction) > 0.0
            # The width along a parameter's direction follows from the parameter, not from the states' share.
            first = own[:m] if own[:m].any() else own
            chosen = np.flatnonzero(first)
            size = float(np.min(sizes[chosen] / np.abs(direction[chosen]))) if chosen.size else 1.0
            high, low = at + size * direction, at - size * direction
            up = down = size
            for k in np.flatnonzero(own[:m]).tolist():
                high_k, low_k = self._inside(k, high[k], at[k]), self._inside(k, low[k], at[k])
                up, down = min(up, (high_k - at[k]) / direction[k]), min(down, (at[k] - low_k) / direction[k])
            rows += [at + up * direction, at - down * direction]
            widths.append(up + down)
        return Points(np.array(rows).reshape(-1, at.size), np.zeros(0), np.array(widths))

    def _reach(self, k: int, value: float) -> float:
        return STEP * max(abs(value), _LEAST * self._parameters[k].scale)

    def _inside(self, k: int, value: float, at: float) -> float:
        """The value if it is possible for the parameter, otherwise the current one."""
        return float(value if self._parameters[k].possible(float(value)) else at)

    def _at(self, values: Mapping[str, float]) -> FloatArray:
        return np.array([self._starts[state.name](values) for state in self._states], dtype=np.float64)

    def _slope(self, values: Mapping[str, float], name: str, size: float) -> FloatArray:
        high, low = ({**values, name: values[name] + sign * size} for sign in (1.0, -1.0))
        return (self._at(high) - self._at(low)) / (2.0 * size)
