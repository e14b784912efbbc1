"""Findings of a plant check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple


class Finding(NamedTuple):
    """A fault, and what to do about it."""

    what: str
    todo: str


@dataclass(frozen=True)
class CheckedPlant:
    """Result of a check."""

    title: str
    findings: tuple[Finding, ...] = ()
    notes: tuple[str, ...] = ()
    """Remarks that are not faults."""
    unusable: str = ""
    """Why the plant cannot be simulated at all; empty: it can."""

    @property
    def exit_code(self) -> int:
        """0: no findings; 1: findings; 2: the plant cannot be used."""
        return 2 if self.unusable else 1 if self.findings else 0
