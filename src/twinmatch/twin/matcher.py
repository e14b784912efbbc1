"""From a request to a match: nothing is kept between two of them."""

from __future__ import annotations

from typing import NamedTuple

from twinmatch.dynamics import Parameters
from twinmatch.errors import TwinmatchError
from twinmatch.matching import Match, Status, match
from twinmatch.matching.result import without_fit
from twinmatch.signals import Window
from twinmatch.twin.settings import TwinSettings
from twinmatch.twin.threads import one_thread

__all__ = ["MatchReport", "MatchRequest", "answer"]


class MatchRequest(NamedTuple):
    """All that a match is made from."""

    sample: int
    """Index of the sample that set it off."""
    operating_point: float
    """Set-point at the window's end."""
    window: Window
    start: Parameters
    """Where the search begins, and the values of all that is not free."""
    incumbent: Parameters | None
    """What stands for this regime, which the match has to beat; None: nothing does."""


class MatchReport(NamedTuple):
    """A match and where in the session it was made."""

    sample: int
    """Index of the sample that set it off."""
    operating_point: float
    """Set-point at the window's end."""
    match: Match

    def answers(self, request: MatchRequest) -> bool:
        """Whether this is the match of that window."""
        window = request.window
        return (self.sample, *self.match.samples) == (request.sample, window.first, window.last)


def answer(request: MatchRequest, settings: TwinSettings) -> MatchReport:
    """The match asked for; a window that cannot be matched at all is refused in its words."""
    try:
        with one_thread():
            found = match(
                request.window,
                free=settings.free,
                start=request.start,
                incumbent=request.incumbent,
                noise=settings.noise,
                gains=settings.gains,
                min_step=settings.least_movement,
            )
    except TwinmatchError as error:
        status, words = Status.DID_NOT_CONVERGE, f"the window could not be matched: {error}"
        found = without_fit(request.window, settings.free, request.start, status, words)
    return MatchReport(request.sample, request.operating_point, found)
