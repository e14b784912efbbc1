"""The courses that an experiment may take: levels of set-points or inputs, and where they begin and end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, permutations, product
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.controllers.answer import ControllerError
from twinmatch.controllers.members import Holding
from twinmatch.controllers.responses import counted_range
from twinmatch.dynamics import Plant
from twinmatch.dynamics.pace import plant_scale
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

MIN_COURSE: Final = 30
"""Least samples of an experiment."""
_SHARES: Final = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Levels of the table, as shares of their range."""
_STEPS: Final = (2, 4, 8)
"""How often a course of the table steps between two levels."""
_PLAIN: Final = 0.1
"""Size of a plain step, as a share of the range."""


class _CourseLength(Rule):
    """Length of an experiment: six time constants, if these are not too many samples."""

    usual: int = 600
    """Length, s, on a plant with a time constant of 100 s."""
    most: int = 20_000
    """Samples, at most."""


_LENGTH: Final = _CourseLength()


@dataclass(frozen=True, eq=False)
class ExperimentTerms:
    """What a course may do, and where it begins."""

    holding: Holding
    """How the plant is held; set-points of its law are planned, without a law inputs."""
    before: FloatArray
    """Outputs, and with a law set-points, until now, shape (o,)."""
    size: int
    """Samples of a course, at most."""
    levels: FloatArray
    """Lowest and highest planned set-points or inputs, shape (2, c)."""
    outputs: FloatArray
    """Ends of the range that no band may leave, shape (2, o)."""
    offset: float = 2.0
    """Standard deviation of what stays between readings and a twin that is right, such as what a sensor does
    not resolve, in the outputs' noise."""

    @classmethod
    def of(
        cls,
        plant: type[Plant],
        holding: Holding,
        before: FloatArray,
        *,
        size: int | None = None,
        within: Sequence[float] | None = None,
        ranges: Sequence[tuple[float, float]] = (),
    ) -> ExperimentTerms:
        """What a plant allows: the outputs stay where it is safe, and `within` these ends; a course of `size`
        samples, by default in proportion to the plant's time constant; set-points in these `ranges`.

        Raises:
            ControllerError: the range is empty, or the course too short or too long.
        """
        period = holding.period
        size = size or round(_LENGTH.usual * plant_scale(plant, period) / period)
        if not MIN_COURSE <= size <= _LENGTH.most:
            raise ControllerError(
                f"experiment: {size} samples of {period:g} s; give {MIN_COURSE} to {_LENGTH.most} of them"
            )
        low, high = np.array(
            [counted_range(output) for output in plant.outputs.values()]
        ).T
        if within is not None:
            low = np.maximum(low, within[0])
            high = np.minimum(high, within[1])
        if not (low < high).all():
            raise ControllerError(
                "experiment: the range leaves nothing of the safe one; give LOW below HIGH, inside it"
            )
        if holding.law is None:
            levels = np.array([drive.limits for drive in plant.drives.values()]).T
        else:
            spans = np.array(
                [output.set_points or output.span for output in plant.outputs.values()]
            ).T
            levels = np.clip(spans, low, high)
            if ranges:
                levels = np.clip(levels, *np.transpose(ranges))
        return cls(holding, before, size, levels, np.array([low, high]))


class Staircase(NamedTuple):
    """A course of levels, each held until the next."""

    shares: tuple[float, ...]
    """Levels, as shares of their range."""
    ends: tuple[float, ...]
    """Where each ends, as a share of the course; the last one is 1."""
    column: int
    """The set-point or input that moves; -1: all, each later than the one before."""

    def rows(self, base: FloatArray, levels: FloatArray, size: int) -> FloatArray:
        """Its levels, sample by sample, shape (N, c); others stay as in `base`, shape (c,)."""
        rows = np.tile(base, (size, 1))
        m = base.size
        low, high = levels
        for j in range(m) if self.column < 0 else [self.column]:
            delay = round(size * self.ends[0] * j / m) if self.column < 0 else 0
            ends = np.minimum(
                np.round(np.multiply(self.ends, size)).astype(int) + delay, size
            )
            for share, first, end in zip(
                self.shares, (delay, *ends), ends, strict=False
            ):
                rows[first:end, j] = low[j] + share * (high[j] - low[j])
        return rows

    def moved(self, by: float) -> Iterator[Staircase]:
        """The courses with one level or time moved by so much, up or down; a level at an end of its range only
        moves inwards."""
        for k, movement in product(range(len(self.shares)), (by, -by)):
            shares = list(self.shares)
            shares[k] = min(max(shares[k] + movement, 0.0), 1.0)
            if shares[k] != self.shares[k]:
                yield self._replace(shares=tuple(shares))
            ends = list(self.ends)
            if k < len(ends) - 1:
                ends[k] += movement
                if all(first < end for first, end in pairwise([0.0, *ends])):
                    yield self._replace(ends=tuple(ends))


def staircases_within(terms: ExperimentTerms) -> list[Staircase]:
    """The table: every pair of levels, every number of steps, for every set-point or input and for all."""
    count = terms.levels.shape[1]
    columns = [*range(count), -1] if count > 1 else [0]
    table = [
        Staircase((share,), (1.0,), column)
        for share, column in product(_SHARES, columns)
    ]
    for (first, second), steps, column in product(
        permutations(_SHARES, 2), _STEPS, columns
    ):
        ends = tuple(((np.arange(steps) + 1) / steps).tolist())
        table.append(Staircase((first, second) * (steps // 2), ends, column))
    return table


def maximal_sequence() -> NDArray[np.bool_]:
    """The binary sequence of a shift register of five bits, whose 31 values repeat no earlier.

    `scipy.signal.max_len_seq` gives the same, but takes half a second to import.
    """
    values = [True] * 5
    while len(values) < 2**5 - 1:
        values.append(values[-5] != values[-2])
    return np.array(values)


def plain_courses(
    rows: FloatArray, base: FloatArray, levels: FloatArray
) -> dict[str, FloatArray]:
    """What one would do without a computer in the same time: a step by a tenth of the range, to the side with
    more room, a random binary sequence of as much to both sides, nothing."""
    low, high = levels
    size = _PLAIN * (high - low)
    step = np.where(high - base >= base - low, size, -size)
    sequence = maximal_sequence()
    repeats = max(len(rows) // sequence.size, 1)
    is_high = np.resize(np.repeat(sequence, repeats), len(rows))
    binary = np.where(is_high[:, None], base + step, base - step)
    return {
        "step": np.tile(base + step, (len(rows), 1)),
        "PRBS": np.clip(binary, low, high),
        "nothing": np.tile(base, (len(rows), 1)),
    }
