"""Who publishes the topics that may have one publisher only."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from twinmatch.nodes.health import Level
from twinmatch.nodes.node import TwinmatchNode

LOOK: Final = 0.25
"""Interval between two looks, wall s."""


class Senders:
    """Reports topics with more than one publisher, and who they are.

    DDS does not say of whom a message is, so two publishers cannot be kept apart. A process that was killed
    is seen as a publisher until its lease ends, some seconds later: two of one name are a warning, no error.
    """

    def __init__(
        self,
        node: TwinmatchNode,
        topics: Sequence[str],
        changed: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Look regularly; `changed` is called with what was found (empty: nothing) when that changes."""
        self._node = node
        self._changed = changed
        self._topics = [node.resolve_topic_name(topic) for topic in topics]
        self._reported = ""
        node.wall_timer(LOOK, self._look)

    def _look(self) -> None:
        report = "; ".join(filter(None, map(self._report, self._topics)))
        if report != self._reported:
            self._reported = report
            self._changed(report)
            self._node.report_now()

    def _report(self, topic: str) -> str:
        """Report a topic with several publishers; returns the sentence, empty if there is none."""
        if self._node.count_publishers(topic) < 2:
            self._node.health.withdraw(f"senders: {topic}")
            return ""
        names = sorted(
            info.node_name for info in self._node.get_publishers_info_by_topic(topic)
        )
        text = f"{topic} is published by {' and '.join(names)}; end all but one of them"
        level = Level.ERROR if len(set(names)) > 1 else Level.WARN
        self._node.health.flag(f"senders: {topic}", level, text)
        return text
