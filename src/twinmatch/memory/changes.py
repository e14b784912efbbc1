"""What has changed between sessions: steps and trends of parameters, told apart from what varies anyway.

The lessons on one structure are estimates of its parameters with standard deviations s. They scatter by more,
since no structure is exact and a room is another one every day: a spread τ of its own is integrated over for
each parameter, small ones being likelier (random effects). Errors have the tails of Student's distribution
with a few degrees of freedom, so that one odd session pulls nothing. Parameters that cannot be negative are
compared by their logarithms. Two that trade against each other are also compared by their ratio or product,
if that is known far better than either.

Hypotheses are that a parameter is steady, that it steps before some session, and that it changes evenly. The
evidence for a change is the logarithm of the likelihood of all changes, integrated over level, size and
spread (Laplace) and weighted with what it costs to say which parameter, which kind and when, relative to
steady: a mixture of alternatives, as in `health.changes`, so that looking after every session hardly adds up.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics import Model
from twinmatch.memory.lesson import Lesson, in_order
from twinmatch.settings import Rule
from twinmatch.signals import MEDIAN_TO_SIGMA, FloatArray

MIN_SIDE: Final = 2
"""Least number of sessions on either side of a step: a single one may be odd."""
MIN_TREND: Final = 6
"""Least number of sessions for a trend: in fewer, half a step looks like it."""
MAX_SESSIONS: Final = 60
"""Newest sessions that are compared."""
_SPREADS: Final = np.array([0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0])
"""Spreads between sessions that are tried, in units of the median standard deviation of a session."""
_TIGHTER: Final = 3.0
"""Factor by which a ratio or product must be known better than its parts, as in a match."""
_DAY: Final = 86_400e9
_NINETY: Final = 1.645


class _RobustFit(Rule):
    """Levels and sizes under errors with heavy tails, so that one odd session pulls nothing: Student's
    distribution with five degrees of freedom, by least squares that are weighted again and again."""

    degrees: float = 5.0
    """Degrees of freedom of Student's distribution."""
    size: float = 0.15
    """Standard deviation of a change before it was seen, as a logarithm or in units of the parameter's
    scale."""
    rounds: int = 8
    """How often the weights are computed."""


_ROBUST: Final = _RobustFit()


class _NamedFrom(Rule):
    """From which evidence on, in nats beyond what it costs to say it, a change is reported. Few plants change
    evenly, so that a trend has to lead. Moments of a step that are two nats behind the best are seven times
    less likely, and not worth considering."""

    least: float = 0.7
    """Evidence from which a change is reported."""
    trend: float = 1.0
    """Evidence by which a trend must lead a step."""
    moments: float = 2.0
    """Evidence by which the best moment of a step leads one that is not considered."""
    most: float = 500.0
    """Evidence above which more makes no difference: its exponential has to be finite."""


_NAMED_FROM: Final = _NamedFrom()


class ParameterHistory(NamedTuple):
    """A parameter, or a combination of two, over the sessions."""

    name: str
    """That of the plant file; of a combination with its sign: "seebeck / heat_capacity"."""
    words: str
    """What it is called in a sentence."""
    unit: str
    values: FloatArray
    """In its unit, shape (n,)."""
    scale: float
    """What a change is relative to; 0: to the value itself, by logarithms."""
    deviations: FloatArray
    """Standard deviations of a session, in units of the scale or relative, shape (n,)."""
    parts: tuple[str, ...]
    """Names of the parameters in it."""
    bounds: tuple[float, float]
    """Within which the plant file allows it; infinite for a combination."""

    @property
    def levels(self) -> FloatArray:
        """Values in which changes are compared: logarithms, or in units of the scale, shape (n,)."""
        return self.values / self.scale if self.scale else np.log(self.values)

    def value(self, level: float) -> float:
        """The value of a level."""
        return level * self.scale if self.scale else math.exp(level)

    def part(self, first: int, end: int) -> ParameterHistory:
        """Some of the sessions."""
        return self._replace(
            values=self.values[first:end], deviations=self.deviations[first:end]
        )


@dataclass(frozen=True)
class ParameterChange:
    """A change of a parameter, or of a combination, between sessions."""

    name: str
    """As that of its history."""
    words: str
    """What it is called in a sentence."""
    unit: str
    kind: str
    """`step` or `trend`."""
    since: str
    """Session from which on the value is another one; of a trend, the first session."""
    after: str
    """Last session before; of a trend, the newest."""
    old: float
    """Value before, or at the beginning."""
    new: float
    """Value since, or now."""
    relative: bool
    """Whether sizes are relative to the value; otherwise they are in its unit."""
    size: float
    """Relative change, or in the unit."""
    error: float
    """Standard deviation of the size."""
    evidence: float
    """Nats by which it is more credible than no change."""
    days: float = math.nan
    """Length of a trend, in days if `dated`, otherwise in sessions."""
    dated: bool = True
    bounds: tuple[float, float] = (-math.inf, math.inf)

    @property
    def sentence(self) -> str:
        """It in words."""
        if self.kind == "step":
            word = "higher" if self.size > 0 else "lower"
            unit = f" {self.unit}" if self.unit else ""
            values = f"{self.old:.3g} → {self.new:.3g}{unit}"
            text = f"since {self.since} the {self.words} is {self._amount(self.size)} {word} ({values})"
            return f"{text}; before and after it was steady"
        rate = (
            math.expm1(math.log1p(self.size) / self.days)
            if self.relative
            else self.size / self.days
        )
        word = "rises" if self.size > 0 else "falls"
        per = "day" if self.dated else "session"
        text = f"the {self.words} {word} by {self._amount(rate)} a {per}"
        return text + self._leaving(per)

    def _amount(self, size: float) -> str:
        return (
            f"{100 * abs(size):.2g} %"
            if self.relative
            else f"{abs(size):.2g} {self.unit}".rstrip()
        )

    @property
    def leaves(self) -> tuple[float, float, float] | None:
        """Days or sessions until a trend leaves the bounds, expected, and the ends of its 90 % interval; None
        for a step, and where there are no bounds."""
        bound = self.bounds[1] if self.size > 0 else self.bounds[0]
        if (
            self.kind == "step"
            or not math.isfinite(bound)
            or (self.relative and bound <= 0.0)
        ):
            return None
        if self.relative:
            distance = abs(math.log(bound / self.new))
            size = math.log1p(self.size)
        else:
            distance = abs(bound - self.new)
            size = self.size
        times = []
        for deviations in (0, _NINETY, -_NINETY):
            rate = max(abs(size) + deviations * self.error, 0.0) / self.days
            times.append(distance / rate if rate > 0.0 else math.inf)
        expected, low, high = times
        return expected, low, high

    def _leaving(self, per: str) -> str:
        if self.leaves is None:
            return ""
        expected, low, high = self.leaves
        end = (
            f"{low:.0f} to {high:.0f}" if math.isfinite(high) else f"{low:.0f} or more"
        )
        return f": at this rate it leaves the range of the plant file in {expected:.0f} {per}s, 90 %: {end}"


class MemoryReport(NamedTuple):
    """What has changed on a rig, in one structure."""

    lessons: list[Lesson]
    """Those that were compared, oldest first."""
    histories: list[ParameterHistory]
    changes: list[ParameterChange]
    restless: list[str]
    """What is another one in every session, in words: it varies by far more than a session knows it."""

    @property
    def sentence(self) -> str:
        """It in words."""
        count = len(self.lessons)
        least = 2 * MIN_SIDE
        if count < least:
            return f"what changes shows from {least} sessions on, and only {count} can be compared"
        words = "; ".join(change.sentence for change in self.changes)
        words = (
            words
            or f"between these {count} sessions nothing has changed by more than they vary"
        )
        if not self.restless:
            return words
        return f"{words}; another one in every session: the {' and the '.join(self.restless)}"


def report_on(lessons: Sequence[Lesson], model: Model) -> MemoryReport:
    """What has changed between these sessions of one plant and rig, all on the structure of the model."""
    newest = in_order(lessons)[-MAX_SESSIONS:]
    if len(newest) < 2 * MIN_SIDE:
        return MemoryReport(
            newest, histories_of(newest, model) if newest else [], [], []
        )
    histories = histories_of(newest, model)
    sessions = _SessionTimes.of(newest)
    changes: list[ParameterChange] = []
    for history in histories:
        # parameters first, then combinations of those that are not named by themselves
        if not any(change.name in history.parts for change in changes):
            changes += _changes(history, sessions, len(histories))
    changed = {change.name for change in changes}
    restless = []
    for history in histories:
        is_single = len(history.parts) == 1
        if is_single and history.name not in changed and _spread(history) > _TIGHTER:
            restless.append(history.words)
    return MemoryReport(newest, histories, changes, restless)


def shared_structure(lessons: Sequence[Lesson]) -> str:
    """The structure in which sessions are compared: the one that led in most of them, of equals the one with
    lessons from most; empty without lessons."""
    count = Counter(lesson.structure for lesson in lessons)
    led = Counter(lesson.structure for lesson in lessons if lesson.led)
    return max(count, key=lambda name: (led[name], count[name]), default="")


def histories_of(lessons: Sequence[Lesson], model: Model) -> list[ParameterHistory]:
    """Free parameters over these sessions, and ratios and products that are known better than their parts."""
    free = lessons[0].free
    declared = [model.declared[name] for name in free]
    values = np.array([lesson.values for lesson in lessons])
    covariances = np.array([lesson.covariance for lesson in lessons])
    by_logs = []
    for k, parameter in enumerate(declared):
        by_logs.append(parameter.relative and bool((values[:, k] > 0).all()))
    units = np.where(by_logs, values, [parameter.scale for parameter in declared])
    covariances = covariances / units[:, :, None] / units[:, None, :]
    histories = []
    for k, (name, parameter) in enumerate(zip(free, declared, strict=True)):
        histories.append(
            ParameterHistory(
                name=name,
                words=parameter.text or name.replace("_", " "),
                unit=parameter.unit,
                values=values[:, k],
                scale=0.0 if by_logs[k] else parameter.scale,
                deviations=np.sqrt(covariances[:, k, k]),
                parts=(name,),
                bounds=parameter.bounds,
            )
        )
    combined = []
    for i, j in combinations(np.flatnonzero(by_logs).tolist(), 2):
        pair = _pair(histories[i], histories[j], covariances[:, i, j])
        if pair is not None:
            combined.append(pair)
    return histories + combined


def _pair(
    first: ParameterHistory, second: ParameterHistory, covariance: FloatArray
) -> ParameterHistory | None:
    """Ratio or product of two parameters; None unless it is known far better than either."""
    is_ratio = bool(np.median(covariance) > 0.0)
    sign = -1.0 if is_ratio else 1.0
    variances = (
        np.square(first.deviations)
        + np.square(second.deviations)
        + 2.0 * sign * covariance
    )
    deviations = np.sqrt(np.maximum(variances, 1e-12))
    least = min(np.median(first.deviations), np.median(second.deviations))
    if not _TIGHTER * np.median(deviations) < least:
        return None
    mark = "/" if is_ratio else "·"
    word = "ratio" if is_ratio else "product"
    return ParameterHistory(
        name=f"{first.name} {mark} {second.name}",
        words=f"{word} of {first.words} and {second.words}",
        unit="",
        values=first.values / second.values
        if is_ratio
        else first.values * second.values,
        scale=0.0,
        deviations=deviations,
        parts=(*first.parts, *second.parts),
        bounds=(-math.inf, math.inf),
    )


class _SessionTimes(NamedTuple):
    """Sessions in their order, and when each began."""

    names: list[str]
    when: FloatArray
    """Days, or numbers of the sessions if they are not dated, shape (n,)."""
    dated: bool

    @classmethod
    def of(cls, lessons: Sequence[Lesson]) -> _SessionTimes:
        """Those of lessons, oldest first."""
        names = [lesson.name for lesson in lessons]
        began = np.array([lesson.began for lesson in lessons], dtype=np.float64) / _DAY
        dated = bool((np.diff(began) > 0.0).all())
        return cls(
            names, began if dated else np.arange(len(lessons), dtype=np.float64), dated
        )

    def part(self, first: int, end: int) -> _SessionTimes:
        """Some of them."""
        return _SessionTimes(self.names[first:end], self.when[first:end], self.dated)


class _Fitted(NamedTuple):
    """A parameter under several hypotheses at once: K of them, or S spreads and K of them."""

    evidence: FloatArray
    """Logarithm of the integrated likelihood, shape (K,) or (S, K)."""
    level: FloatArray
    size: FloatArray
    error: FloatArray
    """Of the size."""


def _fit(history: ParameterHistory, shapes: FloatArray) -> _Fitted:
    """Fit level + size · shape for shapes (K, n), integrated over level, size and spread."""
    y = history.levels
    s = history.deviations
    spreads = _SPREADS * np.median(s)
    # Surroundings, whose zero is arbitrary, are expected to be others every session; properties are not.
    prior = np.zeros(_SPREADS.size) if history.scale else -2.0 * np.log1p(_SPREADS)
    prior -= np.log(np.exp(prior).sum())
    fits = _fit_at(y, np.square(s) + np.square(spreads)[:, None], shapes)
    logs = fits.evidence + prior[:, None]
    most = logs.max(axis=0)
    evidence = most + np.log(np.exp(logs - most).sum(axis=0))
    best = (logs.argmax(axis=0), np.arange(len(shapes)))
    return _Fitted(evidence, fits.level[best], fits.size[best], fits.error[best])


def _fit_at(y: FloatArray, variances: FloatArray, shapes: FloatArray) -> _Fitted:
    """The same for each spread, with variances (S, n), by iteratively reweighted least squares."""
    of_spread = variances[:, None]  # beside the axis of the shapes
    weights = np.tile(1.0 / of_spread, (1, len(shapes), 1))
    for _ in range(_ROBUST.rounds):
        # normal equations: a·level + b·size = Σ w·y and b·level + c·size = Σ w·shape·y
        weighted_shapes = weights * shapes
        a = weights.sum(axis=-1)
        b = weighted_shapes.sum(axis=-1)
        c = (weights * shapes**2).sum(axis=-1)
        c += 1.0 / _ROBUST.size**2
        determinant = a * c - b**2
        of_y = weights @ y
        of_shape = weighted_shapes @ y
        level = (c * of_y - b * of_shape) / determinant
        size = (a * of_shape - b * of_y) / determinant
        residuals = y - level[..., None] - size[..., None] * shapes
        squares = np.square(residuals) / of_spread
        weights = (_ROBUST.degrees + 1.0) / (_ROBUST.degrees + squares) / of_spread
    losses = (_ROBUST.degrees + 1.0) * np.log1p(squares / _ROBUST.degrees) + np.log(
        of_spread
    )
    likelihood = -0.5 * losses.sum(axis=-1)
    evidence = likelihood - 0.5 * np.log(determinant)
    evidence = evidence - 0.5 * np.square(size / _ROBUST.size) - math.log(_ROBUST.size)
    return _Fitted(evidence, level, size, np.sqrt(a / determinant))


def _spread(history: ParameterHistory) -> float:
    """How many times its deviations a parameter scatters between sessions, robustly."""
    levels = history.levels
    return float(
        MEDIAN_TO_SIGMA
        * np.median(np.abs(levels - np.median(levels)))
        / np.median(history.deviations)
    )


def _changes(
    history: ParameterHistory, sessions: _SessionTimes, among: int
) -> list[ParameterChange]:
    """The changes of one parameter, oldest first; `among` is the number of those that are looked at."""
    n = history.values.size
    if n < 2 * MIN_SIDE:
        return []
    hypotheses = _Hypotheses.of(history, sessions)
    evidence = hypotheses.evidence_for_any() - math.log(among)
    if evidence < _NAMED_FROM.least:
        return []
    if hypotheses.is_trend:
        trend = _change(history, sessions, hypotheses, -1, evidence)
        return [trend]
    place = hypotheses.latest_step
    first_after = MIN_SIDE + place
    step = _change(history, sessions, hypotheses, place, evidence)
    before = _changes(
        history.part(0, first_after), sessions.part(0, first_after), among
    )
    after = _changes(history.part(first_after, n), sessions.part(first_after, n), among)
    return [*before, step, *after]


class _Hypotheses(NamedTuple):
    """A parameter under every step, earliest first, and a trend if there are sessions enough."""

    fitted: _Fitted
    """Under them, shape (K,)."""
    evidence: FloatArray
    """For each beyond that of a steady parameter, nats, shape (K,)."""
    n_steps: int

    @classmethod
    def of(cls, history: ParameterHistory, sessions: _SessionTimes) -> _Hypotheses:
        """Those of a parameter over sessions."""
        n = history.values.size
        steps = [
            np.arange(n) >= first_after
            for first_after in range(MIN_SIDE, n - MIN_SIDE + 1)
        ]
        when = sessions.when
        ramp = (when - when[0]) / (when[-1] - when[0])
        trends = [ramp] if n >= MIN_TREND else []
        fitted = _fit(
            history, np.array([np.zeros(n), *steps, *trends], dtype=np.float64)
        )
        of_changes = _Fitted(*(figures[1:] for figures in fitted))
        return cls(of_changes, of_changes.evidence - fitted.evidence[0], len(steps))

    @property
    def of_steps(self) -> FloatArray:
        """Evidence for each step."""
        return self.evidence[: self.n_steps]

    def evidence_for_any(self) -> float:
        """Evidence for all changes together: half of their probability is that of steps, half of a trend."""
        n_trends = self.evidence.size - self.n_steps
        kinds = np.array([0.5 / self.n_steps] * self.n_steps + [0.5] * n_trends)
        return float(
            np.log(kinds @ np.exp(np.minimum(self.evidence, _NAMED_FROM.most)))
        )

    @property
    def is_trend(self) -> bool:
        """Whether a trend is clearly more credible than every step."""
        if self.evidence.size == self.n_steps:
            return False
        return not self.of_steps.max() >= self.evidence[-1] - _NAMED_FROM.trend

    @property
    def latest_step(self) -> int:
        """Number of the latest credible step: from it on the change is complete."""
        return int(
            np.flatnonzero(self.of_steps >= self.of_steps.max() - _NAMED_FROM.moments)[
                -1
            ]
        )


def _change(
    history: ParameterHistory,
    sessions: _SessionTimes,
    hypotheses: _Hypotheses,
    place: int,
    evidence: float,
) -> ParameterChange:
    """The change of one of the hypotheses; -1 is the trend."""
    is_step = place >= 0
    level = float(hypotheses.fitted.level[place])
    size = float(hypotheses.fitted.size[place])
    error = float(hypotheses.fitted.error[place])
    old = history.value(level)
    new = history.value(level + size)
    first_after = MIN_SIDE + place if is_step else 0
    relative = not history.scale
    return ParameterChange(
        name=history.name,
        words=history.words,
        unit=history.unit,
        kind="step" if is_step else "trend",
        since=sessions.names[first_after],
        after=sessions.names[first_after - 1],
        old=old,
        new=new,
        relative=relative,
        size=new / old - 1.0 if relative else new - old,
        error=error if relative else error * history.scale,
        evidence=evidence,
        days=float(sessions.when[-1] - sessions.when[0]),
        dated=sessions.dated,
        bounds=history.bounds,
    )
