"""The width of the bands that follows from past errors of forecasts.

A twin propagates the uncertainty of its parameters, states and sensor to every future sample. It does not
know the errors of its structure. So each past error is divided by the standard deviation of its forecast, and
the band is as many standard deviations wide as contained 90 % of these quotients: split conformal prediction,
one lead at a time, with slow forgetting (Vovk et al. 2005; weights: Barber et al. 2023). The first few
forecasts of a session are too few for a quantile, so quotients of a normal distribution are added as a prior.

How noisy a sensor is, how far from its equations a plant drifts and how much a twin overestimates both change
faster than a quantile can follow. So quotients are kept in units of their newest mean, and the width that
follows from them is multiplied by it: conformal prediction with a local scale (Lei et al. 2018). Forecasts
that overlap share most of their errors, so at long leads they move that mean less, and it begins with the one
at the next shorter lead, where more is known by then.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from typing import Final

import numpy as np

from twinmatch.forecasting.forecast import CONFIDENCE
from twinmatch.signals import FloatArray

LEADS: Final = (1.0, 3.0, 10.0, 30.0, 60.0, 120.0, 300.0)
"""Leads at which quotients are learned, s; between them the width is interpolated over log time."""
_HALF_NORMAL: Final = np.array([
    0.09655861528963908, 0.1940281424239262, 0.29338123212119344, 0.3957252958144873, 0.5024022233733555,
    0.6151411045959737, 0.7363159173761293, 0.8694237732888861, 1.0200762327862014, 1.1983797023069247,
    1.4260768722728474, 1.7688250385187065,
])  # fmt: skip
"""The prior quotients: quantiles of |z|, z standard normal, at levels 1/13, 2/13 … 12/13."""
_TRUSTED: Final = 3.0
"""Weight, in forecasts that do not overlap, of the next shorter lead in the local scale; at the first lead,
of the twin's own deviations."""
_MEAN: Final = float(np.sqrt(2.0 / np.pi))
"""Mean of |z|, z standard normal."""
_NEGLIGIBLE: Final = 1e-3
"""Weight below which a quotient is dropped."""


def leads_of(period: float, longest: int) -> tuple[int, ...]:
    """Leads at which a band is learned, samples, for a sample time (s) and the longest horizon (samples)."""
    leads = {min(max(round(lead / period), 1), longest) for lead in LEADS}
    return (*sorted(leads | {longest}),)


class Calibration:
    """Quotients |error| / standard deviation of one twin, by lead, and the widths that follow."""

    def __init__(
        self,
        leads: tuple[int, ...],
        kept: float,
        recent: float,
        signals: int = 2,
        stride: int = 1,
        *,
        outputs: int = 1,
    ) -> None:
        """Begin with the prior only.

        Args:
            leads: leads at which quotients are learned, samples, shape (L,).
            kept: factor on past weights per forecast.
            recent: the same in the local scale, which follows the newest forecasts.
            signals: number of forecast signals: outputs and inputs, or only the outputs if inputs are given.
            stride: samples between two forecasts.
            outputs: number of outputs among the signals, which come first.
        """
        self._is_output = np.arange(signals) < outputs
        self._outputs = range(min(outputs, signals))
        """Indices of the outputs among the signals."""
        self.leads = leads
        self._kept = kept
        self._recent = recent
        self._uncovered = np.minimum(stride / np.array(leads), 1.0)
        """Share of a forecast that the one before did not cover, shape (L,)."""
        # In units of the local scale, beginning with the prior; those from `_first` to `_end` count.
        self._quotients = np.zeros((len(leads), signals, 2 * _HALF_NORMAL.size))
        self._quotients[:, :, : _HALF_NORMAL.size] = _HALF_NORMAL
        self._first = [0] * len(leads)
        self._end = [_HALF_NORMAL.size] * len(leads)
        self._learned = [0] * len(leads)
        # By age, beginning with the weight of the newest quotient.
        self._weights: list[float] = np.cumprod(
            [1.0, *[kept] * _HALF_NORMAL.size]
        ).tolist()
        # of the newest quotients, weighted
        self._sums = np.zeros((signals, len(leads)))
        self._counts = np.zeros(len(leads))  # sums of their weights
        self._quantiles = np.zeros((signals, len(leads)))
        self._inside = np.zeros((signals, len(leads)))
        """Readings within the band, weighted, of the `_compared` ones."""
        self._compared = np.zeros(len(leads))
        """Readings compared with a band, weighted."""
        self._stale = set(range(len(leads)))
        """Leads whose quantile has to be computed again."""

    def copy(self) -> Calibration:
        """An independent copy."""
        copied = copy(self)
        for name, value in vars(self).items():
            # what else there is never changes; `deepcopy` would look at every number in the lists
            if isinstance(value, np.ndarray | list | set):
                setattr(copied, name, value.copy())
        return copied

    def learn(self, quotients: FloatArray, before: int, widths: FloatArray) -> None:
        """Learn from one forecast, at the leads after `before`.

        Args:
            quotients: those of the signals at N samples ahead, shape (signals, N); NaN where a sample was
                lost.
            before: lead up to which it has been learned from already, samples.
            widths: those that its bands had, shape (signals, L).
        """
        size = quotients.shape[1]
        reached = [k for k, lead in enumerate(self.leads) if before < lead <= size]
        at_reached = quotients[:, [self.leads[k] - 1 for k in reached]]
        is_read = [not math.isnan(quotient) for quotient in at_reached[0].tolist()]
        if all(is_read):
            self._learn_at(reached, at_reached, widths)
            return
        read = [
            k for k, has_reading in zip(reached, is_read, strict=True) if has_reading
        ]
        if read:
            self._learn_at(read, at_reached[:, is_read], widths)

    def _learn_at(
        self, leads: list[int], quotients: FloatArray, widths: FloatArray
    ) -> None:
        """Learn from the quotients at n leads, given by index; shape (signals, n)."""
        places = _places(leads)
        is_inside = quotients <= widths[:, places]
        self._inside[:, places] = self._kept * self._inside[:, places] + is_inside
        self._compared[places] = self._kept * self._compared[places] + 1.0
        self.add(leads, quotients)

    def coverage(
        self, before: int, last: int, signal: int | None = None
    ) -> tuple[float, float]:
        """Share of the readings that the bands have held, and how many forecasts that rests on.

        It is the share at leads after `before` up to `last`, of one `signal` or the least of all. The number
        is effective and of forecasts that do not overlap. Both are NaN without any.
        """
        compared = [
            k
            for k, lead in enumerate(self.leads)
            if before < lead <= last and self._compared[k] > 0.0
        ]
        if not compared:
            return np.nan, np.nan
        places = _places(compared)
        inside = np.add.reduce(self._inside[:, places] / self._compared[places], axis=1)
        shares = (inside / len(compared)).tolist()
        share = min(shares) if signal is None else shares[signal]
        longest = compared[-1]
        return share, float(self._compared[longest] * self._uncovered[longest])

    def add(self, leads: Sequence[int], quotients: FloatArray) -> None:
        """Learn the signals' quotients of one forecast at n leads, given by index; shape (signals, n)."""
        places = _places(leads)
        scaled = quotients / self._scales[:, places]
        for k, lead in enumerate(leads):
            size = self._end[lead] - self._first[lead]
            if self._end[lead] == self._quotients.shape[2]:
                self._make_room(lead)
            self._quotients[lead, :, self._end[lead]] = scaled[:, k]
            self._end[lead] += 1
            self._learned[lead] += 1
            if size == len(self._weights):
                self._weights.append(self._weights[-1] * self._kept)
            # Those of the prior are as old as the first that was learned.
            weight_of_oldest = self._weights[min(size, self._learned[lead])]
            if weight_of_oldest < _NEGLIGIBLE:
                self._first[lead] += 1
        self._sums[:, places] = (
            self._recent * self._sums[:, places] + self._uncovered[places] * quotients
        )
        self._counts[places] = (
            self._recent * self._counts[places] + self._uncovered[places]
        )
        self._stale.update(leads)

    def _make_room(self, lead: int) -> None:
        """Move the quotients that count to the front, or double the room if they fill more than half."""
        first = self._first[lead]
        end = self._end[lead]
        if 2 * (end - first) > end:
            self._quotients = np.concatenate(
                [self._quotients, np.zeros_like(self._quotients)], axis=2
            )
            return
        self._quotients[lead, :, : end - first] = self._quotients[lead, :, first:end]
        self._first[lead] = 0
        self._end[lead] = end - first

    @property
    def widths(self) -> FloatArray:
        """Half width of a band in standard deviations, at every lead, shape (signals, L)."""
        if self._stale:
            # Leads up to the same horizon have learned as much.
            leads_by_history: dict[tuple[int, int, int], list[int]] = {}
            for lead in sorted(self._stale):
                history = self._first[lead], self._end[lead], self._learned[lead]
                leads_by_history.setdefault(history, []).append(lead)
            weights_by_age = np.array(self._weights)
            for (first, end, learned), leads in leads_by_history.items():
                ages = np.arange(end - first - 1, -1, -1)
                # Those of the prior are as old as the first that was learned.
                weights = weights_by_age[np.minimum(ages, learned)]
                places = _places(leads)
                self._quantiles[:, places] = self._quantiles_of(
                    self._quotients[places, :, first:end], places, weights
                )
            self._stale.clear()
        return self._quantiles * self._scales

    @property
    def _scales(self) -> FloatArray:
        """How large errors are now, in units of the twin's standard deviations, shape (signals, L).

        A lead with few forecasts of an output takes it from the next shorter one; the first lead then takes
        the deviations as they are, a scale of 1. Inputs always take 1: what a controller commands errs at
        short leads as a reading does, at long ones as a level, so one lead says nothing of the next.
        """
        shares = _TRUSTED / (_TRUSTED + self._counts)
        of_errors = self._sums / (_MEAN * (_TRUSTED + self._counts))
        scales = shares + of_errors
        for signal in self._outputs:
            scale = 1.0
            scales_of_output = []
            for share, of_error in zip(
                shares.tolist(), of_errors[signal].tolist(), strict=True
            ):
                scale = share * scale + of_error
                scales_of_output.append(scale)
            scales[signal] = scales_of_output
        return scales

    def _quantiles_of(
        self, quotients: FloatArray, places: slice | list[int], weights: FloatArray
    ) -> FloatArray:
        """The quantiles, shape (signals, n), of quotients, shape (n, signals, N), at n leads, with weights,
        shape (N,)."""
        # The next forecast counts as one more, with an unknown quotient: at long leads as more than one,
        # since it shares less with those before than they do with each other.
        of_outputs = self._uncovered[places] ** -0.5
        weight_of_next = np.where(self._is_output, of_outputs[:, None], 1.0)
        weight_of_all = np.add.reduce(weights)
        order = quotients.argsort(axis=2, kind="stable")
        cumulated = weights[order].cumsum(axis=2)
        share = cumulated / (weight_of_all + weight_of_next)[:, :, None]
        # As shares rise, this is the first place at which the share reaches the confidence.
        rank = np.add.reduce(share < CONFIDENCE, axis=2)
        rank = np.minimum(rank, len(weights) - 1)
        each_lead = np.arange(len(quotients))[:, None]
        each_signal = np.arange(quotients.shape[1])
        chosen = order[each_lead, each_signal, rank]
        return np.asarray(quotients[each_lead, each_signal, chosen].T)


def _places(leads: Sequence[int]) -> slice | list[int]:
    """Ascending indices as a slice, by which arrays are read and written in a third of the time, if none is
    left out between them."""
    if leads and leads[-1] - leads[0] == len(leads) - 1:
        return slice(leads[0], leads[-1] + 1)
    return list(leads)
