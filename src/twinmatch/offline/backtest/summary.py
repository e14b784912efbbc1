"""Summary of the marks of many forecasts in the figures of a report card."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twinmatch.offline.backtest.scoring import Marks
from twinmatch.signals import FloatArray

__all__ = ["HINDSIGHT", "Card", "Marked", "best_in_hindsight", "cards", "common"]

HINDSIGHT = "best in hindsight"
"""Name for the best candidate of each forecast, known only in hindsight."""


@dataclass(frozen=True, slots=True)
class Marked:
    """One forecast of one forecaster, judged at one horizon."""

    session: str
    sample: int
    """Index of the newest sample it was made from."""
    horizon: float
    """Horizon, s."""
    who: str
    """Name of the forecaster."""
    marks: Marks
    candidate: str = ""
    """Name of the candidate; empty for a peer."""

    @property
    def place(self) -> tuple[str, int, float]:
        """Session, sample and horizon; equal for comparable forecasts."""
        return self.session, self.sample, self.horizon


@dataclass(frozen=True, slots=True)
class Card:
    """One forecaster at one horizon, over many forecasts; errors, widths, scores in units of the noise."""

    who: str
    horizon: float
    """Horizon, s."""
    count: int
    """Number of scored forecasts."""
    median: float
    """Median of the errors over the path, both signals together."""
    nine_in_ten: float
    """Value below which nine in ten of these errors are."""
    ratio: float
    """Mean of the errors, each divided by that of the best in hindsight; NaN without it."""
    end_output: float
    """Median size of the output's error at the horizon itself."""
    end_input: float
    """NaN where inputs were given, as for coverage and width."""
    coverage_output: float
    """Share of all output samples within the band."""
    coverage_input: float
    width_output: float
    """Median over the forecasts of the band's mean width."""
    width_input: float
    score: float
    """Mean interval score, both signals together; smaller is better."""


def best_in_hindsight(marked: Iterable[Marked]) -> list[Marked]:
    """The forecast with the least error for every origin and horizon, under the name `HINDSIGHT`.

    Args:
        marked: forecasts of candidates; of equal ones the first is taken.
    """
    best: dict[tuple[str, int, float], Marked] = {}
    for one in marked:
        if one.place not in best or one.marks.error < best[one.place].marks.error:
            best[one.place] = one
    return [replace(one, who=HINDSIGHT) for one in best.values()]


def common(marked: Sequence[Marked]) -> list[Marked]:
    """Only the forecasts that every forecaster made, so that all are compared on the same samples."""
    names = {one.who for one in marked}
    asked: dict[tuple[str, int, float], set[str]] = {}
    for one in marked:
        asked.setdefault(one.place, set()).add(one.who)
    return [one for one in marked if asked[one.place] == names]


def cards(marked: Sequence[Marked]) -> list[Card]:
    """The report cards: forecasters in the order in which they first appear, horizons from near to far.

    Marks of several sessions give the cards over all: every forecast has the same weight.
    """
    best = {one.place: one.marks.error for one in marked if one.who == HINDSIGHT}
    groups: dict[str, dict[float, list[Marked]]] = {}
    for one in marked:
        groups.setdefault(one.who, {}).setdefault(one.horizon, []).append(one)
    return [
        _card(who, horizon, held, best)
        for who, by_horizon in groups.items()
        for horizon, held in sorted(by_horizon.items())
    ]


def _card(
    who: str, horizon: float, held: Sequence[Marked], best: dict[tuple[str, int, float], float]
) -> Card:
    errors = np.array([one.marks.error for one in held])
    least = np.array([best.get(one.place, np.nan) for one in held])
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(errors == least, 1.0, errors / least)
    signals = [one.marks.output for one in held], [one.marks.input for one in held]
    both = [[s for s in pair if s is not None] for pair in zip(*signals, strict=True)]
    if None in signals[1]:  # the input was given, at least to some
        both = [[output] for output in signals[0]]
    ends = _pair(np.median(np.abs([[s.end for s in pair] for pair in both]), axis=0))
    coverages = _pair(np.mean([[s.coverage for s in pair] for pair in both], axis=0))
    widths = _pair(np.median([[s.width for s in pair] for pair in both], axis=0))
    return Card(
        who=who,
        horizon=horizon,
        count=len(held),
        median=float(np.median(errors)),
        nine_in_ten=float(np.quantile(errors, 0.9)),
        ratio=float(np.mean(ratios)),
        end_output=float(ends[0]),
        end_input=float(ends[1]),
        coverage_output=float(coverages[0]),
        coverage_input=float(coverages[1]),
        width_output=float(widths[0]),
        width_input=float(widths[1]),
        score=float(np.mean([one.marks.score for one in held])),
    )


def _pair(figures: FloatArray) -> tuple[float, float]:
    """Figures of output and input; NaN for a given input."""
    output, entry = [*figures.tolist(), float("nan")][:2]
    return output, entry
