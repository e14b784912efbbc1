"""A forecast: mean and band of outputs and inputs, sample by sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Final

import numpy as np

from twinmatch.errors import TwinmatchError
from twinmatch.requirements import FINITE, LARGEST, RISING, RowsOf, SentAs, Within
from twinmatch.signals import FloatArray, column_of, one_of_each, only


class ForecastError(TwinmatchError):
    """A forecast that cannot be made: no candidate yet, or an invalid set-point profile."""


CONFIDENCE: Final = 0.9
"""Share of future samples that a band is to hold."""
HORIZONS: Final = (10.0, 60.0, 300.0)
"""Horizons at which forecasts of the rig are made and scored, s."""


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """Forecast of one signal, in its unit, shape (N,) each."""

    mean: FloatArray
    low: FloatArray
    high: FloatArray


_BY_TIME: Final = RowsOf("time", "its times")


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """Forecast by one candidate of the N samples after `sample`, as the sensor will read them."""

    sample: int
    """Index of the newest sample it was made from."""
    candidate: str
    """Name of the candidate."""
    structure: str
    """Name of its structure."""
    confidence: Annotated[float, Within(0.0, 1.0, may_be_absent=False)]
    """Share of the samples that the band is to hold."""
    time: Annotated[FloatArray, RISING]
    """Seconds after `sample`, shape (N,); the first is one period."""
    references: Annotated[
        FloatArray, SentAs("reference"), _BY_TIME, Within(-LARGEST, LARGEST)
    ]
    """Set-points for which it is made, shape (N, r), or (N,) for one; NaN if the loop is not known: it is
    made for `inputs`."""
    outputs: Annotated[tuple[Band, ...], SentAs("output"), _BY_TIME, FINITE]
    inputs: Annotated[tuple[Band, ...], SentAs("input"), _BY_TIME, FINITE]
    notes: tuple[str, ...] = ()
    """Sentences on what the band does not cover: a fault, a level never visited."""

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "references", np.reshape(self.references, (self.time.size, -1))
        )

    @property
    def closed(self) -> bool:
        """Whether it is made for set-points; otherwise for inputs."""
        return bool(np.isfinite(self.references).any())

    def alone(self, k: int) -> Forecast:
        """Its k-th output and input, with the set-point of that output; of fewer the last."""
        outputs, inputs = (
            bands[min(k, len(bands) - 1)] for bands in (self.outputs, self.inputs)
        )
        return replace(
            self,
            references=column_of(self.references, k),
            outputs=(outputs,),
            inputs=(inputs,),
        )

    def at(self, samples: Sequence[int]) -> Forecast:
        """Only what it says of so many samples ahead, counted from 1."""
        rows = np.array(samples) - 1

        def thinned(bands: tuple[Band, ...]) -> tuple[Band, ...]:
            return tuple(
                Band(band.mean[rows], band.low[rows], band.high[rows]) for band in bands
            )

        return replace(
            self,
            time=self.time[rows],
            references=self.references[rows],
            outputs=thinned(self.outputs),
            inputs=thinned(self.inputs),
        )

    @property
    def reference(self) -> FloatArray:
        """Set-points of a single loop, shape (N,)."""
        return only("reference", self.references)

    @property
    def output(self) -> Band:
        """The output of a single loop."""
        return one_of_each("output", self.outputs)

    @property
    def input(self) -> Band:
        """The input of a single loop."""
        return one_of_each("input", self.inputs)
