"""What a run in one process shows on the page, and what can be asked there."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, cast

from twinmatch.errors import TwinmatchError
from twinmatch.forecasting import Question, what_if
from twinmatch.plants.records import description_of
from twinmatch.showing.forecasts import forecast_words
from twinmatch.showing.page.goal import ASKED_EVERY, Goal, answer_of
from twinmatch.showing.page.health import ERROR, OK
from twinmatch.showing.page.shown import Shown
from twinmatch.showing.page.state import DashboardState, TwinRow, WhatIfAnswer
from twinmatch.signals import Sample
from twinmatch.twin import Snapshot, TwinSettings

if TYPE_CHECKING:
    from twinmatch.launching.judging import Judged
    from twinmatch.showing.page.requests import Requests


class Asked:
    """What can be asked on such a page: what-if questions. Nothing is commanded, and nothing is played."""

    control = False

    def __init__(self, state: DashboardState, settings: TwinSettings) -> None:
        """Answer into a state."""
        self._state = state
        self._settings = settings
        self.snapshot = Snapshot()
        """What is answered from."""

    def what_if(self, level: float, hold: float | None) -> None:
        """Forecast with the set-point at a level, and back after a time (s)."""
        question, times, levels = self._state.question(level, hold)
        try:
            forecast = what_if(
                self.snapshot.outlook(), Question(tuple(times), tuple(levels))
            ).forecast
        except TwinmatchError as error:
            self._state.answer(WhatIfAnswer(question, (str(error),)))
        else:
            words = (*forecast_words(forecast, self._settings), *forecast.notes)
            self._state.answer(WhatIfAnswer(question, words, forecast))

    def pause(self, paused: bool) -> None:
        """Nothing is played here."""

    def rate(self, rate: float) -> None:
        """Nothing is played here."""


class RunShown(Shown):
    """Keeps the state of a run in this process up to date for those who look at it."""

    def __init__(
        self,
        settings: TwinSettings,
        port: int | None,
        broker: str | None,
        goal: Goal | None = None,
    ) -> None:
        """Serve the page on a local port (None: no page), and tell a broker (None: none) what it shows; with
        a `goal` also when it is reached.

        Raises:
            TwinmatchError: the port cannot be used, or the broker cannot be reached.
        """
        super().__init__(description_of(settings.plant), lambda: settings)
        self.wanted = port is not None
        """Whether anybody looks."""
        self._asked = Asked(self.state, settings)
        self._goal = goal
        self._goal_asked_at = -math.inf
        try:
            if port is not None:
                # without `control`, a tab makes no other requests than these
                self.serve(cast("Requests", self._asked), port)
            if broker:
                self.publish_to(broker, settings.plant.name)
        except BaseException:
            self.close()
            raise

    def sample(self, sample: Sample) -> None:
        """Show a sample."""
        self.state.push_sample(sample, time.monotonic())

    def take(self, judged: Judged, snapshot: Snapshot) -> None:
        """Show what the twin made of a sample."""
        mirror = judged.mirror
        state = self.state
        if mirror is not None:
            row = TwinRow(*(getattr(mirror, name) for name in TwinRow._fields))
            state.push_twin(mirror.sample.index, row)
        self.ask_from(snapshot)
        if judged.forecast is not None:
            state.push_forecast(judged.forecast)
        for estimate in judged.outcome.estimates:
            state.push_estimate(estimate)
        for verdict in judged.outcome.verdicts:
            state.push_verdict(verdict)

    def ask_from(self, snapshot: Snapshot) -> None:
        """Answer questions from these twins."""
        self._asked.snapshot = snapshot

    def trouble(self, name: str, text: str) -> None:
        """Show why a signal gives no samples; empty: it does."""
        report = (ERROR, text) if text else (OK, "sampling")
        self.state.push_health(f"{name}: health", *report, {}, time.monotonic())

    def tell(self) -> str | None:
        """Do what a `Shown` does, and show why nothing reaches the broker."""
        self._ask_goal(time.monotonic())
        trouble = super().tell()
        if trouble is not None:
            self.trouble("broker", trouble)
        return trouble

    def _ask_goal(self, now: float) -> None:
        """Ask the leader when the goal is reached, from time to time; before there is one, nobody."""
        if self._goal is None or now - self._goal_asked_at < ASKED_EVERY:
            return
        self._goal_asked_at = now
        try:
            answer = answer_of(self._goal, self._asked.snapshot.outlook())
        except TwinmatchError as error:
            self.state.push_goal(None)
            self.trouble("goal", str(error) if self.state.forecast is not None else "")
        else:
            self.state.push_goal(answer)
            self.trouble("goal", "")
