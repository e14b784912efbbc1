"""What is learned of a sensor from its readings: noise, last digit, pauses, and long repeats."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics.bank import JUNK
from twinmatch.health.roughness import Roughness
from twinmatch.settings import Rule

_STANDS: Final = math.log(1.0 - 1e-4)
"""Log-probability with which a frozen sensor repeats its reading."""
_FAR: Final = 6.0
"""Times a reading's usual movement in a sample from which on it has jumped."""
_USUAL: Final = 1.2
"""Times the mean size of its movements that a reading usually moves: a standard deviation."""
_LEAST: Final = 8.0
"""Times its noise that a jump has at least: an offset is reported from there on."""
_TAKEN_BACK: Final = 3
"""Samples within which an outlier is taken back."""
_EXPECTED: Final = 1.0 / 3.0
"""Share of a movement from which on the equations expected it, even if they know the drive's effect badly."""
_MOVES_ON: Final = 0.5
"""Share of a movement from which on a reading moves on behind it, as one that follows its plant does."""
_MOVES: Final = 20
"""Movements of a reading after which its last digit is known."""


class _Pauses(Rule):
    """How it is learned how often a reading is repeated."""

    longest: int = 10
    """Repeats in a row from which on they may be those of a frozen sensor, and teach nothing."""
    most: float = 500.0
    """Readings that count: from there on, older ones count half."""


_PAUSES: Final = _Pauses()


class Jump(NamedTuple):
    """A movement of a reading in one sample."""

    age: int
    """Samples since."""
    size: float
    """By how much it moved, in its unit; 0: nothing has jumped."""
    since: float = 0.0
    """By how much it has moved since then, in its unit."""

    @property
    def stays(self) -> bool:
        """Whether it is where it jumped to."""
        return self.size != 0.0 and abs(self.since) < _MOVES_ON * abs(self.size)


class RunOfRepeats(NamedTuple):
    """A run of repeats of one reading that has ended."""

    value: float
    """The reading that was repeated, in its unit."""
    repeats: int
    frozen: float
    """What they said for a frozen sensor, nats."""


class RunLengths:
    """How long a sensor usually repeats a reading, from its runs of repeats that have ended.

    A display with coarse steps, or a reading that is averaged, stands for longer the better the loop holds
    it, so how likely a run is to continue depends on how long it already is: a ratio for each doubling of its
    length, of the repeats there to the runs that ended there.
    """

    _RUNS: Final = 2
    """Runs of at least such a length from which on the ratio is known."""
    _DOUBLINGS: Final = 24

    def __init__(self) -> None:
        """Begin without any run."""
        self._continued = np.zeros(self._DOUBLINGS)
        self._ended = np.zeros(self._DOUBLINGS)

    @classmethod
    def _doubling(cls, repeats: int) -> int:
        return min((repeats + 1).bit_length() - 1, cls._DOUBLINGS - 1)

    def take(self, repeats: int) -> None:
        """Take a run of so many repeats that has ended."""
        last = self._doubling(repeats)
        for doubling in range(last):
            self._continued[doubling] += 2**doubling
        self._continued[last] += repeats + 1 - 2**last
        self._ended[last] += 1.0

    def continues(self, repeats: int) -> float:
        """Probability that a run of so many repeats continues; 0 where too few have been that long."""
        doubling = self._doubling(repeats)
        if self._ended[doubling:].sum() < self._RUNS:
            return 0.0
        continued = float(self._continued[doubling])
        return (continued + 1.0) / (continued + float(self._ended[doubling]) + 2.0)


class LearnedSensor:
    """Learns of one output; numbers are in its unit."""

    def __init__(self, noise: float, span: tuple[float, float], second: float) -> None:
        """Begin with the plant file's noise; `second`: samples in a second of a plant as fast as the rig."""
        self._usual = noise
        self._span = span[1] - span[0]
        self._second = second
        self.noise = noise
        """Standard deviation of a reading."""
        self.step = 0.1 * noise
        """Value of its last digit."""
        self._roughness = Roughness(noise)
        self.run_lengths = RunLengths()
        """How long its readings usually stand."""
        self._walk = 2.0 * noise  # how far readings usually move in a sample
        self._pace = 2.0 * noise  # the same, with repeats as movements of nothing
        self._smallest = math.inf  # movement so far
        self._moves = 0  # movements so far
        # Counts of repeats and of readings: after a new reading, and after a repeat.
        self._pauses = [[1.0, 50.0], [2.0, 4.0]]
        self.restart()

    def restart(self) -> None:
        """Begin again after a gap, keeping what was learned."""
        # the reading before, and the one before that
        self._before = self._earlier = math.nan
        self._anchor = math.nan  # the reading before an outlier
        self._counted = self._pauses[0]
        self.repeated = False
        """Whether the reading is the one before."""
        self.repeats = 0
        """Repeats in a row."""
        self.frozen = 0.0
        """What they say for a frozen sensor, nats."""
        self.is_accused = False
        """Whether this run of repeats is that of a frozen sensor, which is not how it usually reads."""
        self.ended_run: RunOfRepeats | None = None
        """The run of repeats that ended with the newest reading; None if none did."""
        self.jump = Jump(0, 0.0)
        """The newest movement in one sample that is far from how the reading usually moves."""

    @property
    def variance(self) -> float:
        """That of a reading, with its rounding."""
        return self.noise**2 + self.step**2 / 12.0

    def read(self, value: float, *, counts: bool) -> None:
        """Take a reading, and whether it counts."""
        self._counted = self._pauses[self.repeated]
        self.repeated = counts and value == self._before

    @property
    def pause(self) -> float:
        """Probability that it repeats this reading, or might have, whatever the plant does."""
        return self._counted[0] / self._counted[1]

    def walked(self, value: float, gained: float, *, counts: bool) -> float:
        """Log-probability of the reading without equations: it is like the one before. A repeat says nothing
        of a display with coarse steps: it counts as the equations say, `gained`."""
        if self.repeated:
            return gained
        if not counts or math.isnan(self._before):
            return 0.0
        anchor = self._before if math.isnan(self._anchor) else self._anchor
        change = value - anchor
        spread = self._walk
        near = _between(change, self.step, 1.0 * spread)
        far = _between(change, self.step, 3.0 * spread)
        moved = min(max(abs(change), 0.3 * self.noise), 4.0 * spread)
        self._walk += (_USUAL * moved - spread) / (30.0 * self._second)
        likelihood = 0.95 * near + 0.05 * far
        junk = JUNK * min(self.step / self._span, 1.0)
        # A reading that says nothing is not where the next one starts, but two are.
        self._anchor = (
            anchor if likelihood < junk and math.isnan(self._anchor) else math.nan
        )
        return math.log((1.0 - self.pause) * likelihood + junk)

    def learn(
        self, value: float, gained: float, expected: float, *, counts: bool
    ) -> None:
        """Learn of this reading, whose log-probability was `gained`; the equations expected another one."""
        self._follow_repeats(gained, counts=counts)
        before = self._before
        earlier = self._earlier
        self._earlier = before
        self._before = value if counts else math.nan
        if not counts or math.isnan(before):
            return
        self._follow_jump(value - before, expected - before)
        self._learn_pause()
        self._learn_movement(abs(value - before))
        if not math.isnan(earlier):
            self._roughness.take(abs(value - 2.0 * before + earlier))
        self.noise = self._roughness.noise

    def _follow_repeats(self, gained: float, *, counts: bool) -> None:
        """Count the repeats in a row, and what they say for a frozen sensor; a new reading ends them."""
        self.ended_run = None
        if self.repeated:
            usually = self.run_lengths.continues(self.repeats)
            healthy = max(gained, math.log(usually)) if usually > 0.0 else gained
            self.repeats = self.repeats + 1
            self.frozen = self.frozen + _STANDS - healthy
        elif counts:
            if not self.is_accused and not math.isnan(self._before):
                self.run_lengths.take(self.repeats)
            if self.repeats:
                self.ended_run = RunOfRepeats(self._before, self.repeats, self.frozen)
            self.is_accused = False
            self.repeats = 0
            self.frozen = 0.0

    def _learn_pause(self) -> None:
        """Learn how often a reading is repeated, unless it has been for so long that it may be frozen."""
        if self.repeats >= _PAUSES.longest:
            return
        self._counted[0] += 0.5 * self.repeated
        self._counted[1] += 1.0
        if self._counted[1] > _PAUSES.most:
            self._counted[:] = 0.5 * self._counted[0], 0.5 * self._counted[1]

    def _learn_movement(self, moved: float) -> None:
        """Learn how far readings usually move, and their last digit, from the size of a movement."""
        steady = min(moved, 4.0 * self._walk)
        self._pace += (_USUAL * steady - self._pace) / (30.0 * self._second)
        if moved > 1e-9:
            self._moves = self._moves + 1
            self._smallest = min(self._smallest, moved)
            if self._moves >= _MOVES:
                self.step = min(self._smallest, 30.0 * self._usual)

    def _follow_jump(self, moved: float, expected: float) -> None:
        """Note a movement that is far from the usual ones, and from the expected one.

        One that is taken back at once was an outlier.
        """
        age, size, since = self.jump
        self.jump = Jump(age + 1, size, since + moved)
        # A display with coarse steps moves by one now and then, and its plant far less in a sample.
        usually = min(_FAR * self._walk, _FAR * self._pace + self.step)
        is_far = abs(moved) > max(usually, _LEAST * self.noise, _LEAST * self._usual)
        if not is_far or expected * moved >= _EXPECTED * moved**2:
            return
        is_taken_back = age < _TAKEN_BACK and abs(moved + size) < 0.5 * abs(size)
        self.jump = Jump(0, 0.0 if is_taken_back else moved)


def _between(deviation: float, digit: float, spread: float) -> float:
    """Probability that a normal value rounds to a reading with this deviation from its mean."""
    low = (deviation - 0.5 * digit) / (math.sqrt(2.0) * spread)
    high = (deviation + 0.5 * digit) / (math.sqrt(2.0) * spread)
    return 0.5 * (math.erf(high) - math.erf(low))
