"""The candidates of a verdict with their windows, matches and Box–Jenkins models.

A verdict carries figures, not models. The models are identified here again, in the same way and with the same
seed as in the discriminator, so they are the same to the last bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from twinmatch.comparing import (
    CandidateScore,
    SimoModel,
    Verdict,
    identify,
    twin_response,
)
from twinmatch.comparing.models import ahead, deviations, operating_level
from twinmatch.dynamics import Response
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import Match
from twinmatch.signals import Sample, Window, unbroken
from twinmatch.twin import MatchReport, TwinSettings, response_on
from twinmatch.twin.matcher import one_thread

__all__ = ["Member", "family"]


@dataclass(frozen=True, eq=False)
class Member:
    """One candidate of the family at the end of a session."""

    score: CandidateScore
    nominal: bool
    match: Match | None
    """The match it came from; None for a candidate from a file."""
    window: Window
    """Measured samples it was judged on: those it was matched on, otherwise the first excited window."""
    settings: TwinSettings

    @cached_property
    def response(self) -> Window:
        """Response of its twin to that window's set-point, or input in open loop, with sensor noise."""
        s = self.settings
        return twin_response(
            self.score.parameters, self.window, s.gains, s.sensor, s.seed + self.window.first
        )

    @cached_property
    def models(self) -> tuple[SimoModel, ...]:
        """Box–Jenkins models of that response, one per order."""
        with one_thread():
            return identify(self.response, scale=self.settings.model_scale, lead=self.settings.schedule.lead)

    @property
    def measured(self) -> Window:
        """The measured samples on which the models were scored."""
        return self.window.part(self.response.first, self.response.last)

    @property
    def quiet_twin(self) -> Response:
        """The same response without sensor noise, from the window's third sample."""
        return response_on(self.score.parameters, self.window, self.settings.gains)

    def simulated(self, order: str) -> Window:
        """The measured window as simulated by the model of this order: B/F alone, as for the gain."""
        model = next(m for m in self.models if m.order == order)
        measured = self.measured
        level = operating_level(measured, driven=model.u is None, lead=model.lead)
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
    """The members of a verdict's family, in its order; empty without a verdict.

    Candidates whose window is not among the samples are left out, as the recording started after it.
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
    """The accepted match of exactly this window; a candidate from a file has an empty window and no match."""
    wanted = (score.first, score.last)
    return next((m.match for m in matches if m.match.accepted and m.match.samples == wanted), None)


def _window_of(
    score: CandidateScore, matches: Sequence[MatchReport], samples: Sequence[Sample], period: float
) -> Window | None:
    first, last = score.first, score.last
    if last < first:  # from a file, so judged on the first window that excited the loop
        last = next((m.match.samples[1] for m in matches if m.match.samples[0] == first), last)
    held = [s for s in samples if first <= s.index <= last]
    if len(held) != last - first + 1 or len(unbroken(held)) != 1:
        return None
    try:
        return Window.from_samples(held, period)
    except TwinmatchError:
        return None
