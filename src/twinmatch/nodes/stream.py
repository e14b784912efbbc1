"""Samples in the order of their indices, however they arrive: live, or fetched because they were missed.

A node that comes back has missed all, one that was stopped some. It asks the keeper for what lies between
the sample it knows and the one that has come, and holds back what comes meanwhile. Only what the keeper has
not got either is a gap: then the rig itself made none.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

from twinmatch.signals import Sample

__all__ = ["Missing", "Stream"]


class Missing(NamedTuple):
    """Samples that are asked for."""

    first: int
    last: int


class Stream:
    """Gives samples on in their order, and says which are missing."""

    def __init__(self, give: Callable[[Sample], None]) -> None:
        """Give every sample on to `give`."""
        self.missing: Missing | None = None
        """What is to be fetched now; what comes live is held back until then."""
        self._give = give
        self._end = 0  # index of the newest that was given on, plus one
        self._held: deque[Sample] = deque()

    @property
    def begun(self) -> bool:
        """Whether a sample was given on."""
        return self._end > 0

    def push(self, sample: Sample) -> None:
        """Take a sample that came live."""
        if self.missing is not None:
            self._held.append(sample)
        elif sample.index > self._end:
            self.missing = Missing(self._end, sample.index - 1)
            self._held.append(sample)
        else:
            self._on(sample)

    def fetched(self, samples: Sequence[Sample], heard: int) -> bool:
        """Take an answer: samples of those missing, and the end of what the keeper has heard.

        Returns whether it brought anything on; otherwise there is no use in asking again at once.
        """
        missing = self.missing
        if missing is None:
            return False
        for sample in samples:
            self._on(sample)
        if self._end > missing.last or (not samples and heard > missing.last):
            self.go_on()
            return True
        self.missing = Missing(self._end, missing.last)
        return bool(samples)

    def go_on(self) -> None:
        """Do without what is still missing, and give on what was held back."""
        self.missing = None
        held, self._held = self._held, deque()
        if held:
            self._on(held.popleft())  # with a gap before it, if so it is
        for sample in held:
            self.push(sample)

    def _on(self, sample: Sample) -> None:
        self._end = sample.index + 1
        self._give(sample)
