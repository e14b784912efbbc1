"""Forecasts as topics and a service of the node that holds the candidates."""

from __future__ import annotations

import numpy as np

from twinmatch.dynamics import PlantError
from twinmatch.errors import TwinmatchError
from twinmatch.forecasting import Outlook, what_if
from twinmatch.nodes.conversions import leader_message
from twinmatch.nodes.forecast_messages import answer_message, forecast_message, question_from, shown_samples
from twinmatch.nodes.samples import LATCHED, RELIABLE, TwinNode
from twinmatch.twin import Discriminator, Snapshot
from twinmatch_msgs.msg import Forecast, ForecastScore
from twinmatch_msgs.srv import WhatIf

__all__ = ["QUESTIONS", "Foreteller"]

QUESTIONS = "questions"
"""Key on /diagnostics: number of answers on `twin/what_if`."""


class Foreteller:
    """Publishes the leader's forecast at every sample, and answers what-if questions.

    The judging thread leaves a snapshot of all candidates at every sample. Questions are answered from the
    newest snapshot in the callback thread, so that they never wait for a verdict.
    """

    def __init__(self, node: TwinNode) -> None:
        """Create the topics and the service."""
        self._node, self._health = node, node.health
        self._snapshot = Snapshot()
        self._leader: Outlook | None = None
        self._ahead: tuple[int, ...] = ()
        self._made = 0
        self.heard = 0
        """Number of forecasts published before this node started, which are not published again."""
        self._forecasts = node.create_publisher(Forecast, "twin/forecast", RELIABLE)
        self._leaders = node.create_publisher(ForecastScore, "twin/leader", LATCHED)
        node.create_service(WhatIf, "twin/what_if", self._on_question)

    def publish(self, discriminator: Discriminator) -> None:
        """Publish the forecast from the newest sample that is fully judged, once there is a candidate."""
        self.look(discriminator)
        name = self._snapshot.leader
        if name is None:
            return
        self._made += 1
        if self._made <= self.heard:
            return
        outlook = self._snapshot.outlook(name)
        if self._leader is None or _identity(outlook) != _identity(self._leader):
            score = next(score for score in discriminator.forecaster.scores if score.name == name)
            self._leaders.publish(leader_message(score))
            self._leader = outlook
        if not self._ahead:
            self._ahead = shown_samples(outlook.period, discriminator.forecaster.horizons)
        sample = outlook.sample
        try:
            forecast = outlook.forecast(np.full(max(self._ahead), outlook.standing))
        except PlantError:
            if not outlook.parameters.model.is_elsewhere:
                raise
            return  # at the next sample another candidate leads, which can be run
        self._node.publish(self._forecasts, forecast_message(forecast, sample.stamp, self._ahead))
        self._health.set("leader", name)
        self._health.set("forecast from sample", sample.index)

    def look(self, discriminator: Discriminator) -> None:
        """Take a new snapshot."""
        self._snapshot = discriminator.forecaster.snapshot()

    def _on_question(self, request: WhatIf.Request, _: WhatIf.Response) -> WhatIf.Response:
        snapshot = self._snapshot
        try:
            outlook = snapshot.outlook(request.candidate or None)
            answer = what_if(outlook, question_from(request))
        except TwinmatchError as error:
            return WhatIf.Response(success=False, message=str(error))
        self._health.count(QUESTIONS)
        return answer_message(answer, outlook.sample.stamp)


def _identity(outlook: Outlook) -> tuple[object, ...]:
    return outlook.candidate, outlook.parameters
