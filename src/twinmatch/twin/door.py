"""Where samples enter, live and from a session: each is settled here, once, as measured, as a stand-in or as
not usable; `Sample.seen`, `refused` and `usable`, and a window's `seen`, say so to everybody.

Behind this door samples follow one another, or a longer gap has ended the stretch. A plant file that declares
no typical twin leaves it to the first nominal one to say how far a reading may move. A door learns it from
the verdicts, which say from which sample on, so that every door settles a stream alike, live and in replay.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import chain

from twinmatch.comparing import Verdict
from twinmatch.dynamics import Law, Parameters
from twinmatch.health import HealthSettings, Refusals
from twinmatch.signals import Sample, Window, stretches
from twinmatch.twin.gaps import GapFiller
from twinmatch.twin.settings import TwinSettings


def filled(
    samples: Iterable[Sample], settings: TwinSettings, verdicts: Iterable[Verdict] = ()
) -> list[Sample]:
    """The samples of a session and its stand-ins, as the twin with these settings takes them whose verdicts
    these are."""
    door = Door.of(settings)
    for verdict in verdicts:
        door.learn(verdict)
    settled = chain.from_iterable(door.take(sample) for sample in samples)
    return [sample for sample in settled if sample.usable]


def filled_stretches(
    samples: Iterable[Sample], settings: TwinSettings, verdicts: Iterable[Verdict] = ()
) -> tuple[Window, ...]:
    """These as windows: one for each stretch between gaps that are too long to be filled."""
    return stretches(filled(samples, settings, verdicts), settings.period)


class Door:
    """Settles the samples of a stream: refuses implausible readings, and fills short gaps."""

    def __init__(self, law: Law | None, longest: int, health: HealthSettings | None) -> None:
        """Begin without samples; stand-ins replace at most `longest` samples in a row.

        `law` is that of the loop, None if it is not known; `health` has the limits of a reading, None for a
        plant with several outputs: then none is refused.
        """
        self._filler = GapFiller(law, longest)
        self._refusals = None if health is None else Refusals(health, longest)
        self._learned: tuple[int, Parameters] | None = None  # sample of a verdict, and its nominal twin
        self._last: int | None = None

    @property
    def learning(self) -> bool:
        """Whether verdicts to come decide how readings are judged."""
        return self._refusals is not None and not self._refusals.taught

    @classmethod
    def of(cls, settings: TwinSettings) -> Door:
        """That of the plant, loop, limits and longest gap of these settings."""
        health = replace(settings.health, period=settings.period)
        return cls(settings.law, settings.schedule.gap, health)

    def know(self, parameters: Parameters) -> None:
        """Judge readings by this twin if the plant file declares no typical one."""
        if self._refusals is not None:
            self._refusals.know(parameters)

    def learn(self, verdict: Verdict) -> None:
        """Take a verdict, in order; its nominal twin, the first of all, is known to the samples behind it."""
        if self._learned is None and verdict.chosen is not None:
            self._learned = verdict.sample, verdict.chosen.parameters

    def take(self, sample: Sample) -> list[Sample]:
        """The stand-ins for the samples lost before this one, if they are few enough, and this one, settled;
        oldest first."""
        if self.learning and self._learned is not None and self._last is not None:
            since, parameters = self._learned
            if since <= self._last:
                self.know(parameters)
        self._last = sample.index
        settled = sample if self._refusals is None else self._refusals.settle(sample)
        if settled.usable:
            return self._filler.take(settled)
        self._filler.restart()
        return [settled]
