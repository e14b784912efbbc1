"""The matcher: answers a request with a match, without state between requests."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from threading import Lock
from typing import Any, NamedTuple

from threadpoolctl import ThreadpoolController

from twinmatch.dynamics import Parameters
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import Match, Status, match
from twinmatch.fitting.match import without_fit
from twinmatch.signals import Window
from twinmatch.twin.settings import TwinSettings

_blas = cache(ThreadpoolController)
_lock = Lock()
_inside: list[Any] = []
"""The limit on the process's BLAS, once for every thread that relies on it."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Context within which the BLAS of the process uses one thread.

    A BLAS that splits a product among threads sums in a different order than one thread does, and the last
    bits differ. Verdicts are compared bit for bit, and the matrices here are too small to gain from threads.
    """
    with _lock:
        _inside.append(_inside[0] if _inside else _blas().limit(limits=1, user_api="blas"))
    try:
        yield
    finally:
        with _lock:
            limit = _inside.pop()
            if not _inside:
                limit.restore_original_limits()


class MatchRequest(NamedTuple):
    """The complete input of a match."""

    sample: int
    """Index of the sample that set it off."""
    operating_point: float
    """Set-point at the window's end."""
    window: Window
    start: Parameters
    """Start of the search, and the values of the parameters that are not free."""
    incumbent: Parameters | None
    """Parameters of the regime's current candidate, which the match must beat; None if there is none."""


class MatchReport(NamedTuple):
    """A match and its place in the session."""

    sample: int
    """Index of the sample that set it off."""
    operating_point: float
    """Set-point at the window's end."""
    match: Match

    def answers(self, request: MatchRequest) -> bool:
        """Whether this is the match for that request."""
        window = request.window
        return (self.sample, *self.match.samples) == (request.sample, window.first, window.last)


def carry_out(request: MatchRequest, settings: TwinSettings) -> MatchReport:
    """Carry out a request; if the window cannot be matched at all, the match is refused with the error."""
    try:
        with one_thread():
            found = match(
                request.window,
                free=settings.free,
                start=request.start,
                incumbent=request.incumbent,
                noise=settings.noise,
                law=settings.law,
                min_step=settings.least_movement,
            )
    except TwinmatchError as error:
        status, reason = Status.DID_NOT_CONVERGE, f"the window could not be matched: {error}"
        found = without_fit(request.window, settings.free, request.start, status, reason)
    return MatchReport(request.sample, request.operating_point, found)
