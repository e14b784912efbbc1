"""What comes next, as topics and a service of the node that holds the candidates."""

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
"""Key on /diagnostics: how many were answered on `twin/what_if`."""


class Foreteller:
    """Publishes at every sample what the leader foretells, and answers what if.

    The thread that judges leaves a snapshot of all candidates behind at every sample; questions are answered
    from the newest one in the thread of the callbacks, so that they never wait for a judgement.
    """

    def __init__(self, node: TwinNode) -> None:
        """Make topics and service of a node."""
        self._node, self._health = node, node.health
        self._snapshot = Snapshot()
        self._leader: Outlook | None = None
        self._ahead: tuple[int, ...] = ()
        self._made = 0
        self.heard = 0
        """Forecasts that were heard before this node came, and are not published again."""
        self._forecasts = node.create_publisher(Forecast, "twin/forecast", RELIABLE)
        self._leaders = node.create_publisher(ForecastScore, "twin/leader", LATCHED)
        node.create_service(WhatIf, "twin/what_if", self._on_question)

    def publish(self, discriminator: Discriminator) -> None:
        """Tell what comes after the newest sample of which everything is said, once there is a candidate."""
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
            return  # whoever leads at the next sample can be run
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
