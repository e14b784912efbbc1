"""First-order models of an output, by least squares over blocks of rows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from twinmatch.importing.pairs import standard_errors
from twinmatch.signals import FloatArray

_LONGEST: Final = 11
"""Power of two of the longest block, rows."""
_MOVES: Final = 5.0
"""Standard deviation of the changes from block to block, in those of the noise, that shows the plant."""
_SURELY_RESTS: Final = 3.0
"""Standard errors from which the way back to a rest differs from none."""


class BlockModel(NamedTuple):
    """A first-order model of an output that several signals move."""

    gains: list[float]
    """Steady-state gain of each of them."""
    lag: float
    """Time constant, s."""
    rest: float
    """Steady-state output where they are all zero."""
    rests: bool
    """Whether the samples show that it tends to a steady state."""

    def with_lag(self, lag: float, middle: float) -> BlockModel:
        """The model with another lag and the same rates about the `middle` of its output."""
        share = lag / self.lag
        gains = [share * gain for gain in self.gains]
        rest = middle + share * (self.rest - middle)
        return self._replace(gains=gains, lag=lag, rest=rest)


def models_of_blocks(
    output: FloatArray,
    moving: Sequence[FloatArray],
    noise: float,
    period: float,
    *,
    fewest: int,
) -> Iterator[BlockModel]:
    """The models of the difference equation of an output and what may be moving it, of the shortest blocks first.

    Args:
        output: readings, shape (N,).
        moving: signals of the same shape.
        noise: standard deviation of a reading.
        period: that of the rows, s.
        fewest: number of blocks that a model needs.
    """
    for block in (2**k for k in range(_LONGEST + 1)):
        if output.size < fewest * block:
            return
        whole = output.size - output.size % block
        means = [
            signal[:whole].reshape(-1, block).mean(axis=1)
            for signal in (output, *moving)
        ]
        model = _of_means(means, noise / math.sqrt(block), block, period)
        if model is not None:
            yield model


def _of_means(
    means: Sequence[FloatArray], noise: float, block: int, period: float
) -> BlockModel | None:
    """The model of means over blocks, whose `noise` is given, of so many rows.

    None if the output does not move beyond its noise, or does not tend to where the others have it.
    """
    before = means[0][:-1]
    changes = means[0][1:] - before
    if np.std(changes) < _MOVES * noise:
        return None
    acting = [_between(signal, block) for signal in means[1:]]
    table = np.column_stack([np.ones(before.size), before, *acting])
    coefficients = np.linalg.lstsq(table, changes, rcond=None)[0]
    constant, by_output, *effects = coefficients.tolist()
    back = -by_output
    if not 0.0 < back < 1.0:
        return None
    error = float(standard_errors(table, changes - table @ coefficients)[1])
    return BlockModel(
        gains=[effect / back for effect in effects],
        lag=-block * period / math.log1p(-back),
        rest=constant / back,
        rests=back > _SURELY_RESTS * error,
    )


def _between(means: FloatArray, block: int) -> FloatArray:
    """What acted from the middle of each block of rows of a signal to that of the next, of its means over
    blocks; what one row says is held until the next.

    With the means of the first of two blocks alone, what an input did in the second would pass for a way back.
    """
    return means[:-1] if block == 1 else (means[:-1] + means[1:]) / 2.0
