"""Keeps the messages of a run, and serves them on `plant/past` to a node that restarts or fell behind.

It runs in the process that publishes the samples, so that it is there whenever there are samples.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, ClassVar

from rclpy.serialization import deserialize_message

from twinmatch.nodes.health import Report
from twinmatch.nodes.messages import SAMPLED
from twinmatch.nodes.node import KEEPER, TwinmatchNode
from twinmatch.nodes.past import PAST
from twinmatch.nodes.senders import Senders
from twinmatch.nodes.topics import EVERYTHING
from twinmatch.parameters.declared import BUILT_IN, Setting
from twinmatch.sessions.spool import MessageSpool, SampleSpool
from twinmatch.signals import Sample
from twinmatch_msgs.msg import Forecast, LoopSample, Match, ModelScore, TwinState
from twinmatch_msgs.srv import Past

MOST_SAMPLES = 2000
"""Most samples in one answer: some milliseconds of work."""
MOST_MESSAGES = 20
"""Most matches, and most verdicts, in one answer."""

AHEAD = 100
"""Messages that may be about samples not received yet; there is at most one about each sample."""

LINGER = 2.0
"""Time after a request during which the process stays up for the next one, wall s."""


class Keeper(TwinmatchNode):
    """Records samples and the twin's messages about them, from the session's first sample on."""

    NAME = KEEPER
    KEPT: ClassVar = {"twin/match": Match, "twin/model_score": ModelScore}
    COUNTED: ClassVar = {"twin/forecast": Forecast, "twin/state": TwinState}

    @classmethod
    def table_for(cls, given: Mapping[str, Any]) -> tuple[Sequence[Setting], Mapping[str, Any]]:
        """No parameters: those given to its process are for the other nodes in it."""
        return (), {name: value for name, value in given.items() if name.startswith(BUILT_IN)}

    def open(self) -> None:
        """Subscribe and offer the service."""
        self._start_session(SampleSpool())
        self._requested_at = -LINGER
        self.create_subscription(LoopSample, "plant/sample", self._on_sample, EVERYTHING)
        for name, kind in (self.KEPT | self.COUNTED).items():
            self.create_subscription(kind, name, partial(self._on_said, name), EVERYTHING, raw=True)
        self.create_service(Past, PAST, self._on_question)
        Senders(self, ("plant/sample", "/clock"))
        self.health.say("keeping")
        self.report_on()

    def report(self) -> Report:
        """The numbers of samples and messages kept."""
        self.health.set("samples", len(self._samples))
        for name, texts in self._messages.items():
            self.health.set(name, len(texts))
        return super().report()

    def close(self) -> bool:
        """Release the files."""
        if hasattr(self, "_samples"):
            self._samples.close()
            for texts in self._messages.values():
                texts.close()
        return True

    def _on_sample(self, sample: Sample) -> None:
        if not self._samples.continued_by(sample):
            self.close()
            self._start_session(SampleSpool(sample.shape))
        self._samples.push(sample)

    def _start_session(self, samples: SampleSpool) -> None:
        self._samples = samples
        self._messages = {name: MessageSpool() for name in self.KEPT}
        self._counts = dict.fromkeys(self.COUNTED, 0)

    def _on_said(self, name: str, data: bytes) -> None:
        if name in self._messages:
            if len(self._messages[name]) < len(self._samples) + AHEAD:
                self._messages[name].push(bytes(data))
            else:
                self.health.count(f"{name}: more than samples")
        else:
            self._counts[name] += 1

    @property
    def busy(self) -> bool:
        """Whether a node is catching up."""
        return time.monotonic() - self._requested_at < LINGER

    def _on_question(self, request: Past.Request, answer: Past.Response) -> Past.Response:
        self._requested_at = time.monotonic()
        rows = self._samples.rows(request.first, request.count, MOST_SAMPLES)
        answer.heard = self._samples.end
        for name in ("index", "stamp", *SAMPLED):
            setattr(answer, name, rows[SAMPLED.get(name, name)].ravel().tolist())
        matches, scores = self._messages.values()
        answer.match = [deserialize_message(d, Match) for d in matches.since(request.matches, MOST_MESSAGES)]
        answer.score = [
            deserialize_message(d, ModelScore) for d in scores.since(request.scores, MOST_MESSAGES)
        ]
        answer.matches_heard, answer.scores_heard = len(matches), len(scores)
        answer.forecasts_heard, answer.states_heard = self._counts.values()
        self.health.count("questions")
        return answer
