"""What a linear model without physics (ARX) forecasts beside the equations."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from twinmatch.fitting.arx import Arx, ArxForecast
from twinmatch.signals import BoolArray, FloatArray, Sample


class LinearRival:
    """Forecasts by an ARX model of all samples so far, under the inputs that followed.

    Each has a place, from which it is read until another one begins there.
    """

    def __init__(self, places: int, longest: int, kept: float) -> None:
        """Begin without samples.

        Args:
            places: number of forecasts that may be on at the same time.
            longest: samples ahead up to which a forecast is read.
            kept: factor per sample on the weights of those before.
        """
        self._arx = Arx(None, kept)
        self._begun: list[ArxForecast | None] = [None] * places
        self._newest: deque[Sample] = deque(maxlen=longest + 1)

    def take(self, sample: Sample, values: FloatArray, counts: BoolArray) -> None:
        """Take one sample, the values of its outputs, and which of them count; it is lost if not all do."""
        if not counts.all():
            sample = replace(
                sample, outputs=tuple(values.tolist()), seen=False, refused=()
            )
        self._arx.push(sample)
        self._newest.append(sample)

    def begin(self, place: int) -> None:
        """Begin a forecast at this place, from the newest sample."""
        has_readings = bool(self._arx.visited)
        self._begun[place] = self._arx.departure(np.zeros(0)) if has_readings else None

    def forecast(self, place: int, ahead: int) -> FloatArray:
        """The outputs that the forecast at a place expected of the newest sample, which came `ahead` samples
        after it had begun, shape (o,); infinite if there was no reading before it."""
        samples = list(self._newest)[-ahead - 1 :]
        begun = self._begun[place]
        if begun is None:
            return np.full(len(samples[-1].outputs), np.inf)
        inputs = np.array([sample.inputs for sample in samples[1:]])
        disturbances = np.array([sample.disturbances for sample in samples])
        rows = disturbances if disturbances.size else None
        return begun.forecast(inputs, rows)[: len(begun.spans), -1]
