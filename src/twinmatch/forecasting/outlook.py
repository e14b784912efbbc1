"""The state of one twin at one sample, from which it can forecast."""

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
"""Least standard deviation of a future input, in units of its noise: the controller may leave a limit."""
_MARGIN: Final = 3.0
"""Margin around the visited levels that still counts as visited, in the output's noise."""


@dataclass(frozen=True, eq=False)
class Outlook:
    """A twin at one sample, ready to forecast; immutable."""

    sample: Sample
    """The newest sample it knows."""
    candidate: str
    parameters: Parameters
    states: FloatArray
    """States at that sample, corrected by its reading, shape (n,)."""
    covariance: FloatArray
    """Covariance of the states and of the parameters `unsure`, shape (n + m, n + m)."""
    unsure: tuple[str, ...]
    controller: PidState
    """State of the controller after that sample."""
    gains: PidGains | None
    """Gains of the controller; None if the loop is not known: forecasts then take future inputs."""
    period: float
    """Sample time, s."""
    leads: tuple[int, ...]
    """Leads at which the widths are known, samples, shape (L,)."""
    widths: FloatArray
    """Half widths of the band there, in standard deviations, for output and, in closed loop, input; shape
    (signals, L)."""
    visited: tuple[float, float]
    """Lowest and highest output so far."""
    notes: tuple[str, ...] = ()
    """Reservations that apply to every forecast made now."""

    @property
    def closed(self) -> bool:
        """Whether forecasts take future set-points; otherwise future inputs."""
        return self.gains is not None

    @property
    def standing(self) -> float:
        """The newest set-point, or the newest input if the loop is not known."""
        return self.sample.reference if self.closed else self.sample.input

    @property
    def signal(self) -> Output | Drive:
        """The plant's output, or its drive if the loop is not known, which declares their range."""
        plant = self.parameters.model.plant
        return plant.output if self.closed else plant.drive

    def foretold(self, ahead: ArrayLike, disturbances: ArrayLike | None = None) -> Foretold:
        """Mean and variance of the next N samples under these set-points or inputs, shape (N,).

        Disturbances stay constant unless they are given, from the newest sample on, shape (N + 1, d).
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
        """Output and input of `foretold`, bit for bit, at a third of its cost; shape (2, N).

        `disturbances` are those from the newest sample on, shape (N + 1, d), if there are any.
        """
        initial = advance(
            self.parameters,
            self.states,
            self.sample.input,
            self.period,
            None if disturbances is None else disturbances[0],
        )
        rows = None if disturbances is None else disturbances[1:]
        if self.gains is None:
            found = simulate_driven(
                self.parameters, ahead, states=initial, period=self.period, disturbances=rows
            )
        else:
            found = simulate_closed_loop(
                self.parameters,
                ahead,
                states=initial,
                controller=self.controller,
                gains=self.gains,
                disturbances=rows,
            )
        return np.stack([found.output, found.input])

    def deviations(self, foretold: Foretold) -> FloatArray:
        """Standard deviations of output and input expected by the twin, shape (2, N)."""
        least = (_LEAST * self.parameters.model.plant.drive.noise) ** 2
        return np.sqrt(np.stack([foretold.output_variance, foretold.input_variance + least]))

    def forecast(self, ahead: ArrayLike, disturbances: ArrayLike | None = None) -> Forecast:
        """Forecast under these set-points, or inputs if the loop is not known, shape (N,), from the next
        sample on; disturbances as in `foretold`.

        Raises:
            ForecastError: there is no value, or one that is not finite.
        """
        values = np.array(ahead, dtype=np.float64)
        if values.ndim != 1 or not values.size or not np.isfinite(values).all():
            what = "set-points" if self.closed else "inputs"
            msg = f"forecast: the {what} ahead are not a list of finite numbers; give one for each sample"
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
            notes=self.notes + self._assumptions(values, disturbances) + self._unvisited(foretold.output),
        )

    def _assumptions(self, ahead: FloatArray, disturbances: ArrayLike | None) -> tuple[str, ...]:
        """Notes on assumptions: given inputs, and constant disturbances."""
        plant, notes = self.parameters.model.plant, []
        if not self.closed:
            stays = bool((ahead == self.sample.input).all())
            level = f"{self.sample.input:g} {plant.drive.unit}".rstrip()
            what = f"a constant input of {level}" if stays else "the given inputs"
            notes.append(f"the loop is not known: the forecast is for {what}")
        if self.sample.disturbances and disturbances is None:
            names = " and ".join(d.text or d.name for d in plant.disturbances.values())
            notes.append(f"the forecast assumes that the measured disturbances ({names}) stay constant")
        return tuple(notes)

    def _input_band(self, mean: FloatArray, half: FloatArray) -> Band:
        """Band of the controller's commands; given inputs have no uncertainty."""
        if self.gains is None:
            return Band(mean, mean, mean)
        limits = self.parameters.model.plant.drive.limits
        low, high = max(self.gains.low, limits[0]), min(self.gains.high, limits[1])
        return Band(mean, np.clip(mean - half[0], low, high), np.clip(mean + half[0], low, high))

    def _widths(self, samples: int) -> FloatArray:
        ahead, knots = np.log(np.arange(1, samples + 1)), np.log(np.array(self.leads, dtype=np.float64))
        return np.stack([np.interp(ahead, knots, row) for row in self.widths])

    def _unvisited(self, output: FloatArray) -> tuple[str, ...]:
        """A note if the forecast leaves the visited range."""
        plant = self.parameters.model.plant
        room, unit = _MARGIN * plant.output.noise, plant.output.unit
        low, high = self.visited[0] - room, self.visited[1] + room
        reach = float(output.min()), float(output.max())
        if low <= reach[0] and reach[1] <= high:
            return ()
        span = f"{self.visited[0]:.4g} to {self.visited[1]:.4g} {unit}"
        went = f"{reach[0]:.4g} to {reach[1]:.4g} {unit}"
        return (
            f"the forecast covers {went}, but only {span} was visited: beyond that the band may not hold",
        )
