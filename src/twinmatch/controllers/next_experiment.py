"""What next? The shortest safe course after which one knows most, from all twins of a family.

A twin's outputs under a course are taken as linear in what its recording leaves open. With J, their
derivatives by the open parameters in units of the noise, and P, the covariance of these, the course tells
½ log₂ det(I + P JᵀJ) characters (of one bit each) of them. Commands are given: whatever the law did, readings
differ from these outputs by their noise alone. Of two twins, one saves as many characters as its rival's
misses cost after the rival was fitted again within its own P.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, permutations, product
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.controllers.answer import ControllerAnswer, ControllerError
from twinmatch.controllers.members import Holding, TriedTwin
from twinmatch.controllers.responses import counted_range, state_holding, taken_by
from twinmatch.controllers.stability import UNBOUNDED, MemberStability
from twinmatch.dynamics import (
    Law,
    LinearLaw,
    Plant,
    PlantError,
    TwoLevel,
    sensitivities,
    simulate_closed_loop,
)
from twinmatch.dynamics.pace import plant_scale
from twinmatch.dynamics.pids import as_linear
from twinmatch.signals import FloatArray

NEARLY: Final = 0.9
"""Share of the most that can be known which the shortest course has to reach."""
LEAD: Final = 5.0
"""Nats by which a structure has to lead to be decided: twice as much is twice the logarithm of the odds from
which on the other has no support (Burnham and Anderson 2002)."""
_NINE_IN_TEN: Final = 1.2816
ENOUGH: Final = (
    0.5 * (_NINE_IN_TEN + math.sqrt(_NINE_IN_TEN**2 + 2.0 * LEAD)) ** 2 / math.log(2.0)
)
"""Expected characters after which nine of ten runs decide: noise moves a lead of n nats by √(2 n)."""
MIN_COURSE: Final = 30
"""Least samples of an experiment."""
LEAST: Final = 1.0
"""Least characters that make a course worth its time."""
_BAND: Final = 1.645
"""Half width of a band that holds nine in ten, standard deviations."""
_SHARES: Final = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Levels of the table, as shares of their range."""
_STEPS: Final = (2, 4, 8)
"""How often a course of the table steps between two levels."""
_PLAIN: Final = 0.1
"""Size of a plain step, as a share of the range."""
_DIFFERENCE: Final = 0.01
"""Relative change of a drive's share that gives the derivative by it."""


@dataclass(frozen=True, slots=True)
class _CourseLength:
    """Length of an experiment: six time constants, if these are not too many samples."""

    usual: int = 600
    """Length, s, on a plant with a time constant of 100 s."""
    most: int = 20_000
    """Samples, at most."""


_LENGTH: Final = _CourseLength()


@dataclass(frozen=True, slots=True)
class _Effort:
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


@dataclass(frozen=True, slots=True)
class _ConfusedFaults:
    """A weak drive and grown losses that leave one mark.

    Where losses that have grown to their most need less than the drive lacks, the drive is as weak as they
    allow, but not so little that a twin which is right could be meant.
    """

    share: float = 0.8
    """What a drive does that has become weak, as a share."""
    growth: float = 4.0
    """The largest factor by which losses may have grown."""
    right: float = 0.9
    """Share of a command about which a twin is right."""
    near: float = 0.01
    """Difference of commands that leave the same mark, as a share."""
    unsure: float = 0.25
    """Standard deviation of a fault's size, as a share of what it changes."""


_EFFORT: Final = _Effort()
_FAULTS: Final = _ConfusedFaults()


@dataclass(frozen=True, eq=False)
class ExperimentTerms:
    """What a course may do, and where it begins."""

    holding: Holding
    """How the plant is held; set-points of its law are planned, without a law inputs."""
    before: FloatArray
    """Outputs, and with a law set-points, until now, shape (o,)."""
    size: int
    """Samples of a course, at most."""
    levels: FloatArray
    """Lowest and highest planned set-points or inputs, shape (2, c)."""
    outputs: FloatArray
    """Ends of the range that no band may leave, shape (2, o)."""
    offset: float = 2.0
    """Standard deviation of what stays between readings and a twin that is right, such as what a sensor does
    not resolve, in the outputs' noise."""

    @classmethod
    def of(
        cls,
        plant: type[Plant],
        holding: Holding,
        before: FloatArray,
        *,
        size: int | None = None,
        within: Sequence[float] | None = None,
        ranges: Sequence[tuple[float, float]] = (),
    ) -> ExperimentTerms:
        """What a plant allows: the outputs stay where it is safe, and `within` these ends; a course of `size`
        samples, by default in proportion to the plant's time constant; set-points in these `ranges`.

        Raises:
            ControllerError: the range is empty, or the course too short or too long.
        """
        period = holding.period
        size = size or round(_LENGTH.usual * plant_scale(plant, period) / period)
        if not MIN_COURSE <= size <= _LENGTH.most:
            raise ControllerError(
                f"experiment: {size} samples of {period:g} s; give {MIN_COURSE} to {_LENGTH.most} of them"
            )
        low, high = np.array(
            [counted_range(output) for output in plant.outputs.values()]
        ).T
        if within is not None:
            low = np.maximum(low, within[0])
            high = np.minimum(high, within[1])
        if not (low < high).all():
            raise ControllerError(
                "experiment: the range leaves nothing of the safe one; give LOW below HIGH, inside it"
            )
        if holding.law is None:
            levels = np.array([drive.limits for drive in plant.drives.values()]).T
        else:
            spans = np.array(
                [output.set_points or output.span for output in plant.outputs.values()]
            ).T
            levels = np.clip(spans, low, high)
            if ranges:
                levels = np.clip(levels, *np.transpose(ranges))
        return cls(holding, before, size, levels, np.array([low, high]))


class Staircase(NamedTuple):
    """A course of levels, each held until the next."""

    shares: tuple[float, ...]
    """Levels, as shares of their range."""
    ends: tuple[float, ...]
    """Where each ends, as a share of the course; the last one is 1."""
    column: int
    """The set-point or input that moves; -1: all, each later than the one before."""

    def rows(self, base: FloatArray, levels: FloatArray, size: int) -> FloatArray:
        """Its levels, sample by sample, shape (N, c); others stay as in `base`, shape (c,)."""
        rows = np.tile(base, (size, 1))
        m = base.size
        low, high = levels
        for j in range(m) if self.column < 0 else [self.column]:
            delay = round(size * self.ends[0] * j / m) if self.column < 0 else 0
            ends = np.minimum(
                np.round(np.multiply(self.ends, size)).astype(int) + delay, size
            )
            for share, first, end in zip(
                self.shares, (delay, *ends), ends, strict=False
            ):
                rows[first:end, j] = low[j] + share * (high[j] - low[j])
        return rows

    def moved(self, by: float) -> Iterator[Staircase]:
        """The same with one level or time moved by so much, up or down."""
        for k, movement in product(range(len(self.shares)), (by, -by)):
            shares = list(self.shares)
            shares[k] = min(max(shares[k] + movement, 0.0), 1.0)
            yield self._replace(shares=tuple(shares))
            ends = list(self.ends)
            if k < len(ends) - 1:
                ends[k] += movement
                if all(first < end for first, end in pairwise([0.0, *ends])):
                    yield self._replace(ends=tuple(ends))


class Contender(NamedTuple):
    """A twin that may be the plant, with drives that do a share of what they are given."""

    twin: TriedTwin
    share: float = 1.0


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


@dataclass(frozen=True, eq=False)
class LearningGoal:
    """What is to be known."""

    name: str
    contenders: tuple[Contender, ...]
    pairs: bool = False
    """Whether the contenders are to be told apart; else the open parameters of each are to be known."""
    directions: tuple[FloatArray, ...] = ()
    """If not empty, one combination of each contender's open parameters is to be known: its derivatives by
    these, shape (n,)."""

    def label(self, k: int) -> str:
        """A contender by what it is suspected of."""
        twin = self.contenders[k].twin
        return (
            twin.parameters.model.structure_name
            if self.name == "structure"
            else twin.name
        )

    @property
    def most(self) -> float:
        """Characters from which on more is not needed."""
        return ENOUGH if self.pairs else math.inf


class CourseWorth(NamedTuple):
    """What a course brings."""

    name: str
    rows: FloatArray
    """Set-points or inputs, shape (N, c)."""
    characters: float
    within: bool
    """Whether every band stays in the range."""
    spreads: FloatArray
    """Standard deviations of the leader's open parameters after it, shape (n,)."""
    runs: tuple[PredictedRun, ...]
    """What each twin of the family does."""


@dataclass(frozen=True, eq=False)
class NextExperiment:
    """The course, and others of its length beside it."""

    goal: LearningGoal
    leader: TriedTwin
    terms: ExperimentTerms
    course: CourseWorth
    others: tuple[CourseWorth, ...]
    most: float
    """Characters of the best course of full length."""


def goal_named(
    name: str | None,
    members: Sequence[TriedTwin],
    terms: ExperimentTerms,
    answer: ControllerAnswer | None = None,
) -> LearningGoal:
    """A goal by its name, by default the first that is undecided; "controller" takes a law's `answer`.

    Raises:
        ControllerError: there is nothing to decide.
    """
    if not members:
        raise ControllerError("experiment: there is no twin to predict its courses")
    for goal_name in ("structure", "parameters") if name is None else (name,):
        goal_or_reason = GOALS[goal_name](members, terms, answer)
        if isinstance(goal_or_reason, LearningGoal):
            return goal_or_reason
    raise ControllerError(f"experiment: {goal_or_reason}")


def _structure(members: Sequence[TriedTwin], *_: Any) -> LearningGoal | str:
    first_twins = {
        twin.parameters.model.structure_name: Contender(twin)
        for twin in reversed(members)
    }
    if len(first_twins) < 2:
        return f"all twins have the structure {next(iter(first_twins))}; choose --for parameters"
    return LearningGoal("structure", tuple(first_twins.values()), pairs=True)


def _parameters(members: Sequence[TriedTwin], *_: Any) -> LearningGoal | str:
    contenders = tuple(
        Contender(twin) for twin in members if twin.free and twin.covariance is not None
    )
    if not contenders:
        return "no twin leaves a parameter open; record more samples"
    return LearningGoal("parameters", contenders)


def _controller(*asked: Any) -> LearningGoal | str:
    """What the largest eigenvalue hangs on: its slopes by the open parameters, from the draws."""
    answer: ControllerAnswer | None = asked[-1]
    if answer is None:
        return "--for controller needs the law in question; give --loop FILE"
    contenders = []
    directions = []
    for loop in answer.stability:
        if (
            not loop.sound
            and loop.member.free
            and len(loop.drawn) > len(loop.member.free)
        ):
            contenders.append(Contender(loop.member))
            directions.append(_eigenvalue_slopes(loop))
    if not contenders:
        return f"the law is not undecided for its stability ({answer.sentence})"
    return LearningGoal("controller", tuple(contenders), directions=tuple(directions))


def _eigenvalue_slopes(loop: MemberStability) -> FloatArray:
    """Derivatives of the largest eigenvalue by the open parameters, from the draws, shape (n,)."""
    rows = []
    for draw in loop.drawn:
        rows.append([draw[name] for name in loop.member.free])
    values = np.array(rows)
    sizes = np.where(np.isfinite(loop.eigenvalues), loop.eigenvalues, UNBOUNDED)
    slopes = np.linalg.lstsq(
        values - values.mean(axis=0), sizes - sizes.mean(), rcond=None
    )[0]
    return np.asarray(slopes)


def _fault(
    members: Sequence[TriedTwin], terms: ExperimentTerms, _: Any
) -> LearningGoal | str:
    """A weak drive, and losses that have grown until they need the same command where the plant is held now:
    there they leave one mark."""
    leader = members[0]
    parameters = leader.parameters
    declared = parameters.model.declared
    before = terms.before.tolist()
    losses = next(
        (name for name in leader.free if declared[name].role == "losses"), None
    )
    if losses is None:
        return "the plant file has no open parameter with role='losses', with which a weak drive is confused"

    def command(growth: float) -> float | None:
        """What grown losses need, from rest on; None where they cannot be held."""
        grown = parameters.replace(**{losses: growth * parameters[losses]})
        try:
            rest_point = terms.holding.linear(grown, before).rest
        except PlantError:
            return None
        return float(rest_point.inputs[0] - parameters.model.rest[0])

    usual_command = command(1.0) or 0.0
    most_command = command(_FAULTS.growth)
    if not usual_command:
        return f"{leader.name} needs no command at {before}, or is not held there; begin at another level"
    most_by = math.inf if most_command is None else most_command / usual_command
    if _FAULTS.right * most_by <= 1.0:
        return (
            f"at {before} the {_FAULTS.growth:g}-fold {losses} needs a command {most_by:.3g} times as large: "
            "a drive weaker than that is not confused with it"
        )
    share = max(_FAULTS.share, 1.0 / most_by)

    def excess(growth: float) -> float:
        """By how much grown losses need more than the weak drive lacks, as a share; 1 where not held."""
        needed = command(growth)
        return 1.0 if needed is None else needed * share / usual_command - 1.0

    growth = _FAULTS.growth
    if share <= _FAULTS.share:
        from scipy.optimize import brentq  # noqa: PLC0415

        growth = float(brentq(excess, 1.0, _FAULTS.growth, xtol=1e-6))
    if abs(excess(growth)) > _FAULTS.near:
        return f"a weak drive does not hold {leader.name} at {before}; begin at another level"
    grown_losses = _with_grown_losses(leader, losses, growth)
    weak_drive = replace(leader, name="weak drive", states=None)
    return LearningGoal(
        "fault", (Contender(weak_drive, share), Contender(grown_losses)), pairs=True
    )


def _with_grown_losses(leader: TriedTwin, losses: str, growth: float) -> TriedTwin:
    """The twin if the parameter `losses` has grown by about this factor."""
    parameters = leader.parameters.replace(
        **{losses: growth * leader.parameters[losses]}
    )
    size = len(leader.free)
    covariance = np.array(
        np.zeros((size, size)) if leader.covariance is None else leader.covariance
    )
    place = leader.free.index(losses)
    covariance[place, place] += (_FAULTS.unsure * parameters[losses]) ** 2
    return replace(
        leader,
        name="grown losses",
        parameters=parameters,
        covariance=covariance,
        states=None,
    )


GOALS: Final[dict[str, Callable[..., LearningGoal | str]]] = {
    "structure": _structure,
    "parameters": _parameters,
    "controller": _controller,
    "fault": _fault,
}
"""What can be asked; a text says why there is nothing to decide."""


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
    the bands leave the range or another course brings a character more.

    Raises:
        ControllerError: no course keeps to the range, or a twin cannot be held where it begins.
    """
    search = ExperimentSearch(members, goal, terms)
    ranked = _ranked_by_leaders(search, _staircases(terms), watch)
    tried = _first_within_range(search, ranked)
    if not tried:
        low, high = terms.outputs
        raise ControllerError(
            f"experiment: no course keeps the bands of every twin within {low.tolist()} to {high.tolist()}; "
            "widen --within, or begin further from its ends"
        )
    if not goal.pairs:
        best_tried = sorted(tried, key=_missing_at_end)[: _EFFORT.polished]
        tried += [search.polished(course, _missing_at_end) for course in best_tried]
    reach = min(NEARLY * max(float(course.curve.max()) for course in tried), goal.most)

    def delay(course: _RatedCourse) -> float:
        """A cost that is least for the course that brings what is to be reached soonest."""
        return _delay(course.curve, reach)

    for early in sorted(ranked, key=delay)[: 2 * _EFFORT.few]:
        course = search.rated(early.staircase)
        if course is not None:
            tried.append(course)
    best = search.polished(min(tried, key=delay), delay)
    most = max(float(course.curve.max()) for course in tried)
    size = int(search.marks[min(_reaching(best.curve, reach), len(best.curve) - 1)])
    worth = _worth_unless_known(search, search.rows(best.staircase)[:size], running)
    plain_courses = [
        search.worth(name, rows)
        for name, rows in _plain(worth.rows, search.base, terms.levels).items()
    ]
    return NextExperiment(goal, members[0], terms, worth, tuple(plain_courses), most)


class _RatedCourse(NamedTuple):
    """A course and the characters that it brings."""

    curve: FloatArray
    """Characters up to every mark."""
    staircase: Staircase


def _missing_at_end(course: _RatedCourse) -> float:
    """A cost that is least for the course that brings most in its whole length."""
    return -float(course.curve[-1])


def _ranked_by_leaders(
    search: ExperimentSearch,
    table: Sequence[Staircase],
    watch: Callable[[int, int], None] | None,
) -> list[_RatedCourse]:
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
    search: ExperimentSearch, ranked: Sequence[_RatedCourse]
) -> list[_RatedCourse]:
    """The first few courses that keep the bands of all twins within the range."""
    tried: list[_RatedCourse] = []
    for ranked_course in ranked:
        course = search.rated(ranked_course.staircase)
        if course is not None:
            tried.append(course)
        if len(tried) == _EFFORT.few:
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
        if alternative.within and alternative.characters > best.characters - LEAST:
            best = alternative
    return best


def characters_by(
    found: NextExperiment, outputs: FloatArray, inputs: FloatArray
) -> FloatArray:
    """What readings, shape (N, o), under commands, shape (N, m), say of each contender, in characters, shape
    (contenders,): of those to be told apart how well each predicted them, of others how much narrower their
    parameters are."""
    search = ExperimentSearch([found.leader], found.goal, found.terms)
    end = np.array([len(outputs)])
    characters = []
    for contender in found.goal.contenders:
        run = search.run(contender, outputs, inputs)
        information = _information(run.slopes, end)
        if found.goal.pairs:
            miss = (outputs - run.outputs) / run.noise
            pull = np.einsum("ko,koi->i", miss, run.slopes)
            cost = np.sum(miss**2) - pull @ np.linalg.solve(information[0], pull)
            characters.append(
                -_characters_of(information, 0)[0] - 0.5 * cost / math.log(2.0)
            )
        else:
            characters.append(_characters_of(information, len(_root(contender)))[0])
    return np.array(characters)


def _delay(curve: FloatArray, reach: float) -> float:
    """Mean share of what is to be reached that is missing, over the longest course."""
    return float(np.mean(np.maximum(reach - curve, 0.0))) / reach


def _reaching(curve: FloatArray, reach: float) -> int:
    """Number of the mark at which a course first reaches this much; that behind the last if it never does."""
    reached = np.flatnonzero(curve >= reach)
    return int(reached[0]) if reached.size else curve.size


def _staircases(terms: ExperimentTerms) -> list[Staircase]:
    """The table: every pair of levels, every number of steps, for every set-point or input and for all."""
    count = terms.levels.shape[1]
    columns = [*range(count), -1] if count > 1 else [0]
    table = [
        Staircase((share,), (1.0,), column)
        for share, column in product(_SHARES, columns)
    ]
    for (first, second), steps, column in product(
        permutations(_SHARES, 2), _STEPS, columns
    ):
        ends = tuple(((np.arange(steps) + 1) / steps).tolist())
        table.append(Staircase((first, second) * (steps // 2), ends, column))
    return table


def maximal_sequence() -> NDArray[np.bool_]:
    """The binary sequence of a shift register of five bits, whose 31 values repeat no earlier.

    `scipy.signal.max_len_seq` gives the same, but takes half a second to import.
    """
    values = [True] * 5
    while len(values) < 2**5 - 1:
        values.append(values[-5] != values[-2])
    return np.array(values)


def _plain(
    rows: FloatArray, base: FloatArray, levels: FloatArray
) -> dict[str, FloatArray]:
    """What one would do without a computer in the same time: a step by a tenth of the range, to the side with
    more room, a random binary sequence of as much to both sides, nothing."""
    low, high = levels
    size = _PLAIN * (high - low)
    step = np.where(high - base >= base - low, size, -size)
    sequence = maximal_sequence()
    repeats = max(len(rows) // sequence.size, 1)
    is_high = np.resize(np.repeat(sequence, repeats), len(rows))
    binary = np.where(is_high[:, None], base + step, base - step)
    return {
        "step": np.tile(base + step, (len(rows), 1)),
        "PRBS": np.clip(binary, low, high),
        "nothing": np.tile(base, (len(rows), 1)),
    }


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
            id(contender.twin): _start(contender, terms)
            for contender in (*goal.contenders, *self.family)
        }
        self.base = terms.before if law is not None else self.starts[id(members[0])][1]
        self.marks = np.unique(
            np.linspace(1, terms.size, _EFFORT.marks).round().astype(int)
        )

    def rows(self, staircase: Staircase) -> FloatArray:
        """The set-points or inputs of a course, shape (N, signals)."""
        return staircase.rows(self.base, self.terms.levels, self.terms.size)

    def curve(
        self, staircase: Staircase, *, leaders: bool = False
    ) -> FloatArray | None:
        """Characters at every mark, of the leaders nearly; None if a band leaves the range."""
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
        return self._characters(runs, self.marks, from_one_side=leaders)

    def rated(
        self, staircase: Staircase, *, leaders: bool = False
    ) -> _RatedCourse | None:
        """A course with its curve; None if a band leaves the range."""
        curve = self.curve(staircase, leaders=leaders)
        return None if curve is None else _RatedCourse(curve, staircase)

    def polished(
        self, course: _RatedCourse, cost: Callable[[_RatedCourse], float]
    ) -> _RatedCourse:
        """The course of least cost that small movements of levels and times lead to."""
        best = course
        for movement in _EFFORT.movements:
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
        root = _root(self.family[0])
        n = len(root)
        open_share = np.linalg.inv(_information(family[0].slopes, end)[0])[:n, :n]
        covariance = root @ open_share @ root.T
        characters = float(self._characters(runs, end)[0])
        return CourseWorth(
            name, rows, characters, is_within, np.sqrt(np.diag(covariance)), family
        )

    def run(
        self, contender: Contender, rows: FloatArray, commands: FloatArray | None = None
    ) -> PredictedRun:
        """A contender over a course, or under these commands."""
        twin = contender.twin
        model = twin.parameters.model
        share = contender.share
        states, _ = self.starts[id(twin)]
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
        slopes = derivatives @ _root(contender) if free else derivatives
        if share != 1.0:
            moved_outputs = under(share * (1.0 + _DIFFERENCE))[0]
            by_share = (moved_outputs - outputs) / _DIFFERENCE * _FAULTS.unsure
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
        if self.law is None:
            return rows
        twin = contender.twin
        share = contender.share
        states, inputs = self.starts[id(twin)]
        model = twin.parameters.model
        law = self.law if share == 1.0 else _weakened(self.law, share, model.rest)
        outputs = model.kernels.outputs_at(
            twin.parameters.vector, states, inputs, steady[0]
        )[0]
        run = simulate_closed_loop(
            twin.parameters,
            rows,
            states=states,
            law=law,
            controller=state_holding(law, self.terms.before, outputs, inputs),
            disturbances=steady,
        )
        return np.asarray(model.rest + (run.inputs - model.rest) / share)

    def _characters(
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
        """Of every contender, the characters that its nearest rival loses."""
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
        """Characters that a course tells of contender number k: of its open parameters, or of the
        combination that is asked for."""
        information = _information(run.slopes, marks)
        root = _root(self.goal.contenders[k])
        if not self.goal.directions:
            return _characters_of(information, len(root))
        direction = np.zeros(information.shape[1])
        direction[: len(root)] = root.T @ self.goal.directions[k]
        repeated = np.tile(direction, (len(marks), 1))[:, :, None]
        left_open = np.linalg.solve(information, repeated)[:, :, 0] @ direction
        return np.asarray(0.5 * np.log2(direction @ direction / left_open))

    def _apart(
        self, run: PredictedRun, rival: Contender, marks: NDArray[np.int64]
    ) -> FloatArray:
        """Characters that a contender's readings cost its rival, fitted to them again, at these ends."""
        rival_run = self.run(rival, run.outputs, run.inputs)
        miss = (run.outputs - rival_run.outputs) / rival_run.noise
        information = _information(rival_run.slopes, marks)
        by_sample = np.einsum("ko,koi->ki", miss, rival_run.slopes)
        pull = np.cumsum(by_sample, axis=0)[marks - 1]
        moved = np.linalg.solve(information, pull[:, :, None])[:, :, 0]
        explained = np.einsum("ki,ki->k", pull, moved)
        squares = np.cumsum(np.sum(miss**2, axis=1))[marks - 1]
        return np.asarray(0.5 * (squares - explained) / math.log(2.0))


def _information(slopes: FloatArray, marks: NDArray[np.int64]) -> FloatArray:
    """I + JᵀJ of the samples before every mark, shape (marks, n, n)."""
    sums = np.cumsum(np.einsum("koi,koj->kij", slopes, slopes), axis=0)[marks - 1]
    return np.asarray(np.eye(slopes.shape[2]) + sums)


def _characters_of(whole: FloatArray, known: int) -> FloatArray:
    """What readings tell of the first parameters, given I + JᵀJ of all, shape (marks, n, n)."""
    nuisance = whole[:, known:, known:]
    return np.asarray(
        0.5
        * (np.linalg.slogdet(whole)[1] - np.linalg.slogdet(nuisance)[1])
        / math.log(2.0)
    )


def _root(contender: Contender) -> FloatArray:
    """A root of the covariance of what is open, shape (n, n)."""
    if contender.twin.covariance is None:
        return np.zeros((0, 0))
    values, modes = np.linalg.eigh(contender.twin.covariance)
    return np.asarray(modes * np.sqrt(np.maximum(values, 0.0)))


def _start(
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
