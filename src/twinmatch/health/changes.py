"""Change detection: whether something about the plant has changed, what, and since when.

The plant is tracked by its equations (`Tracker`) at several levels of assumed model error; the samples decide
which level is used. The trace that a jump of the losses, of the room, of the drive's share, of the reading or
of an unnamed push would have left in the innovations since is computed recursively (Willsky and Jones 1976),
which is cheap. Where such a jump explains more than it costs, the tracker is run for every hypothesis from
the belief before the change; the code length of the readings that it saves is the evidence for it.
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
"""Spacing of the moments at which a change may have begun, blocks."""
_LEAST_AGE: Final = 3
"""Least age of a change that is reported, blocks."""
_LEARN: Final = 30
"""Blocks that must be seen before a change is reported."""
_WORTH: Final = 4.0
"""Nats that a jump must save before the tracker is run for each hypothesis, and by which one onset must beat
another to count as the beginning of the change."""
_ONSET: Final = 20.0
"""Time after its assumed onset within which a sudden change may have happened, s."""
_LESS_ACCURATE: Final = frozenset({Kind.LOSSES, Kind.ROOM, Kind.OTHER})
"""Changes after which the equations may be less accurate than before, as they may without a change: the air
in an open box is no longer one lump. A sensor offset or a weak drive leaves their accuracy as it was."""
_PATIENCE: Final = 12
"""Comparisons without result after which they are made less often …"""
_RAREST: Final = 6
"""… down to once in so many blocks."""


class Changes:
    """Tracks one plant and detects what has changed."""

    def __init__(self, parameters: Parameters, period: float) -> None:
        """Begin with these parameters in the tracked structure; `period` is the sample time, s."""
        self._period = period
        self._past = Past(parameters, period)
        self.tracker = self._past.tracker
        noise = parameters.model.plant.output.noise
        self.hypotheses = hypotheses(self.tracker, noise, period)
        self._jumps = list({h.index: h for h in self.hypotheses}.values())
        self._offset = next(h for h in self.hypotheses if h.kind is Kind.SENSOR)
        self._best: tuple[Change, Belief] | None = None
        self._reset()

    @property
    def level(self) -> float:
        """Assumed model error, in units of that of a real rig."""
        return self._past.trust

    @property
    def suspected(self) -> bool:
        """Whether a change is suspected now."""
        return self._best is not None

    @property
    def push_rate(self) -> float:
        """Rate at which something unnamed moves the output, in its unit per second."""
        belief = self._past.belief
        if belief is None:
            return 0.0
        return float(belief.values[self.tracker.fading] + belief.values[self.tracker.push])

    def restart(self, *, offset: bool = False) -> None:
        """Start over after a gap or a fault, keeping what was learned about the plant.

        With `offset`, the offset of the reading is unknown again.
        """
        opening = (self._offset.index, self._offset.spread) if offset else None
        self._past.restart(opening)
        self._reset()

    def push(self, sample: Sample) -> Change | None:
        """Take a sample; when a block is full, return the change, if any."""
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
        return self._search()

    def adopt(self) -> None:
        """Accept the change returned last as the new state of the plant."""
        assert self._best is not None  # noqa: S101 — only a returned change is adopted
        self._past.adopt(self._best[1])
        self._reset()

    def _reset(self) -> None:
        self._best = None
        self._idle = self._asking = 0
        self._clear()

    def _clear(self) -> None:
        """Look for jumps from now on only."""
        n, kinds, starts = self.tracker.size, len(self._jumps), REACH // _EVERY
        self._traces = Traces(
            np.zeros((n, kinds, starts)), np.zeros((kinds, starts)), np.zeros((kinds, starts))
        )
        self._started = np.full(starts, -1)  # block count of each start

    def _start(self) -> None:
        """Start the traces of a jump that happens now."""
        start = self._past.count // _EVERY % self._started.size
        self._started[start] = self._past.count
        for array in self._traces:
            array[..., start] = 0.0
        for k, jump in enumerate(self._jumps):
            self._traces.effects[jump.index, k, start] = 1.0

    def _search(self) -> Change | None:
        """The change, if a jump of any number saves more than it costs."""
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
        return self._compare(kept) if kept else None

    def _compare(self, ages: Sequence[int]) -> Change | None:
        """Compare every hypothesis of a change, `ages` blocks ago, with no change."""
        nothing, before = self._past.unchanged()
        found: dict[Kind, tuple[float, Hypothesis, int, int, Belief]] = {}
        for age, h, level in itertools.product(ages, self.hypotheses, self._past.levels):
            if level > self._past.level and h.kind not in _LESS_ACCURATE:
                continue
            cost, belief = self._run(h, age, level)
            gain = nothing - float(before[-age - 1]) - cost
            if h.kind not in found or gain > found[h.kind][0]:
                found[h.kind] = (gain, h, age, level, belief)
        order = sorted(found.values(), key=lambda f: -f[0])
        gain, h, age, level, belief = order[0]
        if gain < _WORTH:
            self._best = None
            return None
        # A change has an onset; one that explains as much from long before was there from the start.
        oldest = len(self._past.blocks)
        dated = oldest
        if oldest - age >= 2 * _EVERY:
            cost, early = self._run(h, oldest, level)
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

    def _run(self, h: Hypothesis, age: int, level: int) -> tuple[float, Belief]:
        """Code length of the last blocks' readings under a hypothesis at a level, and the belief after it."""
        blocks: list[Block] = list(self._past.blocks)[-age:]
        stretch: Stretch = joined(blocks)
        before = blocks[0].before[level]
        if h.slowly:
            belief = before.opened(self.tracker.rate, 0.0, h.spread / h.slowly)
            belief, cost = self.tracker.run(belief, stretch, level, rising=h.index)
            return cost + h.price, belief.closed(self.tracker.rate)
        opened = np.zeros(self.tracker.size)
        half = math.sqrt(0.5) * h.spread
        opened[h.index] = half / math.sqrt(_ONSET)
        belief, cost = self.tracker.run(
            before.opened(h.index, h.shift, half),
            stretch,
            level,
            opened=opened,
            lasting=round(_ONSET / self._period),
        )
        return cost, belief
