"""When laws on trial have driven the plant, and which forecasts that leaves without samples to compare."""

from __future__ import annotations

import math

__all__ = ["LawTrials"]


class LawTrials:
    """The trials of one session, by samples.

    Twins forecast under the law before a trial. So what the plant does under another law counts neither for
    nor against them.
    """

    def __init__(self) -> None:
        """Begin without a trial."""
        self._ends: dict[int, float] = {}
        """By the first sample that a law on trial drove the last one; infinite while it drives."""

    def note(self, first: int, last: float = math.inf) -> None:
        """Note that a law on trial drove from sample `first` to `last`; infinite while it drives."""
        self._ends[first] = last

    def between(self, first: int, last: int) -> str:
        """That a law on trial drove between two samples, both included, in words; empty if none did."""
        begins = [
            begin for begin, end in self._ends.items() if begin <= last and end >= first
        ]
        return f"a law on trial has driven since sample {begins[-1]}" if begins else ""

    def why_not_compared(self, newest: int, samples: int, horizon: int) -> str:
        """Why so many samples, up to the newest, are not compared with forecasts of up to `horizon` samples.

        They are not where a law on trial drove when the forecasts were made, or has driven since. Empty if
        none did.
        """
        reach = samples + horizon
        if not self.between(newest - reach, newest):
            return ""
        last = max(end for begin, end in self._ends.items() if begin <= newest)
        if last >= newest:
            return "a law is on trial: its samples are not compared with forecasts for the law before"
        over = f"a law on trial drove until sample {last:.0f}"
        return f"{over}: measurements are compared with forecasts again after sample {last + reach:.0f}"
