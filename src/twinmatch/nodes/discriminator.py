"""Judges the family of matches: samples and matches in, verdicts out, and a forecast at every sample.

It publishes `twin/model_score`, `twin/nominal`, `twin/leader`, `twin/forecast`, `twin/match_request` and
`plant/estimate`, and serves `twin/what_if`, `twin/experiment` and `twin/try_law`.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from typing import Final

import numpy as np

from twinmatch import twin
from twinmatch.comparing import TrustLevel, Verdict, statements_of
from twinmatch.defects import without_what_fails
from twinmatch.dynamics import PlantError
from twinmatch.errors import TwinmatchError
from twinmatch.forecasting import what_if
from twinmatch.nodes.experimenter import Experimenter
from twinmatch.nodes.health import Level, Report
from twinmatch.nodes.law_desk import LawDesk
from twinmatch.nodes.messages import (
    answer_message,
    message_of,
    question_from,
    record_of,
    shown_samples,
)
from twinmatch.nodes.samples import SampleNode, TwinNode
from twinmatch.nodes.topics import EVERYTHING, LATCHED, RELIABLE
from twinmatch.parameters.candidates import candidates_in
from twinmatch.safety import LawReport, TrialPhase, Turn
from twinmatch.signals import Sample
from twinmatch.twin import Discriminator, MatchReport, Snapshot, Step
from twinmatch_msgs import msg as messages
from twinmatch_msgs.msg import (
    Candidate,
    EstimatedReading,
    Forecast,
    ForecastScore,
    Match,
    MatchRequest,
    ModelScore,
)
from twinmatch_msgs.srv import Past, WhatIf

QUESTIONS = "questions"
"""Key on /diagnostics: number of answers on `twin/what_if`."""


class ForecastPublisher:
    """Publishes the leader's forecast at every sample, and answers what-if questions.

    The judging thread leaves a snapshot of all candidates at every sample. Questions are answered from the
    newest snapshot in the callback thread, so that they never wait for a verdict.
    """

    def __init__(self, node: TwinNode, horizons: tuple[int, ...]) -> None:
        """Create the topics and the service; the forecasts shown have these horizons, in samples."""
        self._node = node
        self._health = node.health
        self._horizons = horizons
        self.newest = Snapshot()
        """What questions are answered from."""
        self._leader: tuple[object, ...] = ()  # name and parameters
        self._ahead: tuple[int, ...] = ()
        self._forecasts_made = 0
        self.published_before = 0
        """Number of forecasts published before this node started, which are not published again."""
        self._forecasts = node.create_publisher(Forecast, "twin/forecast", RELIABLE)
        self._leaders = node.create_publisher(ForecastScore, "twin/leader", LATCHED)
        node.create_service(WhatIf, "twin/what_if", self._on_question)

    def publish(self, snapshot: Snapshot) -> None:
        """Publish the forecast from the snapshot's sample, once there is a candidate."""
        self.take(snapshot)
        if snapshot.leading is None:
            return
        self._forecasts_made += 1
        if self._forecasts_made <= self.published_before:
            return
        outlook = snapshot.outlook()
        leader = (outlook.candidate, outlook.parameters)
        if leader != self._leader:
            self._leaders.publish(message_of(snapshot.leading))
            self._leader = leader
        if not self._ahead:
            self._ahead = shown_samples(outlook.period, self._horizons)
        sample = outlook.sample
        try:
            forecast = outlook.forecast(
                np.tile(outlook.standing, (max(self._ahead), 1))
            )
        except PlantError:
            if not outlook.parameters.model.is_external:
                raise
            return  # at the next sample another candidate leads, which can be run
        self._node.publish(
            self._forecasts, message_of(forecast.at(self._ahead), sample.stamp)
        )
        self._health.set("leader", outlook.candidate)
        self._health.set("forecast from sample", sample.index)

    def take(self, snapshot: Snapshot) -> None:
        """Answer questions from this snapshot from now on."""
        self.newest = snapshot

    def _on_question(
        self, request: WhatIf.Request, _: WhatIf.Response
    ) -> WhatIf.Response:
        snapshot = self.newest
        try:
            outlook = snapshot.outlook(request.candidate or None)
            answer = what_if(outlook, question_from(request))
        except TwinmatchError as error:
            return WhatIf.Response(success=False, message=str(error))
        self._health.count(QUESTIONS)
        return answer_message(answer, outlook.sample.stamp)


SETTLED = "settled"
"""Key on /diagnostics: newest sample up to which everything is judged."""
VERDICTS = "verdicts"
"""Key on /diagnostics: verdicts so far."""


def plant_report(verdict: Verdict | None, reason: str) -> Report:
    """What a verdict says of the plant: an error is a fault, a warning what a twin adapts to, or unexplained
    readings. `reason` is the sentence with which the fault was found."""
    if verdict is None:
        return Report(Level.OK, "nothing is judged yet", {})
    trust, fault, _ = statements_of(verdict)
    if fault is None and trust.missed_since is None:
        return Report(Level.OK, "the plant responds normally", {})
    if fault is None:
        return Report(
            Level.WARN, trust.reason, {"since sample": str(trust.missed_since)}
        )
    values = {"fault": fault.name, "channel": fault.signal, "since sample": fault.since}
    filled = {
        key: str(value) for key, value in values.items() if value not in ("", None)
    }
    level = Level.ERROR if fault.level is TrustLevel.FAULT else Level.WARN
    return Report(level, fault._replace(reason=reason).with_reason, filled)


class DiscriminatorNode(SampleNode):
    """Requests matches, and publishes every verdict, and the nominal candidate when it changes.

    A request is repeated every `PATIENCE` seconds until it is answered: the matcher may have crashed or
    started late. The answer depends on the request alone, so waiting changes no verdict.
    """

    PATIENCE: Final = 2.0
    """Time after which an unanswered match request is repeated, wall s."""
    BEHIND: Final = 20
    """Samples for which a plant in step continues while a match is awaited."""
    CHECK: Final = 0.5
    """Interval at which the pending request is checked, wall s."""

    NAME = "discriminator"

    def open(self) -> None:
        """Start to judge samples and matches."""
        self._discriminator = Discriminator(
            self.settings, candidates_in(self.values), snapshots=True
        )
        self._forecasts = ForecastPublisher(
            self, self._discriminator.forecaster.horizons
        )
        self._judged: Verdict | None = None
        self._fault_reason = ""
        self._nominal: tuple[object, ...] = ()  # name, window and parameters
        # matches made before this node started, oldest first
        self._answers: deque[MatchReport] = deque()
        self._verdicts_made = 0
        self._reported_defects = 0
        self._published_before = 0  # verdicts published before this node started
        self._pending: MatchRequest | None = None
        self._newest_index = 0
        self._requested_at = 0.0
        self._tries = 0
        self._scores = self.create_publisher(ModelScore, "twin/model_score", RELIABLE)
        self._nominals = self.create_publisher(Candidate, "twin/nominal", LATCHED)
        self._estimates = self.create_publisher(
            EstimatedReading, "plant/estimate", RELIABLE
        )
        self._requests = self.create_publisher(
            MatchRequest, "twin/match_request", RELIABLE
        )
        super().open()
        stamps = self._discriminator.stamps

        def newest() -> Snapshot:
            return self._forecasts.newest

        def stamp_of(index: int) -> int:
            return stamps.get(index, 0)

        turn = Turn()
        self._experimenter = Experimenter(self, newest, stamp_of, turn)
        self._laws = LawDesk(self, newest, stamp_of, turn)
        self.create_subscription(Match, "twin/match", self._on_match, EVERYTHING)
        self.create_subscription(messages.LawReport, "plant/law", self.put, LATCHED)
        if self.step is not None:
            self.step.wait_for(self._behind)
        self.wall_timer(self.CHECK, self._repeat)

    def report_on(self, **tasks: Callable[[], Report]) -> None:
        """Report on the plant, too."""
        super().report_on(
            **tasks, plant=lambda: plant_report(self._judged, self._fault_reason)
        )

    def _behind(self) -> bool:
        """Whether a match has been awaited for so long that a plant in step should wait too."""
        request = self._discriminator.request
        return (
            request is not None
            and (self._watch.last or 0) - request.sample > self.BEHIND
        )

    def work(self, received: Sample | MatchReport | LawReport) -> None:
        """Take one sample or match, publish the verdicts now due, and request the match they need."""
        if isinstance(received, LawReport):
            self._laws.observe(received)
            if received.first:
                last = (
                    received.sample if received.phase is TrialPhase.BACK else math.inf
                )
                self._discriminator.tell_of_trial(received.first, last)
            return
        if isinstance(received, MatchReport):
            step = self._discriminator.push_match(received)
        else:
            if received.index < self._newest_index:
                self._laws.begin_again()
            self._newest_index = received.index
            step = self._discriminator.push_sample(received)
        self._publish_step(step)
        while (
            step.request is not None
            and (earlier_match := self._answer(step.request)) is not None
        ):
            step = self._discriminator.push_match(earlier_match)
            self._publish_step(step)
        if step.request is not None:
            self._tries = 0
            self._request(message_of(step.request, self._stamp_of(step.request)))
        elif self._discriminator.request is None:
            self.health.set("waiting for a match of", "nothing")
            self.health.withdraw("match")
        self.health.set(SETTLED, self._discriminator.settled)

    def learn(self, answer: Past.Response) -> None:
        """Take the results of a discriminator before this one, which are not published again."""
        if not self._stream.begun:
            self._published_before = answer.scores_heard
            self._forecasts.published_before = answer.forecasts_heard
        self._answers += map(record_of, answer.match)

    def _stamp_of(self, record: Verdict | twin.MatchRequest) -> int:
        """Stamp of the sample of a verdict or request, ns; 0: it was so long ago that it is forgotten."""
        return self._discriminator.stamps.get(record.sample, 0)

    def _answer(self, request: twin.MatchRequest) -> MatchReport | None:
        """The match that answered a request before this node started, if there is one."""
        while self._answers:
            report = self._answers.popleft()
            if report.answers(request):
                return report
        return None

    def _publish_step(self, step: Step) -> None:
        """Publish what a sample or a match has brought: estimates, forecasts and verdicts."""
        for estimate in step.estimates:
            self.publish(
                self._estimates,
                message_of(estimate, self._discriminator.stamps[estimate.sample]),
            )
        defects = self._discriminator.defects
        for snapshot in step.snapshots:
            with without_what_fails("no forecast could be published", defects):
                self._forecasts.publish(snapshot)
        for verdict in step.verdicts:
            self._publish_verdict(verdict)
        if step.verdicts:  # a match may have brought a candidate
            with without_what_fails(
                "no question can be answered with what is new", defects
            ):
                self._forecasts.take(self._discriminator.forecaster.snapshot())
        if len(defects) > self._reported_defects:
            self._reported_defects = len(defects)
            words = "; ".join(map(str, defects.values()))
            self.health.flag(
                "defect",
                Level.ERROR,
                f"a defect of this program, please report it: {words}",
            )
        self._experimenter.take(step.settled, step.verdicts)

    def _request(self, request: MatchRequest) -> None:
        self._requested_at = time.monotonic()
        self._tries += 1
        self._pending = request
        self._requests.publish(request)
        last = request.first + self._length(request) - 1
        self.health.set("waiting for a match of", f"{request.first} to {last}")

    def _length(self, request: MatchRequest) -> int:
        """Samples in its window."""
        return len(request.output) // len(self.settings.plant.outputs)

    def _repeat(self) -> None:
        """Repeat the pending request if it has not been answered for `PATIENCE`."""
        pending = self._pending
        if pending is None or time.monotonic() - self._requested_at < self.PATIENCE:
            return
        self._request(pending)
        words = f"no answer to the match request of sample {pending.sample}; requested {self._tries} times"
        self.health.flag("match", Level.WARN, words)

    def _on_match(self, report: MatchReport) -> None:
        pending = self._pending
        requested = (
            None
            if pending is None
            else (pending.sample, pending.first, self._length(pending))
        )
        first, last = report.match.samples
        if requested != (report.sample, first, last + 1 - first):
            # a second answer, or anybody's: not even queued
            self.health.count("matches not asked for")
            return
        self._pending = None
        self.put(report)

    def _publish_verdict(self, verdict: Verdict) -> None:
        """Report a verdict and publish it, unless a discriminator before this one did; then the nominal."""
        if self._judged is None or verdict.named_fault != self._judged.named_fault:
            self._fault_reason = verdict.reason
        self._judged = verdict
        self.health.count(VERDICTS)
        trust = statements_of(verdict).trust
        self.health.set("level", trust.level.value)
        self.health.set("level because", trust.reason)
        self.health.set("nominal", verdict.nominal or "none")
        self._verdicts_made += 1
        if self._verdicts_made > self._published_before:
            self.publish(self._scores, message_of(verdict, self._stamp_of(verdict)))
        if self._verdicts_made < self._published_before:
            return
        if verdict.chosen is None:
            return
        nominal = message_of(verdict.chosen)
        identity = (nominal.name, nominal.first, nominal.last, nominal.parameters)
        if identity != self._nominal:
            self._nominal = identity
            self._nominals.publish(nominal)
