"""All that is known at one sample of what comes next, by one twin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.dynamics import (
    Drive,
    Foretold,
    Output,
    Parameters,
    PidGains,
    PidState,
    advance,
    foretell,
    simulate_closed_loop,
    simulate_driven,
)
from twinmatch.forecasting.errors import ForecastError
from twinmatch.forecasting.follower import drift_of
from twinmatch.forecasting.forecast import CONFIDENCE, Band, Forecast
from twinmatch.signals import FloatArray, Sample

__all__ = ["Outlook"]

_LEAST: Final = 0.3
"""Least standard deviation of an input ahead, in units of its noise: a limit may be left."""
_ROOM: Final = 3.0
"""How far beyond the levels visited a set-point still counts as visited, in the output's noise."""


@dataclass(frozen=True, eq=False)
class Outlook:
    """A twin at one sample, ready to be asked; it does not change."""

    sample: Sample
    """The newest one it knows."""
    candidate: str
    parameters: Parameters
    states: FloatArray
    """At that sample, its reading taken in, shape (n,)."""
    covariance: FloatArray
    """Of the states and of the parameters `unsure`, shape (n + m, n + m)."""
    unsure: tuple[str, ...]
    controller: PidState
    """What the controller remembers after that sample."""
    gains: PidGains | None
    """Of the controller; None: the loop is not known, and what comes follows from the inputs ahead."""
    period: float
    """Sample time, s."""
    leads: tuple[int, ...]
    """Samples ahead at which the widths are known, shape (L,)."""
    widths: FloatArray
    """Half widths of the band there, in standard deviations, of output and, in closed loop, of input; shape
    (signals, L)."""
    visited: tuple[float, float]
    """Least and greatest output seen so far."""
    notes: tuple[str, ...] = ()
    """What no band can promise now."""

    @property
    def closed(self) -> bool:
        """Whether it foretells under set-points ahead; otherwise under inputs ahead."""
        return self.gains is not None

    @property
    def standing(self) -> float:
        """The newest of what it foretells under: the set-point, or the input."""
        return self.sample.reference if self.closed else self.sample.input

    @property
    def signal(self) -> Output | Drive:
        """What that is of the plant."""
        plant = self.parameters.model.plant
        return plant.output if self.closed else plant.drive

    def foretold(self, ahead: ArrayLike, disturbances: ArrayLike | None = None) -> Foretold:
        """Mean and variance of the N samples ahead under these set-points or inputs, shape (N,).

        Disturbances stay as they are, unless they are given from the newest sample on, shape (N + 1, d).
        """
        if disturbances is None and self.sample.disturbances:
            disturbances = np.array(self.sample.disturbances)
        return foretell(
            self.parameters,
            states=self.states,
            covariance=self.covariance,
            unsure=self.unsure,
            input=self.sample.input,
            drift=drift_of(self.parameters.model),
            reference=ahead if self.closed else None,
            inputs=None if self.closed else ahead,
            controller=self.controller,
            gains=self.gains,
            period=self.period,
            disturbances=disturbances,
        )

    def mean(self, ahead: FloatArray, disturbances: FloatArray | None = None) -> FloatArray:
        """Output and input of `foretold`, to the last bit, at a third of its cost; shape (2, N).

        `disturbances` are those from the newest sample on, shape (N + 1, d), if there are any.
        """
        begun = advance(
            self.parameters,
            self.states,
            self.sample.input,
            self.period,
            None if disturbances is None else disturbances[0],
        )
        rows = None if disturbances is None else disturbances[1:]
        if self.gains is None:
            found = simulate_driven(
                self.parameters, ahead, states=begun, period=self.period, disturbances=rows
            )
        else:
            found = simulate_closed_loop(
                self.parameters,
                ahead,
                states=begun,
                controller=self.controller,
                gains=self.gains,
                disturbances=rows,
            )
        return np.stack([found.output, found.input])

    def deviations(self, foretold: Foretold) -> FloatArray:
        """Standard deviations of output and input that the twin reckons with, shape (2, N)."""
        least = (_LEAST * self.parameters.model.plant.drive.noise) ** 2
        return np.sqrt(np.stack([foretold.output_variance, foretold.input_variance + least]))

    def forecast(self, ahead: ArrayLike, disturbances: ArrayLike | None = None) -> Forecast:
        """What comes under these set-points, or inputs where the loop is not known, shape (N,), from the next
        sample on; disturbances as in `foretold`.

        Raises:
            ForecastError: there is none, or one that is not finite.
        """
        values = np.array(ahead, dtype=np.float64)
        if values.ndim != 1 or not values.size or not np.isfinite(values).all():
            what = "set-points" if self.closed else "inputs"
            msg = f"forecast: the {what} ahead are no list of finite numbers; give one for each sample"
            raise ForecastError(msg)
        foretold = self.foretold(values, disturbances)
        half = self.deviations(foretold)[: len(self.widths)] * self._widths(values.size)
        return Forecast(
            sample=self.sample.index,
            candidate=self.candidate,
            structure=self.parameters.model.structure_name,
            confidence=CONFIDENCE,
            time=np.arange(1, values.size + 1, dtype=np.float64) * self.period,
            reference=values if self.closed else np.full(values.size, np.nan),
            output=Band(foretold.output, foretold.output - half[0], foretold.output + half[0]),
            input=self._input_band(foretold.input, half[1:]),
            notes=self.notes + self._given(values, disturbances) + self._beyond(foretold.output),
        )

    def _given(self, ahead: FloatArray, disturbances: ArrayLike | None) -> tuple[str, ...]:
        """What it takes for granted: inputs that nobody foretells, and disturbances."""
        plant, told = self.parameters.model.plant, []
        if not self.closed:
            stays = bool((ahead == self.sample.input).all())
            level = f"{self.sample.input:g} {plant.drive.unit}".rstrip()
            what = f"an input that stays at {level}" if stays else "the inputs that were given"
            told.append(f"the loop is not known: it holds for {what}")
        if self.sample.disturbances and disturbances is None:
            names = " and ".join(d.text or d.name for d in plant.disturbances.values())
            told.append(
                f"it takes for granted that what is measured beside the output ({names}) stays as it is"
            )
        return tuple(told)

    def _input_band(self, mean: FloatArray, half: FloatArray) -> Band:
        """Of the controller's answers; inputs that were given are what they are."""
        if self.gains is None:
            return Band(mean, mean, mean)
        limits = self.parameters.model.plant.drive.limits
        low, high = max(self.gains.low, limits[0]), min(self.gains.high, limits[1])
        return Band(mean, np.clip(mean - half[0], low, high), np.clip(mean + half[0], low, high))

    def _widths(self, samples: int) -> FloatArray:
        ahead, knots = np.log(np.arange(1, samples + 1)), np.log(np.array(self.leads, dtype=np.float64))
        return np.stack([np.interp(ahead, knots, row) for row in self.widths])

    def _beyond(self, output: FloatArray) -> tuple[str, ...]:
        """Whether the forecast leaves what was ever visited."""
        plant = self.parameters.model.plant
        room, unit = _ROOM * plant.output.noise, plant.output.unit
        low, high = self.visited[0] - room, self.visited[1] + room
        reach = float(output.min()), float(output.max())
        if low <= reach[0] and reach[1] <= high:
            return ()
        span = f"{self.visited[0]:.4g} to {self.visited[1]:.4g} {unit}"
        went = f"{reach[0]:.4g} to {reach[1]:.4g} {unit}"
        return (f"it goes from {went}, and only {span} was visited: outside the band is no promise",)
