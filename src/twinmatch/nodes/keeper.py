"""Keeps the messages of a run, and serves them on `plant/past` to a node that restarts or fell behind.

It runs in the process that publishes the samples, so that it is there whenever there are samples.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Final

from rclpy.serialization import deserialize_message

from twinmatch.ending import end_in_order
from twinmatch.nodes.health import Report
from twinmatch.nodes.node import KEEPER, TwinmatchNode
from twinmatch.nodes.past import PAST
from twinmatch.nodes.senders import Senders
from twinmatch.nodes.topics import EVERYTHING
from twinmatch.parameters.declared import BUILT_IN, Setting
from twinmatch.record import SAMPLED
from twinmatch.sessions.spool import MessageSpool, SampleSpool
from twinmatch.signals import Sample
from twinmatch_msgs.msg import Forecast, LoopSample, Match, ModelScore, TwinState
from twinmatch_msgs.srv import Past

LINGER = 2.0
"""Time after a request during which the process stays up for the next one, wall s."""

TOPICS: Final = {
    Match: "twin/match",
    ModelScore: "twin/model_score",
    Forecast: "twin/forecast",
    TwinState: "twin/state",
}
"""Topics of the messages about samples: matches and verdicts are kept, forecasts and states are counted."""


class RunStore:
    """What is kept of one session, from its first sample on."""

    MAX_SAMPLES: Final = 2000
    """Most samples in one answer: some milliseconds of work."""
    MAX_MESSAGES: Final = 20
    """Most matches, and most verdicts, in one answer."""
    AHEAD: Final = 100
    """Messages that may be about samples not received yet; there is at most one about each sample."""

    def __init__(self) -> None:
        """Start empty."""
        self.samples = SampleSpool()
        self.messages = {Match: MessageSpool(), ModelScore: MessageSpool()}
        self.counts = {Forecast: 0, TwinState: 0}
        """Numbers of messages that are not kept."""

    def push(self, kind: Any, data: bytes) -> bool:
        """Take a serialised message about a sample; returns whether there is room for it."""
        if kind in self.counts:
            self.counts[kind] += 1
        elif len(self.messages[kind]) < len(self.samples) + self.AHEAD:
            self.messages[kind].push(data)
        else:
            return False
        return True

    def answer(self, request: Past.Request) -> Past.Response:
        """What was requested, as far as it fits: samples only up to the first about which there is more."""
        answer = Past.Response(heard=self.samples.end)
        end = request.first + request.count
        answer.match, match_end = self._messages(Match, request.matches, end)
        answer.score, end = self._messages(ModelScore, request.scores, match_end)
        rows = self.samples.rows(
            request.first, max(0, end - request.first), self.MAX_SAMPLES
        )
        for name in ("index", "stamp", *SAMPLED):
            setattr(answer, name, rows[SAMPLED.get(name, name)].ravel().tolist())
        answer.matches_heard = len(self.messages[Match])
        answer.scores_heard = len(self.messages[ModelScore])
        answer.forecasts_heard = self.counts[Forecast]
        answer.states_heard = self.counts[TwinState]
        return answer

    def _messages(self, kind: Any, received: int, end: int) -> tuple[list[Any], int]:
        """The messages of a kind after the first `received`, and before which sample (`end` at most) there
        are no more of them than these."""
        spool = self.messages[kind]
        messages = [
            deserialize_message(data, kind)
            for data in spool.since(received, self.MAX_MESSAGES)
        ]
        if received + len(messages) < len(spool):
            end = min(end, messages[-1].sample)
        return messages, end

    def close(self) -> None:
        """Release the files."""
        self.samples.close()
        for spool in self.messages.values():
            spool.close()


class Keeper(TwinmatchNode):
    """Keeps samples and the twin's messages about them, from the session's first sample on."""

    NAME = KEEPER

    @classmethod
    def table_for(
        cls, overrides: Mapping[str, Any]
    ) -> tuple[Sequence[Setting], Mapping[str, Any]]:
        """No parameters: those given to its process are for the other nodes in it."""
        return (), {
            name: value
            for name, value in overrides.items()
            if name.startswith(BUILT_IN)
        }

    def open(self) -> None:
        """Subscribe and offer the service."""
        self._store = RunStore()
        self._requested_at = -LINGER
        self.create_subscription(
            LoopSample, "plant/sample", self._on_sample, EVERYTHING
        )
        for kind, name in TOPICS.items():
            self.create_subscription(
                kind, name, partial(self._on_message, kind), EVERYTHING, raw=True
            )
        self.create_service(Past, PAST, self._on_question)
        Senders(self, ("plant/sample", "/clock"))
        self.health.say("keeping")
        self.report_on()

    def report(self) -> Report:
        """The numbers of samples and messages kept."""
        self.health.set("samples", len(self._store.samples))
        for kind, spool in self._store.messages.items():
            self.health.set(TOPICS[kind], len(spool))
        return super().report()

    def close(self) -> bool:
        """Release the files."""
        stores = [self._store.close] if hasattr(self, "_store") else []
        return end_in_order(*stores, super().close)

    @property
    def busy(self) -> bool:
        """Whether a node is catching up."""
        return time.monotonic() - self._requested_at < LINGER

    def _on_sample(self, sample: Sample) -> None:
        if not self._store.samples.continued_by(sample):
            self._store.close()
            self._store = RunStore()
        self._store.samples.push(sample)

    def _on_message(self, kind: Any, data: bytes) -> None:
        if not self._store.push(kind, data):
            self.health.count(f"{TOPICS[kind]}: more than samples")

    def _on_question(self, request: Past.Request, _: Past.Response) -> Past.Response:
        self._requested_at = time.monotonic()
        self.health.count("questions")
        return self._store.answer(request)
