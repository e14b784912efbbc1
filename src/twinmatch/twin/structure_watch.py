"""Which structure the plant has, asked again and again while samples come in."""

from __future__ import annotations

from dataclasses import dataclass

from twinmatch.dynamics import FILED, Closing, Model, Plant
from twinmatch.errors import TwinmatchError
from twinmatch.matching import Noise
from twinmatch.signals import Window
from twinmatch.twin.history import History
from twinmatch.twin.structures import StructureChoice, choose_structure

__all__ = ["StructureSettings", "StructureWatch", "watched"]


@dataclass(frozen=True)
class StructureSettings:
    """What to look for, when to look, and at how much.

    Raises:
        TwinmatchError: the counts do not go together.
    """

    models: tuple[Model, ...]
    """The plant in each structure that is tried."""
    least: int = 900
    """Samples wanted before the first look."""
    every: int = 1200
    """Samples between two looks."""
    longest: int = 1200
    """Newest samples that are looked at."""
    noise: Noise | None = None
    gains: Closing = FILED
    decimals: int = 2

    def __post_init__(self) -> None:
        if not (100 <= self.least <= self.longest and self.every >= 1 and self.models):
            msg = (
                f"structure watch: least {self.least} samples must be 100 or more and not above longest "
                f"{self.longest}, every {self.every} positive, and there must be a structure to try"
            )
            raise TwinmatchError(msg)


def watched(plant: type[Plant]) -> tuple[Model, ...]:
    """The plant in those structures that its file wants watched beside a running plant."""
    return tuple(plant.model(name) for name, structure in plant.structures.items() if structure.watched)


class StructureWatch:
    """Keeps the newest samples and chooses a structure every so many of them.

    Give it every window of the schedule that shows no fault, in order. Windows may overlap or follow one
    another; after a gap the record begins anew. Looks at samples that do not overlap add their evidence, so
    that a stretch which tells little does not turn the choice over. All depends on the samples alone, so a
    replay chooses as the live twin did.
    """

    def __init__(self, settings: StructureSettings) -> None:
        """Begin with no samples."""
        self.settings = settings
        self._history = History(settings.longest)
        self._looked: int | None = None
        self._choice: StructureChoice | None = None

    @property
    def choice(self) -> StructureChoice | None:
        """The newest choice, if there is one yet."""
        return self._choice

    @property
    def history(self) -> Window | None:
        """The newest samples without a fault, as many as are looked at; None before the first window."""
        return self._history.window

    def push(self, window: Window) -> StructureChoice | None:
        """Take one window; return the choice it brought about, if any."""
        settings, before = self.settings, self._history.window
        history = self._history.push(window)
        if before is None or history.first > before.last or history.last < before.last:
            self._looked = None
        if len(history) < settings.least:
            return None
        if self._looked is not None and history.last - self._looked < settings.every:
            return None
        self._looked = history.last
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
