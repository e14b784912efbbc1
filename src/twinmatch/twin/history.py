"""The newest samples of a session as one window."""

from __future__ import annotations

import numpy as np

from twinmatch.signals import Window

__all__ = ["History"]


class History:
    """Joins the windows of a schedule and keeps the newest samples.

    Windows may overlap or follow one another; after a gap, or if one goes back, it starts over.
    """

    def __init__(self, longest: int) -> None:
        """Begin without samples; keep at most `longest`."""
        self.longest = longest
        self.window: Window | None = None

    def push(self, window: Window) -> Window:
        """Take one window; return all samples that are kept now."""
        held = self.window
        if held is None or window.first > held.last + 1 or window.last < held.last:
            held = window
        elif window.last > held.last:
            held = _continued(held, window.part(held.last + 1, window.last))
        self.window = held.part(max(held.first, held.last - self.longest + 1), held.last)
        return self.window

    def cut(self, first: int) -> None:
        """Forget the samples before `first`."""
        held = self.window
        if held is not None and held.first < first:
            self.window = held.part(first, held.last) if first <= held.last else None


def _continued(window: Window, newer: Window) -> Window:
    return Window(
        reference=np.concatenate([window.reference, newer.reference]),
        output=np.concatenate([window.output, newer.output]),
        input=np.concatenate([window.input, newer.input]),
        first=window.first,
        period=window.period,
        disturbances=np.concatenate([window.disturbances, newer.disturbances]),
    )
