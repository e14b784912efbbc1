"""The whole loop of a plant and a law around an operating point: stable or not, and how far from the other.

The plant's states and the law's move together once a sample: plant, observer, integrators, filters and dead
times are all in one matrix. If its largest eigenvalue is 1 or more in size, small deviations do not decay;
this is decided as computed, without a tolerance. For the distance from there let L(z) be the closed loop's
response from a load at one command to the command that the law gives. Opened there, with all others closed,
the loop answers with T = L/(1 + L). An eigenvalue is on the unit circle for every gain k with k·T = 1, which
is k = 1 + 1/L, at the frequencies where L is real, 0 and the Nyquist frequency among them; and for every dead
time θ with T·e^(−jωθ) = 1. The sensitivity is 1/(1 − T) = 1 + L. L is finite, also where T is not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.comparing import having_value
from twinmatch.dynamics import Linear, LinearLaw, largest_eigenvalue, loop_matrix
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

_AROUND: Final = np.linspace(-3.0, 3.0, 25)
"""Places of further frequencies around a resonance, in half widths of its peak."""

LEAST_GAIN: Final = 1e-6
"""Factor on a gain below which the loop counts as opened: an integrating plant is lost at 0 itself."""

_Response = Callable[[float], complex]


class _FrequencyGrid(Rule):
    """The grid on which crossings are looked for: from a period of two months at 1 s on, 60 frequencies in a
    decade."""

    slowest: float = 1e-6
    """Lowest frequency, radians per sample."""
    count: int = 400


_FREQUENCIES: Final = _FrequencyGrid()


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
        return min(
            self.gain_up, math.inf if self.gain_down == 0 else 1.0 / self.gain_down
        )


UNSTABLE: Final = ChannelMargins(1.0, 1.0, 0.0, math.inf)


@dataclass(frozen=True, eq=False)
class WholeLoop:
    """A plant, linearised, and the law around it, both with one sample time."""

    plant: Linear
    law: LinearLaw

    @cached_property
    def matrix(self) -> FloatArray:
        """How the states of plant and law deviate one sample later, shape (n + q, n + q)."""
        return loop_matrix(self.plant, self.law)

    @property
    def eigenvalue(self) -> float:
        """Size of the largest eigenvalue; infinite where the plant has no finite linearisation."""
        return largest_eigenvalue(self.matrix)

    @property
    def stable(self) -> bool:
        """Whether small deviations decay."""
        return self.eigenvalue < 1.0

    @cached_property
    def _commands(self) -> FloatArray:
        return np.hstack([self.law.D @ self.plant.C, self.law.C])

    @cached_property
    def _load(self) -> FloatArray:
        """How a load at the plant's inputs moves the states."""
        plant = self.plant
        return np.vstack([plant.B, np.zeros((len(self.law.A), plant.B.shape[1]))])

    def _responses(self, angles: FloatArray) -> NDArray[np.complex128]:
        """How the law's commands answer loads at the plant's inputs, all loops closed, at frequencies in
        radians per sample; shape (f, m, m)."""
        shifted = (
            np.exp(1j * angles)[:, None, None] * np.eye(len(self.matrix)) - self.matrix
        )
        states = np.linalg.solve(
            shifted, np.broadcast_to(self._load, (angles.size, *self._load.shape))
        )
        return np.asarray(self._commands @ states, dtype=np.complex128)

    @having_value("the margin of the loop")
    def margins(self) -> tuple[ChannelMargins, ...]:
        """Those of every command, all others closed.

        Raises:
            PlantError: plant and law have different sample times.
            UndefinedError: they have no value.
        """
        self.law.require_period(self.plant.period)
        channels = range(self.plant.B.shape[1])
        if not self.stable:
            return tuple(UNSTABLE for _ in channels)
        grid = _frequencies(np.linalg.eigvals(self.matrix))
        values = self._responses(grid)

        def at(channel: int) -> _Response:
            return lambda angle: complex(
                self._responses(np.array([angle]))[0, channel, channel]
            )

        return tuple(
            _margins(at(k), grid, values[:, k, k], self.plant.period) for k in channels
        )

    @having_value("the sensitivity of the loop")
    def sensitivity(self) -> float:
        """Maximum sensitivity of the loop, over all commands together: the largest singular value of
        (1 + C·P)⁻¹.

        Raises:
            UndefinedError: it has no value.
        """
        matrix = self.matrix
        eigenvalues = (
            np.linalg.eigvals(matrix)
            if np.isfinite(matrix).all()
            else np.array([np.inf])
        )
        if not np.abs(eigenvalues).max() < 1.0:
            return math.inf
        whole = np.eye(self._load.shape[1]) + self._responses(_frequencies(eigenvalues))
        return float(np.linalg.norm(whole, 2, axis=(1, 2)).max())


def _frequencies(eigenvalues: NDArray[Any]) -> FloatArray:
    """A grid over all frequencies with both ends, finer around the resonances of these eigenvalues; radians
    per sample."""
    grid = [np.zeros(1), np.geomspace(_FREQUENCIES.slowest, np.pi, _FREQUENCIES.count)]
    for value in eigenvalues[eigenvalues.imag > 0]:
        width = max(abs(1.0 - abs(value)), 1e-6)
        grid.append(np.angle(value) + width * _AROUND)
    all_frequencies = np.unique(np.concatenate(grid))
    return np.asarray(
        all_frequencies[(all_frequencies >= 0) & (all_frequencies <= np.pi)],
        dtype=np.float64,
    )


def _margins(
    closed: _Response, grid: FloatArray, values: NDArray[np.complex128], period: float
) -> ChannelMargins:
    """From the frequencies at which the closed loop's response is real, both ends among them, and those at
    which the opened one's has size 1."""
    gains = _critical_gains(closed, grid, values)
    return ChannelMargins(
        gain_down=max((gain for gain in gains if LEAST_GAIN < gain < 1.0), default=0.0),
        gain_up=min((gain for gain in gains if gain > 1.0), default=math.inf),
        delay=min(_critical_delays(closed, grid, values), default=math.inf) * period,
        sensitivity=_sensitivity(closed, grid, values),
    )


def _critical_gains(
    closed: _Response, grid: FloatArray, values: NDArray[np.complex128]
) -> list[float]:
    """Factors k = 1 + 1/L on the gain with which an eigenvalue is on the unit circle."""
    crossings = _crossings(grid, values.imag, lambda w: closed(w).imag)
    real_parts = [closed(w).real for w in crossings]
    real_parts += [float(values[0].real), float(values[-1].real)]
    return [1.0 + 1.0 / real for real in real_parts if real != 0.0]


def _critical_delays(
    closed: _Response, grid: FloatArray, values: NDArray[np.complex128]
) -> list[float]:
    """Dead times, in samples, with which an eigenvalue is on the unit circle: T = L/(1 + L) has size 1."""

    def excess(response: Any) -> Any:
        return np.abs(response) - np.abs(1.0 + response)

    delays = []
    for w in _crossings(grid, excess(values), lambda w: float(excess(closed(w)))):
        response = closed(w)
        lag = float(np.angle(response / (1.0 + response))) % (2 * np.pi)
        delays.append(lag / w)
    return delays


def _crossings(
    grid: FloatArray, values: FloatArray, exact: Callable[[float], float]
) -> list[float]:
    """Frequencies at which a quantity, known on the grid, is zero."""
    from scipy.optimize import brentq  # noqa: PLC0415

    signs = np.sign(values)
    places = np.flatnonzero(signs[1:] * signs[:-1] < 0)
    return [float(brentq(exact, grid[k], grid[k + 1], xtol=1e-14)) for k in places]


def _sensitivity(
    closed: _Response, grid: FloatArray, values: NDArray[np.complex128]
) -> float:
    """The largest |1 + L|: the largest on the grid, or the top of the peak around it."""
    from scipy.optimize import minimize_scalar  # noqa: PLC0415

    sizes = np.abs(1.0 + values)
    k = int(np.argmax(sizes))
    low = grid[max(k - 1, 0)]
    high = grid[min(k + 1, grid.size - 1)]
    top = minimize_scalar(
        lambda w: -abs(1.0 + closed(w)),
        bounds=(low, high),
        method="bounded",
        options={"xatol": 1e-9},
    )
    return max(-float(top.fun), float(sizes[k]))
