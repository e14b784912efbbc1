"""Fits the rig's parameters to requested windows: `twin/match_request` in, `twin/match` out."""

from __future__ import annotations

import threading

from twinmatch.nodes.messages import match_message, request_from
from twinmatch.nodes.runner import program
from twinmatch.nodes.sample_messages import nanoseconds
from twinmatch.nodes.samples import TwinNode
from twinmatch.nodes.topics import EVERYTHING, RELIABLE
from twinmatch.twin import carry_out
from twinmatch_msgs.msg import Match, MatchRequest


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

    def work(self, item: MatchRequest) -> None:
        """Compute the match and publish it."""
        try:
            report = carry_out(request_from(item), self.settings)
        finally:
            with self._lock:
                self._in_progress.discard((item.sample, item.first))
        self.health.count("matches")
        self.health.set("last match", f"{report.match.status.value} at sample {report.sample}")
        self.publish(self._publisher, match_message(report, nanoseconds(item.header.stamp)))

    def _on_request(self, message: MatchRequest) -> None:
        self.health.say("working")
        name = (message.sample, message.first)
        with self._lock:
            if name in self._in_progress:
                return
            self._in_progress.add(name)
        self.put(message)


main = program(MatcherNode)


if __name__ == "__main__":
    main()
