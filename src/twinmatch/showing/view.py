"""The view of a run on standard output."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from twinmatch.showing.lines import Lines, redraws

if TYPE_CHECKING:
    from twinmatch.showing.terminal import Screen


def view_of(
    title: str, period: float = 1.0, total: int | None = None
) -> Screen | Lines:
    """A view that is redrawn on a terminal; elsewhere lines, for which nothing of `rich` is imported.

    Args:
        title: what is shown.
        period: sample time, s.
        total: number of samples, if it is known.
    """
    if not redraws(sys.stdout):
        return Lines(period)
    from twinmatch.showing.console import Console  # noqa: PLC0415
    from twinmatch.showing.terminal import Screen  # noqa: PLC0415

    return Screen(Console(), title, period, total)
