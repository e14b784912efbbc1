"""The whole loop of a plant and a law around an operating point: stable or not, and how far from the other.

The plant's states and the law's move together once a sample: plant, observer, integrators, filters and dead
times are all in one matrix. If its largest eigenvalue is 1 or more in size, small deviations do not decay;
this is decided as computed, without a tolerance. For the distance from there the loop is opened at one
command with all others closed. Its response T(z) from that command, as the plant receives it, to the one that
the law gives shows every gain k (k·T = 1) and every dead time θ (T·e^(−jωθ) = 1) at which an eigenvalue is on
the unit circle, and 1/(1 − T) is the sensitivity.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize_scalar

from twinmatch.dynamics import Linear, LinearLaw, PlantError
from twinmatch.signals import FloatArray

_SLOWEST: Final = 1e-6
"""Lowest frequency of the grid, radians per sample: a period of two months at 1 s."""
_GRID: Final = 400
_AROUND: Final = np.linspace(-3.0, 3.0, 25)
"""Places of further frequencies around a resonance, in half widths of its peak."""

_Response = Callable[[FloatArray], NDArray[np.complex128]]


class ChannelMargins(NamedTuple):
    """How far a stable loop is from instability at one command."""

    gain_down: float
    """Factor on the gain, below 1, at which it becomes unstable; 0 if none does."""
    gain_up: float
    """Factor above 1; infinite if none does."""
    delay: float
    """Additional dead time at which it becomes unstable, s; infinite if none does."""
    sensitivity: float
    """Maximum sensitivity M_s."""

    @property
    def gain_change(self) -> float:
        """The smallest change of the gain that makes it unstable, as a factor of 1 or more."""
        return min(self.gain_up, math.inf if self.gain_down == 0 else 1.0 / self.gain_down)


UNSTABLE: Final = ChannelMargins(1.0, 1.0, 0.0, math.inf)


class WholeLoop(NamedTuple):
    """A plant, linearised, and the law around it, both with one sample time."""

    plant: Linear
    law: LinearLaw

    @property
    def matrix(self) -> FloatArray:
        """How the states of plant and law deviate one sample later, shape (n + q, n + q)."""
        return self._free + np.vstack([self.plant.B, self.law.G]) @ self._commands

    @property
    def eigenvalue(self) -> float:
        """Size of the largest eigenvalue; infinite where the plant has no finite linearisation."""
        matrix = self.matrix
        return float(np.abs(np.linalg.eigvals(matrix)).max()) if np.isfinite(matrix).all() else math.inf

    @property
    def stable(self) -> bool:
        """Whether small deviations decay."""
        return self.eigenvalue < 1.0

    @property
    def _commands(self) -> FloatArray:
        return np.hstack([self.law.D @ self.plant.C, self.law.C])

    @property
    def _free(self) -> FloatArray:
        """The same without commands."""
        plant, law = self.plant, self.law
        return np.block([[plant.A, np.zeros((len(plant.A), len(law.A)))], [law.B @ plant.C, law.A]])

    @property
    def _load(self) -> FloatArray:
        """How a load at the plant's inputs moves the states."""
        plant = self.plant
        return np.vstack([plant.B, np.zeros((len(self.law.A), plant.B.shape[1]))])

    def opened(self, channel: int) -> _Response:
        """T(e^jω) as a function of frequencies in radians per sample: opened at one command."""
        row, entry = self._commands[channel], self._load[:, channel]
        matrix = self.matrix - np.outer(entry, row)

        def response(angles: FloatArray) -> NDArray[np.complex128]:
            shifted = np.exp(1j * angles)[:, None, None] * np.eye(len(matrix)) - matrix
            states = np.linalg.solve(shifted, np.broadcast_to(entry[:, None], (angles.size, entry.size, 1)))
            return np.asarray(states[:, :, 0] @ row, dtype=np.complex128)

        return response

    def margins(self) -> tuple[ChannelMargins, ...]:
        """Those of every command, all others closed.

        Raises:
            PlantError: plant and law have different sample times.
        """
        if self.plant.period != self.law.period:
            raise PlantError(
                f"loop: the plant is sampled every {self.plant.period:g} s, the law every "
                f"{self.law.period:g} s; give both the same period"
            )
        channels = range(self.plant.B.shape[1])
        if not self.stable:
            return tuple(UNSTABLE for _ in channels)
        grid = _frequencies(np.linalg.eigvals(self.matrix))
        return tuple(_margins(self.opened(k), grid, self.plant.period) for k in channels)

    def sensitivity(self) -> float:
        """Maximum sensitivity of the loop, over all commands together: the largest singular value of
        (1 + C·P)⁻¹."""
        matrix = self.matrix
        eigenvalues = np.linalg.eigvals(matrix) if np.isfinite(matrix).all() else np.array([np.inf])
        if not np.abs(eigenvalues).max() < 1.0:
            return math.inf
        angles = _frequencies(eigenvalues)
        shifted = np.exp(1j * angles)[:, None, None] * np.eye(len(matrix)) - matrix
        states = np.linalg.solve(shifted, np.broadcast_to(self._load, (angles.size, *self._load.shape)))
        whole = np.eye(self._load.shape[1]) + self._commands @ states
        return float(np.linalg.norm(whole, 2, axis=(1, 2)).max())


def _frequencies(eigenvalues: NDArray[Any]) -> FloatArray:
    """A grid over all frequencies, finer around the resonances of these eigenvalues; radians per sample."""
    grid = [np.geomspace(_SLOWEST, np.pi, _GRID)]
    for value in eigenvalues[eigenvalues.imag > 0]:
        width = max(abs(1.0 - abs(value)), 1e-6)
        grid.append(np.angle(value) + width * _AROUND)
    every = np.unique(np.concatenate(grid))
    return np.asarray(every[(every > 0) & (every <= np.pi)], dtype=np.float64)


def _margins(response: _Response, grid: FloatArray, period: float) -> ChannelMargins:
    """From the crossings of the response with the positive real axis and with the unit circle."""
    values = response(grid)

    def at(angle: float) -> complex:
        return complex(response(np.array([angle]))[0])

    real = [at(w) for w in _crossings(grid, values.imag, lambda w: at(w).imag)]
    gains = [1.0 / t.real for t in [*real, complex(values[-1].real)] if t.real > 0.0]
    crossed = _crossings(grid, np.log(np.abs(values)), lambda w: math.log(abs(at(w))))
    delays = [(float(np.angle(at(w))) % (2 * np.pi)) / w for w in crossed]
    return ChannelMargins(
        max((k for k in gains if k < 1.0), default=0.0),
        min((k for k in gains if k > 1.0), default=math.inf),
        min(delays, default=math.inf) * period,
        _sensitivity(at, grid, values),
    )


def _crossings(grid: FloatArray, values: FloatArray, exact: Callable[[float], float]) -> list[float]:
    """Frequencies at which a quantity, known on the grid, is zero."""
    signs = np.sign(values)
    places = np.flatnonzero(signs[1:] * signs[:-1] < 0)
    return [float(brentq(exact, grid[k], grid[k + 1], xtol=1e-14)) for k in places]


def _sensitivity(at: Callable[[float], complex], grid: FloatArray, values: NDArray[np.complex128]) -> float:
    k = int(np.argmin(np.abs(1.0 - values)))
    ends = grid[max(k - 1, 0)], grid[min(k + 1, grid.size - 1)]
    near = minimize_scalar(lambda w: abs(1.0 - at(w)), bounds=ends, method="bounded", options={"xatol": 1e-9})
    return 1.0 / min(float(near.fun), float(np.abs(1.0 - values[k])))
