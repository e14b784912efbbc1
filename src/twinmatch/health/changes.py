"""Whether something about the plant has changed, what, and since when.

The plant is followed by its equations (`Tracker`), at several degrees of trust in them; the samples say which
degree they bear. What a jump of the losses, of the room, of the drive's share, of the reading or of nothing
that has a name would have left in the surprises since is known at any time (Willsky and Jones 1976), and
cheap. Where such a jump explains more than it costs, every hypothesis is followed for itself from what was
believed before; what it saves of the code length of the readings is what speaks for it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from twinmatch.dynamics import Parameters
from twinmatch.dynamics.tracker import Belief, Stretch, Traces
from twinmatch.health.blocks import REACH, Block, Past, joined
from twinmatch.health.hypotheses import Change, Hypothesis, Kind, hypotheses
from twinmatch.signals import Sample

__all__ = ["Changes"]

_EVERY: Final = 2
"""Blocks from one moment at which a change may have begun to the next."""
_LEAST_AGE: Final = 3
"""Blocks before which nothing is told of a change."""
_LEARN: Final = 30
"""Blocks that have to be seen before a change is told."""
_WORTH: Final = 4.0
"""Nats that a jump has to save before hypotheses are followed for themselves, and that a moment has to be
better than another to be the one at which it began."""
_AT_ONCE: Final = 20.0
"""Time within which a sudden change may have come about after the moment it is said to have begun, s."""
_UNSETTLING: Final = frozenset({Kind.LOSSES, Kind.ROOM, Kind.OTHER})
"""Changes after which the equations may be off by more than before, as they may where nothing changed: the
air in an open box is no longer one lump. A reading that is off leaves them as they were, as a weak drive."""
_PATIENCE: Final = 12
"""Comparisons that came to nothing after which they are made less often …"""
_RAREST: Final = 6
"""… down to once in so many blocks."""


class Changes:
    """Follows one plant and asks of it what has changed."""

    def __init__(self, parameters: Parameters, period: float) -> None:
        """Begin with these parameters in the structure that is followed; `period` is the sample time, s."""
        self._period = period
        self._past = Past(parameters, period)
        self.tracker = self._past.tracker
        noise = parameters.model.plant.output.noise
        self.hypotheses = hypotheses(self.tracker, noise, period)
        self._jumps = list({h.index: h for h in self.hypotheses}.values())
        self._offset = next(h for h in self.hypotheses if h.kind is Kind.SENSOR)
        self._best: tuple[Change, Belief] | None = None
        self._fresh()

    @property
    def level(self) -> float:
        """How far the equations are taken to be off, in what a real rig shows."""
        return self._past.trust

    @property
    def suspected(self) -> bool:
        """Whether something has changed, as far as is known now."""
        return self._best is not None

    @property
    def push_rate(self) -> float:
        """By how much something without a name moves the output, in its unit per second."""
        belief = self._past.belief
        if belief is None:
            return 0.0
        return float(belief.values[self.tracker.fading] + belief.values[self.tracker.push])

    def restart(self, *, offset: bool = False) -> None:
        """Begin anew behind a gap or a fault, keeping what was learned of the plant.

        With `offset`, what the reading is off by is open again.
        """
        opening = (self._offset.index, self._offset.spread) if offset else None
        self._past.restart(opening)
        self._fresh()

    def push(self, sample: Sample) -> Change | None:
        """Take a sample; when a block is full, say what has changed, if anything."""
        stretch = self._past.full(sample)
        if stretch is None:
            return None
        if self._past.count % _EVERY == 0:
            self._start()
        self._past.take(stretch, self._traces, settled=self.suspected)
        if self._past.moved_level:
            self._clear()
        if self._past.known < _LEARN or self._past.blind:
            self._best = None
            return None
        return self._asked()

    def adopt(self) -> None:
        """Believe in the change that was said last."""
        assert self._best is not None  # noqa: S101 — only who was told of one adopts it
        self._past.adopt(self._best[1])
        self._fresh()

    def _fresh(self) -> None:
        self._best = None
        self._idle = self._asking = 0
        self._clear()

    def _clear(self) -> None:
        """Look for jumps from here on."""
        n, kinds, starts = self.tracker.size, len(self._jumps), REACH // _EVERY
        self._traces = Traces(
            np.zeros((n, kinds, starts)), np.zeros((kinds, starts)), np.zeros((kinds, starts))
        )
        self._started = np.full(starts, -1)  # block count of each start

    def _start(self) -> None:
        """From now on ask what a jump now would have done."""
        start = self._past.count // _EVERY % self._started.size
        self._started[start] = self._past.count
        for array in self._traces:
            array[..., start] = 0.0
        for k, jump in enumerate(self._jumps):
            self._traces.effects[jump.index, k, start] = 1.0

    def _asked(self) -> Change | None:
        """What has changed, if a jump of anything is worth more than it costs."""
        count, longest = self._past.count, len(self._past.blocks)
        spreads = np.array([[max(h.spread, abs(h.shift))] for h in self._jumps]) ** 2
        hits, weights = self._traces.hits, self._traces.weights
        worth = 0.5 * hits**2 / (weights + 1.0 / spreads) - 0.5 * np.log1p(weights * spreads)
        age = count - self._started
        fits = (self._started >= 0) & (age >= _LEAST_AGE) & (age <= longest)
        worth = np.where(fits, worth, 0.0)
        if worth.max() < _WORTH and self._best is None:
            self._asking = 0
            return None
        self._idle += 1
        if self._idle < min(1 + self._asking // _PATIENCE, _RAREST):
            return None
        self._idle, self._asking = 0, self._asking + 1
        best = int(age[np.argmax(worth.max(axis=0))])
        ages = {best - _EVERY, best, best + _EVERY}
        if self._best is not None:
            ages.add(round((self._past.blocks[-1].first - self._best[0].first) / self._past.size) + 1)
        kept = sorted(a for a in ages if _LEAST_AGE <= a <= longest)
        return self._compared(kept) if kept else None

    def _compared(self, ages: Sequence[int]) -> Change | None:
        """Every hypothesis of a change so many blocks ago against none."""
        nothing, before = self._past.unchanged()
        found: dict[Kind, tuple[float, Hypothesis, int, int, Belief]] = {}
        for age, h, level in itertools.product(ages, self.hypotheses, self._past.levels):
            if level > self._past.level and h.kind not in _UNSETTLING:
                continue
            cost, belief = self._followed(h, age, level)
            gain = nothing - float(before[-age - 1]) - cost
            if h.kind not in found or gain > found[h.kind][0]:
                found[h.kind] = (gain, h, age, level, belief)
        order = sorted(found.values(), key=lambda f: -f[0])
        gain, h, age, level, belief = order[0]
        if gain < _WORTH:
            self._best = None
            return None
        # A change has a beginning; what would explain as much from long before on was wrong all along.
        oldest = len(self._past.blocks)
        dated = oldest
        if oldest - age >= 2 * _EVERY:
            cost, early = self._followed(h, oldest, level)
            longer = nothing - float(before[-oldest - 1]) - cost
            if longer > gain - _WORTH:
                belief, dated = early, 0
        held = self._past.blocks[-age]
        change = Change(
            hypothesis=h,
            gain=gain,
            lead=gain - order[1][0],
            first=held.first,
            before=float(held.before[self._past.level].values[h.index]),
            value=float(belief.values[h.index]),
            begun=dated > 0,
            rivals=tuple(f[1].kind for f in order[1:]),
            gains=tuple(f[0] for f in order[1:]),
        )
        self._best = (change, belief)
        return change

    def _followed(self, h: Hypothesis, age: int, level: int) -> tuple[float, Belief]:
        """What the last blocks' readings cost under a hypothesis at a level, and what is believed then."""
        blocks: list[Block] = list(self._past.blocks)[-age:]
        stretch: Stretch = joined(blocks)
        before = blocks[0].before[level]
        if h.slowly:
            belief = before.opened(self.tracker.rate, 0.0, h.spread / h.slowly)
            belief, cost = self.tracker.run(belief, stretch, level, rising=h.index)
            return cost + h.price, belief.closed(self.tracker.rate)
        opened = np.zeros(self.tracker.size)
        half = math.sqrt(0.5) * h.spread
        opened[h.index] = half / math.sqrt(_AT_ONCE)
        belief, cost = self.tracker.run(
            before.opened(h.index, h.shift, half),
            stretch,
            level,
            opened=opened,
            lasting=round(_AT_ONCE / self._period),
        )
        return cost, belief
