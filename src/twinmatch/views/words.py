"""What output and input of a plant are called in figures, tables and sentences, and their units."""

from __future__ import annotations

import math
from typing import NamedTuple

from twinmatch.discrimination import Verdict
from twinmatch.dynamics import Plant
from twinmatch.views.quantities import number

__all__ = ["Words", "leader_words", "missed", "with_unit", "words_of"]


class Words(NamedTuple):
    """Names of output and input with their units; a unit may be empty."""

    output: str
    """Such as temperature."""
    output_unit: str
    input: str
    """Such as inflow; "control" where the plant file says no more than its unit."""
    input_unit: str
    output_decimals: int
    """Decimal places of its values; an error has one more."""
    input_decimals: int

    @property
    def output_label(self) -> str:
        """Name and unit, as on an axis."""
        return with_unit(self.output, self.output_unit)

    @property
    def input_label(self) -> str:
        """Name and unit, as on an axis."""
        return with_unit(self.input, self.input_unit)


def words_of(plant: type[Plant]) -> Words:
    """Those of a plant, from its declarations."""
    y, u = plant.output, plant.drive
    driven = "control" if u.name.lower() == u.unit.lower() else u.name.replace("_", " ")
    return Words(y.name.replace("_", " "), y.unit, driven, u.unit, y.decimals, u.decimals)


def with_unit(name: str, unit: str) -> str:
    """A name and its unit, as on an axis."""
    return f"{name} / {unit}" if unit else name


def missed(verdict: Verdict) -> str:
    """How far the newest samples lay from what was foretold, in half widths of the band."""
    if math.isnan(verdict.miss_y):
        return "nothing has come yet of what was foretold"
    of = verdict.forecasts[0].parameters if verdict.forecasts else None
    words = words_of(of.model.plant) if of else None
    names = (words.output, words.input) if words else ("output", "control")
    misses = zip(names, (verdict.miss_y, verdict.miss_u), strict=True)
    told = " and ".join(f"{name} {number(miss, 1)}" for name, miss in misses if not math.isnan(miss))
    return f"{told} half widths of the band from what was foretold"


def leader_words(verdict: Verdict) -> str:
    """The leader, how sure that is, and what its forecasts have saved."""
    if verdict.leader is None:
        return "none yet"
    gain = next((s.gain for s in verdict.forecasts if s.name == verdict.leader), math.nan)
    saved = "" if math.isnan(gain) else f", its forecasts save {number(gain, 1)} characters each"
    return f"{verdict.leader} (confidence {number(verdict.leader_confidence, 2)}){saved}"
