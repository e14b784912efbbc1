"""What is asked of an experiment on the running plant, and what is reported of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Final

from twinmatch.errors import TwinmatchError

GOALS: Final = ("structure", "parameters", "fault")
"""What a running twin can be asked for."""
MAX_MINUTES: Final = 1e4
"""Longest course that can be asked for, min."""
LEAST: Final = 1.0
"""Characters below which a course is not worth its time."""


class ExperimentError(TwinmatchError):
    """An experiment cannot be run on the plant as it is."""


class ExperimentPhase(Enum):
    """How far an experiment is."""

    PROPOSED = "proposed"
    RUNNING = "running"
    DECIDED = "decided"
    ENDED = "ended"
    REFUSED = "refused"


@dataclass(frozen=True)
class ExperimentReport:
    """An experiment at a sample."""

    sample: int
    """Index of the newest sample it knows."""
    phase: ExperimentPhase
    goal: str
    """What is to be known: structure, parameters or fault."""
    first: int
    """Its first sample."""
    expected: float = math.nan
    """Characters that it is to bring in all, by what is left of its course and what it has brought."""
    brought: float = math.nan
    """Characters that it has brought."""
    levels: tuple[float, ...] = ()
    """Set-points still to come: one of each output, then the next of each."""
    holds: tuple[float, ...] = ()
    """How long each of them is held, s."""
    reason: str = ""
    """What its course and others bring, in words; at its end why it ended, or why it is refused."""
    request: str = ""
    """The word of the request that it belongs to."""


@dataclass(frozen=True)
class Wish:
    """What is asked for.

    Raises:
        ExperimentError: the goal is not known, the time is not positive, or the range is not one.
    """

    goal: str | None = None
    """Its name; None: the first that is undecided."""
    minutes: float | None = None
    """Longest course; None: in proportion to the plant's time constant."""
    within: tuple[float, ...] | None = None
    """Range that every output keeps, bands included; None: what counts as safe."""
    ranges: tuple[tuple[float, float], ...] = ()
    """Least and greatest set-point that the controller takes, for each output; empty: not known."""

    def __post_init__(self) -> None:
        if self.goal is not None and self.goal not in GOALS:
            raise ExperimentError(
                f"goal: {self.goal[:80]!r} is not known; give one of {', '.join(GOALS)}"
            )
        if self.minutes is not None and not 0.0 < self.minutes <= MAX_MINUTES:
            raise ExperimentError(
                f"minutes is {self.minutes:g}; give a time of up to {MAX_MINUTES:g} minutes"
            )
        if self.within is None:
            return
        if len(self.within) != 2:
            raise ExperimentError(
                f"within has {len(self.within)} values; give the lowest and the highest, or none"
            )
        low, high = self.within
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ExperimentError(
                f"within is {low:g} to {high:g}; give finite values, the lower one first"
            )
