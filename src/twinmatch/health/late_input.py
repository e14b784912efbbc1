"""How much later than its equations say the input of a plant acts: a rival of every fault of the drive.

A table may hold each input a row early, a heater may sit behind a wall that no equation has. Then the reading
stays where the equations expect it to move, as behind a dead drive. So the plant is tracked with its input as
it is and with the same input a few seconds late; the readings' code lengths say which delays are credible.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from typing import Final

import numpy as np

from twinmatch.dynamics import Parameters
from twinmatch.dynamics.filters import Readings
from twinmatch.dynamics.pace import slow_scale
from twinmatch.dynamics.tracker import Belief, Tracker
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray, Sample

DELAYS_S: Final = (0.0, 2.0, 4.0, 7.0, 10.0, 15.0, 20.0)
"""Delays that are tried, s: up to where a late input and a lost drive look the same for a whole stretch."""


class _Delays(Rule):
    """How the delay of the input is chosen."""

    block: float = 10.0
    """Time that is tracked at once, s."""
    credible: float = 6.0
    """Nats by which a credible delay may be worse than the best: 1 in 400."""
    far: float = 40.0
    """Nats by which another delay has to be better than the one that is taken: taking it starts over."""
    memory: float = 0.99
    """What a block leaves of the code lengths before: the memory is a hundred blocks."""
    learned_after: int = 10
    """Blocks after which a code length counts: a drive that has just been lost looks like a late one."""


_DELAYS: Final = _Delays()


_LEVEL: Final = 1.0
"""Assumed model error, in units of that of a real rig."""


_LATER_S: Final = (1.0, 2.0, 3.0, 4.0, 6.0, 9.0, 12.0)
"""Delays, and lags, with which an input of a stretch is tried, s of a plant as fast as the rig."""


def later_inputs(inputs: FloatArray, size: int, second: float) -> Iterator[FloatArray]:
    """The newest `size` inputs as they act if they come late, or through a lag; `second` is the number of
    samples in one."""
    first = inputs.size - size
    times = [late * second for late in _LATER_S if late * second >= 0.5]
    for delay in sorted({max(1, round(late)) for late in times}):
        yield inputs[np.maximum(np.arange(first, inputs.size) - delay, 0)]
    for late in times:
        remaining = math.exp(-1.0 / late)
        behind = [float(inputs[0])]
        for value in inputs.tolist():
            behind.append(remaining * behind[-1] + (1.0 - remaining) * value)
        yield np.array(behind[1 + first :])


class LateInput:
    """Which delays of the input are credible; push every sample, in order."""

    def __init__(self, parameters: Parameters, period: float) -> None:
        """Begin with a usual plant and the sample time, s."""
        scale = slow_scale(parameters.model.plant, period)
        self._tracker = Tracker(parameters, period, (_LEVEL,))
        self._delays = sorted({round(delay * scale / period) for delay in DELAYS_S})
        self._size = max(4, round(_DELAYS.block * scale / period))
        self._costs = np.zeros(len(self._delays))
        self._taken = 0  # place of the delay with which inputs are taken
        self._waiting: deque[FloatArray] = deque()
        self._beliefs: list[Belief] = []
        self._past: deque[Sample] = deque(maxlen=self._size + self._delays[-1])
        self._fresh = 0  # samples that were not tracked yet
        self._gap = False
        self._before = [np.nan, np.nan]  # the two readings before the block

    @property
    def credible(self) -> tuple[int, ...]:
        """Delays that explain the readings about as well as the best of them, samples."""
        near = self._costs <= self._costs.min() + _DELAYS.credible
        return tuple(
            delay
            for delay, credible in zip(self._delays, near.tolist(), strict=True)
            if credible
        )

    @property
    def delay(self) -> int:
        """The delay with which inputs are taken, samples: that of the file until another is far better."""
        return self._delays[self._taken]

    def restart(self) -> None:
        """Start over after a gap, keeping what was learned."""
        self._past.clear()
        self._fresh = 0
        self._gap = bool(self._beliefs)
        self._before = [np.nan, np.nan]

    def push(self, sample: Sample, *, learn: bool = True) -> None:
        """Take a sample; nothing is learned from the last minutes before one with a fault."""
        if not learn:
            self._waiting.clear()
        self._past.append(sample)
        self._fresh = self._fresh + 1 if learn else 0
        if self._fresh == self._size:
            self._track()
            self._fresh = 0
        self._gap = self._gap or not learn

    @property
    def input(self) -> float:
        """The input that acts now."""
        return self._past[max(0, len(self._past) - 1 - self.delay)].input

    def _track(self) -> None:
        samples = list(self._past)[-self._size :]
        model = self._tracker.parameters.model
        rows = np.array(
            [model.disturbance_row(s.disturbances or None) for s in samples]
        )
        rows = rows.reshape(self._size, -1)
        is_read = np.array([s.seen for s in samples])
        output = np.array([*self._before, *(s.output for s in samples)])
        self._before = output[-2:].tolist()
        noise = np.where(is_read, model.plant.output.noise, np.inf)
        costs = np.zeros(len(self._delays))
        for place in range(len(self._delays)):
            late = self._late([s.input for s in self._past], self._delays[place])
            belief = self._belief_before(
                place, samples[0].output, float(late[0]), rows[0]
            )
            belief, costs[place] = self._tracker.run(
                belief, Readings(output, late, rows, noise), 0
            )
            if place < len(self._beliefs):
                self._beliefs[place] = belief
            else:
                self._beliefs.append(belief)
        self._waiting.append(costs)
        if len(self._waiting) > _DELAYS.learned_after:
            self._costs = _DELAYS.memory * self._costs + self._waiting.popleft()
            best = int(np.argmin(self._costs))
            if self._costs[self._taken] > self._costs[best] + _DELAYS.far:
                self._taken = best
        self._gap = False

    def _belief_before(
        self, place: int, output: float, first_input: float, row: FloatArray
    ) -> Belief:
        """What is believed with the delay at a place before a block that begins with these values."""
        if len(self._beliefs) <= place:
            return self._tracker.begin(output, first_input, row, 0)
        if self._gap:
            return self._tracker.again(self._beliefs[place], output, first_input, row)
        return self._beliefs[place]

    def _late(self, inputs: list[float], delay: int) -> FloatArray:
        """The inputs that act in the newest block, if they act so late."""
        begin = len(inputs) - self._size - delay
        return np.array([inputs[max(0, begin + i)] for i in range(self._size)])
