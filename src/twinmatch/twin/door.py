"""Where samples enter, live and from a session.

Each sample is settled here, once: as measured, as a stand-in, or as not usable. `Sample.seen`, `refused` and
`usable`, and a window's `seen`, say as which. Behind this door samples follow one another, or a longer gap
has ended the stretch.

How far a reading may move is judged by the typical twin of the plant file or, without one, by the first
nominal twin. A door learns that twin from the verdicts. They say from which sample on it is known, so that
every door settles a stream alike, live and in replay: that of the engine, and that of a process which only
receives what the engine publishes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace

from twinmatch.comparing import Verdict
from twinmatch.dynamics import Parameters
from twinmatch.health import Refusals
from twinmatch.signals import Sample, Window, stretches
from twinmatch.twin.gaps import GapFiller
from twinmatch.twin.settings import TwinSettings


def filled(
    samples: Iterable[Sample], settings: TwinSettings, verdicts: Iterable[Verdict] = ()
) -> list[Sample]:
    """The usable samples of a session and their stand-ins, as a twin with these settings takes them.

    `verdicts` are those of the twin on this session.
    """
    door = Door(settings)
    for verdict in verdicts:
        door.learn(verdict)
    for sample in samples:
        door.push(sample)
    return [sample for sample in door.settled() if sample.usable]


def filled_stretches(
    samples: Iterable[Sample], settings: TwinSettings, verdicts: Iterable[Verdict] = ()
) -> tuple[Window, ...]:
    """The samples given by `filled` as windows: one for each stretch between gaps too long to be filled."""
    return stretches(filled(samples, settings, verdicts), settings.period)


def all_judged(index: int) -> bool:  # noqa: ARG001
    """Whether all verdicts up to a sample have arrived, where no verdict is waited for."""
    return True


class Door:
    """Settles the samples of a stream: refuses implausible readings, and fills short gaps.

    A sample waits as long as a verdict to come may still decide how it is settled.
    """

    def __init__(self, settings: TwinSettings) -> None:
        """Begin without samples; `settings` are the twin's: plant, loop, limits, and the longest gap that is
        filled."""
        self._settings = settings
        self._waiting: deque[Sample] = deque()
        """Samples that have not been settled, oldest first."""
        self._settled: deque[Sample] = deque()
        """Settled samples that nobody has taken yet, oldest first."""
        self.restart()

    def restart(self) -> None:
        """Settle the samples that wait, and those to come, without knowing any before."""
        settings = self._settings
        longest = settings.schedule.gap
        health = replace(settings.health, period=settings.period)
        self._filler = GapFiller(settings.law, longest)
        self._refusals = Refusals(health, longest)
        self._nominal: tuple[int, Parameters] | None = None
        """The first nominal twin, and the sample of the verdict that named it."""
        self._last: int | None = None
        """Index of the newest sample that has been settled."""
        self._settled.clear()

    @property
    def waiting(self) -> int:
        """Number of samples that have not been settled."""
        return len(self._waiting)

    @property
    def oldest(self) -> Sample | None:
        """The oldest sample that nobody has taken, settled or not; None if there is none."""
        if self._settled:
            return self._settled[0]
        return self._waiting[0] if self._waiting else None

    @property
    def learning(self) -> bool:
        """Whether the door still needs a nominal twin to judge readings."""
        return not self._refusals.taught

    @property
    def steps_recur(self) -> bool:
        """Whether steps that were refused have recurred, so that they are the plant's."""
        return self._refusals.steps.recur

    def know(self, parameters: Parameters) -> None:
        """Judge readings from now on by this twin, if the plant file declares no typical one."""
        self._refusals.know(parameters)

    def learn(self, verdict: Verdict) -> None:
        """Take the next verdict. The first nominal twin judges the samples after that of its verdict."""
        if self._nominal is None and verdict.chosen is not None:
            self._nominal = verdict.sample, verdict.chosen.parameters

    def push(self, sample: Sample) -> None:
        """Take the next sample; it waits until `next` or `settled` gives it."""
        self._waiting.append(sample)

    def forget(self) -> None:
        """Drop the samples that wait."""
        self._waiting.clear()

    def next(self, judged: Callable[[int], bool] = all_judged) -> Sample | None:
        """The next settled sample or stand-in; None if there is none, or if it still depends on a verdict.

        `judged` tells whether all verdicts up to the sample with an index have arrived.
        """
        if self._waiting and not self._settled:
            is_decided = not self.learning or judged(self._waiting[0].index - 1)
            if is_decided:
                self._settled.extend(self._settle(self._waiting.popleft()))
        return self._settled.popleft() if self._settled else None

    def settled(self, judged: Callable[[int], bool] = all_judged) -> list[Sample]:
        """All samples that `next` gives, and their stand-ins; oldest first."""
        samples: list[Sample] = []
        while (sample := self.next(judged)) is not None:
            samples.append(sample)
        return samples

    def _settle(self, sample: Sample) -> list[Sample]:
        """The stand-ins for the samples lost before this one, if they are few enough, and this one, settled;
        oldest first."""
        if self.learning and self._nominal is not None and self._last is not None:
            sample_of_verdict, parameters = self._nominal
            if sample_of_verdict <= self._last:
                self.know(parameters)
        self._last = sample.index
        settled = self._refusals.settle(sample)
        if settled.usable:
            return self._filler.take(settled)
        self._filler.restart()
        return [settled]
