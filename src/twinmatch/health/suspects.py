"""Causes that may explain what the readings of a plant with several signals say."""

from __future__ import annotations

from dataclasses import dataclass

from twinmatch.health.faults import Fault
from twinmatch.health.hypotheses import ChangeRow, PlacedFault


@dataclass(frozen=True)
class Suspect:
    """A cause that may explain the readings, and how well it does."""

    cause: PlacedFault
    evidence: float
    """Nats beyond its price."""
    row: ChangeRow
    shift: float
    """Believed size of the change, as its row has it."""
    error: float
    """Standard deviation of that size."""
    born: int
    """Sample at which it began, counted from the last gap."""
    trace: int
    """Place of its trace in the bank; −1: it has none."""
    returned: float = 0.0
    """Of the end of a change, the share of the way back that is gone."""


def suspected_sensor(fault: Fault, output: int, evidence: float, born: int) -> Suspect:
    """A sensor that its own readings accuse since a sample, counted from the last gap; no trace follows that."""
    row = ChangeRow((fault, output), "")
    return Suspect(row.cause, evidence, row, 0.0, 0.0, born, -1)
