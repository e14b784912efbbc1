"""A running plant followed by its equations: states, parameters and what acts on it unseen, all at once.

An extended Kalman filter whose state is, in this order, the plant's states, the parameters its structure
leaves free, and six numbers no plant file names: by what share the drive does more than it should, by what
the reading is off for good and in passing (a camera that has just corrected itself), how much pushes the
output for a while and for good, and how fast one of the others rises. Of those only the passing offset and
the fading push stray by themselves; the others are opened by whoever asks whether they changed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics.parameters import Parameters
from twinmatch.dynamics.simulation import begin
from twinmatch.dynamics.tracked import Tracked
from twinmatch.signals import FloatArray

__all__ = ["Belief", "Stretch", "Traces", "Tracker", "no_traces"]

_FADES: Final = 100.0
"""Time in which a push that nobody can name is gone, s."""
_PASSES: Final = 14.0
"""Time in which a camera has settled after its correction, s."""
_UNSURE: Final = 0.6
"""Standard deviation of the logarithm of a parameter where the following begins …"""
_PART: Final = 0.5
"""… or of one that has none, in its scale."""
_PLAIN: Final = np.array([0.6, 0.001, 5e-4, 0.2, 0.15])
"""How far the equations of a real rig are off: straying of a state that the output shows, in noises, and of
another, in scales, in the root of a sample; of a parameter, in scales, in the root of a second; a fading
push, in noises per sample; and the error of a movement, as a share of it."""


class Stretch(NamedTuple):
    """Consecutive samples."""

    output: FloatArray
    """Readings, shape (N + 2,): the first two are those before (NaN if there are none)."""
    input: FloatArray
    """Shape (N,)."""
    disturbances: FloatArray
    """Shape (N, m)."""
    noise: FloatArray
    """Standard deviation of each reading, shape (N,)."""


class Traces(NamedTuple):
    """What jumps at past samples would have left in the surprises since."""

    effects: FloatArray
    """On what is believed now, shape (n, kinds, starts)."""
    hits: FloatArray
    """Sums of surprise times effect over variance, shape (kinds, starts)."""
    weights: FloatArray
    """Sums of squared effect over variance, shape (kinds, starts)."""


def no_traces(size: int) -> Traces:
    """For who asks for none."""
    return Traces(np.zeros((size, 0, 0)), np.zeros((0, 0)), np.zeros((0, 0)))


@dataclass(frozen=True)
class Belief:
    """What is believed at one sample; not to be changed."""

    values: FloatArray
    """Shape (n,)."""
    covariance: FloatArray
    """Shape (n, n)."""

    def closed(self, index: int) -> Belief:
        """The same with one of the numbers known to be zero."""
        values, covariance = self.values.copy(), self.covariance.copy()
        values[index] = 0.0
        covariance[index, :] = covariance[:, index] = 0.0
        return Belief(values, covariance)

    def opened(self, index: int, shift: float, spread: float) -> Belief:
        """The same had one of the numbers moved by a shift known to within a spread."""
        values, covariance = self.values.copy(), self.covariance.copy()
        values[index] += shift
        covariance[index, index] += spread**2
        return Belief(values, covariance)


class Tracker:
    """Follows one plant at several degrees of trust in its equations."""

    def __init__(self, parameters: Parameters, period: float, levels: tuple[float, ...]) -> None:
        """Begin with these parameters; `levels` multiply how far the equations may be off."""
        model = parameters.model
        free, declared = model.structure.free, model.declared
        kernels = model.kernels
        self.parameters = parameters
        self.free = free
        n, m = len(model.states), len(free)
        self.size = n + m + 6
        self.at = {name: n + j for j, name in enumerate(free)}
        """Where the parameters stand in a belief."""
        self.share, self.offset, self.passing, self.fading, self.push, self.rate = range(n + m, self.size)
        values = np.array([parameters[name] for name in free])
        bounds = np.array([declared[name].bounds for name in free])
        logged = [declared[k].relative and parameters[k] > 0 and math.isinf(declared[k].most) for k in free]
        self.logged = np.array(logged)
        floor = np.maximum(bounds[:, 0], 0.01 * values)
        # A belief that is cut off at a bound is no longer one: what goes with the parameter would not follow.
        width = bounds[:, 1] - bounds[:, 0]
        with np.errstate(invalid="ignore", divide="ignore"):
            least = np.where(self.logged, np.log(floor / values), bounds[:, 0] - width - values)
            most = np.where(self.logged, np.log(bounds[:, 1] / values), bounds[:, 1] + width - values)
        keeps = np.ones(self.size)
        keeps[self.fading] = math.exp(-period / _FADES)
        keeps[self.passing] = math.exp(-period / _PASSES)
        self._fixed = Tracked(
            vector=parameters.vector.copy(),
            places=np.array([kernels.PARAMETERS.index(k) for k in free], dtype=np.int64),
            which=np.array([kernels.UNKNOWN.index(k) for k in free], dtype=np.int64),
            logged=self.logged,
            least=least,
            most=most,
            keeps=keeps,
            rest=float(model.plant.drive.rest),
            period=float(period),
            steps=2 * parameters.steps(period),  # parameters move, and a fast plant may become faster
        )
        self._scales = np.array(
            [1.0 if log else declared[k].scale for k, log in zip(free, logged, strict=True)]
        )
        self._track = kernels.track
        noise = model.plant.output.noise
        scales = np.array([state.scale for state in model.declared_states])
        slope = kernels.slopes_at(
            parameters.vector, begin(parameters, 0.0), float(model.plant.drive.rest), model.disturbances
        )[4]
        self._shown = slope != 0.0
        seen = np.where(self._shown, noise / np.where(self._shown, np.abs(slope), 1.0), 0.0)
        self._first = np.concatenate([
            np.where(self._shown, 3.0 * seen, 0.5 * scales),
            np.where(self.logged, _UNSURE, _PART * self._scales),
        ])  # fmt: skip
        drift = np.zeros(self.size)
        drift[:n] = np.where(self._shown, _PLAIN[0] * seen, _PLAIN[1] * scales)
        drift[n : n + m] = _PLAIN[2] * self._scales
        drift[:n] /= math.sqrt(period)  # a plant that is sampled faster is a faster one
        drift[self.fading] = _PLAIN[3] * noise / period * math.sqrt(2.0 / _FADES)
        self._fading = _PLAIN[3] * noise / period
        self._drifts = [level * drift for level in levels]
        self._swift = [level * float(_PLAIN[4]) for level in levels]
        self._closed = np.zeros(self.size)
        self._none = no_traces(self.size)
        self._levels = levels

    def begin(self, output: float, disturbances: FloatArray, level: int) -> Belief:
        """What is believed at the first reading."""
        values = np.zeros(self.size)
        n = len(self.parameters.model.states)
        values[:n] = begin(self.parameters, output, disturbances=disturbances)
        spread = np.zeros(self.size)
        spread[: self._first.size] = self._first
        spread[self.fading] = self._levels[level] * self._fading
        return Belief(values, np.diag(spread**2))

    def again(self, belief: Belief, output: float, disturbances: FloatArray) -> Belief:
        """The belief behind a gap: parameters are kept, states begin anew at a reading."""
        n = len(self.parameters.model.states)
        start = self.begin(output, disturbances, 0)
        values, covariance = belief.values.copy(), belief.covariance.copy()
        values[:n] = np.where(self._shown, start.values[:n], values[:n])
        values[self.passing] = values[self.fading] = 0.0
        for i in (*range(n), self.passing):
            covariance[i, :] = covariance[:, i] = 0.0
            covariance[i, i] = start.covariance[i, i]
        return Belief(values, covariance)

    def run(
        self,
        belief: Belief,
        stretch: Stretch,
        level: int,
        *,
        traces: Traces | None = None,
        opened: FloatArray | None = None,
        lasting: int = 0,
        rising: int = -1,
    ) -> tuple[Belief, float]:
        """The belief after some samples, and what their readings cost, in nats.

        Args:
            belief: before them.
            stretch: the samples.
            level: which of the levels.
            traces: moved along, in place.
            opened: more straying, per √s, in the first `lasting` samples, shape (n,).
            lasting: number of those samples.
            rising: which of the numbers rises at the believed rate; negative: none.
        """
        values, covariance = belief.values.copy(), belief.covariance.copy()
        cost = self._track(
            self._fixed, values, covariance, self._drifts[level], self._swift[level],
            *stretch, self._closed if opened is None else opened, lasting, rising, *(traces or self._none),
        )  # fmt: skip
        return Belief(values, covariance), float(cost)

    def named(self, belief: Belief, name: str) -> float:
        """The value of a parameter that is believed."""
        q, start = float(belief.values[self.at[name]]), self.parameters[name]
        return start * math.exp(q) if self.logged[self.free.index(name)] else start + q
