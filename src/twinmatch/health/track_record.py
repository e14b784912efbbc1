"""How a tracker's forecasts came out, beside the errors that it expects of them and beside no twin at all.

A tracker of a plant that has more than its equations (a dead time, a second mass, a wall that warms) is too
sure of itself: its forecasts of minutes are off by several of its own standard deviations, and a change that
nobody made explains them well. So evidence counts for what forecasts have been worth: divided by how many
times their squared errors were what the tracker expects (the overdispersion of quasi-likelihood, McCullagh
and Nelder 1989). And as long as they are not far better than to say that nothing changes, nobody is accused.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics.tracker import Tracker
from twinmatch.health.earned import Record
from twinmatch.health.tracking import Block, joined
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

HORIZONS: Final = (3, 6, 12)
"""How far ahead the output is forecast, blocks: as long as a change shows before it is reported."""


class _Scoring(Rule):
    """How forecasts of blocks are scored."""

    every: int = 3
    """Spacing of the forecasts, blocks."""
    counted_after: int = 5
    """Forecasts after which one counts: by then a change that it shows has been reported."""
    prior: float = 4.0
    """Number of forecasts as good as expected that are assumed in the beginning."""
    most: float = 25.0
    """Most that one squared error counts, in its expected size: one outlier alone says little."""


_SCORING: Final = _Scoring()


_KEPT: Final = 1.0 - 1.0 / 120.0
"""What a forecast leaves of the sums before: the memory is an hour of a plant as fast as the rig."""


class _Outcome(NamedTuple):
    """One forecast at every horizon."""

    relative: FloatArray
    """Squared error, in its expected size."""
    error: FloatArray
    """In the output's unit."""
    moved: FloatArray
    """How far the output moved, in its unit."""


class TrackRecord:
    """Compares a tracker's forecasts with the measurements; push it after every block."""

    def __init__(self, tracker: Tracker) -> None:
        """Begin without forecasts."""
        self._tracker = tracker
        self._noise = tracker.parameters.model.plant.output.noise
        self._waiting: deque[_Outcome] = deque()
        self._relative = np.full(len(HORIZONS), _SCORING.prior)
        self._weight = _SCORING.prior
        self._squares = np.full(len(HORIZONS), 3.0 * _SCORING.prior)
        self._records = [Record()] * len(HORIZONS)

    @property
    def dispersion(self) -> float:
        """Factor by which squared errors of forecasts exceed what the tracker expects, at least 1."""
        return max(1.0, float(self._relative.max()) / self._weight)

    @property
    def missed(self) -> float:
        """The same, each error weighted by its size: what a wrong twin misses comes with large movements.

        Of Gaussian errors as expected, the fourth moment is three times the second.
        """
        return max(1.0, float(np.max(self._squares / self._relative)) / 3.0)

    @property
    def earned(self) -> bool:
        """Whether the forecasts have been far better than to say that nothing changes."""
        return all(record.earned(self._noise) for record in self._records)

    def forget_newest(self) -> None:
        """A fault began: what was forecast lately does not count."""
        self._waiting.clear()

    def push(
        self, blocks: Sequence[Block], count: int, level: int, *, newcomer: bool
    ) -> None:
        """Forecast the newest blocks from the belief before them, at a level; a newcomer's forecasts count at
        once. `count`: blocks so far."""
        if len(blocks) <= HORIZONS[-1] or count % _SCORING.every:
            return
        outcome = self._outcome(list(blocks)[-HORIZONS[-1] - 1 :], level)
        if outcome is not None:
            self._waiting.append(outcome)
        while self._waiting and (
            newcomer or len(self._waiting) > _SCORING.counted_after
        ):
            self._count(self._waiting.popleft())

    def _count(self, outcome: _Outcome) -> None:
        self._relative = _KEPT * self._relative + outcome.relative
        self._squares = _KEPT * self._squares + outcome.relative**2
        self._weight = _KEPT * self._weight + 1.0
        squares = zip(
            self._records, outcome.error.tolist(), outcome.moved.tolist(), strict=True
        )
        self._records = [
            record.after(error, moved, _KEPT) for record, error, moved in squares
        ]

    def _outcome(self, blocks: Sequence[Block], level: int) -> _Outcome | None:
        """The forecasts from before the first block; None if a reading to compare them with was lost."""
        came = [blocks[horizon].stretch for horizon in HORIZONS]
        last = blocks[0].stretch.output[1]
        if np.isnan(last) or any(np.isinf(after.noise[0]) for after in came):
            return None
        belief = blocks[0].before[level]
        begun = 0
        outcomes = []
        for horizon, after in zip(HORIZONS, came, strict=True):
            belief, _ = self._tracker.run(
                belief, joined(blocks[begun:horizon]).unseen, level
            )
            expected, variance = self._tracker.expected(
                belief, after.disturbances[0], after.input[:1]
            )
            error = after.output[2] - expected
            begun = horizon
            relative = min(error**2 / (variance + after.noise[0] ** 2), _SCORING.most)
            outcomes.append((relative, error, after.output[2] - last))
        return _Outcome(*np.array(outcomes).T)
