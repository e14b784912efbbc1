"""A lesson: what one session has taught about the plant in one of its structures."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import NoReturn

import numpy as np

from twinmatch.dynamics import Plant
from twinmatch.errors import TwinmatchError
from twinmatch.signals import FloatArray

Span = tuple[float, float]
"""The lowest and the highest value."""


class MemoryFaultError(TwinmatchError):
    """A memory, or a lesson in it, cannot be used; the message says which, and what to do."""


@dataclass(frozen=True)
class Lesson:
    """What a session has taught about one structure of its plant, up to its first fault.

    Raises:
        MemoryFaultError: parameters, names and covariance do not belong together.
    """

    session: str
    """Digest of the session's samples: the same recording under another name is the same session."""
    name: str
    """Name of the session."""
    plant: str
    equations: str
    """Digest of the structure's equations: `Model.equations`."""
    rig: str
    """Which of several plants of this kind; empty if not named."""
    structure: str
    began: int
    """Stamp of the first sample, ns since the epoch of its clock."""
    duration: float
    """Length of the healthy part, s."""
    samples: int
    """Healthy samples, without lost and refused ones."""
    parameters: Mapping[str, float]
    """Values of all parameters of the structure."""
    free: tuple[str, ...]
    """Names of those that were fitted."""
    covariance: tuple[tuple[float, ...], ...]
    """Of the free ones, in their units squared, shape (n, n): for correlated residuals, and including what
    the parts of the session disagree about."""
    outputs: tuple[Span, ...]
    """Lowest and highest reading of each output."""
    inputs: tuple[Span, ...]
    led: bool
    """Whether this structure led at the end."""
    chosen: bool
    """Whether the criteria chose it."""
    level: str
    """Level of trust of the session's last verdict before a fault, as a word; empty without one."""
    horizons: tuple[float, ...] = ()
    """Horizons of the forecasts, s; empty if the structure did not compete."""
    persistence_skill: tuple[float, ...] = ()
    """At each horizon, 1 − (mean |error|) / (that of a forecast of no change); NaN: too few were compared."""
    arx_skill: tuple[float, ...] = ()
    """The same beside an ARX model."""
    fault_at: int | None = None
    """First sample of the first fault; None without one."""

    def __post_init__(self) -> None:
        n = len(self.free)
        covariances = list(chain.from_iterable(self.covariance))
        numbers = [
            *covariances,
            *self.parameters.values(),
            *chain.from_iterable(self.outputs),
        ]
        if (
            len(covariances) != n * n
            or not n
            or not self.parameters.keys() >= {*self.free}
        ):
            self._refuse(
                f"{n} free parameters and {len(covariances)} covariances do not belong together"
            )
        if not all(map(math.isfinite, numbers)):
            self._refuse("a value is not finite")
        if not self.outputs or min(covariances[:: n + 1]) < 0.0:
            self._refuse("it has no outputs, or a negative variance")

    def _refuse(self, why: str) -> NoReturn:
        place = f"lesson of {self.name}, {self.structure}"
        raise MemoryFaultError(
            f"{place}: {why}; forget the session, and remember it again"
        )

    @property
    def values(self) -> FloatArray:
        """Values of the free parameters, shape (n,)."""
        return np.array([self.parameters[name] for name in self.free])

    @property
    def deviations(self) -> FloatArray:
        """Standard deviations of the free parameters, shape (n,)."""
        return np.sqrt(np.diag(np.array(self.covariance)))


def current_lessons(lessons: Iterable[Lesson], plant: type[Plant]) -> list[Lesson]:
    """Those on structures that the plant still has, with the same equations and free parameters."""
    current = []
    for lesson in lessons:
        if lesson.plant == plant.name and lesson.structure in plant.structures:
            model = plant.model(lesson.structure)
            if (
                lesson.equations == model.equations
                and lesson.free == model.structure.free
            ):
                current.append(lesson)
    return current


def in_order(lessons: Iterable[Lesson]) -> list[Lesson]:
    """Lessons from the oldest to the newest; sessions without a date by their names, numbers as numbers."""
    return sorted(
        lessons,
        key=lambda lesson: (lesson.began, natural(lesson.name), lesson.structure),
    )


def natural(name: str) -> str:
    """The name with its numbers so long that names are in the order of their numbers."""
    return re.sub(r"\d+", lambda number: number[0].rjust(20, "0"), name)
