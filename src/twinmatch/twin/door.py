"""Where samples enter, live and from a session: each is settled here, once, as measured, as a stand-in or as
not usable; `Sample.seen`, `refused` and `usable`, and a window's `seen`, say so to everybody.

Behind this door samples follow one another, or a longer gap has ended the stretch.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from twinmatch.dynamics import Law, Parameters
from twinmatch.health import HealthSettings, Refusals
from twinmatch.signals import Sample, Window, stretches
from twinmatch.twin.gaps import GapFiller
from twinmatch.twin.settings import TwinSettings


def filled(samples: Iterable[Sample], settings: TwinSettings) -> list[Sample]:
    """The samples of a session and its stand-ins, as a twin with these settings takes them."""
    door = Door.of(settings)
    return [one for sample in samples for one in door.take(sample) if one.usable]


def filled_stretches(samples: Iterable[Sample], settings: TwinSettings) -> tuple[Window, ...]:
    """These as windows: one for each stretch between gaps that are too long to be filled."""
    return stretches(filled(samples, settings), settings.period)


class Door:
    """Settles the samples of a stream: refuses implausible readings, and fills short gaps."""

    def __init__(self, law: Law | None, longest: int, health: HealthSettings | None) -> None:
        """Begin without samples; stand-ins replace at most `longest` samples in a row.

        `law` is that of the loop, None if it is not known; `health` has the limits of a reading, None for a
        plant with several outputs: then none is refused.
        """
        self._filler = GapFiller(law, longest)
        self._refusals = None if health is None else Refusals(health, longest)

    @classmethod
    def of(cls, settings: TwinSettings) -> Door:
        """That of the plant, loop, limits and longest gap of these settings."""
        health = replace(settings.health, period=settings.period)
        return cls(settings.law, settings.schedule.gap, health)

    def know(self, parameters: Parameters) -> None:
        """Judge readings by this twin if the plant file declares no typical one."""
        if self._refusals is not None:
            self._refusals.know(parameters)

    def take(self, sample: Sample) -> list[Sample]:
        """The stand-ins for the samples lost before this one, if they are few enough, and this one, settled;
        oldest first."""
        settled = sample if self._refusals is None else self._refusals.settle(sample)
        if settled.usable:
            return self._filler.take(settled)
        self._filler.restart()
        return [settled]
