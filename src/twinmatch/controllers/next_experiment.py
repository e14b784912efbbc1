"""What next? The shortest safe course after which one knows most, from all twins of a family."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from twinmatch.controllers.answer import ControllerError
from twinmatch.controllers.courses import (
    ExperimentTerms,
    Staircase,
    plain_courses,
    staircases_within,
)
from twinmatch.controllers.experiment_search import (
    EFFORT,
    CourseWorth,
    ExperimentSearch,
    RatedCourse,
    bits_of,
    information_of,
)
from twinmatch.controllers.learning_goals import LearningGoal
from twinmatch.controllers.members import TriedTwin
from twinmatch.signals import FloatArray

NEARLY: Final = 0.9
"""Share of the most that can be known which the shortest course has to reach."""
LEAST: Final = 1.0
"""Least bits that make a course worth its time."""


@dataclass(frozen=True, eq=False)
class NextExperiment:
    """The course, and others of its length beside it."""

    goal: LearningGoal
    leader: TriedTwin
    terms: ExperimentTerms
    course: CourseWorth
    others: tuple[CourseWorth, ...]
    most: float
    """Bits of the best course of full length."""


def next_experiment(
    members: Sequence[TriedTwin],
    goal: LearningGoal,
    terms: ExperimentTerms,
    watch: Callable[[int, int], None] | None = None,
    *,
    running: FloatArray | None = None,
) -> NextExperiment:
    """The shortest course that brings nearly as much as the best; `watch` is called with work done and all.

    Nothing is moved, and the rest of a course that runs already, `running`, shape (N, c), is kept, unless
    the bands leave the range or another course brings a bit more.

    Raises:
        ControllerError: no course keeps to the range, or a twin cannot be held where it begins.
    """
    search = ExperimentSearch(members, goal, terms)
    ranked = _ranked_by_leaders(search, staircases_within(terms), watch)
    tried = _first_within_range(search, ranked)
    if not tried:
        low, high = terms.outputs
        raise ControllerError(
            f"experiment: no course keeps the bands of every twin within {low.tolist()} to {high.tolist()}; "
            "widen --within, or begin further from its ends"
        )
    if not goal.pairs:
        best_tried = sorted(tried, key=_missing_at_end)[: EFFORT.polished]
        tried += [search.polished(course, _missing_at_end) for course in best_tried]
    reach = min(NEARLY * max(float(course.curve.max()) for course in tried), goal.most)

    def delay(course: RatedCourse) -> float:
        """A cost that is least for the course that brings what is to be reached soonest."""
        return _delay(course.curve, reach)

    tried_staircases = {course.staircase for course in tried}
    for early in sorted(ranked, key=delay)[: 2 * EFFORT.few]:
        if early.staircase in tried_staircases:
            continue
        course = search.rated(early.staircase)
        if course is not None:
            tried.append(course)
    best = search.polished(min(tried, key=delay), delay)
    most = max(float(course.curve.max()) for course in tried)
    size = int(search.marks[min(_reaching(best.curve, reach), len(best.curve) - 1)])
    worth = _worth_unless_known(search, search.rows(best.staircase)[:size], running)
    others = [
        search.worth(name, rows)
        for name, rows in plain_courses(worth.rows, search.base, terms.levels).items()
    ]
    return NextExperiment(goal, members[0], terms, worth, tuple(others), most)


def _missing_at_end(course: RatedCourse) -> float:
    """A cost that is least for the course that brings most in its whole length."""
    return -float(course.curve[-1])


def _ranked_by_leaders(
    search: ExperimentSearch,
    table: Sequence[Staircase],
    watch: Callable[[int, int], None] | None,
) -> list[RatedCourse]:
    """The courses of the table within the range, by what they bring nearly; that of most first."""
    ranked = []
    for number, staircase in enumerate(table):
        course = search.rated(staircase, leaders=True)
        if course is not None:
            ranked.append(course)
        if watch is not None:
            watch(number, 2 * len(table))
    return sorted(ranked, key=_missing_at_end)


def _first_within_range(
    search: ExperimentSearch, ranked: Sequence[RatedCourse]
) -> list[RatedCourse]:
    """The first few courses that keep the bands of all twins within the range."""
    tried: list[RatedCourse] = []
    for ranked_course in ranked:
        course = search.rated(ranked_course.staircase)
        if course is not None:
            tried.append(course)
        if len(tried) == EFFORT.few:
            break
    return tried


def _worth_unless_known(
    search: ExperimentSearch, rows: FloatArray, running: FloatArray | None
) -> CourseWorth:
    """What a course is worth; or what moving nothing is, or what runs already, if that is hardly less."""
    best = search.worth("proposed", rows)
    calm = np.tile(search.base, (len(rows), 1))
    for alternative_rows in [calm] if running is None else [calm, running]:
        alternative = search.worth("proposed", alternative_rows)
        if alternative.within and alternative.bits > best.bits - LEAST:
            best = alternative
    return best


def bits_by(
    found: NextExperiment, outputs: FloatArray, inputs: FloatArray
) -> FloatArray:
    """What readings, shape (N, o), under commands, shape (N, m), say of each contender, in bits, shape
    (contenders,): of those to be told apart how well each predicted them, of others how much narrower their
    parameters are."""
    search = ExperimentSearch([found.leader], found.goal, found.terms)
    end = np.array([len(outputs)])
    bits = []
    for contender in found.goal.contenders:
        run = search.run(contender, outputs, inputs)
        information = information_of(run.slopes, end)
        if found.goal.pairs:
            miss = (outputs - run.outputs) / run.noise
            pull = np.einsum("ko,koi->i", miss, run.slopes)
            cost = np.sum(miss**2) - pull @ np.linalg.solve(information[0], pull)
            bits.append(-bits_of(information, 0)[0] - 0.5 * cost / math.log(2.0))
        else:
            bits.append(bits_of(information, len(contender.root))[0])
    return np.array(bits)


def _delay(curve: FloatArray, reach: float) -> float:
    """Mean share of what is to be reached that is missing, over the longest course."""
    return float(np.mean(np.maximum(reach - curve, 0.0))) / reach


def _reaching(curve: FloatArray, reach: float) -> int:
    """Number of the mark at which a course first reaches this much; that behind the last if it never does."""
    reached = np.flatnonzero(curve >= reach)
    return int(reached[0]) if reached.size else curve.size
