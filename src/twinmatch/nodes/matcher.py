"""Fits the rig's parameters to requested windows: `twin/match_request` in, `twin/match` out."""

from __future__ import annotations

import threading

from twinmatch import twin
from twinmatch.nodes.messages import match_message
from twinmatch.nodes.runner import program
from twinmatch.nodes.samples import TwinNode
from twinmatch.nodes.topics import EVERYTHING, RELIABLE
from twinmatch.twin import carry_out
from twinmatch_msgs.msg import Match, MatchRequest

MOST_WAITING = 20
"""Most requests that wait; a discriminator has one, and repeats it."""


class MatcherNode(TwinNode):
    """Answers every request; one that is repeated while in progress is answered once."""

    NAME = "matcher"

    def open(self) -> None:
        """Wait for requests."""
        self._publisher = self.create_publisher(Match, "twin/match", RELIABLE)
        self._in_progress: set[tuple[int, int]] = set()
        self._lock = threading.Lock()
        self.health.say("waiting for requests")
        super().open()
        self.create_subscription(MatchRequest, "twin/match_request", self._on_request, EVERYTHING)

    def work(self, item: tuple[twin.MatchRequest, int]) -> None:
        """Compute the match and publish it, with the stamp (ns) of its request."""
        request, stamp = item
        try:
            report = carry_out(request, self.settings)
        finally:
            with self._lock:
                self._in_progress.discard((request.sample, request.window.first))
        self.health.count("matches")
        self.health.set("last match", f"{report.match.status.value} at sample {report.sample}")
        self.publish(self._publisher, match_message(report, stamp))

    def _on_request(self, item: tuple[twin.MatchRequest, int]) -> None:
        self.health.say("working")
        request, _ = item
        name = (request.sample, request.window.first)
        with self._lock:
            if name in self._in_progress:
                return
            if len(self._in_progress) >= MOST_WAITING:
                self.health.count("left to be repeated")
                return
            self._in_progress.add(name)
        self.put(item)


main = program(MatcherNode)


if __name__ == "__main__":
    main()
