"""The samples of the last minutes in blocks, with the tracker's belief before each, at every level."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from twinmatch.dynamics import Parameters
from twinmatch.dynamics.filters import Readings, Traces
from twinmatch.dynamics.pace import slow_scale
from twinmatch.dynamics.tracker import Belief, Tracker
from twinmatch.health.roughness import Roughness
from twinmatch.settings import Rule
from twinmatch.signals import BoolArray, FloatArray, Sample

LEVELS: Final = (0.12, 0.25, 0.5, 1.0, 2.0, 4.0)
"""Levels of assumed model error, in units of that of a real rig."""


class _LevelChoice(Rule):
    """How the level of model error is chosen by which changes are judged."""

    blind: int = 4
    """Level from which on the equations explain so little that no change can be detected."""
    wait: int = 12
    """Blocks after which the cost of a block counts for the choice of the level."""
    forget: int = 180
    """Blocks over which the cost of a level is averaged."""
    clearly: float = 3.0
    """Nats that a smaller level must save to be preferred."""
    lost: float = 12.0
    """Nats by which a level may fall behind the next before it adopts the next one's belief, and the
    cost."""
    careful: int = 5
    """Blocks after which the assumed error is lowered by one level: while the plant is still unknown, a
    filter's belief is too confident."""


_CHOICE: Final = _LevelChoice()


_BLOCK: Final = 10.0
"""Length of a block, s."""
REACH: Final = 48
"""Blocks after which a change can no longer be detected."""


@dataclass(frozen=True)
class Block:
    """Some samples, and the belief before them at each level."""

    first: int
    """Index of its first sample."""
    stretch: Readings
    before: tuple[Belief, ...]
    """What was believed before it, at each level."""
    costs: tuple[float, ...]
    """Code length of its readings at each level, nats."""


class TrackedBlocks:
    """Tracks one plant at every level, and keeps the last blocks."""

    def __init__(self, parameters: Parameters, period: float) -> None:
        """Begin with these parameters; `period` is the sample time, s."""
        self.size = max(
            4, round(_BLOCK * slow_scale(parameters.model.plant, period) / period)
        )
        """Samples of a block."""
        self.tracker = Tracker(parameters, period, LEVELS)
        self.blocks: deque[Block] = deque(maxlen=REACH)
        """The newest blocks, oldest first."""
        self.count = 0
        """Blocks so far."""
        self.known = 0
        """Of those, how many since the plant was first seen."""
        self.spent = 0.0
        """Code length of all readings so far, at the levels used for judging, nats."""
        self.level = len(LEVELS) - 2
        """Index of the level used for judging."""
        self.blind = False
        """Whether the equations explain too little of the plant to detect a change."""
        self.moved_level = False
        """Whether the last block changed the level."""
        self._roughness = Roughness(parameters.model.plant.output.noise)
        self._costs = np.zeros(len(LEVELS))  # mean code length of a block at each level
        self._counted = 0  # blocks that these are means of
        # nats by which each level is behind the next
        self._behind = [0.0] * len(LEVELS)
        self._beliefs: tuple[Belief, ...] = ()
        self._gap = False  # whether samples are missing before the next block
        self._opening: tuple[int, float] | None = None
        self._samples: list[Sample] = []
        self._last = [math.nan, math.nan]  # the two readings before the block

    @property
    def trust(self) -> float:
        """The assumed model error at the level used for judging."""
        return LEVELS[self.level]

    @property
    def between_blocks(self) -> bool:
        """Whether the next sample begins a block."""
        return not self._samples

    @property
    def levels(self) -> range:
        """The level used for judging, and all that trust the equations less."""
        return range(self.level, len(LEVELS))

    @property
    def belief(self) -> Belief | None:
        """The current belief at the level used for judging."""
        return self._beliefs[self.level] if self._beliefs else None

    def restart(self, opening: tuple[int, float] | None) -> None:
        """Start over after a gap; `opening`: a number (index) whose variance is widened by a spread."""
        self._samples.clear()
        self._last = [math.nan, math.nan]
        self.blocks.clear()
        self._gap = bool(self._beliefs)
        self._opening = opening or self._opening

    def adopt(self, belief: Belief, before: Sequence[Belief] = ()) -> None:
        """Continue from another belief at every level.

        With beliefs `before`, one for each level, the plant is again what it was then.
        """
        returned = tuple(
            self.tracker.returned(belief, belief_before) for belief_before in before
        )
        self._beliefs = returned or (belief,) * len(LEVELS)
        self.blocks.clear()

    def full(self, sample: Sample) -> Readings | None:
        """Take a sample; return the block once it is full, with the noise estimated from the readings."""
        self._samples.append(sample)
        if len(self._samples) < self.size:
            return None
        y = np.array([*self._last, *(s.output for s in self._samples)])
        is_read = np.array([s.seen for s in self._samples])
        self._learn_roughness(y, is_read)
        self._last = [float(y[-2]), float(y[-1])]
        u = np.array([s.input for s in self._samples])
        model = self.tracker.parameters.model
        rows = np.array(
            [model.disturbance_row(s.disturbances or None) for s in self._samples]
        )
        noise = np.where(is_read, self._roughness.noise, math.inf)
        return Readings(y, u, rows.reshape(u.size, -1), noise)

    def _learn_roughness(self, y: FloatArray, is_read: BoolArray) -> None:
        """Average the sizes of the second differences of readings that count; two readings precede them."""
        read = y.copy()
        read[2:][~is_read] = math.nan
        for size in np.abs(read[2:] - 2 * read[1:-1] + read[:-2]).tolist():
            if not math.isnan(size):
                self._roughness.take(size)

    def take(self, stretch: Readings, traces: Traces, *, settled: bool) -> None:
        """Track a block; the level is kept if `settled`."""
        first = self._samples[0]
        row = stretch.disturbances[0]
        self._samples.clear()
        if not self._beliefs:
            levels = range(len(LEVELS))
            self._beliefs = tuple(
                self.tracker.begin(first.output, first.input, row, level)
                for level in levels
            )
        elif self._gap:
            beliefs = (
                self.tracker.again(b, first.output, first.input, row)
                for b in self._beliefs
            )
            number, spread = self._opening or (0, 0.0)
            self._beliefs = tuple(b.opened(number, 0.0, spread) for b in beliefs)
            self._opening = None
        self._gap = False
        after = []
        costs = []
        careful = len(LEVELS) - 1 - self.known // _CHOICE.careful
        for level, belief in enumerate(self._beliefs):
            watched = traces if level == self.level else None
            following, cost = self.tracker.run(
                belief, stretch, max(level, careful), traces=watched
            )
            after.append(following)
            costs.append(cost)
        self._recover(after, costs)
        self.spent += costs[self.level]
        self.blocks.append(Block(first.index, stretch, self._beliefs, tuple(costs)))
        self._beliefs = tuple(after)
        self.count += 1
        self.known += 1
        self.moved_level = not settled and self._choose()

    def unchanged(self) -> tuple[float, FloatArray]:
        """Cost of all kept blocks without a change, where the level may rise once; and the cumulative costs
        before each block, and of all, at the level used for judging."""
        costs = np.array([b.costs for b in self.blocks])
        before = np.concatenate([[0.0], np.cumsum(costs[:, self.level])])
        after = np.cumsum(costs[::-1, self.level :], axis=0)[::-1].min(axis=1)
        return float((before[:-1] + after).min()), before

    def _recover(self, after: list[Belief], costs: list[float]) -> None:
        """Let a level that lost the plant by trusting the equations too much adopt the next one's belief."""
        for level in reversed(range(len(LEVELS) - 1)):
            behind = self._behind[level] + costs[level] - costs[level + 1]
            self._behind[level] = max(behind, 0.0)
            if behind > _CHOICE.lost:
                after[level] = after[level + 1]
                costs[level] += _CHOICE.lost
                self._behind[level] = 0.0

    def _choose(self) -> bool:
        """Choose the level that the samples support plus one for safety; return whether it changed."""
        if len(self.blocks) <= _CHOICE.wait:
            return False
        self._counted = min(self._counted + 1, _CHOICE.forget)
        self._costs += (
            np.array(self.blocks[-_CHOICE.wait - 1].costs) - self._costs
        ) / self._counted
        total = self._costs * self._counted
        best = int(np.flatnonzero(total <= total.min() + _CHOICE.clearly)[-1])
        before = self.level
        level = min(best + 1, len(LEVELS) - 1)
        if self._counted >= _CHOICE.wait:
            self.level = level
            self.blind = best >= _CHOICE.blind
        return self.level != before


def joined(blocks: Sequence[Block]) -> Readings:
    """Concatenate blocks."""
    y = np.concatenate(
        [blocks[0].stretch.output[:2], *(b.stretch.output[2:] for b in blocks)]
    )
    return Readings(
        y,
        np.concatenate([b.stretch.input for b in blocks]),
        np.concatenate([b.stretch.disturbances for b in blocks]),
        np.concatenate([b.stretch.noise for b in blocks]),
    )
