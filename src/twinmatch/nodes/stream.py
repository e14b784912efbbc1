"""Samples in the order of their indices, whether they arrive live or are fetched later.

A restarted node has missed all samples, a paused one some. It asks the keeper for those between its last
sample and the newest one, and holds back what arrives meanwhile. Only samples that the keeper does not have
either are a gap: the rig itself published none.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

from twinmatch.signals import Sample

__all__ = ["Missing", "Stream"]


class Missing(NamedTuple):
    """Range of samples to fetch."""

    first: int
    last: int


class Stream:
    """Passes samples on in order, and reports which are missing."""

    def __init__(self, give: Callable[[Sample], None]) -> None:
        """Pass every sample on to `give`."""
        self.missing: Missing | None = None
        """The samples to fetch now; live samples are held back until then."""
        self._give = give
        self._end = 0  # index of the newest sample passed on, plus one
        self._held: deque[Sample] = deque()

    @property
    def begun(self) -> bool:
        """Whether a sample was passed on."""
        return self._end > 0

    def push(self, sample: Sample) -> None:
        """Take a live sample."""
        if self.missing is not None:
            self._held.append(sample)
        elif sample.index > self._end:
            self.missing = Missing(self._end, sample.index - 1)
            self._held.append(sample)
        else:
            self._pass_on(sample)

    def fetched(self, samples: Sequence[Sample], heard: int) -> bool:
        """Take an answer: some of the missing samples, and the end of what the keeper has received.

        Returns whether this made progress; if not, asking again at once is useless.
        """
        missing = self.missing
        if missing is None:
            return False
        for sample in samples:
            self._pass_on(sample)
        if self._end > missing.last or (not samples and heard > missing.last):
            self.skip()
            return True
        self.missing = Missing(self._end, missing.last)
        return bool(samples)

    def skip(self) -> None:
        """Skip what is still missing, and pass on what was held back."""
        self.missing = None
        held, self._held = self._held, deque()
        if held:
            self._pass_on(held.popleft())  # possibly with a gap before it
        for sample in held:
            self.push(sample)

    def _pass_on(self, sample: Sample) -> None:
        self._end = sample.index + 1
        self._give(sample)
