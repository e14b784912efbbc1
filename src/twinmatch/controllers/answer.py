"""May this controller be run? The question, and the answer from every twin that the recordings allow."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import chain
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.comparing import DiscriminationError
from twinmatch.controllers.guarantee import Guarantee, guarantee_of
from twinmatch.controllers.members import Holding, TriedTwin
from twinmatch.controllers.responses import (
    LOAD,
    CourseFigure,
    Run,
    conduct_of,
    counted_range,
    quantities_of,
    run_law,
    taken_by,
)
from twinmatch.controllers.stability import (
    MAX_UNSTABLE,
    MemberStability,
    OpenQuestion,
    Point,
    open_question,
    stability_of,
)
from twinmatch.dynamics import (
    Law,
    Linear,
    Parameters,
    Plant,
    PlantError,
    Rest,
    TwoLevel,
)
from twinmatch.dynamics.pids import as_linear
from twinmatch.errors import TwinmatchError
from twinmatch.signals import FloatArray

CONFIDENCE: Final = 0.9
"""Share of the draws within a band."""
_BAND_QUANTILES: Final = ((1.0 - CONFIDENCE) / 2.0, 0.5, 1.0 - (1.0 - CONFIDENCE) / 2.0)
"""Probabilities of a band's lower end, median and upper end."""
MIN_DRAWS: Final = 25
"""Draws of each twin, at least."""
MAX_SAMPLES: Final = 20_000_000
"""Samples of a question's courses in all, at most: a day of seconds in 200 draws."""
_LARGE: Final = 1000.0
"""Eigenvalue from which on its order of magnitude says enough."""
MAX_POINTS: Final = 8
"""Operating points at which the loop is linearised, at most."""


class ControllerError(TwinmatchError):
    """A controller cannot be tried on these twins."""


class ControllerDecision(Enum):
    """Whether a controller may be run."""

    SAFE = "safe"
    FAILS = "fails"
    UNDECIDED = "undecided"


@dataclass(frozen=True, eq=False)
class ControllerQuestion:
    """A law, and under which conditions it is to be tried.

    Raises:
        ControllerError: there are no draws, or they have too many samples.
    """

    law: Law
    references: FloatArray
    """Set-points of every sample, shape (N, r)."""
    before: FloatArray
    """Set-points until then, shape (r,): the law takes over without a bump at these."""
    holding: Holding
    """How the plant is brought to an operating point; its law is the one that ran, for comparison."""
    draws: int = 200
    """Draws over all twins."""
    seed: int = 31
    state: FloatArray | None = None
    """The law's state before the first sample, shape (q,); None: it takes over without a bump."""

    def __post_init__(self) -> None:
        if not 1 <= self.draws <= MAX_SAMPLES / max(len(self.references), 1):
            raise ControllerError(
                f"controller: {self.draws} draws of {len(self.references)} samples; give at least one draw, "
                f"and at most {MAX_SAMPLES} samples in all: fewer draws, or a shorter profile"
            )


class Spread(NamedTuple):
    """Median and band of a figure over all draws."""

    low: float
    median: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Of these values; one may be infinite."""
        row = np.array(values)
        if np.isnan(row).all():
            return cls(math.nan, math.nan, math.nan)
        low, median, high = np.nanquantile(
            row, _BAND_QUANTILES, method="nearest"
        ).tolist()
        return cls(low, median, high)

    def widened(self, factor: float) -> Spread:
        """With both sides of the band so many times as wide, for a figure that is not negative."""
        low = self.median + factor * (self.low - self.median)
        high = self.median + factor * (self.high - self.median)
        return Spread(max(low, 0.0), self.median, high)


@dataclass(frozen=True, eq=False)
class Courses:
    """What one law does on all draws."""

    figures: Mapping[CourseFigure, Spread]
    outputs: FloatArray
    """Lower end, median and upper end of the outputs at every sample, shape (3, N, o)."""
    inputs: FloatArray
    """Of the commands, shape (3, N, m)."""
    values: Mapping[CourseFigure, FloatArray]
    """The figures of every draw, shape (draws,)."""
    owner: FloatArray
    """Number of the twin of every draw, shape (draws,)."""
    misconduct: Mapping[str, NDArray[np.bool_]]
    """What a safe course never does, in words, and whether each draw does it, shape (draws,)."""


@dataclass(frozen=True, eq=False)
class ControllerAnswer:
    """Whether a law may be run, and what it does."""

    plant: type[Plant]
    decision: ControllerDecision
    sentence: str
    members: tuple[str, ...]
    points: tuple[Point, ...]
    stability: tuple[MemberStability, ...]
    """Of every twin; empty for a law that is not linear."""
    question: OpenQuestion | None
    """What is left open, if the answer is undecided."""
    time: FloatArray
    """s, shape (N,)."""
    references: FloatArray
    """Shape (N, r)."""
    courses: Courses
    running: Courses | None
    """Of the law that ran, if it is known."""
    notes: tuple[str, ...] = ()
    guarantee: Guarantee | None = None
    """Of a linear law that holds all twins."""
    widening: float = 1.0
    """Factor on the bands of its costs, from what measured ones have shown."""


def operating_points(references: FloatArray) -> tuple[Point, ...]:
    """The distinct set-points of a profile, at most `MAX_POINTS` that are spread over them, and both ends."""
    set_points = np.unique(references, axis=0)
    if len(set_points) > MAX_POINTS:
        set_points = set_points[
            np.linspace(0, len(set_points) - 1, MAX_POINTS).round().astype(int)
        ]
    return tuple(tuple(row) for row in set_points.tolist())


# an unstable course grows without bound; NaN is unsafe
@np.errstate(over="ignore", invalid="ignore")
def try_controller(
    members: Sequence[TriedTwin],
    question: ControllerQuestion,
    watch: Callable[[int, int], None] | None = None,
) -> ControllerAnswer:
    """Try a law on every twin and on draws of its parameters; `watch` is called with draws done and all.

    Raises:
        ControllerError: there is no twin, or none can be held at any operating point.
        PlantError: the law is for another number of signals.
    """
    if not members:
        raise ControllerError("controller: there is no twin to try it on")
    plant = members[0].parameters.model.plant
    points = operating_points(question.references)
    number = max(question.draws // len(members), MIN_DRAWS)
    drawn = [
        member.drawn(number, question.seed + k) for k, member in enumerate(members)
    ]
    laws = (
        [question.law]
        if question.holding.law is None
        else [question.law, question.holding.law]
    )
    reservations = _reservations(plant, question.law)
    progress = _Progress(watch, (1 + len(laws)) * sum(map(len, drawn)))
    stability, held_twins, notes = _stabilities(
        list(zip(members, drawn, strict=True)), points, question, progress
    )
    twins_with_draws = [(members[k], drawn[k]) for k in held_twins]
    courses = [_courses(twins_with_draws, law, question, progress) for law in laws]
    names = tuple(members[k].name for k in held_twins)
    decision, sentence, left_open = _decide(
        plant, names, stability, courses[0], question
    )
    period = question.holding.period
    guarantee = None
    if stability and all(loop.eigenvalue < 1.0 for loop in stability):
        try:
            guarantee = guarantee_of(plant, stability, as_linear(question.law))
        except DiscriminationError as error:
            reservations.append(f"nothing is guaranteed: {error}")
    return ControllerAnswer(
        plant,
        decision,
        sentence,
        names,
        points,
        tuple(stability),
        left_open,
        np.arange(len(question.references), dtype=np.float64) * period,
        question.references,
        courses[0],
        courses[1] if len(courses) > 1 else None,
        (*notes, *reservations),
        guarantee,
    )


def _reservations(plant: type[Plant], law: Law) -> list[str]:
    """What an answer had to assume, in words."""
    notes = []
    for name, output in plant.outputs.items():
        if not np.isfinite(output.safe).all():
            low, high = counted_range(output)
            notes.append(
                f"{name} has no declared safe range, so {low:g} to {high:g} {output.unit} counts, its span; "
                "declare `safe` in the plant file"
            )
    if isinstance(law, TwoLevel):
        return notes
    linear = as_linear(law)
    for (name, drive), low, high in zip(
        plant.drives.items(), linear.low, linear.high, strict=True
    ):
        drive_low, drive_high = drive.limits
        if low < drive_low or high > drive_high:
            notes.append(
                f"the law's limits of {name}, {low:g} to {high:g} {drive.unit}, are wider than the drive's, "
                f"{drive_low:g} to {drive_high:g}: the drive limits its commands, and the law "
                "does not know of it"
            )
    return notes


class _Progress:
    """Counts the draws that are done, and reports them."""

    def __init__(self, watch: Callable[[int, int], None] | None, total: int) -> None:
        self._watch = watch
        self._total = total
        self._done = 0

    def step(self, number: int = 1) -> None:
        self._done += number
        if self._watch is not None:
            self._watch(self._done, self._total)


def _stabilities(
    twins_with_draws: Sequence[tuple[TriedTwin, Sequence[Parameters]]],
    points: Sequence[Point],
    question: ControllerQuestion,
    progress: _Progress,
) -> tuple[list[MemberStability], list[int], list[str]]:
    """The loops with all twins that can be held, for a linear law; numbers of these twins; why not others.

    Raises:
        ControllerError: none can be held.
    """
    linear = None if isinstance(question.law, TwoLevel) else as_linear(question.law)
    stability = []
    held_twins = []
    notes = []
    for k, (member, drawn) in enumerate(twins_with_draws):
        progress.step(len(drawn))
        try:
            if linear is not None:
                stability.append(
                    stability_of(member, linear, points, question.holding, drawn)
                )
            held_twins.append(k)
        except PlantError as error:
            notes.append(f"{member.name} is left out: {error}")
    if not held_twins:
        raise ControllerError(
            f"controller: none of the twins can be held there; {notes[0]}"
        )
    return stability, held_twins, notes


def _courses(
    twins_with_draws: Sequence[tuple[TriedTwin, Sequence[Parameters]]],
    law: Law,
    question: ControllerQuestion,
    progress: _Progress,
) -> Courses:
    """What a law does on all draws of all twins."""
    if law is not question.law:
        question = replace(question, state=None)
    acting = taken_by(
        twins_with_draws[0][0].parameters.model.plant,
        law if isinstance(law, TwoLevel) else as_linear(law),
    )
    rng = np.random.default_rng(question.seed)
    runs = []
    owner = []
    for k, (member, drawn) in enumerate(twins_with_draws):
        for parameters in drawn:
            progress.step()
            try:
                runs.append(_course(member, parameters, acting, question, rng))
            except PlantError:
                continue  # a draw that cannot be held where courses begin
            owner.append(k)
    if not runs:
        raise ControllerError(
            "controller: no draw can be held where the profile begins"
        )
    values = {
        q: np.array([course.figures[q] for course in runs]) for q in runs[0].figures
    }
    return Courses(
        {q: Spread.of(row.tolist()) for q, row in values.items()},
        _band([course.run.outputs for course in runs]),
        _band([course.run.inputs for course in runs]),
        values,
        np.array(owner, dtype=np.float64),
        {
            words: np.array([course.conduct[words] for course in runs])
            for words in runs[0].conduct
        },
    )


class _Course(NamedTuple):
    """What a law does on one draw."""

    run: Run
    """Over the profile, with noisy readings."""
    figures: dict[CourseFigure, float]
    conduct: dict[str, bool]
    """What a safe course never does, in words, and whether this one does it."""


def _course(
    member: TriedTwin,
    parameters: Parameters,
    law: Law,
    question: ControllerQuestion,
    rng: np.random.Generator,
) -> _Course:
    """One draw over the profile with noisy readings; without noise beyond it, and after loads."""
    model = parameters.model
    holding = question.holding
    size = len(question.references)
    references = np.vstack(
        [question.references, np.tile(question.references[-1], (holding.samples, 1))]
    )
    at_rest = holding.linear(parameters, question.before.tolist(), member.disturbances)
    start = at_rest
    if member.states is not None and member.inputs is not None:
        start = at_rest._replace(rest=Rest(member.states, member.inputs))
    slow = member.wandering(size, rng)
    if slow is not None:
        slow = np.vstack([slow, np.tile(slow[-1], (holding.samples, 1))])
    noise = np.zeros((len(references), len(model.noise)))
    deviations = model.noise if member.noise is None else member.noise
    noise[:size] = deviations * rng.standard_normal((size, deviations.size))
    beyond_profile = run_law(
        parameters,
        law,
        references,
        start,
        before=question.before,
        state=question.state,
        noise=noise,
        slow=slow,
        disturbances=member.disturbances,
    )
    run = Run(*(rows[:size] for rows in beyond_profile))
    still, *loads = _runs_at_rest(member, parameters, law, question, at_rest)
    conduct = conduct_of(beyond_profile, size, law, model.plant)
    return _Course(run, quantities_of(run, still, loads, parameters, law), conduct)


def _runs_at_rest(
    member: TriedTwin,
    parameters: Parameters,
    law: Law,
    question: ControllerQuestion,
    at_rest: Linear,
) -> list[Run]:
    """The courses with the set-points held: without a load, and with one at each input in turn."""
    drives = parameters.model.plant.drives.values()
    ranges = np.array([drive.limits[1] - drive.limits[0] for drive in drives])
    level = np.tile(question.before, (question.holding.samples, 1))
    runs = []
    for load in (np.zeros(len(drives)), *(LOAD * np.diag(ranges))):
        runs.append(
            run_law(
                parameters,
                law,
                level,
                at_rest,
                before=question.before,
                load=load,
                disturbances=member.disturbances,
            )
        )
    return runs


def _band(rows: Sequence[FloatArray]) -> FloatArray:
    """Lower end, median and upper end over draws of a course, each of shape (N, k), shape (3, N, k)."""
    quantiles = np.quantile(np.array(rows), _BAND_QUANTILES, axis=0, method="nearest")
    return np.asarray(quantiles, dtype=np.float64)


def _decide(
    plant: type[Plant],
    names: Sequence[str],
    stability: Sequence[MemberStability],
    courses: Courses,
    question: ControllerQuestion,
) -> tuple[ControllerDecision, str, OpenQuestion | None]:
    """The decision, its sentence, and what is left open."""
    failing = [loop for loop in stability if loop.fails]
    if failing:
        return ControllerDecision.FAILS, _unstable_words(plant, names, failing), None
    misconduct = _misconduct(names, courses)
    if misconduct is not None and misconduct[0] is ControllerDecision.FAILS:
        return *misconduct, None
    unsure = [loop for loop in stability if not loop.sound]
    if unsure:
        draws = sum(loop.eigenvalues.size for loop in stability)
        unstable = sum(int(np.sum(loop.eigenvalues >= 1.0)) for loop in stability)
        words = f"undecided: unstable in {unstable} of {draws} draws of what the data leave open"
        most_unsure = max(unsure, key=lambda loop: loop.unstable)
        if not most_unsure.member.free:
            return ControllerDecision.UNDECIDED, words, None
        asked = open_question(most_unsure, question.before.tolist(), question.holding)
        words += f"; {open_words(most_unsure.member.parameters, asked)}"
        return ControllerDecision.UNDECIDED, words, asked
    if misconduct is not None:
        return *misconduct, None
    return (
        ControllerDecision.SAFE,
        f"safe for all that the data allow: {_safe_words(names, stability)}",
        None,
    )


def _unstable_words(
    plant: type[Plant], names: Sequence[str], failing: Sequence[MemberStability]
) -> str:
    """On which twins a law fails since its loop is unstable, in words."""
    worst = max(failing, key=lambda loop: loop.eigenvalue)
    where = levels_words(plant, worst.point)
    size = (
        f"{worst.eigenvalue:.4f}"
        if worst.eigenvalue < _LARGE
        else f"{worst.eigenvalue:.3g}"
    )
    why = f"its loop is unstable at {where}: largest eigenvalue {size}"
    return _fails(len(failing), names, worst.member.name, why)


def _safe_words(names: Sequence[str], stability: Sequence[MemberStability]) -> str:
    """How far a law is safe, in words; without stabilities for one that switches."""
    all_twins = f"{len(names)} of {len(names)} twins"
    if not stability:
        return f"within the safe range, and switching, on {all_twins}"
    draws = sum(loop.eigenvalues.size for loop in stability)
    eigenvalue = max(loop.eigenvalue for loop in stability)
    margins = list(chain.from_iterable(loop.margins for loop in stability))
    gain = min(margin.gain_change for margin in margins)
    delay = min(margin.delay for margin in margins)
    return (
        f"stable on {all_twins} and in {draws} draws of their parameters, largest eigenvalue "
        f"{eigenvalue:.4f}, until a gain changes {gain:.2f} times or a dead time grows by {delay:.3g} s"
    )


def _fails(number: int, names: Sequence[str], first: str, why: str) -> str:
    """On how many of the twins a law fails, on which of them first, and why, in words."""
    on = (
        f"on {number} of {len(names)} twins, first on {first}"
        if len(names) > 1
        else f"on {first}"
    )
    return f"fails {on}: {why}"


def _misconduct(
    names: Sequence[str], courses: Courses
) -> tuple[ControllerDecision, str] | None:
    """A decision and its sentence if courses do what safe ones never do: on a twin whatever the data leave
    open, or in some draws."""
    twins = np.unique(courses.owner).astype(int).tolist()
    undecided = None
    for words, is_seen in courses.misconduct.items():
        shares = {k: float(np.mean(is_seen[courses.owner == k])) for k in twins}
        failing = [k for k in twins if shares[k] >= 1.0 - MAX_UNSTABLE]
        if failing:
            return ControllerDecision.FAILS, _fails(
                len(failing), names, names[failing[0]], words
            )
        if undecided is None and max(shares.values()) > MAX_UNSTABLE:
            sentence = (
                f"undecided: in {int(is_seen.sum())} of {is_seen.size} draws {words}"
            )
            undecided = ControllerDecision.UNDECIDED, sentence
    return undecided


def levels_words(plant: type[Plant], point: Sequence[float]) -> str:
    """An operating point in words."""
    return ", ".join(
        f"{v:g} {o.unit}".rstrip()
        for v, o in zip(point, plant.outputs.values(), strict=True)
    )


def open_words(parameters: Parameters, asked: OpenQuestion) -> str:
    """What a decision hangs on, and what to do, in words."""
    declared = parameters.model.declared[asked.parameter]
    drives = parameters.model.plant.drives
    text = declared.text or asked.parameter
    drive = drives[asked.drive]
    named = drive.text.split(",")[0] or asked.drive
    unit = "" if named.lower() == drive.unit.lower() else f" {drive.unit}"
    return (
        f"it hangs on {asked.parameter} ({text}), which this recording does not show: step {named} by "
        f"{asked.step:g}{unit}"
    )
