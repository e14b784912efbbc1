"""What a check of a plant found, in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

__all__ = ["CheckedPlant", "Finding"]


class Finding(NamedTuple):
    """Something that is wrong, and what to do about it."""

    what: str
    todo: str


@dataclass(frozen=True)
class CheckedPlant:
    """All that was found."""

    title: str
    findings: tuple[Finding, ...] = ()
    notes: tuple[str, ...] = ()
    """What is no mistake but good to know."""
    unusable: str = ""
    """Why the plant cannot be run at all; empty: it can."""

    @property
    def exit_code(self) -> int:
        """0: nothing was found; 1: something was; 2: the plant cannot be used."""
        return 2 if self.unusable else 1 if self.findings else 0
