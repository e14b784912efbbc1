"""Which samples of a session are doubted: those during which somebody else published what the twin judges.

Messages of two publishers reach each node in an order of its own, so of two samples of one index the twin may
take one and the recorder the other. Nobody can tell afterwards; when it may have happened is recorded.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from twinmatch.nodes.entrance import ALONE, UNKNOWN
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.sessions.metadata import doubt_record

Tell = Callable[[str, Mapping[str, str]], None]
"""Takes the name and the values of a record of the session."""


_GONE: Final = "a node that is gone"


@dataclass
class _Topic:
    """A topic that should have one publisher."""

    has_second: Callable[[], bool]
    """Whether a second publisher is there, or was since the last call."""
    seen: dict[bytes, str]
    """Names of its publishers; while it is doubted, of all since a second one came."""
    since: int | None = None
    """Newest sample when a second publisher came; None: there is none."""
    until: float = 0.0
    """Until when its messages may arrive, wall s."""
    told: dict[str, str] = field(default_factory=dict)
    """The record of the present doubt, as it was written last; empty: none yet."""

    @property
    def names(self) -> list[str]:
        """Different names of its publishers; a node that was restarted has the name of the one before."""
        names = {_GONE if name == UNKNOWN else name for name in self.seen.values()}
        if len(self.seen) < 2:
            names.add(_GONE)
        return sorted(names)


class Doubts:
    """Records for which samples a topic had publishers of different names."""

    def __init__(self, node: TwinmatchNode, tell: Tell) -> None:
        """Nothing is watched yet."""
        self._node = node
        self._tell = tell
        self._topics: dict[str, _Topic] = {}
        self._index = self._number = 0

    def watch(self, topic: str, subscription: Any) -> None:
        """Watch a topic, through the newest subscription to it."""
        watched = self._topics.get(topic)
        if watched is None:
            self._topics[topic] = _Topic(
                self._node.entrance.second(subscription), self._publishers(topic)
            )
        else:
            watched.has_second = self._node.entrance.second(subscription)

    def sample(self, index: int, wall_now: float) -> None:
        """Take the index of the newest sample, received at `wall_now` (s)."""
        self.look(wall_now)
        self._index = index

    def look(self, wall_now: float) -> None:
        """Look who publishes at `wall_now` (s)."""
        for name, topic in self._topics.items():
            if topic.has_second():
                topic.since = self._index if topic.since is None else topic.since
                topic.until = wall_now + ALONE
            if topic.since is None:
                continue
            with_names = {
                gid: publisher
                for gid, publisher in topic.seen.items()
                if publisher != UNKNOWN
            }
            topic.seen |= self._publishers(name) | with_names
            over = wall_now > topic.until
            if over or UNKNOWN not in topic.seen.values():
                self._note(name, topic, str(self._index) if over else "")
            if over:
                topic.since = None
                topic.told = {}
                topic.seen = self._publishers(name)

    def _note(self, name: str, topic: _Topic, last: str) -> None:
        """Record the doubt about a topic, unless its record says so already; `last` sample, empty: it
        lasts."""
        if len(topic.names) < 2:
            return  # a node that was restarted
        if len(topic.seen) < 2 and not last:
            return  # the other publisher may still become known
        if not topic.told:
            self._number += 1
        record = {
            "topic": name,
            "publishers": " and ".join(topic.names),
            "first": str(topic.since),
            "last": last,
        }
        if record != topic.told:
            topic.told = record
            self._tell(doubt_record(self._number), record)

    def _publishers(self, topic: str) -> dict[bytes, str]:
        return {
            bytes(i.endpoint_gid): i.node_name
            for i in self._node.get_publishers_info_by_topic(topic)
        }
