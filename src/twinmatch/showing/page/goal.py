"""A level that the output is to reach: when it will be there, and when one must begin to be there in time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from twinmatch.dynamics import Plant
from twinmatch.forecasting import MAX_SAMPLES, Moment, Outlook, Question, what_if
from twinmatch.offline.clock_times import ClockTimeError, clock_words, seconds_until
from twinmatch.signals import decimals_of_time, one_of_each

ASKED_EVERY: Final = 5.0
"""Time between two answers, s: each takes three long forecasts."""


@dataclass(frozen=True)
class Goal:
    """What is to be reached.

    Raises:
        ClockTimeError: the level is not finite, or the time is not one.
    """

    level: float
    """In the output's unit."""
    by: str = ""
    """When, as `forecast --by` takes it; empty: whenever it is."""

    def __post_init__(self) -> None:
        if not math.isfinite(self.level):
            raise ClockTimeError(f"--reach is {self.level:g}; give a finite level")
        if self.by.startswith("+"):
            raise ClockTimeError(
                f"--by {self.by}: on a running plant give a time of day, HH:MM"
            )
        if self.by:
            # any sample with a date: the text has to be a time
            seconds_until(self.by, 10**18)

    def moves(self, plant: type[Plant], *, closed: bool) -> tuple[float, ...]:
        """Set-points or, where the loop is not known, inputs that may lead there."""
        return (self.level,) if closed else plant.drive.limits

    def held(self, period: float) -> Question:
        """When is it there if nothing is changed? At a sample time, s."""
        return Question(horizon=MAX_SAMPLES * period, level=self.level)

    def moved(self, move: float, period: float) -> Question:
        """When is it there if this is given now?"""
        return Question((0.0,), (move,), horizon=MAX_SAMPLES * period, level=self.level)


def number_in(text: str, what: str) -> float:
    """The number that a text is; `what` names it.

    Raises:
        ClockTimeError: it is not one.
    """
    try:
        return float(text)
    except ValueError:
        raise ClockTimeError(
            f"{what}: {text[:80]!r} is not a number; give a level"
        ) from None


class GoalAnswer(NamedTuple):
    """What is known of a goal at a sample; times in s after it."""

    goal: Goal
    held: Moment
    """When the output is there if nothing is changed."""
    move: float
    """Set-point, or input where the loop is not known, that leads there soonest."""
    moved: Moment
    """When it is there if that is given now."""
    stamp: int
    """Of the sample, ns."""

    @property
    def begin(self) -> float:
        """When the move has to be made so that even the edge of the band that arrives last is there in time,
        if the plant stays where it is until then; 0: at once, or too late; NaN if that is not known."""
        if not self.goal.by or self.moved.latest is None:
            return math.nan
        try:
            return max(seconds_until(self.goal.by, self.stamp) - self.moved.latest, 0.0)
        except ClockTimeError:
            return math.nan

    def lines(self, unit: str, period: float) -> tuple[str, ...]:
        """The answer in words, with levels in the output's `unit`, and times as a sampling period, s, needs them."""
        decimals = decimals_of_time(period)
        level = f"{self.goal.level:g} {unit}".rstrip()
        lines = [
            f"{level}: {moment_words(self.held, decimals)} if nothing is changed",
            f"{level}: {moment_words(self.moved, decimals)} with {self.move:g} from now on",
        ]
        if not math.isnan(self.begin):
            clock = clock_words(self.stamp, self.begin)
            at = f", at {clock}" if clock else ""
            lines.append(
                f"to be there by {self.goal.by}: begin in {self.begin:.{decimals}f} s{at}"
            )
        return tuple(lines)


def moment_words(moment: Moment, decimals: int) -> str:
    """When something happens, with its band, s with so many decimals."""
    if moment.expected is None:
        return f"not within {MAX_SAMPLES} samples"
    earliest = moment.expected if moment.earliest is None else moment.earliest
    latest = "later" if moment.latest is None else f"{moment.latest:.{decimals}f}"
    return f"in {moment.expected:.{decimals}f} s ({earliest:.{decimals}f} to {latest})"


def soonest(
    goal: Goal, held: Moment, moved: Mapping[float, Moment], stamp: int
) -> GoalAnswer:
    """The answer with the move that arrives first; with the last one if none does."""

    def delay(move: float) -> float:
        expected = moved[move].expected
        return math.inf if expected is None else expected

    move = min(reversed(list(moved)), key=delay)
    return GoalAnswer(goal, held, move, moved[move], stamp)


def answer_of(goal: Goal, outlook: Outlook) -> GoalAnswer:
    """The answer of a twin.

    Raises:
        ForecastError: the plant has several loops, or does not take the level as set-point.
    """
    plant = outlook.parameters.model.plant
    held = what_if(outlook, goal.held(outlook.period)).reached
    moved = {}
    for move in goal.moves(plant, closed=outlook.closed):
        standing = one_of_each("level", outlook.standing)
        moved[move] = (
            held
            if move == standing
            else what_if(outlook, goal.moved(move, outlook.period)).reached
        )
    return soonest(goal, held, moved, outlook.sample.stamp)
