"""Where samples enter, live and from a session.

Each sample is settled here, once: as measured, as a stand-in, or as not usable. `Sample.seen`, `refused` and
`usable`, and a window's `seen`, say as which. Behind this door samples follow one another, or a longer gap
has ended the stretch.

How far a reading may move is judged by the typical twin of the plant file or, without one, by the first
nominal twin. A door learns that twin from the verdicts. They say from which sample on it is known, so that
every door settles a stream alike, live and in replay.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace

from twinmatch.comparing import Verdict
from twinmatch.dynamics import Law, Parameters
from twinmatch.health import HealthSettings, Refusals
from twinmatch.signals import Sample, Window, stretches
from twinmatch.twin.gaps import GapFiller
from twinmatch.twin.settings import TwinSettings


def filled(
    samples: Iterable[Sample], settings: TwinSettings, verdicts: Iterable[Verdict] = ()
) -> list[Sample]:
    """The usable samples of a session and their stand-ins, as a twin with these settings takes them.

    `verdicts` are those of the twin on this session.
    """
    settling = Settling(settings)
    for verdict in verdicts:
        settling.learn(verdict)
    for sample in samples:
        settling.push(sample)
    return [sample for sample in settling.finish() if sample.usable]


def filled_stretches(
    samples: Iterable[Sample], settings: TwinSettings, verdicts: Iterable[Verdict] = ()
) -> tuple[Window, ...]:
    """The samples given by `filled` as windows: one for each stretch between gaps too long to be filled."""
    return stretches(filled(samples, settings, verdicts), settings.period)


class Door:
    """Settles the samples of a stream: refuses implausible readings, and fills short gaps."""

    def __init__(
        self, law: Law | None, longest: int, health: HealthSettings | None
    ) -> None:
        """Begin without samples; stand-ins replace at most `longest` samples in a row.

        `law` is that of the loop, None if it is not known. `health` has the limits of a reading; None: no
        reading is refused, as on a plant with several outputs.
        """
        self._filler = GapFiller(law, longest)
        self._refusals = None if health is None else Refusals(health, longest)
        self._nominal: tuple[int, Parameters] | None = None
        """The first nominal twin, and the sample of the verdict that named it."""
        self._last: int | None = None
        """Index of the newest sample."""

    @property
    def learning(self) -> bool:
        """Whether the door still needs a nominal twin to judge readings."""
        return self._refusals is not None and not self._refusals.taught

    @property
    def steps_recur(self) -> bool:
        """Whether steps that were refused have recurred, so that they are the plant's."""
        return self._refusals is not None and self._refusals.steps.recur

    @classmethod
    def of(cls, settings: TwinSettings) -> Door:
        """A door for the plant, loop, limits and longest gap of these settings."""
        health = replace(settings.health, period=settings.period)
        return cls(settings.law, settings.schedule.gap, health)

    def know(self, parameters: Parameters) -> None:
        """Judge readings from now on by this twin, if the plant file declares no typical one."""
        if self._refusals is not None:
            self._refusals.know(parameters)

    def learn(self, verdict: Verdict) -> None:
        """Take the next verdict. The first nominal twin judges the samples after that of its verdict."""
        if self._nominal is None and verdict.chosen is not None:
            self._nominal = verdict.sample, verdict.chosen.parameters

    def take(self, sample: Sample) -> list[Sample]:
        """The stand-ins for the samples lost before this one, if they are few enough, and this one, settled;
        oldest first."""
        if self.learning and self._nominal is not None and self._last is not None:
            sample_of_verdict, parameters = self._nominal
            if sample_of_verdict <= self._last:
                self.know(parameters)
        self._last = sample.index
        settled = sample if self._refusals is None else self._refusals.settle(sample)
        if settled.usable:
            return self._filler.take(settled)
        self._filler.restart()
        return [settled]


class Settling:
    """Settles the samples of a stream as the engine does, where only the verdicts of the engine arrive.

    A sample waits as long as a verdict to come may still decide how it is settled.
    """

    def __init__(self, settings: TwinSettings) -> None:
        """Begin without samples; `settings` are the twin's."""
        self._door = Door.of(settings)
        self._waiting: deque[Sample] = deque()

    @property
    def waiting(self) -> int:
        """Number of samples that verdicts to come decide how to settle."""
        return len(self._waiting)

    def learn(self, verdict: Verdict) -> None:
        """Take the next verdict."""
        self._door.learn(verdict)

    def push(self, sample: Sample) -> None:
        """Take the next sample; `settled` gives it."""
        self._waiting.append(sample)

    def forget(self) -> None:
        """Drop the samples that wait."""
        self._waiting.clear()

    def settled(self, judged: Callable[[int], bool]) -> list[Sample]:
        """The samples that can be settled now, and their stand-ins; oldest first.

        `judged` tells whether all verdicts up to the sample with an index have arrived.
        """
        settled: list[Sample] = []
        while self._waiting and (
            not self._door.learning or judged(self._waiting[0].index - 1)
        ):
            settled += self._door.take(self._waiting.popleft())
        return settled

    def finish(self) -> list[Sample]:
        """All samples that wait, settled with the verdicts so far."""
        return self.settled(lambda _: True)
