"""Judges the family of matches: samples and matches in, `twin/model_score` and `twin/nominal` out."""

from __future__ import annotations

import sys
from pathlib import Path

from twinmatch.discrimination import Verdict
from twinmatch.nodes.conversions import candidate_message, match_from, score_message
from twinmatch.nodes.runner import run
from twinmatch.nodes.samples import EVERYTHING, LATCHED, RELIABLE, SampleNode
from twinmatch.sessions.candidates import read_candidates
from twinmatch.signals import Sample
from twinmatch.twin import Discriminator, MatchReport
from twinmatch_msgs.msg import Candidate, Match, ModelScore

__all__ = ["DiscriminatorNode", "main"]

MOST_STAMPS = 10_000
"""Samples whose stamps are kept for the verdicts that are still due."""


class DiscriminatorNode(SampleNode):
    """Publishes every verdict, and the nominal candidate when it is another or has other parameters."""

    NAME = "discriminator"

    def open(self) -> None:
        """Judge the samples and matches to come.

        Raises:
            CandidateFileError: the file of candidates to begin with cannot be used.
        """
        path = self.values["candidates"]
        given = read_candidates(Path(path)) if path else []
        self._discriminator = Discriminator(self.settings, given)
        self._stamps: dict[int, int] = {}
        self._nominal: Candidate | None = None
        self._scores = self.create_publisher(ModelScore, "twin/model_score", RELIABLE)
        self._nominals = self.create_publisher(Candidate, "twin/nominal", LATCHED)
        super().open()
        self.create_subscription(Match, "twin/match", self._on_match, EVERYTHING)

    def work(self, item: Sample | MatchReport) -> None:
        """Take one sample or match and publish the verdicts that became due."""
        if isinstance(item, MatchReport):
            verdicts = self._discriminator.push_match(item)
        else:
            self._stamps[item.index] = item.stamp
            if len(self._stamps) > MOST_STAMPS:
                del self._stamps[next(iter(self._stamps))]
            verdicts = self._discriminator.push_sample(item)
        for verdict in verdicts:
            self._publish(verdict)
        waiting = self._discriminator.waiting_for
        self.health.set("waits for a match of", "{} to {}".format(*waiting) if waiting else "nothing")

    def _on_match(self, message: Match) -> None:
        self.put(match_from(message))

    def _publish(self, verdict: Verdict) -> None:
        self.health.count("verdicts")
        self.health.set("level", verdict.level.value)
        self.health.set("nominal", verdict.nominal or "none")
        self._scores.publish(score_message(verdict, self._stamps.get(verdict.sample, 0)))
        names = [candidate.name for candidate in verdict.candidates]
        if verdict.nominal is None:
            return
        nominal = candidate_message(verdict, names.index(verdict.nominal))
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
