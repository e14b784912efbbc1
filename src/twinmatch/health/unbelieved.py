"""Sensors of a plant with several signals that are not believed: they are read through until they are right."""

from __future__ import annotations

from collections import deque
from typing import Final

from twinmatch.dynamics import Plant
from twinmatch.health.evidence import Competition
from twinmatch.health.faults import HOUR, EstimatedReading, Lie
from twinmatch.health.reading_through import ReadThrough
from twinmatch.health.runaway import RUNNING, WayBack
from twinmatch.signals import BoolArray, FloatArray, Sample

_WIDE: Final = 10.0
"""Width of a band up to which an estimate is good, ± so many standard deviations of the sensor's noise."""
_KEPT: Final = 1000
"""Number of lies kept."""


class UnbelievedSensors:
    """The sensors of one plant that lie: what they should read, and whether they are right again.

    Of two kinds: the readings of a sensor that is off are the plant's with something that stays, and filters take
    them with that offset. Those of a sensor that has run away or is frozen say nothing of the plant: they are left
    out, no filter takes them, and what they have taught is forgotten.
    """

    def __init__(self, competition: Competition, plant: type[Plant]) -> None:
        """Begin with sensors that are right; the competition's filters take their readings, or do not."""
        self._competition = competition
        self._outputs = list(plant.outputs.items())
        self._ways_back: dict[int, WayBack] = {}
        """Of the outputs whose readings have run away."""
        self._believed: dict[int, FloatArray] = {}
        """What was believed before the readings of an output were left out, shape (N,)."""
        self._lies_of_output: dict[int, Lie] = {}
        """Of the outputs whose sensors lie now."""
        self._past_lies: deque[Lie] = deque(maxlen=_KEPT)

    @property
    def is_blind(self) -> bool:
        """Whether no sensor is left by which another could be read through."""
        return len(self._competition.through) == len(self._outputs)

    def is_blind_without(self, output: int) -> bool:
        """Whether none is left if this output is read through as well."""
        return len({*self._competition.through, output}) == len(self._outputs)

    @property
    def any_has_run_away(self) -> bool:
        """Whether a reading has run away, and is not back."""
        return bool(self._ways_back)

    def has_run_away(self, output: int) -> bool:
        """Whether the reading of an output has run away, and is not back."""
        return output in self._ways_back

    def read_through(self, output: int, since: int) -> None:
        """Estimate an output without its sensor, which lies since a sample, counted from the last gap."""
        self._competition.read_through(output, since)

    def leave_out(self, output: int, since: int) -> None:
        """Read through a sensor whose readings say nothing of the plant since a sample, counted from the last
        gap."""
        self.read_through(output, since)
        self._believed[output] = self._competition.believed_before(since)
        self._competition.leave_out(output)

    def leave_out_run_away(self, output: int, since: int) -> None:
        """Leave out a sensor whose reading runs away since a sample, until it is back."""
        self._ways_back[output] = WayBack(self._competition.second)
        self.leave_out(output, since)

    def back(self, values: FloatArray) -> list[int]:
        """Outputs whose readings, shape (o,), had run away and are back; they need not be left out any longer. Ask
        once at every sample."""
        back = []
        for output, way_back in [*self._ways_back.items()]:
            if output not in self._competition.through:  # after a gap
                self._ways_back[output] = WayBack(self._competition.second)
                self.read_through(output, 0)
                continue
            expected, band = self._competition.through[output].estimate
            _, declared = self._outputs[output]
            least = RUNNING.noises * declared.noise
            tolerance = max(RUNNING.bands * band, least)
            if way_back.take(float(values[output]), expected, tolerance, least):
                del self._ways_back[output]
                back.append(output)
        return back

    def settle(self, lying: BoolArray, since: int, index: int) -> bool:
        """Believe those that do not lie, shape (o,), at a sample; the newest alarm began at the sample `since`.

        Returns whether readings are taken again that were left out, which is a gap.
        """
        for output in [*self._competition.through]:
            if not lying[output]:
                del self._competition.through[output]
        taken_again = [
            output for output in self._competition.untaken if not lying[output]
        ]
        for output in taken_again:
            self._competition.take_again(output, self._believed.pop(output))
        for output, lies in enumerate(lying.tolist()):
            self._follow_lie(output, since, index, lies=lies)
        return bool(taken_again)

    def _follow_lie(self, output: int, since: int, index: int, *, lies: bool) -> None:
        """Note that the sensor of an output begins to lie, or ends."""
        lie = self._lies_of_output.get(output)
        if lies and lie is None:
            name, _ = self._outputs[output]
            self._lies_of_output[output] = Lie(name, since, None)
        elif not lies and lie is not None:
            self._past_lies.append(lie._replace(last=index))
            del self._lies_of_output[output]

    def lie_between(self, first: int, last: int) -> Lie | None:
        """The lie of a sensor that is known between two samples, both included; None without one."""
        lies = [*self._past_lies, *self._lies_of_output.values()]
        return next((lie for lie in lies if lie.overlaps(first, last)), None)

    def estimates(self, sample: Sample) -> tuple[EstimatedReading, ...]:
        """What sensors should read at a sample that are not believed; none if no sensor is right."""
        if self.is_blind:
            return ()
        return tuple(
            self._estimate(output, estimator, sample)
            for output, estimator in self._competition.through.items()
            if estimator.samples > estimator.rehearsed
        )

    def _estimate(
        self, output: int, estimator: ReadThrough, sample: Sample
    ) -> EstimatedReading:
        name, declared = self._outputs[output]
        wide = _WIDE * declared.noise
        if estimator.good is None:
            period = self._competition.healthy.period
            estimator.good = period * estimator.lasts(wide, round(HOUR / period))
        value, band = estimator.estimate
        reading = (sample.refused or sample.outputs)[output]
        since = sample.index - (estimator.samples - estimator.rehearsed) + 1
        return EstimatedReading(
            sample.index, name, value, band, reading, since, wide, estimator.good
        )
