"""Judges the family of matches: samples and matches in, verdicts out, and at every sample what comes next.

Its topics are `twin/model_score`, `twin/nominal`, `twin/leader`, `twin/forecast` and `twin/match_request`;
`twin/what_if` answers questions.
"""

from __future__ import annotations

import sys
import time
from collections import deque
from pathlib import Path

from rclpy.clock import Clock, ClockType

from twinmatch import twin
from twinmatch.discrimination import Verdict
from twinmatch.nodes.conversions import candidate_message, match_from, score_message
from twinmatch.nodes.diagnostics import Level
from twinmatch.nodes.foreteller import Foreteller
from twinmatch.nodes.request_messages import request_message
from twinmatch.nodes.runner import run
from twinmatch.nodes.samples import EVERYTHING, LATCHED, RELIABLE, SampleNode
from twinmatch.sessions.candidates import read_candidates
from twinmatch.signals import Sample
from twinmatch.twin import Discriminator, MatchReport, Step
from twinmatch_msgs.msg import Candidate, Match, MatchRequest, ModelScore
from twinmatch_msgs.srv import Past

__all__ = ["SETTLED", "VERDICTS", "DiscriminatorNode", "main"]

PATIENCE = 2.0
"""Wall seconds after which a match that did not come is asked for again."""
LOOK = 0.5
"""Wall seconds between two looks for one."""
SETTLED = "settled"
"""Key on /diagnostics: newest sample of which everything is said."""
VERDICTS = "verdicts"
"""Key on /diagnostics: verdicts so far."""
MOST_STAMPS = 10_000
"""Samples whose stamps are kept for the verdicts that are still due."""


class DiscriminatorNode(SampleNode):
    """Asks for matches, and publishes every verdict, and the nominal candidate when it is another.

    A request is published again every `PATIENCE` seconds until it is answered: the matcher may have been
    lost, or have come late. The answer depends on the request alone, so that waiting changes no verdict.
    """

    NAME = "discriminator"

    def open(self) -> None:
        """Judge the samples and matches to come.

        Raises:
            CandidateFileError: the file of candidates to begin with cannot be used.
        """
        path = self.values["candidates"]
        given = read_candidates(Path(path)) if path else []
        self._discriminator = Discriminator(self.settings, given, self._followed)
        self._foreteller = Foreteller(self)
        self._stamps: dict[int, int] = {}
        self._nominal: Candidate | None = None
        self._answers: deque[MatchReport] = deque()  # of matches before this node came, oldest first
        self._said = self._heard = 0  # verdicts made; those that were heard before this node came
        self._asking: MatchRequest | None = None
        self._asked_at = 0.0
        self._times_asked = 0
        self._scores = self.create_publisher(ModelScore, "twin/model_score", RELIABLE)
        self._nominals = self.create_publisher(Candidate, "twin/nominal", LATCHED)
        self._requests = self.create_publisher(MatchRequest, "twin/match_request", RELIABLE)
        super().open()
        self.create_subscription(Match, "twin/match", self._on_match, EVERYTHING)
        self.create_timer(LOOK, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def work(self, item: Sample | MatchReport) -> None:
        """Take one sample or match, publish the verdicts that became due, and ask for the match they need."""
        if isinstance(item, MatchReport):
            step = self._discriminator.push_match(item)
        else:
            self._stamps[item.index] = item.stamp
            if len(self._stamps) > MOST_STAMPS:
                del self._stamps[next(iter(self._stamps))]
            step = self._discriminator.push_sample(item)
        self._tell(step)
        while step.request is not None and (known := self._answer(step.request)) is not None:
            step = self._discriminator.push_match(known)
            self._tell(step)
        if step.request is not None:
            self._times_asked = 0
            self._ask(request_message(step.request, self._stamps.get(step.request.sample, 0)))
        elif self._discriminator.request is None:
            self.health.set("waits for a match of", "nothing")
            self.health.withdraw("match")
        self.health.set(SETTLED, self._discriminator.settled)

    def learn(self, said: Past.Response) -> None:
        """Take what a discriminator before this one has said: it is not said again."""
        self._heard = said.scores_heard
        self._foreteller.heard = said.forecasts_heard
        self._answers += map(match_from, said.match)

    def _answer(self, request: twin.MatchRequest) -> MatchReport | None:
        """The answer to a request of which it is known."""
        while self._answers:
            report = self._answers.popleft()
            if report.answers(request):
                return report
        return None

    def _tell(self, step: Step) -> None:
        for verdict in step.verdicts:
            self._publish(verdict)
        if step.verdicts:  # a match may have brought a candidate
            self._foreteller.look(self._discriminator)

    def _followed(self, _: Sample) -> None:
        self._foreteller.publish(self._discriminator)

    def _ask(self, request: MatchRequest) -> None:
        self._asked_at = time.monotonic()
        self._times_asked += 1
        self._asking = request
        self._requests.publish(request)
        last = request.first + len(request.reference) - 1
        self.health.set("waits for a match of", f"{request.first} to {last}")

    def _look(self) -> None:
        """Ask again for what was not answered."""
        asking = self._asking
        if asking is None or time.monotonic() - self._asked_at < PATIENCE:
            return
        self._ask(asking)
        words = f"the match of sample {asking.sample} has not come; asked {self._times_asked} times"
        self.health.complain("match", Level.WARN, words)

    def _on_match(self, message: Match) -> None:
        asking = self._asking
        if asking is not None and (message.sample, message.first) == (asking.sample, asking.first):
            self._asking = None
        self.put(match_from(message))

    def _publish(self, verdict: Verdict) -> None:
        self.health.count(VERDICTS)
        self.health.set("level", verdict.level.value)
        self.health.set("nominal", verdict.nominal or "none")
        self._said += 1
        if self._said > self._heard:
            message = score_message(verdict, self._stamps.get(verdict.sample, 0))
            self.publish(self._scores, message)
        if self._said < self._heard:
            return
        chosen = next((c for c in verdict.candidates if c.name == verdict.nominal), None)
        if chosen is None:
            return
        nominal = candidate_message(chosen)
        if self._nominal is None or _identity(nominal) != _identity(self._nominal):
            self._nominal = nominal
            self._nominals.publish(nominal)


def _identity(candidate: Candidate) -> tuple[object, ...]:
    return candidate.name, candidate.first, candidate.last, candidate.parameters


def main() -> None:
    """Console script."""
    sys.exit(run([DiscriminatorNode]))


if __name__ == "__main__":
    main()
