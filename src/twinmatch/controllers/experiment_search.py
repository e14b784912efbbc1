"""Courses run on all twins of a family, and rated by what they tell.

A twin's outputs under a course are taken as linear in what its recording leaves open. With J, their
derivatives by the open parameters in units of the noise, and P, the covariance of these, the course tells
½ log₂ det(I + P JᵀJ) bits of them. Commands are given: whatever the law did, readings differ from these
outputs by their noise alone. Of two twins, one saves as many bits as its rival's misses cost after the rival was
fitted again within its own P.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import permutations
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.controllers.answer import ControllerError
from twinmatch.controllers.courses import ExperimentTerms, Staircase
from twinmatch.controllers.learning_goals import ENOUGH, FAULTS, Contender, LearningGoal
from twinmatch.controllers.members import TriedTwin
from twinmatch.controllers.responses import state_holding, taken_by
from twinmatch.dynamics import (
    Law,
    LinearLaw,
    PlantError,
    TwoLevel,
    sensitivities,
    simulate_closed_loop,
)
from twinmatch.dynamics.pids import as_linear
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

_BAND: Final = 1.645
"""Half width of a band that holds nine in ten, standard deviations."""
_DIFFERENCE: Final = 0.01
"""Relative change of a drive's share that gives the derivative by it."""


class _Effort(Rule):
    """How much is tried, so that an operator waits for seconds: the whole table with the leaders, then only
    the best few with all twins, then the best of these with small movements, each half a step of the table or
    less."""

    marks: int = 60
    """Ends of a course that are considered."""
    few: int = 4
    """Courses of the table that are tried with all twins."""
    polished: int = 2
    """How many of these are polished."""
    movements: tuple[float, ...] = (0.1, 0.03)
    """Movements of levels and times in polishing, as shares of their ranges."""


EFFORT: Final = _Effort()


class PredictedRun(NamedTuple):
    """What a contender does over a course."""

    outputs: FloatArray
    """Shape (N, o)."""
    inputs: FloatArray
    """The commands, shape (N, m)."""
    slopes: FloatArray
    """Derivatives of the outputs, in units of their noise, by what is open, in units of its spread; shape
    (N, o, n)."""
    noise: FloatArray
    """Standard deviations of readings, shape (o,)."""

    @property
    def bands(self) -> FloatArray:
        """Half widths of the bands of the readings, shape (N, o)."""
        return np.asarray(
            _BAND * self.noise * np.sqrt(1.0 + np.sum(self.slopes**2, axis=2))
        )

    def within(self, ends: FloatArray) -> bool:
        """Whether the bands stay in a range, shape (2, o)."""
        low = self.outputs - self.bands
        high = self.outputs + self.bands
        return bool((low >= ends[0]).all() and (high <= ends[1]).all())


class CourseWorth(NamedTuple):
    """What a course brings."""

    name: str
    rows: FloatArray
    """Set-points or inputs, shape (N, c)."""
    bits: float
    within: bool
    """Whether every band stays in the range."""
    spreads: FloatArray
    """Standard deviations of the leader's open parameters after it, shape (n,)."""
    runs: tuple[PredictedRun, ...]
    """What each twin of the family does."""


class RatedCourse(NamedTuple):
    """A course and the bits that it brings."""

    curve: FloatArray
    """Bits up to every mark."""
    staircase: Staircase


class _Start(NamedTuple):
    """How a contender begins every course."""

    states: FloatArray
    """Shape (n,)."""
    inputs: FloatArray
    """Those that act, shape (m,)."""
    law: Law | None = None
    """The law, on drives as weak as the contender's; None: the commands are given."""
    controller: FloatArray | None = None
    """State of the law."""


class ExperimentSearch:
    """Runs courses on all twins of a family, and rates them by a goal."""

    def __init__(
        self, members: Sequence[TriedTwin], goal: LearningGoal, terms: ExperimentTerms
    ) -> None:
        self.goal = goal
        self.terms = terms
        contending = [contender.twin for contender in goal.contenders]
        self.others = [Contender(twin) for twin in members if twin not in contending]
        self.family = [Contender(twin) for twin in members]
        law = terms.holding.law
        if law is not None:
            plant = members[0].parameters.model.plant
            law = taken_by(plant, law if isinstance(law, TwoLevel) else as_linear(law))
        self.law = law
        self.starts = {
            contender: _start(contender, terms, law)
            for contender in (*goal.contenders, *self.others, *self.family)
        }
        leader_start = self.starts[self.family[0]]
        self.base = terms.before if law is not None else leader_start.inputs
        self.marks = np.unique(
            np.linspace(1, terms.size, EFFORT.marks).round().astype(int)
        )

    def rows(self, staircase: Staircase) -> FloatArray:
        """The set-points or inputs of a course, shape (N, signals)."""
        return staircase.rows(self.base, self.terms.levels, self.terms.size)

    def curve(
        self, staircase: Staircase, *, leaders: bool = False
    ) -> FloatArray | None:
        """Bits at every mark, of the leaders nearly; None if a band leaves the range."""
        rows = self.rows(staircase)
        contenders = self.goal.contenders
        if leaders and not self.goal.pairs:
            contenders = contenders[:1]
        runs = [self.run(contender, rows) for contender in contenders]
        if not all(run.within(self.terms.outputs) for run in runs):
            return None
        if not leaders and not all(
            self.run(twin, rows).within(self.terms.outputs) for twin in self.others
        ):
            return None
        return self._bits(runs, self.marks, from_one_side=leaders)

    def rated(
        self, staircase: Staircase, *, leaders: bool = False
    ) -> RatedCourse | None:
        """A course with its curve; None if a band leaves the range."""
        curve = self.curve(staircase, leaders=leaders)
        return None if curve is None else RatedCourse(curve, staircase)

    def polished(
        self, course: RatedCourse, cost: Callable[[RatedCourse], float]
    ) -> RatedCourse:
        """The course of least cost that small movements of levels and times lead to."""
        best = course
        for movement in EFFORT.movements:
            for moved in best.staircase.moved(movement):
                moved_course = self.rated(moved)
                if moved_course is not None and cost(moved_course) < cost(best):
                    best = moved_course
        return best

    def worth(self, name: str, rows: FloatArray) -> CourseWorth:
        """What a course brings, shape (N, c), and what it tells of the leader's parameters."""
        runs = [self.run(contender, rows) for contender in self.goal.contenders]
        family = tuple(self.run(twin, rows) for twin in self.family)
        is_within = all(run.within(self.terms.outputs) for run in (*runs, *family))
        end = np.array([len(rows)])
        root = self.family[0].root
        n = len(root)
        open_share = np.linalg.inv(information_of(family[0].slopes, end)[0])[:n, :n]
        covariance = root @ open_share @ root.T
        bits = float(self._bits(runs, end)[0])
        return CourseWorth(
            name, rows, bits, is_within, np.sqrt(np.diag(covariance)), family
        )

    def run(
        self, contender: Contender, rows: FloatArray, commands: FloatArray | None = None
    ) -> PredictedRun:
        """A contender over a course, or under these commands."""
        twin = contender.twin
        model = twin.parameters.model
        share = contender.share
        states = self.starts[contender].states
        steady = np.tile(model.disturbance_row(twin.disturbances), (len(rows), 1))
        sent = self._commands(contender, rows, steady) if commands is None else commands
        free = twin.free if twin.covariance is not None else ()

        def under(drive_share: float) -> tuple[FloatArray, FloatArray]:
            """Outputs and their derivatives if the drives do this share of the commands."""
            acting = model.rest + drive_share * (sent - model.rest)
            return sensitivities(
                twin.parameters,
                free,
                acting,
                states,
                period=self.terms.holding.period,
                disturbances=steady,
            )

        outputs, derivatives = under(share)
        slopes = derivatives @ contender.root if free else derivatives
        if share != 1.0:
            moved_outputs = under(share * (1.0 + _DIFFERENCE))[0]
            by_share = (moved_outputs - outputs) / _DIFFERENCE * FAULTS.unsure
            slopes = np.concatenate([slopes, by_share[:, :, None]], axis=2)
        noise = model.noise if twin.noise is None else twin.noise
        slopes = slopes / noise[:, None]
        if self.terms.offset:
            by_offset = np.tile(
                self.terms.offset * np.eye(noise.size), (len(outputs), 1, 1)
            )
            slopes = np.concatenate([slopes, by_offset], axis=2)
        return PredictedRun(outputs, sent, slopes, noise)

    def _commands(
        self, contender: Contender, rows: FloatArray, steady: FloatArray
    ) -> FloatArray:
        """The commands over a course, shape (N, m): those of the law; without one the course itself."""
        start = self.starts[contender]
        if start.law is None:
            return rows
        parameters = contender.twin.parameters
        run = simulate_closed_loop(
            parameters,
            rows,
            states=start.states,
            law=start.law,
            controller=start.controller,
            disturbances=steady,
        )
        rest = parameters.model.rest
        return np.asarray(rest + (run.inputs - rest) / contender.share)

    def _bits(
        self,
        runs: Sequence[PredictedRun],
        marks: NDArray[np.int64],
        *,
        from_one_side: bool = False,
    ) -> FloatArray:
        """What is known at these ends of a course.

        With `from_one_side`, a pair is compared from one side only, which is nearly as far apart as from the
        other.
        """
        if self.goal.pairs:
            nearest = self._nearest_rivals(runs, marks, from_one_side=from_one_side)
            return np.asarray(np.mean(np.minimum(nearest, ENOUGH), axis=0))
        learned = [self._learned(k, run, marks) for k, run in enumerate(runs)]
        return np.asarray(np.mean(learned, axis=0))

    def _nearest_rivals(
        self,
        runs: Sequence[PredictedRun],
        marks: NDArray[np.int64],
        *,
        from_one_side: bool,
    ) -> list[FloatArray]:
        """Of every contender, the bits that its nearest rival loses."""
        apart: dict[tuple[int, int], FloatArray] = {}
        for a, b in permutations(range(len(runs)), 2):
            if from_one_side and a > b:
                apart[a, b] = apart[b, a]
            else:
                apart[a, b] = self._apart(runs[a], self.goal.contenders[b], marks)
        nearest = []
        for a in range(len(runs)):
            nearest.append(
                np.min([apart[a, b] for b in range(len(runs)) if b != a], axis=0)
            )
        return nearest

    def _learned(
        self, k: int, run: PredictedRun, marks: NDArray[np.int64]
    ) -> FloatArray:
        """Bits that a course tells of contender number k: of its open parameters, or of the
        combination that is asked for."""
        information = information_of(run.slopes, marks)
        root = self.goal.contenders[k].root
        if not self.goal.directions:
            return bits_of(information, len(root))
        direction = np.zeros(information.shape[1])
        direction[: len(root)] = root.T @ self.goal.directions[k]
        repeated = np.tile(direction, (len(marks), 1))[:, :, None]
        left_open = np.linalg.solve(information, repeated)[:, :, 0] @ direction
        return np.asarray(0.5 * np.log2(direction @ direction / left_open))

    def _apart(
        self, run: PredictedRun, rival: Contender, marks: NDArray[np.int64]
    ) -> FloatArray:
        """Bits that a contender's readings cost its rival, fitted to them again, at these ends."""
        rival_run = self.run(rival, run.outputs, run.inputs)
        miss = (run.outputs - rival_run.outputs) / rival_run.noise
        information = information_of(rival_run.slopes, marks)
        by_sample = np.einsum("ko,koi->ki", miss, rival_run.slopes)
        pull = np.cumsum(by_sample, axis=0)[marks - 1]
        moved = np.linalg.solve(information, pull[:, :, None])[:, :, 0]
        explained = np.einsum("ki,ki->k", pull, moved)
        squares = np.cumsum(np.sum(miss**2, axis=1))[marks - 1]
        return np.asarray(0.5 * (squares - explained) / math.log(2.0))


def information_of(slopes: FloatArray, marks: NDArray[np.int64]) -> FloatArray:
    """I + JᵀJ of the samples before every mark, shape (marks, n, n)."""
    sums = np.cumsum(np.einsum("koi,koj->kij", slopes, slopes), axis=0)[marks - 1]
    return np.asarray(np.eye(slopes.shape[2]) + sums)


def bits_of(whole: FloatArray, known: int) -> FloatArray:
    """What readings tell of the first parameters, given I + JᵀJ of all, shape (marks, n, n)."""
    nuisance = whole[:, known:, known:]
    return np.asarray(
        0.5
        * (np.linalg.slogdet(whole)[1] - np.linalg.slogdet(nuisance)[1])
        / math.log(2.0)
    )


def _start(contender: Contender, terms: ExperimentTerms, law: Law | None) -> _Start:
    """Where a contender begins, with the law in the state that holds it there."""
    states, inputs = _held_at(contender, terms)
    if law is None:
        return _Start(states, inputs)
    parameters = contender.twin.parameters
    model = parameters.model
    if contender.share != 1.0:
        law = _weakened(law, contender.share, model.rest)
    row = model.disturbance_row(contender.twin.disturbances)
    outputs, _ = model.kernels.outputs_at(parameters.vector, states, inputs, row)
    return _Start(
        states, inputs, law, state_holding(law, terms.before, outputs, inputs)
    )


def _held_at(
    contender: Contender, terms: ExperimentTerms
) -> tuple[FloatArray, FloatArray]:
    """States and acting inputs at the first sample: the twin's own, or where it is held."""
    twin = contender.twin
    if twin.states is not None and twin.inputs is not None:
        return twin.states, twin.inputs
    try:
        rest_point = terms.holding.linear(
            twin.parameters, terms.before.tolist(), twin.disturbances
        ).rest
    except PlantError as error:
        raise ControllerError(f"experiment: {twin.name}: {error}") from error
    return rest_point.states, rest_point.inputs


def _weakened(law: Law, share: float, rest: FloatArray) -> Law:
    """The same law if its drives do a share of what they are given."""
    if isinstance(law, TwoLevel):
        off = float(rest[0] + share * (law.off - rest[0]))
        on = float(rest[0] + share * (law.on - rest[0]))
        return replace(law, off=off, on=on)
    assert isinstance(law, LinearLaw)  # noqa: S101
    of_rest = (1.0 - share) * rest
    return replace(
        law,
        C=share * law.C,
        D=share * law.D,
        E=share * law.E,
        G=law.G / share,
        offset=share * law.offset + of_rest,
        shift=law.shift - law.G @ of_rest / share,
        low=share * law.low + of_rest,
        high=share * law.high + of_rest,
        drives=None if law.drives is None else share * law.drives + of_rest,
    )
