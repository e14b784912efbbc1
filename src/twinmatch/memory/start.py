"""What a session starts with: the twins of earlier sessions, and the centre of all with their spread."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from twinmatch.comparing import Candidate
from twinmatch.dynamics import Model, Plant, PlantError
from twinmatch.memory.lesson import Lesson, current_lessons, in_order
from twinmatch.settings import Rule
from twinmatch.signals import MEDIAN_TO_SIGMA, FloatArray

CENTRE: Final = "remembered"
"""Name of the candidate with the central values of all sessions."""
MAX_SESSIONS: Final = 12
"""Newest sessions that count: a plant ages."""
MAX_TWINS: Final = 4
"""Twins of single sessions that forecast from the first sample on; each costs time at every forecast."""


class _BetweenSessions(Rule):
    """The spread between sessions of one plant. Before any was seen, 15 % are expected; that counts as one
    session, so that few sessions do not look more alike than they are."""

    expected: float = 0.15
    """Expected spread of a parameter, relative to its size."""
    clipped: float = 3.0
    """Deviations from the median are clipped at so many usual ones: one odd session widens nothing."""


_BETWEEN: Final = _BetweenSessions()


def start_from(lessons: Iterable[Lesson], plant: type[Plant]) -> list[Candidate]:
    """The remembered candidates for a session of this plant; empty without lessons that fit its equations.

    First comes the centre of the structure that led, and was trusted, at the end of most of the newest
    sessions, then twins of single sessions in it, the newest and those farthest from what is there already;
    then the centres of the other structures. The covariance of all of them is the spread between sessions.
    """
    by_structure = _newest_by_structure(lessons, plant)
    led = {
        structure: sum(
            lesson.led and lesson.level == "trusted" for lesson in lessons_of_it
        )
        for structure, lessons_of_it in by_structure.items()
    }
    order = sorted(by_structure, key=lambda structure: led[structure], reverse=True)
    if not order or not led[order[0]]:
        return []
    candidates = _remembered(by_structure[order[0]], plant.model(order[0]))
    for structure in order[1:]:
        centre = _remembered(by_structure[structure], plant.model(structure))[0]
        candidates.append(
            replace(centre, name=f"{CENTRE}, {centre.parameters.model.structure_name}")
        )
    return candidates


def _newest_by_structure(
    lessons: Iterable[Lesson], plant: type[Plant]
) -> dict[str, list[Lesson]]:
    """The lessons of the newest sessions that the plant still allows, by structure."""
    usable = [
        lesson
        for lesson in in_order(current_lessons(lessons, plant))
        if _possible(lesson, plant)
    ]
    newest = list(dict.fromkeys(lesson.session for lesson in reversed(usable)))[
        :MAX_SESSIONS
    ]
    by_structure: dict[str, list[Lesson]] = {}
    for lesson in usable:
        if lesson.session in newest:
            by_structure.setdefault(lesson.structure, []).append(lesson)
    return by_structure


def _remembered(lessons: Sequence[Lesson], model: Model) -> list[Candidate]:
    """The centre of sessions in one structure, and twins of some of them."""
    free = model.structure.free
    values = np.array([lesson.values for lesson in lessons])
    levels = [float(np.mean(lesson.outputs[0])) for lesson in lessons]
    centre = np.median(values, axis=0)
    spread = spread_of(values, centre, model)
    covariance = np.diag(np.square(spread))
    base = dict(lessons[-1].parameters) | dict(zip(free, centre.tolist(), strict=True))
    central = Candidate(
        CENTRE,
        float(np.median(levels)),
        model.parameters(**base),
        None,
        free,
        covariance,
    )
    places = _apart((values - centre) / spread)
    twins = []
    for k, title in zip(
        places, _titles([lessons[k].name for k in places]), strict=True
    ):
        parameters = model.parameters(**lessons[k].parameters)
        twins.append(Candidate(title, levels[k], parameters, None, free, covariance))
    return [central, *twins]


def _titles(sessions: Sequence[str]) -> list[str]:
    """A title for the twin of each of these sessions, several of which may have one name."""
    titles = []
    for number, name in enumerate(sessions):
        earlier = sessions[:number].count(name)
        titles.append(
            f"session {name} ({earlier + 1})" if earlier else f"session {name}"
        )
    return titles


def spread_of(values: FloatArray, centre: FloatArray, model: Model) -> FloatArray:
    """Standard deviation of the free parameters between sessions, (n,), from values (sessions, n)."""
    declared = [model.declared[name] for name in model.structure.free]
    usual_sizes = []
    for value, parameter in zip(centre, declared, strict=True):
        size = abs(value) if parameter.relative else parameter.scale
        usual_sizes.append(size or parameter.scale)
    usual = _BETWEEN.expected * np.array(usual_sizes)
    away = np.abs(values - centre)
    most = _BETWEEN.clipped * np.maximum(
        MEDIAN_TO_SIGMA * np.median(away, axis=0), usual / _BETWEEN.clipped
    )
    squares = np.square(np.minimum(away, most)).sum(axis=0)
    return np.asarray(np.sqrt((squares + np.square(usual)) / len(values)))


def _possible(lesson: Lesson, plant: type[Plant]) -> bool:
    """Whether the plant still allows the values of a lesson."""
    try:
        plant.model(lesson.structure).parameters(**lesson.parameters)
    except PlantError:
        return False
    return True


def _apart(places: FloatArray) -> list[int]:
    """The newest of the sessions, and those farthest from the centre and from those already taken; `places`
    are relative to the centre, in units of the spread, shape (sessions, n)."""
    chosen = [len(places) - 1]
    while len(chosen) < min(MAX_TWINS, len(places)):
        occupied = np.vstack([np.zeros_like(places[:1]), places[chosen]])
        distance = np.linalg.norm(places[:, None] - occupied, axis=2).min(axis=1)
        distance[chosen] = -1.0
        chosen.append(int(np.argmax(distance)))
    return chosen
