"""Comparison of a plant's structures on a recording: which of its equations the data support."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from twinmatch.adding.findings import Finding
from twinmatch.dynamics import Plant, PlantError
from twinmatch.fitting import FittingError
from twinmatch.showing.series import root_mean_square
from twinmatch.signals import Sample, Window, unbroken
from twinmatch.twin import StructureScore, TwinSettings, choose_structure

__all__ = ["Compared", "compare_structures"]

_SHORTEST: Final = 60
"""Samples of the shortest stretch that is used."""
_MOST: Final = 7200
"""Samples that are used at most: two hours at 1 s determine a structure, and longer fits take long."""


class Compared(NamedTuple):
    """Result of a comparison."""

    findings: list[Finding]
    """That another structure than the first one is preferred: the first is matched to windows."""
    notes: list[str]
    least: float
    """RMS of the smallest residuals, in the output's unit; NaN if nothing could be fitted."""


def compare_structures(samples: Sequence[Sample], plant: type[Plant], settings: TwinSettings) -> Compared:
    """Fit every structure of the plant file to a recording as a whole."""
    names = [name for name, structure in plant.structures.items() if structure.external is None]
    windows = _windows(samples, settings)
    if not windows:
        return Compared([], [], math.nan)
    try:
        choice = choose_structure(
            windows, [plant.model(name) for name in names], noise=settings.noise, gains=settings.gains
        )
    except (FittingError, PlantError) as error:
        return Compared([], [f"the structures cannot be compared on this recording: {error}"], math.nan)
    used = sum(len(window) for window in windows)
    notes = [f"each structure fitted to {'all' if used == len(samples) else 'the first'} {used} samples:"]
    notes += [f"  {_line(score, plant)}" for score in choice.scores]
    if len(names) > 1:
        notes.append(choice.sentence)
    least = min(map(_rms, choice.scores))
    first = settings.start.model.structure_name
    if choice.chosen == first:
        return Compared([], notes, least)
    what = f"the recording supports the structure {choice.chosen!r} rather than {first!r}"
    todo = "put it first in `structures`: single windows are matched with the first one"
    return Compared([Finding(what, todo)], notes, least)


def _windows(samples: Sequence[Sample], settings: TwinSettings) -> list[Window]:
    windows, left = [], _MOST
    for stretch in unbroken(samples):
        part = stretch[:left]
        if len(part) >= _SHORTEST:
            windows.append(Window.from_samples(part, settings.period))
            left -= len(part)
    return windows


def _line(score: StructureScore, plant: type[Plant]) -> str:
    y = plant.output
    rms = _rms(score)
    values = ", ".join(f"{name} = {score.parameters[name]:.4g}" for name in score.fitted.model.structure.free)
    fit = "" if math.isnan(score.fit[0]) else f", fit {score.fit[0]:.1%}"
    return f"{score.name}: leaves {rms:.3g} {y.unit} ({rms / y.noise:.3g} × noise){fit}; {values}"


def _rms(score: StructureScore) -> float:
    off = [m[0] - s[0] for m, s in zip(score.fitted.measured, score.fitted.simulated, strict=True)]
    return root_mean_square(off)
