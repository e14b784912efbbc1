"""The criterion table: which Box–Jenkins order explains the plant best, by every criterion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from twinmatch.comparing import CandidateScore, OrderScore
from twinmatch.showing.quantities import number

__all__ = ["CRITERIA", "OUTPUTS", "Cell", "Criterion", "CriterionRow", "criterion_rows", "outputs_of"]


class Criterion(NamedTuple):
    """One column of the table."""

    attribute: str
    """Of `Criteria`."""
    name: str
    unit: str
    """Empty: a plain number."""
    decimals: int
    larger_is_better: bool | None
    """None: the column is not a criterion, so no value in it is best."""

    def text(self, value: float) -> str:
        """The value as shown in the table, without unit."""
        return number(value, self.decimals)


CRITERIA: tuple[Criterion, ...] = (
    Criterion("trivial_length", "l(t)", "characters", 0, None),
    Criterion("model_length", "l(p)", "characters", 0, None),
    Criterion("gain", "gain", "characters", 0, True),
    Criterion("explanation", "explained", "", 3, True),
    Criterion("naic", "nAIC", "", 3, False),
    Criterion("bic", "BIC", "", 1, False),
    Criterion("mdl", "MDL", "", 4, False),
    Criterion("two_part_length", "two-part", "characters", 0, False),
)
"""The columns, in the order of the paper's table; MDL has the unit of the loss, output or input squared."""

OUTPUTS: tuple[tuple[str, str], ...] = (
    ("y", "output y/r"),
    ("u", "control u/r"),
    ("total", "both"),
)
"""Attribute of `OrderScore` and its name in tables."""

_DRIVEN: tuple[tuple[str, str], ...] = (("y", "output y/u"),)
"""The same where the loop is not known."""


def outputs_of(orders: Sequence[OrderScore]) -> tuple[tuple[str, str], ...]:
    """The outputs that a candidate's orders were scored on: attributes of `OrderScore` and their names."""
    return _DRIVEN if any(order.u is None for order in orders) else OUTPUTS


class Cell(NamedTuple):
    """One figure of the table."""

    value: float
    text: str
    best: bool
    """Whether this order is the best of its candidate by this criterion, on this output."""


class CriterionRow(NamedTuple):
    """One order of one candidate on one output."""

    output: str
    order: str
    chosen: bool
    """Whether the order is the one chosen for the candidate."""
    cells: tuple[Cell, ...]
    """One for each of the criteria passed to `criterion_rows`."""


def criterion_rows(
    candidate: CandidateScore, criteria: Sequence[Criterion] = CRITERIA
) -> tuple[CriterionRow, ...]:
    """The table of one candidate: a row per order, for y, for u and for both; for y alone in open loop."""
    return tuple(
        CriterionRow(
            output=output,
            order=order.order,
            chosen=order.order == candidate.chosen_order,
            cells=tuple(_cell(candidate.orders, order, output, criterion) for criterion in criteria),
        )
        for output, _ in outputs_of(candidate.orders)
        for order in candidate.orders
    )


def computed(candidates: Sequence[CandidateScore]) -> tuple[Criterion, ...]:
    """The criteria that have a value for at least one candidate."""
    return tuple(
        c
        for c in CRITERIA
        if any(not math.isnan(_value(o, "total", c)) for candidate in candidates for o in candidate.orders)
    )


def _cell(orders: Sequence[OrderScore], order: OrderScore, output: str, criterion: Criterion) -> Cell:
    value = _value(order, output, criterion)
    if criterion.larger_is_better is None or math.isnan(value):
        return Cell(value, criterion.text(value), best=False)
    pick = max if criterion.larger_is_better else min
    best = pick(_value(o, output, criterion) for o in orders)
    return Cell(value, criterion.text(value), best=value == best)


def _value(order: OrderScore, output: str, criterion: Criterion) -> float:
    return float(getattr(getattr(order, output), criterion.attribute))
