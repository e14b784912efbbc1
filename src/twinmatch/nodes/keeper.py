"""Keeps what is heard of a run, and gives it to a node that comes back or was held up: `plant/past`.

It lives in the process that makes the samples: while there are samples, there is somebody who knows them all.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, ClassVar

from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from twinmatch.nodes.diagnostics import Level, Report
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.nodes.parameters import BUILT_IN, Parameter
from twinmatch.nodes.sample_messages import sample_from
from twinmatch.sessions.shelf import Shelf, Texts
from twinmatch.signals import SignalError
from twinmatch_msgs.msg import Forecast, LoopSample, Match, ModelScore, TwinState
from twinmatch_msgs.srv import Past

__all__ = ["PAST", "Keeper"]

PAST = "plant/past"
"""Name of the service."""
MOST_SAMPLES = 2000
"""In one answer: some milliseconds of work."""
MOST_MATCHES = 20

LINGER = 2.0
"""Wall seconds after a question in which another may come: whoever asks is not left alone."""

_EVERYTHING = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)


class Keeper(TwinmatchNode):
    """Hears samples and matches, and counts what else a twin says, from the session's first sample on."""

    NAME = "keeper"
    COUNTED: ClassVar = {
        "twin/model_score": ModelScore,
        "twin/forecast": Forecast,
        "twin/state": TwinState,
    }

    @classmethod
    def table_for(cls, given: Mapping[str, Any]) -> tuple[Sequence[Parameter], Mapping[str, Any]]:
        """None: what is given to its process is meant for the node beside it."""
        return (), {name: value for name, value in given.items() if name.startswith(BUILT_IN)}

    def open(self) -> None:
        """Listen and offer the service."""
        self._shelf = Shelf()
        self._matches = Texts()
        self._asked_at = -LINGER
        self._counts = dict.fromkeys(self.COUNTED, 0)
        self.create_subscription(LoopSample, "plant/sample", self._on_sample, _EVERYTHING)
        self.create_subscription(Match, "twin/match", self._on_match, _EVERYTHING, raw=True)
        for name, kind in self.COUNTED.items():
            self.create_subscription(kind, name, partial(self._on_other, name), _EVERYTHING, raw=True)
        self.create_service(Past, PAST, self._on_question)
        self.health.say("keeping")
        self.report_on()

    def report(self) -> Report:
        """How much there is."""
        self.health.set("samples", len(self._shelf))
        self.health.set("matches", len(self._matches))
        return super().report()

    def close(self) -> bool:
        """Let go of the files."""
        if hasattr(self, "_shelf"):
            self._shelf.close()
            self._matches.close()
        return True

    def _on_sample(self, message: LoopSample) -> None:
        try:
            sample = sample_from(message)
        except SignalError as error:
            self.health.complain("sample", Level.ERROR, f"plant/sample: {error}")
            return
        if sample.index < self._shelf.end or len(sample.disturbances) != self._shelf.disturbances:
            self._begin(len(sample.disturbances))
        self._shelf.push(sample)

    def _begin(self, disturbances: int) -> None:
        """Another session begins: what was said about the one before is none of its past."""
        self.close()
        self._shelf, self._matches = Shelf(disturbances), Texts()
        self._counts = dict.fromkeys(self.COUNTED, 0)

    def _on_match(self, data: bytes) -> None:
        self._matches.push(data)

    def _on_other(self, name: str, _: bytes) -> None:
        self._counts[name] += 1

    @property
    def busy(self) -> bool:
        """Whether somebody is catching up."""
        return time.monotonic() - self._asked_at < LINGER

    def _on_question(self, request: Past.Request, answer: Past.Response) -> Past.Response:
        self._asked_at = time.monotonic()
        rows = self._shelf.rows(request.first, request.count, MOST_SAMPLES)
        answer.heard = self._shelf.end
        for name in ("index", "stamp", "reference", "output", "input"):
            setattr(answer, name, rows[name].tolist())
        answer.disturbances = rows["disturbances"].ravel().tolist()
        answer.match = [
            deserialize_message(data, Match) for data in self._matches.since(request.matches, MOST_MATCHES)
        ]
        answer.matches_heard = len(self._matches)
        answer.scores_heard, answer.forecasts_heard, answer.states_heard = self._counts.values()
        self.health.count("questions")
        return answer
