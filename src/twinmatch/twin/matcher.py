"""The matcher: answers a request with a match, without state between requests."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from threading import Lock
from typing import Any, Final, NamedTuple

import numpy as np
from threadpoolctl import ThreadpoolController

from twinmatch.dynamics import DeadTime, Parameters
from twinmatch.dynamics.pace import slow_scale
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import GateLimits, Match, Status, match
from twinmatch.fitting.match import explaining, usable_fit, without_fit
from twinmatch.health.late_input import DELAYS_S
from twinmatch.signals import Window
from twinmatch.twin.settings import TwinSettings

_LEFT: Final = 3.0
"""Mean squared weighted residual above which a driven twin may lack what another structure has. In a loop the
twin's errors return through the controller, and 8 is usual: there it is the gate's limit."""

_EXPLAINED: Final = 0.25
"""Share of the squared residuals up to which a later input must reduce them to be named."""

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
    """Carry out a request; if the window cannot be matched at all, the match is refused with the error.

    Where no match describes the regime yet, and the structure of the start leaves much of the window, the
    match is made in the structure that the window justifies most. An incumbent has its structure: what it
    does not explain is a change of the plant.
    """
    first, start = settings.start.model, request.start
    free = settings.free if start.model is first else start.model.structure.free
    with one_thread():
        found = _matched(request, settings, start, free)
        new = request.incumbent is None and settings.free == first.structure.free
        if new and found.chi2 > (_LEFT if settings.law is None else GateLimits().chi2):
            found = _in_another_structure(request, settings, found)
    return MatchReport(request.sample, request.operating_point, found)


def _matched(
    request: MatchRequest, settings: TwinSettings, start: Parameters, free: tuple[str, ...]
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
        status, reason = Status.DID_NOT_CONVERGE, f"the window could not be matched: {error}"
        return without_fit(request.window, free, start, status, reason)


def _in_another_structure(request: MatchRequest, settings: TwinSettings, first: Match) -> Match:
    """The match in the most justified structure in which it is accepted; without one, the first match."""
    models = (settings.plant.model(name) for name in settings.plant.structures)
    others = [m.typical() for m in models if not m.is_external and m is not request.start.model]
    of = request.start.model.structure_name
    for start in explaining(request.window, [request.start, *others], settings.noise, settings.law):
        if start is request.start:
            break
        found = _matched(request, settings, start, start.model.structure.free)
        if found.accepted:
            return replace(found, reason=f"{found.reason}; in the structure {of!r}: {first.reason}")
    known = any(isinstance(part, DeadTime) for part in vars(settings.plant).values())
    if settings.law is None and (first.status is Status.NOT_EXPLAINED or not known):
        return replace(first, reason=f"{first.reason}{_missing_dead_time(request, settings, first.chi2)}")
    return first


def _missing_dead_time(request: MatchRequest, settings: TwinSettings, left: float) -> str:
    """What to add to the plant file, if a later input explains far more than what is left; else empty."""
    window, found = request.window, dict[float, float]()
    samples = slow_scale(settings.plant, window.period) / window.period
    for late in sorted({round(delay * samples) for delay in DELAYS_S if delay} - {0}):
        held = np.repeat(window.inputs[:1], late, axis=0)
        inputs = np.concatenate([held, window.inputs])[: len(window)]
        best = usable_fit(replace(window, inputs=inputs), request.start, settings.noise, None)
        if best is not None:
            found[late * window.period] = best.chi2
    delay = min(found, key=found.__getitem__, default=0.0)
    if not found or found[delay] > _EXPLAINED * left:
        return ""
    return (
        f"; with its input {delay:g} s later {found[delay]:.3g} times are left: "
        f"add a dead time of about {delay:g} s to the plant file"
    )
