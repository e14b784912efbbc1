"""The candidates of a verdict with all that belongs to them: window, match, and Box–Jenkins models.

A verdict carries figures, not models. They are identified here once more, in the same way and with the same
seed as the discriminator does, so that they are the same models to the last bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from twinmatch.discrimination import (
    CandidateScore,
    SimoModel,
    Verdict,
    identify,
    twin_response,
)
from twinmatch.discrimination.models import ahead, deviations, operating_level
from twinmatch.dynamics import Response, simulate_window
from twinmatch.errors import TwinmatchError
from twinmatch.matching import Match
from twinmatch.signals import Sample, Window, unbroken
from twinmatch.twin import MatchReport, TwinSettings
from twinmatch.twin.threads import one_thread

__all__ = ["Member", "family"]


@dataclass(frozen=True, eq=False)
class Member:
    """One candidate of the family at the end of a session."""

    score: CandidateScore
    nominal: bool
    match: Match | None
    """The match it came from; None for a candidate that was given."""
    window: Window
    """Measured samples it was judged on: those it was matched on, or the first excited ones."""
    settings: TwinSettings

    @cached_property
    def response(self) -> Window:
        """Its twin on the set-point of that window, or under its input, seen through the sensor."""
        s = self.settings
        return twin_response(
            self.score.parameters, self.window, s.gains, s.sensor, s.seed + self.window.first
        )

    @cached_property
    def models(self) -> tuple[SimoModel, ...]:
        """Box–Jenkins models of that response, one for every order."""
        with one_thread():
            return identify(self.response, scale=self.settings.model_scale)

    @property
    def measured(self) -> Window:
        """The measured samples on which the models were scored."""
        return self.window.part(self.response.first, self.response.last)

    @property
    def quiet_twin(self) -> Response:
        """Its twin on the same set-point or under the same input, without a sensor's noise; from the window's
        third sample."""
        return simulate_window(self.score.parameters, self.window, gains=self.settings.gains)

    def simulated(self, order: str) -> Window:
        """What the model of this order says the measured samples should be: B/F alone, as for the gain."""
        model = next(m for m in self.models if m.order == order)
        measured = self.measured
        level = operating_level(measured, driven=model.u is None)
        r, y, u = deviations(measured, level)
        return Window(
            measured.reference,
            model.y.simulate(u if model.u is None else r, outputs=y[: len(model.y.F)]) + level.output,
            measured.input
            if model.u is None
            else model.u.simulate(ahead(r), outputs=u[: len(model.u.F)]) + level.input,
            first=measured.first,
            period=measured.period,
        )


def family(
    samples: Sequence[Sample],
    matches: Sequence[MatchReport],
    verdict: Verdict | None,
    settings: TwinSettings,
) -> tuple[Member, ...]:
    """The members of the family as a verdict has them, in its order; none without a verdict.

    Candidates whose window is not among the samples are left out: the session then began after it.
    """
    if verdict is None:
        return ()
    members = []
    for score in verdict.modelled:
        match = _match_of(score, matches)
        window = _window_of(score, matches, samples, settings.period)
        if window is not None:
            members.append(Member(score, score.name == verdict.nominal, match, window, settings))
    return tuple(members)


def _match_of(score: CandidateScore, matches: Sequence[MatchReport]) -> Match | None:
    """The accepted match of just this window; a given candidate has a window without samples and no match."""
    wanted = (score.first, score.last)
    return next((m.match for m in matches if m.match.accepted and m.match.samples == wanted), None)


def _window_of(
    score: CandidateScore, matches: Sequence[MatchReport], samples: Sequence[Sample], period: float
) -> Window | None:
    first, last = score.first, score.last
    if last < first:  # given, so judged on the first window that excited the loop
        last = next((m.match.samples[1] for m in matches if m.match.samples[0] == first), last)
    held = [s for s in samples if first <= s.index <= last]
    if len(held) != last - first + 1 or len(unbroken(held)) != 1:
        return None
    try:
        return Window.from_samples(held, period)
    except TwinmatchError:
        return None
