"""Repeated choice of the plant's structure while samples arrive."""

from __future__ import annotations

from dataclasses import dataclass

from twinmatch.dynamics import FILED, Closing, Model, Plant
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import Noise
from twinmatch.signals import Window
from twinmatch.twin.history import History
from twinmatch.twin.structures import StructureChoice, choose_structure

__all__ = ["StructureSettings", "StructureWatch", "watched"]


@dataclass(frozen=True)
class StructureSettings:
    """The structures to choose from, when to choose, and from how many samples.

    Raises:
        TwinmatchError: the counts contradict each other.
    """

    models: tuple[Model, ...]
    """The plant in each structure that is tried."""
    least: int = 900
    """Samples needed before the first choice."""
    every: int = 1200
    """Samples between two choices."""
    longest: int = 1200
    """Number of newest samples that are fitted."""
    noise: Noise | None = None
    gains: Closing = FILED
    decimals: int = 2

    def __post_init__(self) -> None:
        if not (100 <= self.least <= self.longest and self.every >= 1 and self.models):
            msg = (
                f"structure watch: least {self.least}, longest {self.longest}, every {self.every} samples, "
                f"{len(self.models)} structures; give 100 <= least <= longest, every >= 1 and a structure"
            )
            raise TwinmatchError(msg)


def watched(plant: type[Plant]) -> tuple[Model, ...]:
    """The plant in the structures that its file marks to be watched on a running plant."""
    return tuple(plant.model(name) for name, structure in plant.structures.items() if structure.watched)


class StructureWatch:
    """Keeps the newest samples and chooses a structure at regular intervals.

    Push every window of the schedule without a fault, in order. Windows may overlap or follow one another;
    after a gap the record starts over. Choices on samples that do not overlap add their evidence, so that a
    stretch with little information does not change the choice. Everything depends on the samples alone, so a
    replay chooses as the live twin did.
    """

    def __init__(self, settings: StructureSettings) -> None:
        """Begin without samples."""
        self.settings = settings
        self._history = History(settings.longest)
        self._chosen_at: int | None = None
        self._choice: StructureChoice | None = None

    @property
    def choice(self) -> StructureChoice | None:
        """The newest choice, if there is one yet."""
        return self._choice

    @property
    def history(self) -> Window | None:
        """The newest samples without a fault, at most `longest`; None before the first window."""
        return self._history.window

    def push(self, window: Window) -> StructureChoice | None:
        """Take one window; return the new choice, if any."""
        settings, before = self.settings, self._history.window
        history = self._history.push(window)
        if before is None or history.first > before.last or history.last < before.last:
            self._chosen_at = None
        if len(history) < settings.least:
            return None
        if self._chosen_at is not None and history.last - self._chosen_at < settings.every:
            return None
        self._chosen_at = history.last
        self._choice = choose_structure(
            history,
            settings.models,
            previous=self._choice,
            noise=settings.noise,
            gains=settings.gains,
            decimals=settings.decimals,
            thorough=False,
        )
        return self._choice
