"""The table of all changes that may begin in a plant: what each moves, and how probable it is.

In an hour one change begins: its causes and the moments at which it may are equally probable. The end of a
change that was named is expected sooner than that.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from twinmatch.dynamics.bank import ChangeRows
from twinmatch.health.faults import HOUR, Fault
from twinmatch.health.hypotheses import ChangeRow, Explanation
from twinmatch.health.mixture import HealthyMixture
from twinmatch.settings import Rule
from twinmatch.signals import BoolArray, FloatArray

BETWEEN_ONSETS: Final = 2.0
"""Time between two onsets, s of a plant as fast as the rig."""
_LOST: Final = -1.0
"""Change of the share of a drive that does nothing afterwards."""


class _Ends(Rule):
    """How changes end that were named."""

    lasts: float = 600.0
    """Time after which one ends, s. Of causes that have not begun, one begins in an hour."""
    spread: float = 0.2
    """Standard deviation of the share of the way back that is gone."""
    returns: float = 30.0
    """Time within which the size of a change returns to the one that lasts, s."""


_ENDS: Final = _Ends()


def _row_of_end(row: ChangeRow) -> ChangeRow:
    """The row of the end of a change."""
    return replace(
        row, shift=1.0, spread=_ENDS.spread, lasting=0.0, slowly=0.0, is_end=True
    )


class ChangeTable:
    """The rows of the changes that may begin now, and of the ends of those that were named."""

    def __init__(
        self,
        usual: Sequence[ChangeRow],
        named: Sequence[ChangeRow],
        healthy: HealthyMixture,
    ) -> None:
        """Make the table.

        Args:
            usual: rows of the plant.
            named: rows of the changes that were named, and whose ends are expected.
            healthy: names the numbers of a belief, and knows how fast the plant is.
        """
        self._usual = usual
        self._healthy = healthy
        self.rows = [*usual, *(_row_of_end(row) for row in named)]
        self.explanations = list(dict.fromkeys(row.explanation for row in self.rows))
        self.crosses: BoolArray = np.array(
            [explanation.crosses for explanation in self.explanations]
        )
        """Which of the explanations are nobody's fault, as `Explanation.crosses`."""
        self.of_bank = self._of_bank()
        """The rows as the bank of hypotheses takes them."""

    @property
    def expects_ends_by(self) -> float:
        """By how much the end of a change is expected more than a change that has not begun, nats."""
        return math.log(BETWEEN_ONSETS / _ENDS.lasts * self._onsets_in_hour)

    @property
    def _onsets_in_hour(self) -> float:
        """Number of ways in which a change may begin in an hour: causes and moments."""
        causes = int(np.count_nonzero(~self.crosses))
        return causes * HOUR / BETWEEN_ONSETS

    def _of_bank(self) -> ChangeRows:
        rows = self.rows
        second = self._healthy.second
        lasting = np.array(
            [round(row.lasting * second) for row in rows], dtype=np.int64
        )
        spread = np.array([row.spread for row in rows])
        comes_at_once = lasting <= 0
        of_onset = np.where(comes_at_once, 1.0, math.sqrt(0.5))
        arriving = 0.5 * spread**2 / np.maximum(lasting, 1)
        returns = math.exp(
            -self._healthy.period / (_ENDS.returns * self._healthy.scale)
        )
        wanders = np.array([row.wanders for row in rows])
        causes = [self.explanations.index(row.explanation) for row in rows]
        relative = [self._row_of_same_parameter(row) for row in rows]
        return ChangeRows(
            number=self._numbers(),
            also=self._other_numbers(),
            cause=np.array(causes, dtype=np.int64),
            rate=np.array([self._rate_of(row) for row in rows]),
            wanders=wanders**2 * (1.0 - returns**2),
            returns=returns,
            diffusion=np.where(comes_at_once, 0.0, arriving),
            lasting=lasting,
            shift=np.array([row.shift for row in rows]),
            spread=of_onset * spread,
            mass=self._masses(),
            whole=np.array([_takes_whole_drive(row) for row in rows]),
            crosses=np.array([row.crosses for row in rows]),
            follows=self._followed_drives(),
            relative=np.array(relative, dtype=np.int64),
        )

    def _numbers(self) -> NDArray[np.int64]:
        """Index of the number that each row changes, shape (R,)."""
        places = self._healthy.numbers
        return np.array([places[row.number] for row in self.rows], dtype=np.int64)

    def _other_numbers(self) -> NDArray[np.int64]:
        """Indices of the other numbers that change by the same, shape (R, a); −1: there is none."""
        most = max(len(row.also) for row in self.rows)
        also = np.full((len(self.rows), most), -1, dtype=np.int64)
        for places, row in zip(also, self.rows, strict=True):
            places[: len(row.also)] = [self._healthy.numbers[name] for name in row.also]
        return also

    def _followed_drives(self) -> FloatArray:
        """By how much the number of each row follows each drive, shape (R, m)."""
        follows = np.zeros((len(self.rows), self._healthy.drives))
        for followed, row in zip(follows, self.rows, strict=True):
            followed[: len(row.follows)] = row.follows
        return follows

    def _rate_of(self, row: ChangeRow) -> float:
        """By how much a ramp rises in a sample; 0 if it jumps."""
        if not row.slowly:
            return 0.0
        return self._healthy.period / (row.slowly * self._healthy.scale)

    def _row_of_same_parameter(self, row: ChangeRow) -> int:
        """Place of the first row of the parameter that changes by a share of what it was, in a row or at its
        end; −1 if there is none."""
        is_end_of_plant = row.is_end and row.is_of_plant
        for place, other in enumerate(self._usual):
            is_same = other.number == row.number and row.is_relative
            if other.is_relative and (is_same or is_end_of_plant):
                return place
        return -1

    def _masses(self) -> FloatArray:
        """Prior probability that each row begins now, shape (R,)."""
        weights = {
            explanation: self._weight_of(explanation)
            for explanation in self.explanations
        }
        onsets = self._onsets_in_hour
        masses = []
        for row in self.rows:
            if row.is_end:
                masses.append(BETWEEN_ONSETS / _ENDS.lasts)
            else:
                share = math.exp(-row.price) / weights[row.explanation]
                masses.append(share / onsets)
        return np.array(masses)

    def _weight_of(self, explanation: Explanation) -> float:
        """Sum of the weights of an explanation's rows, which share its probability."""
        return sum(
            math.exp(-row.price)
            for row in self._usual
            if row.explanation == explanation
        )


def _takes_whole_drive(row: ChangeRow) -> bool:
    """Whether a drive does nothing afterwards, whatever it did before."""
    return row.cause[0] is Fault.DRIVE_LOST and row.shift == _LOST
