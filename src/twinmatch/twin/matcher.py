"""The matcher: answers a request with a match, without state between requests."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from threading import Lock
from typing import Annotated, Any, NamedTuple

from threadpoolctl import ThreadpoolController

from twinmatch.defects import Defect, defect_of, log_once
from twinmatch.dynamics import Parameters
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import GateLimits, Match, Status, match
from twinmatch.fitting.lacks import LEFT, Lack, effort_for, lack_of
from twinmatch.fitting.match import explaining, usable_fit, without_fit
from twinmatch.fitting.problem import LASTING
from twinmatch.requirements import OfPlant
from twinmatch.signals import OperatingPoint, Window
from twinmatch.twin.settings import TwinSettings

_blas = cache(ThreadpoolController)
_lock = Lock()
logged_defects: dict[str, Defect] = {}
"""Defects that prevented matches in this process, by their places: each is logged once."""
_limits_in_use: list[Any] = []
"""The one limit on the process's BLAS, as often as threads rely on it; the last of them lifts it."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Context within which the BLAS of the process uses one thread.

    A BLAS that splits a product among threads sums in a different order than one thread does, and the last
    bits differ. Verdicts are compared bit for bit, and the matrices here are too small to gain from threads.
    """
    with _lock:
        _limits_in_use.append(
            _limits_in_use[0]
            if _limits_in_use
            else _blas().limit(limits=1, user_api="blas")
        )
    try:
        yield
    finally:
        with _lock:
            limit = _limits_in_use.pop()
            if not _limits_in_use:
                limit.restore_original_limits()


class MatchRequest(NamedTuple):
    """The complete input of a match."""

    sample: int
    """Index of the sample that set it off."""
    operating_point: OperatingPoint
    """Set-points at the window's end."""
    window: Annotated[Window, OfPlant("start")]
    start: Parameters
    """Start of the search, and the values of the parameters that are not free."""
    incumbent: Parameters | None
    """Parameters of the regime's current candidate, which the match must beat; None if there is none."""


class MatchReport(NamedTuple):
    """A match and its place in the session."""

    sample: int
    """Index of the sample that set it off."""
    operating_point: OperatingPoint
    """Set-points at the window's end."""
    match: Match

    def answers(self, request: MatchRequest) -> bool:
        """Whether this is the match for that request."""
        window = request.window
        return (self.sample, *self.match.samples) == (
            request.sample,
            window.first,
            window.last,
        )


def carry_out(request: MatchRequest, settings: TwinSettings) -> MatchReport:
    """Carry out a request; if the window cannot be matched at all, the match is refused with the error.
    A defect of this program refuses it, too.

    Where no match describes the regime yet, and the structure of the start leaves much of the window, the
    match is made in the structure that the window justifies most. An incumbent has its structure: what it
    does not explain is a change of the plant.
    """
    first = settings.start.model
    start = request.start
    free = settings.free if start.model is first else start.model.structure.free
    try:
        with one_thread():
            match = _matched(request, settings, start, free)
            may_change_structure = (
                request.incumbent is None and settings.free == first.structure.free
            )
            most_left = LEFT if settings.law is None else GateLimits().chi2
            if may_change_structure and match.chi2 > most_left:
                match = _in_another_structure(request, settings, match)
    except TwinmatchError:
        raise
    except Exception as error:
        match = _not_made(request, free, defect_of(error))
    return MatchReport(request.sample, request.operating_point, match)


def _not_made(request: MatchRequest, free: tuple[str, ...], defect: Defect) -> Match:
    """The answer to a request whose match a defect has prevented: without one, no verdict would follow."""
    log_once("a window could not be matched", defect, logged_defects)
    reason = f"the window could not be matched, because of a defect in {defect}"
    return without_fit(
        request.window, free, request.start, Status.DID_NOT_CONVERGE, reason
    )


def _matched(
    request: MatchRequest,
    settings: TwinSettings,
    start: Parameters,
    free: tuple[str, ...],
) -> Match:
    """The match in the structure of its start."""
    try:
        return match(
            request.window,
            free=free,
            start=start,
            incumbent=request.incumbent,
            noise=settings.noise,
            law=settings.law,
            min_step=settings.schedule.min_step,
            prior=settings.prior.get(start.model.structure_name, {}),
        )
    except TwinmatchError as error:
        status = Status.DID_NOT_CONVERGE
        reason = f"the window could not be matched: {error}"
        return without_fit(request.window, free, start, status, reason)


def _in_another_structure(
    request: MatchRequest, settings: TwinSettings, first: Match
) -> Match:
    """The match in the most justified structure in which it is accepted; without one, the first match."""
    models = (settings.plant.model(name) for name in settings.plant.structures)
    typical_starts = [
        m.typical()
        for m in models
        if not m.is_external and m is not request.start.model
    ]
    present = request.start.model.structure_name
    for start in explaining(
        request.window, [request.start, *typical_starts], settings.noise, settings.law
    ):
        if start is request.start:
            break
        match = _matched(request, settings, start, start.model.structure.free)
        if match.accepted:
            return replace(
                match,
                reason=f"{match.reason}; in the structure {present!r}: {first.reason}",
            )
    if settings.law is None:
        lack = _lacking(request, settings, first)
        return (
            first if lack is None else replace(first, reason=f"{first.reason}; {lack}")
        )
    return first


def _lacking(
    request: MatchRequest, settings: TwinSettings, first: Match
) -> Lack | None:
    """The effect that explains most of what the first match leaves."""
    effort = effort_for(first.chi2)

    def fit(start: Parameters) -> tuple[Parameters, float] | None:
        best = usable_fit(request.window, start, settings.noise, settings.law, effort)
        return (
            None
            if best is None
            else (best.problem.experiment.parameters_at(best.values), best.chi2)
        )

    independent = len(request.window) / LASTING
    return lack_of(
        first.parameters, request.window.period, first.chi2, independent, fit
    )
