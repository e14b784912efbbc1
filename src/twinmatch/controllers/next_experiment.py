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
from functools import partial
from itertools import permutations, product
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from twinmatch.controllers.answer import ControllerAnswer, ControllerError
from twinmatch.controllers.members import Holding, TriedTwin
from twinmatch.controllers.responses import counted_range, state_holding, taken_by
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
ENOUGH: Final = 0.5 * (_NINE_IN_TEN + math.sqrt(_NINE_IN_TEN**2 + 2.0 * LEAD)) ** 2 / math.log(2.0)
"""Expected characters after which nine of ten runs decide: noise moves a lead of n nats by √(2 n)."""
COURSE: Final = 600
"""Length of an experiment, s, on a plant with a time constant of 100 s …"""
MIN_COURSE: Final = 30
MAX_COURSE: Final = 20_000
"""… and samples of one, at least and at most."""
LEAST: Final = 1.0
"""Characters below which a course is not worth its time."""
_BAND: Final = 1.645
"""Half width of a band that holds nine in ten, standard deviations."""
_SHARES: Final = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Levels of the table, as shares of their range …"""
_STEPS: Final = (2, 4, 8)
"""… and how often a course steps between two of them."""
_PLAIN: Final = 0.1
"""Size of a plain step, as a share of the range."""
_MARKS: Final = 60
"""Ends of a course that are considered."""
_FEW: Final = 4
"""Courses of the table that are tried with all twins …"""
_POLISHED: Final = 2
"""… and polished."""
_MOVES: Final = (0.1, 0.03)
"""Movements of levels and times in polishing, as shares of their ranges."""
_WEAKER: Final = 0.8
"""What a drive does that has become weak, as a share …"""
_GROWN: Final = 4.0
"""… and the largest factor by which losses may have grown that leave the same mark: of losses that can do
less, the drive is as weak as they allow …"""
_SEEN: Final = 0.9
"""… unless that is less than a twin is right about."""
_NEAR: Final = 0.01
"""Difference of commands that leave the same mark, as a share."""
_UNSURE: Final = 0.25
"""Standard deviation of a fault's size, as a share of what it changes."""


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
        size = size or round(COURSE * plant_scale(plant, period) / period)
        if not MIN_COURSE <= size <= MAX_COURSE:
            raise ControllerError(
                f"experiment: {size} samples of {period:g} s; give {MIN_COURSE} to {MAX_COURSE} of them"
            )
        ends = np.array([counted_range(output) for output in plant.outputs.values()]).T
        if within is not None:
            ends = np.array([np.maximum(ends[0], within[0]), np.minimum(ends[1], within[1])])
        if not (ends[0] < ends[1]).all():
            raise ControllerError(
                "experiment: the range leaves nothing of the safe one; give LOW below HIGH, inside it"
            )
        if holding.law is None:
            levels = np.array([drive.limits for drive in plant.drives.values()]).T
        else:
            spans = np.array([output.set_points or output.span for output in plant.outputs.values()]).T
            levels = np.clip(spans, *ends)
            for low, high in [np.transpose(ranges)] if ranges else []:
                levels = np.clip(levels, low, high)
        return cls(holding, before, size, levels, ends)


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
        for j in range(m) if self.column < 0 else [self.column]:
            late = round(size * self.ends[0] * j / m) if self.column < 0 else 0
            ends = np.minimum(np.round(np.multiply(self.ends, size)).astype(int) + late, size)
            for share, first, last in zip(self.shares, (late, *ends), ends, strict=False):
                rows[first:last, j] = levels[0, j] + share * (levels[1, j] - levels[0, j])
        return rows

    def moved(self, by: float) -> Iterator[Staircase]:
        """The same with one level or time moved by so much, up or down."""
        for k, way in product(range(len(self.shares)), (by, -by)):
            shares = list(self.shares)
            ends = list(self.ends)
            shares[k] = min(max(shares[k] + way, 0.0), 1.0)
            yield self._replace(shares=tuple(shares))
            if k < len(ends) - 1:
                ends[k] += way
                if all(a < b for a, b in zip([0.0, *ends], ends, strict=False)):
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
        return np.asarray(_BAND * self.noise * np.sqrt(1.0 + np.sum(self.slopes**2, axis=2)))

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
    """Whether the contenders are to be told apart; else the open parameters of each are to be known …"""
    directions: tuple[FloatArray, ...] = ()
    """… or one combination of each: its derivatives by these, shape (n,)."""

    def label(self, k: int) -> str:
        """A contender by what it is suspected of."""
        twin = self.contenders[k].twin
        return twin.parameters.model.structure_name if self.name == "structure" else twin.name

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
        goal = GOALS[goal_name](members, terms, answer)
        if isinstance(goal, LearningGoal):
            return goal
    raise ControllerError(f"experiment: {goal}")


def _structure(members: Sequence[TriedTwin], *_: Any) -> LearningGoal | str:
    first_twins = {twin.parameters.model.structure_name: Contender(twin) for twin in reversed(members)}
    if len(first_twins) < 2:
        return f"all twins have the structure {next(iter(first_twins))}; choose --for parameters"
    return LearningGoal("structure", tuple(first_twins.values()), pairs=True)


def _parameters(members: Sequence[TriedTwin], *_: Any) -> LearningGoal | str:
    contenders = tuple(Contender(twin) for twin in members if twin.free and twin.covariance is not None)
    return (
        LearningGoal("parameters", contenders)
        if contenders
        else "no twin leaves a parameter open; record more samples"
    )


def _controller(*asked: Any) -> LearningGoal | str:
    """What the largest eigenvalue hangs on: its slopes by the open parameters, from the draws."""
    answer: ControllerAnswer | None = asked[-1]
    if answer is None:
        return "--for controller needs the law in question; give --loop FILE"
    contenders = []
    directions = []
    for loop in answer.stability:
        if not loop.sound and loop.member.free and len(loop.drawn) > len(loop.member.free):
            values = np.array([[drawn[name] for name in loop.member.free] for drawn in loop.drawn])
            sizes = np.where(np.isfinite(loop.eigenvalues), loop.eigenvalues, 2.0)
            slopes = np.linalg.lstsq(values - values.mean(axis=0), sizes - sizes.mean(), rcond=None)[0]
            contenders.append(Contender(loop.member))
            directions.append(slopes)
    if not contenders:
        return f"the law is not undecided for its stability ({answer.sentence})"
    return LearningGoal("controller", tuple(contenders), directions=tuple(directions))


def _fault(members: Sequence[TriedTwin], terms: ExperimentTerms, _: Any) -> LearningGoal | str:
    """A weak drive, and losses that have grown until they need the same command where the plant is held now:
    there they leave one mark."""
    leader = members[0]
    before = terms.before.tolist()
    declared = leader.parameters.model.declared
    parameters = leader.parameters
    lost = next((name for name in leader.free if declared[name].role == "losses"), None)
    if lost is None:
        return "the plant file has no open parameter with role='losses', with which a weak drive is confused"

    def command(factor: float) -> float | None:
        grown = parameters.replace(**{lost: factor * parameters[lost]})
        try:
            rest_point = terms.holding.linear(grown, before).rest
        except PlantError:
            return None
        return float(rest_point.inputs[0] - parameters.model.rest[0])

    def beyond(factor: float) -> float:
        needed = command(factor)
        return 1.0 if needed is None else needed * share / usual_command - 1.0

    usual_command = command(1.0) or 0.0
    most = command(_GROWN)
    if not usual_command:
        return f"{leader.name} needs no command at {before}, or is not held there; begin at another level"
    most_by = math.inf if most is None else most / usual_command
    if _SEEN * most_by <= 1.0:
        return (
            f"at {before} the {_GROWN:g}-fold {lost} needs a command {most_by:.3g} times as large: "
            "a drive weaker than that is not confused with it"
        )
    share = max(_WEAKER, 1.0 / most_by)
    factor = _GROWN if share > _WEAKER else float(brentq(beyond, 1.0, _GROWN, xtol=1e-6))
    if abs(beyond(factor)) > _NEAR:
        return f"a weak drive does not hold {leader.name} at {before}; begin at another level"
    sick = parameters.replace(**{lost: factor * parameters[lost]})
    covariance = np.array(
        leader.covariance if leader.covariance is not None else np.zeros((len(leader.free),) * 2)
    )
    covariance[leader.free.index(lost), leader.free.index(lost)] += (_UNSURE * sick[lost]) ** 2
    losses = replace(leader, name="grown losses", parameters=sick, covariance=covariance, states=None)
    drive = replace(leader, name="weak drive", states=None)
    return LearningGoal("fault", (Contender(drive, share), Contender(losses)), pairs=True)


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
    search = _Search(members, goal, terms)
    table = _staircases(terms)
    ranked = []
    for number, staircase in enumerate(table):
        curve = search.curve(staircase, leaders=True)
        if curve is not None:
            ranked.append((curve, staircase))
        if watch is not None:
            watch(number, 2 * len(table))
    ranked.sort(key=lambda one: -one[0][-1])
    tried: list[tuple[FloatArray, Staircase]] = []
    for _, staircase in ranked:
        curve = search.curve(staircase)
        tried += [] if curve is None else [(curve, staircase)]
        if len(tried) == _FEW:
            break
    if not tried:
        low, high = terms.outputs
        raise ControllerError(
            f"experiment: no course keeps the bands of every twin within {low.tolist()} to {high.tolist()}; "
            "widen --within, or begin further from its ends"
        )
    far = sorted(tried, key=lambda one: -one[0][-1])[:_POLISHED]
    tried += [
        search.polished(staircase, curve, lambda row: -row[-1]) for curve, staircase in far if not goal.pairs
    ]
    reach = min(NEARLY * max(float(curve.max()) for curve, _ in tried), goal.most)
    delay = partial(_delay, reach=reach)
    early = sorted(ranked, key=lambda one: delay(one[0]))[: 2 * _FEW]
    tried += [(curve, staircase) for _, staircase in early if (curve := search.curve(staircase)) is not None]
    curve, best = min(tried, key=lambda one: delay(one[0]))
    curve, best = search.polished(best, curve, delay)
    most = max(float(curve.max()) for curve, _ in tried)
    size = int(search.marks[min(_reaching(curve, reach), len(curve) - 1)])
    course = search.worth("proposed", search.rows(best)[:size])
    calm = np.tile(search.base, (len(course.rows), 1))
    for rows in [calm] if running is None else [calm, running]:
        alternative = search.worth("proposed", rows)
        if alternative.within and alternative.characters > course.characters - LEAST:
            course = alternative
    plain_courses = [
        search.worth(name, rows) for name, rows in _plain(course.rows, search.base, terms.levels).items()
    ]
    return NextExperiment(goal, members[0], terms, course, tuple(plain_courses), most)


def characters_by(found: NextExperiment, outputs: FloatArray, inputs: FloatArray) -> FloatArray:
    """What readings, shape (N, o), under commands, shape (N, m), say of each contender, in characters, shape
    (contenders,): of those to be told apart how well each predicted them, of others how much narrower their
    parameters are."""
    search = _Search([found.leader], found.goal, found.terms)
    characters = []
    for contender in found.goal.contenders:
        run = search.run(contender, outputs, inputs)
        whole = _information(run.slopes, np.array([len(outputs)]))
        if not found.goal.pairs:
            characters.append(_characters_of(whole, len(_root(contender)))[0])
            continue
        miss = (outputs - run.outputs) / run.noise
        pull = np.einsum("ko,koi->i", miss, run.slopes)
        cost = np.sum(miss**2) - pull @ np.linalg.solve(whole[0], pull)
        characters.append(-_characters_of(whole, 0)[0] - 0.5 * cost / math.log(2.0))
    return np.array(characters)


def _delay(curve: FloatArray, reach: float) -> float:
    """Mean share of what is to be reached that is missing, over the longest course."""
    return float(np.mean(np.maximum(reach - curve, 0.0))) / reach


def _reaching(curve: FloatArray, reach: float) -> int:
    reached = np.flatnonzero(curve >= reach)
    return int(reached[0]) if reached.size else curve.size


def _staircases(terms: ExperimentTerms) -> list[Staircase]:
    """The table: every pair of levels, every number of steps, for every set-point or input and for all."""
    count = terms.levels.shape[1]
    columns = [*range(count), *([-1] if count > 1 else [])]
    table = [Staircase((share,), (1.0,), column) for share, column in product(_SHARES, columns)]
    for pair, steps, column in product(permutations(_SHARES, 2), _STEPS, columns):
        ends = tuple(((np.arange(steps) + 1) / steps).tolist())
        table.append(Staircase((*pair,) * (steps // 2), ends, column))
    return table


def _plain(rows: FloatArray, base: FloatArray, levels: FloatArray) -> dict[str, FloatArray]:
    """What one would do without a computer in the same time: a step by a tenth of the range, to the side with
    more room, a random binary sequence of as much to both sides, nothing."""
    from scipy.signal import max_len_seq  # noqa: PLC0415 — slow to load

    step = _PLAIN * (levels[1] - levels[0])
    step = np.where(levels[1] - base >= base - levels[0], step, -step)
    bits = np.resize(np.repeat(max_len_seq(5)[0], max(len(rows) // 31, 1)), len(rows)).astype(bool)
    binary = np.clip(np.where(bits[:, None], base + step, base - step), *levels)
    return {
        "step": np.tile(base + step, (len(rows), 1)),
        "PRBS": binary,
        "nothing": np.tile(base, (len(rows), 1)),
    }


class _Search:
    def __init__(self, members: Sequence[TriedTwin], goal: LearningGoal, terms: ExperimentTerms) -> None:
        self.goal = goal
        self.terms = terms
        contending = [contender.twin for contender in goal.contenders]
        self.others = [Contender(twin) for twin in members if twin not in contending]
        self.family = [Contender(twin) for twin in members]
        plant = members[0].parameters.model.plant
        law = terms.holding.law
        if law is not None:
            law = taken_by(plant, law if isinstance(law, TwoLevel) else as_linear(law))
        self.law = law
        self.starts = {
            id(contender.twin): _start(contender, terms) for contender in (*goal.contenders, *self.family)
        }
        self.base = terms.before if law is not None else self.starts[id(members[0])][1]
        self.marks = np.unique(np.linspace(1, terms.size, _MARKS).round().astype(int))

    def rows(self, staircase: Staircase) -> FloatArray:
        return staircase.rows(self.base, self.terms.levels, self.terms.size)

    def curve(self, staircase: Staircase, *, leaders: bool = False) -> FloatArray | None:
        """Characters at every mark, of the leaders nearly; None if a band leaves the range."""
        rows = self.rows(staircase)
        contenders = self.goal.contenders if self.goal.pairs or not leaders else self.goal.contenders[:1]
        runs = [self.run(contender, rows) for contender in contenders]
        other_runs = [] if leaders else (self.run(contender, rows) for contender in self.others)
        if not all(run.within(self.terms.outputs) for group in (runs, other_runs) for run in group):
            return None
        return self._characters(runs, self.marks, nearly=leaders)

    def polished(
        self, staircase: Staircase, curve: FloatArray, cost: Callable[[FloatArray], float]
    ) -> tuple[FloatArray, Staircase]:
        """The one of least cost that small movements of levels and times lead to."""
        for movement in _MOVES:
            for moved in staircase.moved(movement):
                moved_curve = self.curve(moved)
                if moved_curve is not None and cost(moved_curve) < cost(curve):
                    curve = moved_curve
                    staircase = moved
        return curve, staircase

    def worth(self, name: str, rows: FloatArray) -> CourseWorth:
        runs = [self.run(contender, rows) for contender in self.goal.contenders]
        end = np.array([len(rows)])
        family = tuple(self.run(contender, rows) for contender in self.family)
        fits = all(run.within(self.terms.outputs) for run in (*runs, *family))
        root = _root(self.family[0])
        inside = np.linalg.inv(_information(family[0].slopes, end)[0])[: len(root), : len(root)]
        after = root @ inside @ root.T
        characters = float(self._characters(runs, end)[0])
        return CourseWorth(name, rows, characters, fits, np.sqrt(np.diag(after)), family)

    def run(self, contender: Contender, rows: FloatArray, commands: FloatArray | None = None) -> PredictedRun:
        """A contender over a course, or under these commands."""
        twin = contender.twin
        states, inputs = self.starts[id(contender.twin)]
        terms = self.terms
        model = twin.parameters.model
        period = terms.holding.period
        steady = np.tile(model.disturbance_row(twin.disturbances), (len(rows), 1))
        rest_commands = model.rest
        share = contender.share
        if commands is None and self.law is not None:
            law = self.law if share == 1.0 else _weakened(self.law, share, rest_commands)
            outputs_at_start = model.kernels.outputs_at(twin.parameters.vector, states, inputs, steady[0])[0]
            state = state_holding(law, terms.before, outputs_at_start, inputs)
            run = simulate_closed_loop(
                twin.parameters, rows, states=states, law=law, controller=state, disturbances=steady
            )
            commands = rest_commands + (run.inputs - rest_commands) / share
        commands = rows if commands is None else commands
        free = twin.free if twin.covariance is not None else ()

        def under(part: float) -> tuple[FloatArray, FloatArray]:
            acting = rest_commands + part * (commands - rest_commands)
            return sensitivities(twin.parameters, free, acting, states, period=period, disturbances=steady)

        noise = model.noise if twin.noise is None else twin.noise
        outputs, derivatives = under(share)
        slopes = derivatives @ _root(contender) if free else derivatives
        if share != 1.0:
            size = (under(share * 1.01)[0] - outputs) / 0.01 * _UNSURE
            slopes = np.concatenate([slopes, size[:, :, None]], axis=2)
        slopes = slopes / noise[:, None]
        if terms.offset:
            constant = np.tile(terms.offset * np.eye(noise.size), (len(outputs), 1, 1))
            slopes = np.concatenate([slopes, constant], axis=2)
        return PredictedRun(outputs, commands, slopes, noise)

    def _characters(
        self, runs: Sequence[PredictedRun], marks: NDArray[np.int64], *, nearly: bool = False
    ) -> FloatArray:
        """What is known at these ends of a course; nearly: a pair is as far apart from either side."""
        goal = self.goal
        contenders = self.goal.contenders
        if goal.pairs:
            pairs = permutations(range(len(runs)), 2)
            apart = {
                (a, b): self._apart(runs[a], contenders[b], marks) for a, b in pairs if a < b or not nearly
            }
            apart = {(b, a): characters for (a, b), characters in apart.items()} | apart
            nearest = [
                np.min([apart[a, b] for b in range(len(runs)) if b != a], axis=0) for a in range(len(runs))
            ]
            return np.asarray(np.mean(np.minimum(nearest, ENOUGH), axis=0))
        characters = []
        for k, run in enumerate(runs):
            whole = _information(run.slopes, marks)
            root = _root(contenders[k])
            if not goal.directions:
                characters.append(_characters_of(whole, len(root)))
                continue
            way = np.zeros(whole.shape[1])
            way[: len(root)] = root.T @ goal.directions[k]
            left_open = np.linalg.solve(whole, np.tile(way, (len(marks), 1))[:, :, None])[:, :, 0] @ way
            characters.append(0.5 * np.log2(way @ way / left_open))
        return np.asarray(np.mean(characters, axis=0))

    def _apart(self, run: PredictedRun, rival: Contender, marks: NDArray[np.int64]) -> FloatArray:
        """Characters that a contender's readings cost its rival, fitted to them again, at these ends."""
        rival_run = self.run(rival, run.outputs, run.inputs)
        miss = (run.outputs - rival_run.outputs) / rival_run.noise
        whole = _information(rival_run.slopes, marks)
        pull = np.cumsum(np.einsum("ko,koi->ki", miss, rival_run.slopes), axis=0)[marks - 1]
        explained = np.einsum("ki,ki->k", pull, np.linalg.solve(whole, pull[:, :, None])[:, :, 0])
        costs = np.cumsum(np.sum(miss**2, axis=1))[marks - 1] - explained
        return np.asarray(0.5 * costs / math.log(2.0))


def _information(slopes: FloatArray, marks: NDArray[np.int64]) -> FloatArray:
    """I + JᵀJ of the samples before every mark, shape (marks, n, n)."""
    sums = np.cumsum(np.einsum("koi,koj->kij", slopes, slopes), axis=0)[marks - 1]
    return np.asarray(np.eye(slopes.shape[2]) + sums)


def _characters_of(whole: FloatArray, known: int) -> FloatArray:
    """What readings tell of the first parameters, given I + JᵀJ of all, shape (marks, n, n)."""
    nuisance = whole[:, known:, known:]
    return np.asarray(0.5 * (np.linalg.slogdet(whole)[1] - np.linalg.slogdet(nuisance)[1]) / math.log(2.0))


def _root(contender: Contender) -> FloatArray:
    """A root of the covariance of what is open, shape (n, n)."""
    if contender.twin.covariance is None:
        return np.zeros((0, 0))
    values, modes = np.linalg.eigh(contender.twin.covariance)
    return np.asarray(modes * np.sqrt(np.maximum(values, 0.0)))


def _start(contender: Contender, terms: ExperimentTerms) -> tuple[FloatArray, FloatArray]:
    """States and acting inputs at the first sample: the twin's own, or where it is held."""
    twin = contender.twin
    if twin.states is not None and twin.inputs is not None:
        return twin.states, twin.inputs
    try:
        rest_point = terms.holding.linear(twin.parameters, terms.before.tolist(), twin.disturbances).rest
    except PlantError as error:
        raise ControllerError(f"experiment: {twin.name}: {error}") from error
    return rest_point.states, rest_point.inputs


def _weakened(law: Law, share: float, rest: FloatArray) -> Law:
    """The same law if its drives do a share of what they are given."""
    if isinstance(law, TwoLevel):
        off_level, on_level = (float(rest[0] + share * (level - rest[0])) for level in (law.off, law.on))
        return replace(law, off=off_level, on=on_level)
    assert isinstance(law, LinearLaw)  # noqa: S101 (the search converts)
    rest_part = (1.0 - share) * rest
    changed = {name: share * getattr(law, name) + rest_part for name in ("offset", "low", "high")}
    drives = None if law.drives is None else share * law.drives + rest_part
    return replace(
        law, C=share * law.C, D=share * law.D, E=share * law.E, G=law.G / share, drives=drives,
        shift=law.shift - law.G @ rest_part / share, **changed,
    )  # fmt: skip
