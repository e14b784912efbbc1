"""What comes next, on topics and as a service: the core's own answers, at every sample and at any time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.support.processes import Start
from tests.support.ros import Listener
from twinmatch.forecasting import Question, what_if
from twinmatch.nodes.messages import (
    answer_message,
    message_of,
    shown_samples,
)
from twinmatch.nodes.topics import EVERYTHING, LATCHED
from twinmatch.signals import Sample
from twinmatch.twin import Discriminator, Snapshot, TwinSettings, carry_out
from twinmatch_msgs.msg import Forecast, ForecastScore, Match, MatchRequest, ModelScore
from twinmatch_msgs.srv import WhatIf

pytestmark = pytest.mark.ros


class Offline:
    """What the core forecasts on the samples, as messages."""

    def __init__(self, samples: list[Sample]) -> None:
        settings = TwinSettings()
        self.forecasts: list[Forecast] = []
        self.leaders: list[ForecastScore] = []
        self.discriminator = Discriminator(settings, snapshots=True)
        for sample in samples:
            step = self.discriminator.push_sample(sample)
            snapshots = list(step.snapshots)
            if step.request is not None:
                snapshots += self.discriminator.push_match(
                    carry_out(step.request, settings)
                ).snapshots
            for snapshot in snapshots:
                self._take(snapshot)

    def _take(self, snapshot: Snapshot) -> None:
        if snapshot.leading is None:
            return
        leader = message_of(snapshot.leading)
        if not self.leaders or _identity(leader) != _identity(self.leaders[-1]):
            self.leaders.append(leader)
        outlook = snapshot.outlook()
        ahead = shown_samples(1.0, self.discriminator.forecaster.horizons)
        forecast = outlook.forecast(np.full(ahead[-1], outlook.sample.reference))
        self.forecasts.append(message_of(forecast.at(ahead), outlook.sample.stamp))


@pytest.fixture(scope="module")
def offline(steps: list[Sample]) -> Offline:
    return Offline(steps)


class Asker:
    """A client of `twin/what_if`."""

    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self._client = listener.node.create_client(WhatIf, "twin/what_if")

    def found(self) -> bool:
        return bool(self._client.service_is_ready())

    def __call__(self, **fields: Any) -> WhatIf.Response:
        asked = self._client.call_async(WhatIf.Request(**fields))
        self._listener.spin_until(asked.done, "an answer")
        response: WhatIf.Response = asked.result()
        return response


@pytest.fixture
def ask(listener: Listener) -> Asker:
    return Asker(listener)


REFUSED = {
    "row 1: -5 s lies in the past": {"times": [-5.0], "levels": [50.0]},
    "is not after": {"times": [10.0, 10.0], "levels": [50.0, 60.0]},
    "2 times and 1 set-points are given": {"times": [1.0, 2.0], "levels": [50.0]},
    "the set-point is 400 °C; give one from": {"times": [1.0], "levels": [400.0]},
    "the set-point is nan": {"times": [1.0], "levels": [math.nan]},
    "no candidate 'nobody'; at this sample there are: ": {"candidate": "nobody"},
    "the horizon is -3 s; give a positive time": {"horizon": -3.0},
    "the horizon is 1e+06 s; give at most 3600 s": {"horizon": 1e6},
    "the horizon is nan s": {"horizon": math.nan},
    "the level is inf": {"level": [math.inf]},
    "the tolerance is -1": {"tolerance": [-1.0]},
    "level has 2 values; a twin runs one loop": {"level": [1.0, 2.0]},
}


def test_every_sample_has_the_offline_forecast(
    start_process: Start,
    listener: Listener,
    ask: Asker,
    steps: list[Sample],
    offline: Offline,
) -> None:
    """And every leader the offline one; the answers at the end are the core's to the last bit.

    The discriminator that gives them follows one that was killed.
    """
    assert not listener.health
    assert len(offline.forecasts) > len(steps) / 2
    forecasts = listener.hear(Forecast, "twin/forecast", EVERYTHING)
    leaders = listener.hear(ForecastScore, "twin/leader", LATCHED)
    start_process("matcher")
    killed = start_process("discriminator")
    listener.spin_until(ask.found, "the first service")
    killed.kill()
    listener.spin_until(lambda: not ask.found(), "its end")
    start_process("discriminator")
    listener.wait_for_nodes(
        "twin/forecast", "twin/leader", "twin/match", "twin/match_request"
    )
    listener.spin_until(ask.found, "the service")
    assert ask().message.startswith(
        "forecast: there is no candidate yet; the first comes with"
    )
    listener.send(steps)
    listener.spin_until(
        lambda: len(forecasts) == len(offline.forecasts), "the last forecast"
    )
    assert [repr(m) for m in forecasts] == [repr(m) for m in offline.forecasts]
    assert [f.sample for f in forecasts] == list(range(forecasts[0].sample, len(steps)))
    assert repr(leaders[-1]) == repr(offline.leaders[-1])
    assert {10.0, 60.0, 300.0} <= set(forecasts[0].time)
    level = steps[-1].reference + 5.0
    question = Question(
        (20.0, 100.0), (level, level - 8.0), ramps=True, horizon=200.0, tolerance=1.5
    )
    outlook = offline.discriminator.forecaster.outlook()
    expected = answer_message(what_if(outlook, question), steps[-1].stamp)
    answer = ask(
        times=[20.0, 100.0],
        levels=[level, level - 8.0],
        ramps=True,
        horizon=200.0,
        tolerance=[1.5],
    )
    assert repr(answer) == repr(expected)
    assert (answer.forecast.sample, len(answer.forecast.time)) == (steps[-1].index, 200)
    nothing_changed = ask()
    assert nothing_changed.success
    assert list(nothing_changed.level) == [steps[-1].reference]
    assert set(nothing_changed.forecast.reference) == {steps[-1].reference}
    # What went wrong with a question is not a fault of the node, and the next one is answered.
    for refusal, fields in REFUSED.items():
        answer = ask(**fields)
        assert not answer.success, fields
        assert refusal in answer.message
        assert "\n" not in answer.message
    named = ask(
        candidate=offline.forecasts[0].candidate, level=[math.nan], tolerance=[math.nan]
    )
    assert named.success, named.message
    listener.spin_until(
        lambda: listener.values("forecast from sample"), "word of forecasts"
    )
    assert "" not in listener.values("leader")


def test_questions_are_answered_while_a_match_is_awaited(
    start_process: Start,
    listener: Listener,
    ask: Asker,
    steps: list[Sample],
    offline: Offline,
) -> None:
    """Matching stops after the first match: verdicts wait, answers do not."""
    requests = listener.hear(MatchRequest, "twin/match_request", EVERYTHING)
    matches = listener.hear(Match, "twin/match", EVERYTHING)
    scores = listener.hear(ModelScore, "twin/model_score", EVERYTHING)
    start_process("discriminator")
    matcher = start_process("matcher")
    listener.wait_for_nodes("twin/match", "twin/match_request", "twin/model_score")
    first = offline.forecasts[0].sample
    listener.send(steps[: first + 1])
    listener.spin_until(
        lambda: any(score.candidates for score in scores), "the first candidate"
    )
    matcher.kill()
    answered = len(matches)
    listener.send(steps[first + 1 :])
    listener.spin_until(
        lambda: (
            len({request.sample for request in requests})
            > len({m.sample for m in matches})
        ),
        "a request without an answer",
    )
    answer = listener.spin_until(lambda: _answered(ask()), "an answer")
    waits = max(request.sample for request in requests)
    assert first <= answer.forecast.sample <= waits
    assert len(matches) == answered
    assert (
        answer.forecast.output_low[0]
        < answer.forecast.output[0]
        < answer.forecast.output_high[0]
    )


@pytest.mark.parametrize(
    ("period", "horizons", "first", "count"),
    [
        (1.0, (10, 60, 300), 1, 16),
        (0.1, (100, 600, 3000), 10, 16),
        (20.0, (1, 3, 15), 1, 8),
        (1.0, (4,), 1, 4),
    ],
)
def test_what_is_shown_holds_every_horizon(
    period: float, horizons: tuple[int, ...], first: int, count: int
) -> None:
    shown = shown_samples(period, horizons)
    assert set(horizons) <= set(shown)
    assert (shown[0], shown[-1], len(shown)) == (first, max(horizons), count)
    assert list(shown) == sorted(set(shown))


def _answered(answer: WhatIf.Response) -> WhatIf.Response | None:
    return answer if answer.success else None


def _identity(leader: ForecastScore) -> tuple[object, ...]:
    return leader.name, repr(leader.parameters)
