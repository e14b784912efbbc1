"""Fits the rig parameters to the windows in which the set-point moved: samples in, `twin/match` out."""

from __future__ import annotations

import sys

from twinmatch.nodes.conversions import match_message
from twinmatch.nodes.runner import run
from twinmatch.nodes.samples import RELIABLE, SampleNode
from twinmatch.signals import Sample
from twinmatch.twin import Matcher
from twinmatch_msgs.msg import Match

__all__ = ["MatcherNode", "main"]


class MatcherNode(SampleNode):
    """Publishes a match whenever the schedule says so."""

    NAME = "matcher"

    def open(self) -> None:
        """Publish matches of the samples to come."""
        self._matcher = Matcher(self.settings)
        self._publisher = self.create_publisher(Match, "twin/match", RELIABLE)
        super().open()

    def work(self, item: Sample) -> None:
        """Take one sample and publish the match it sets off, if any."""
        report = self._matcher.push(item)
        if report is not None:
            self.health.count("matches")
            self.health.set("last match", f"{report.match.status.value} at sample {report.sample}")
            self._publisher.publish(match_message(report, item.stamp))


def main() -> None:
    """Console script."""
    sys.exit(run([MatcherNode]))


if __name__ == "__main__":
    main()
