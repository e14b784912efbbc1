"""Names and units of a plant's output and input in figures, tables and sentences."""

from __future__ import annotations

import math
from typing import NamedTuple

from twinmatch.comparing import Verdict
from twinmatch.dynamics import Plant
from twinmatch.showing.quantities import number

__all__ = ["Words", "leader_words", "missed", "with_unit", "words_of"]


class Words(NamedTuple):
    """Names of output and input with their units; a unit may be empty."""

    output: str
    """For example temperature."""
    output_unit: str
    input: str
    """For example inflow; "control" where the plant file names only its unit."""
    input_unit: str
    output_decimals: int
    """Decimal places of its values; an error has one more."""
    input_decimals: int

    @property
    def output_label(self) -> str:
        """Name and unit, as an axis label."""
        return with_unit(self.output, self.output_unit)

    @property
    def input_label(self) -> str:
        """Name and unit, as an axis label."""
        return with_unit(self.input, self.input_unit)


def words_of(plant: type[Plant]) -> Words:
    """Names and units from the plant's declarations."""
    y, u = plant.output, plant.drive
    driven = "control" if u.name.lower() == u.unit.lower() else u.name.replace("_", " ")
    return Words(y.name.replace("_", " "), y.unit, driven, u.unit, y.decimals, u.decimals)


def with_unit(name: str, unit: str) -> str:
    """A name and its unit, as an axis label."""
    return f"{name} / {unit}" if unit else name


def missed(verdict: Verdict) -> str:
    """How far the newest samples are from the forecast, in half widths of the band."""
    if math.isnan(verdict.miss_y):
        return "no forecast has been compared with measurements yet"
    of = verdict.forecasts[0].parameters if verdict.forecasts else None
    words = words_of(of.model.plant) if of else None
    names = (words.output, words.input) if words else ("output", "control")
    misses = zip(names, (verdict.miss_y, verdict.miss_u), strict=True)
    parts = " and ".join(f"{name} {number(miss, 1)}" for name, miss in misses if not math.isnan(miss))
    return f"{parts} half band widths from the forecast"


def leader_words(verdict: Verdict) -> str:
    """The leader, its confidence, and the characters its forecasts have saved."""
    if verdict.leader is None:
        return "none yet"
    gain = next((s.gain for s in verdict.forecasts if s.name == verdict.leader), math.nan)
    saved = "" if math.isnan(gain) else f", its forecasts save {number(gain, 1)} characters each"
    return f"{verdict.leader} (confidence {number(verdict.leader_confidence, 2)}){saved}"
