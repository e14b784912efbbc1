"""What output and input of a plant are called in figures, tables and sentences, and their units."""

from __future__ import annotations

from typing import NamedTuple

from twinmatch.discrimination import Verdict
from twinmatch.dynamics import Plant
from twinmatch.views.quantities import number

__all__ = ["Words", "apart", "with_unit", "words_of"]


class Words(NamedTuple):
    """Names of output and input with their units; a unit may be empty."""

    output: str
    """Such as temperature."""
    output_unit: str
    input: str
    """Always "control": what the controller computes."""
    input_unit: str

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
    return Words(plant.output.name.replace("_", " "), plant.output.unit, "control", plant.drive.unit)


def with_unit(name: str, unit: str) -> str:
    """A name and its unit, as on an axis."""
    return f"{name} / {unit}" if unit else name


def apart(verdict: Verdict) -> str:
    """How far plant and nominal twin were from one another over the newest samples, with units."""
    words = words_of(verdict.candidates[0].parameters.model.plant) if verdict.candidates else None
    units = (words.output_unit, words.input_unit) if words else ("", "")
    figures = (number(verdict.driven_rms_y, 2), number(verdict.closed_rms_u, 1))
    return " and ".join(f"{figure} {unit}".rstrip() for figure, unit in zip(figures, units, strict=True))
