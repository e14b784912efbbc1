"""Names and units of a plant and its signals, for messages, figures, tables and pages."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated

from twinmatch.requirements import SentAs
from twinmatch.signals import one_of_each


@dataclass(frozen=True, slots=True)
class Quantity:
    """A signal or a state of a plant."""

    name: str
    """Name in code and files."""
    text: str
    """Short description."""
    unit: str = ""
    low: float = -math.inf
    """Lowest possible value."""
    high: float = math.inf

    @property
    def decimals(self) -> int:
        """Decimal places that resolve a ten-thousandth of its span; three without a span."""
        span = self.high - self.low
        return (
            min(9, max(0, 4 - math.floor(math.log10(span))))
            if 0 < span < math.inf
            else 3
        )

    @property
    def label(self) -> str:
        """Name and unit, as on an axis; only the unit if both are equal, as for PWM."""
        if self.name.lower() == self.unit.lower():
            return self.unit
        return f"{self.name} / {self.unit}" if self.unit else self.name


def _by_text(several: tuple[Quantity, ...]) -> tuple[Quantity, ...]:
    """Quantities of one kind, called as their texts say where there are more than one."""
    return (
        several
        if len(several) == 1
        else tuple(replace(q, name=q.text or q.name) for q in several)
    )


@dataclass(frozen=True, slots=True)
class Description:
    """A plant; its references have the units of the outputs."""

    plant: str
    """Name, such as peltier."""
    title: str
    """Displayed name."""
    references: Annotated[tuple[Quantity, ...], SentAs("reference")]
    outputs: Annotated[tuple[Quantity, ...], SentAs("output")]
    inputs: Annotated[tuple[Quantity, ...], SentAs("input")]
    disturbances: tuple[Quantity, ...] = ()
    states: tuple[Quantity, ...] = ()
    """States of a twin, in the order of messages."""
    structures: tuple[str, ...] = ()
    """Names of the plant's structures."""

    @property
    def loops(self) -> tuple[Loop, ...]:
        """Its set-points, outputs and inputs, in one place what belongs together (of fewer the last); several
        have their texts as names."""
        references = _by_text(self.references)
        outputs = _by_text(self.outputs)
        inputs = _by_text(self.inputs)
        loops = []
        for k in range(max(len(outputs), len(inputs))):
            loops.append(
                (
                    references[min(k, len(references) - 1)],
                    outputs[min(k, len(outputs) - 1)],
                    inputs[min(k, len(inputs) - 1)],
                )
            )
        return tuple(loops)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of references, outputs and inputs."""
        return len(self.references), len(self.outputs), len(self.inputs)

    @property
    def reference(self) -> Quantity:
        """The reference of a single loop."""
        return one_of_each("reference", self.references)

    @property
    def output(self) -> Quantity:
        """The output of a single loop."""
        return one_of_each("output", self.outputs)

    @property
    def input(self) -> Quantity:
        """The input of a single loop."""
        return one_of_each("input", self.inputs)


Loop = tuple[Quantity, Quantity, Quantity]
"""Set-point, output and input."""


def nth(name: str, k: int) -> str:
    """Name of a column for the k-th of several signals, counted from 0."""
    return f"{name}_{k + 1}" if k else name


UNDESCRIBED = Description(
    plant="",
    title="",
    references=(Quantity("set-point", "set-point of the output"),),
    outputs=(Quantity("output", "measured output"),),
    inputs=(Quantity("input", "commanded input"),),
)
"""Placeholder for a plant that has not published its description yet."""
