"""What a session starts with: the twins of earlier sessions, and the centre of all with their spread."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from twinmatch.comparing import Candidate
from twinmatch.dynamics import Model, Plant, PlantError
from twinmatch.memory.lesson import Lesson, current_lessons, in_order
from twinmatch.signals import MEDIAN_TO_SIGMA, FloatArray

CENTRE: Final = "remembered"
"""Name of the candidate with the central values of all sessions."""
MAX_SESSIONS: Final = 12
"""Newest sessions that count: a plant ages."""
MAX_TWINS: Final = 4
"""Twins of single sessions that forecast from the first sample on; each costs time at every forecast."""
_EXPECTED: Final = 0.15
"""Spread that is expected of one plant's parameters before any was seen, relative to their size: it counts as
one session, so that few sessions do not look more alike than they are."""
_FAR: Final = 3.0
"""Deviations from the median are clipped at so many usual ones: one odd session widens nothing."""


def start_from(lessons: Iterable[Lesson], plant: type[Plant]) -> list[Candidate]:
    """The remembered candidates for a session of this plant; empty without lessons that fit its equations.

    First comes the centre of the structure that led, and was trusted, at the end of most of the newest
    sessions, then twins of single sessions in it, the newest and those farthest from what is there already;
    then the centres of the other structures. The covariance of all of them is the spread between sessions.
    """
    usable = [each for each in in_order(current_lessons(lessons, plant)) if _possible(each, plant)]
    newest = list(dict.fromkeys(lesson.session for lesson in reversed(usable)))[:MAX_SESSIONS]
    of: dict[str, list[Lesson]] = {}
    for lesson in usable:
        if lesson.session in newest:
            of.setdefault(lesson.structure, []).append(lesson)
    led = {name: sum(one.led and one.level == "trusted" for one in each) for name, each in of.items()}
    order = sorted(of, key=lambda structure: led[structure], reverse=True)
    if not order or not led[order[0]]:
        return []
    (centre, *twins), *others = (_remembered(of[structure], plant.model(structure)) for structure in order)
    rest = (replace(other, name=f"{CENTRE}, {other.parameters.model.structure_name}") for other, *_ in others)
    return [centre, *twins, *rest]


def _remembered(lessons: Sequence[Lesson], model: Model) -> list[Candidate]:
    """The centre of sessions in one structure, and twins of some of them."""
    free = model.structure.free
    values = np.array([lesson.values for lesson in lessons])
    levels = [float(np.mean(lesson.outputs[0])) for lesson in lessons]
    centre = np.median(values, axis=0)
    spread = spread_of(values, centre, model)
    covariance = np.diag(np.square(spread))
    base = dict(lessons[-1].parameters) | dict(zip(free, centre.tolist(), strict=True))
    central = Candidate(CENTRE, float(np.median(levels)), model.parameters(**base), None, free, covariance)
    places = _apart((values - centre) / spread)
    twins = []
    names = [f"session {lessons[k].name}" for k in places]
    for number, (k, name) in enumerate(zip(places, names, strict=True)):
        again = names[:number].count(name)  # sessions may have one name
        called = f"{name} ({again + 1})" if again else name
        own = model.parameters(**lessons[k].parameters)
        twins.append(Candidate(called, levels[k], own, None, free, covariance))
    return [central, *twins]


def spread_of(values: FloatArray, centre: FloatArray, model: Model) -> FloatArray:
    """Standard deviation of the free parameters between sessions, (n,), from values (sessions, n)."""
    declared = [model.declared[name] for name in model.structure.free]
    sizes = [abs(c) if each.relative else each.scale for c, each in zip(centre, declared, strict=True)]
    usual = _EXPECTED * np.array([size or each.scale for size, each in zip(sizes, declared, strict=True)])
    away = np.abs(values - centre)
    most = _FAR * np.maximum(MEDIAN_TO_SIGMA * np.median(away, axis=0), usual / _FAR)
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
    taken = [len(places) - 1]
    while len(taken) < min(MAX_TWINS, len(places)):
        others = np.vstack([np.zeros_like(places[:1]), places[taken]])
        distance = np.linalg.norm(places[:, None] - others, axis=2).min(axis=1)
        distance[taken] = -1.0
        taken.append(int(np.argmax(distance)))
    return taken
