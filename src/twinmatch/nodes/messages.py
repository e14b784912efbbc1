"""Convert between the twin's objects and messages, without losing a bit.

`twinmatch.record` describes the form in which a record is sent: verdict, match, request, forecast, answer.
This module fills the messages. In a message every signal is an array, so that a plant with two inputs needs
no other message type.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Final

from builtin_interfaces.msg import Time

from twinmatch.comparing import ForecastScore, Verdict
from twinmatch.comparing.verdict import CandidateScore
from twinmatch.description import Description
from twinmatch.dynamics import Parameters, PlantError
from twinmatch.forecasting import Forecast, Question, WhatIfResult
from twinmatch.health import EstimatedReading
from twinmatch.record import (
    SAMPLED,
    description_tree,
    fill,
    object_of,
    parameters_of,
    parameters_tree,
    tree_of,
    tree_of_message,
)
from twinmatch.safety import LawReport
from twinmatch.signals import NANOSECONDS, Sample, SignalError
from twinmatch.twin import MatchReport, MatchRequest, MirrorState
from twinmatch.twin.experiment import ExperimentReport
from twinmatch_msgs import msg as messages
from twinmatch_msgs import srv as services

LOOP: Final = ("reference", "output", "input")
"""The signals of a loop, without disturbances."""


def time_message(stamp: int) -> Time:
    """A stamp (ns) as a message."""
    seconds, nanoseconds_left = divmod(stamp, NANOSECONDS)
    return Time(sec=seconds, nanosec=nanoseconds_left)


def nanoseconds(stamp: Any) -> int:
    """A ROS time stamp in nanoseconds."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def stamped(message: Any, stamp: int) -> Any:
    """The message, with a stamp (ns) in its header."""
    message.header.stamp = time_message(stamp)
    return message


def sample_message(sample: Sample, frame: str = "plate") -> messages.LoopSample:
    """A sample as `LoopSample`."""
    signals = {name: list(getattr(sample, field)) for name, field in SAMPLED.items()}
    message = messages.LoopSample(index=sample.index, **signals)
    message.header.frame_id = frame
    return stamped(message, sample.stamp)


def sample_from(message: messages.LoopSample) -> Sample:
    """A sample from `LoopSample`, which was checked."""
    signals = [tuple(getattr(message, name)) for name in SAMPLED]
    return Sample(message.index, nanoseconds(message.header.stamp), *signals)


STATE_FIGURES = (
    "closed_output",
    "closed_input",
    "driven_output",
    "closed_residual_y",
    "closed_residual_u",
    "driven_residual_y",
    "closed_rms_y",
    "closed_rms_u",
    "driven_rms_y",
)

SHOWN = (
    1.0,
    2.0,
    3.0,
    5.0,
    7.0,
    10.0,
    15.0,
    20.0,
    30.0,
    45.0,
    60.0,
    90.0,
    120.0,
    180.0,
    240.0,
    300.0,
)
"""Times ahead at which a forecast is published, s: closely spaced where the forecast is sharp."""


def state_message(
    state: MirrorState, leader: str, states: Iterable[str]
) -> messages.TwinState:
    """The states of the twins as `TwinState`.

    Args:
        state: the twins at one tick.
        leader: name of the candidate whose parameters they use.
        states: names of all states of the plant, in the order of its description.
    """
    order = list(states)
    message = messages.TwinState(
        index=state.sample.index,
        leader=leader,
        reference=list(state.sample.references),
        closed_states=[state.closed_states.get(name, math.nan) for name in order],
        driven_states=[state.driven_states.get(name, math.nan) for name in order],
        **{name: list(getattr(state, name)) for name in STATE_FIGURES},
    )
    return stamped(message, state.sample.stamp)


_RECORDS: Final[dict[Any, Any]] = {
    MatchReport: messages.Match,
    Verdict: messages.ModelScore,
    CandidateScore: messages.Candidate,
    ForecastScore: messages.ForecastScore,
    EstimatedReading: messages.EstimatedReading,
    ExperimentReport: messages.ExperimentReport,
    LawReport: messages.LawReport,
    Forecast: messages.Forecast,
    MatchRequest: messages.MatchRequest,
    Description: messages.PlantDescription,
}
"""The message of each record, whose fields say how they are written in it."""


def message_of(record: Any, stamp: int | None = None) -> Any:
    """A record as its message; `stamp` (ns), for those with a header, is that of the sample behind it."""
    message = _fill(_RECORDS[type(record)](), tree_of(record))
    return message if stamp is None else stamped(message, stamp)


def record_of(message: Any) -> Any:
    """The record in a message.

    Raises:
        TwinmatchError: it cannot be used.
    """
    (kind,) = (record for record, sent in _RECORDS.items() if sent is type(message))
    return object_of(kind, tree_of_message(message))


def parameters_from(message: messages.Parameters) -> Parameters:
    """The parameters in a `Parameters`.

    Raises:
        PlantError: the message has none, they are those of another plant, or values are out of range.
    """
    parameters = parameters_of(tree_of_message(message))
    if parameters is None:
        raise PlantError("parameters: the message holds none")
    return parameters


def parameters_message(parameters: Parameters | None) -> messages.Parameters:
    """Parameters as `Parameters`; for None a message without names."""
    return _fill(messages.Parameters(), parameters_tree(parameters))


def description_message(
    description: Description, period: float
) -> messages.PlantDescription:
    """A plant as `PlantDescription`; `period` (s) is the sampling period it is run with."""
    return _fill(messages.PlantDescription(), description_tree(description, period))


def shown_samples(period: float, horizons: tuple[int, ...]) -> tuple[int, ...]:
    """Samples ahead at which a forecast is published, with a period in s: all horizons, some between."""
    longest = max(horizons)
    between = {round(seconds / period) for seconds in SHOWN}
    return tuple(
        sorted({*horizons, *(ahead for ahead in between if 1 <= ahead <= longest)})
    )


def question_from(request: services.WhatIf.Request) -> Question:
    """A question from a request; what the request leaves open is None.

    Raises:
        SignalError: it names several outputs, but a twin runs one loop.
    """
    return Question(
        times=tuple(request.times),
        levels=tuple(request.levels),
        ramps=request.ramps,
        horizon=request.horizon or None,
        level=_single(request, "level"),
        tolerance=_single(request, "tolerance"),
    )


def answer_message(answer: WhatIfResult, stamp: int) -> services.WhatIf.Response:
    """An answer as a response; `stamp` (ns) is that of the newest sample it was made from."""
    response = _fill(services.WhatIf.Response(success=True), tree_of(answer))
    stamped(response.forecast, stamp)
    return response


def _single(request: Any, name: str) -> float | None:
    values = getattr(request, name)
    if len(values) > 1:
        msg = f"what if: {name} has {len(values)} values; a twin runs one loop, so give one or none"
        raise SignalError(msg)
    return None if not values or math.isnan(values[0]) else float(values[0])


def _fill(message: Any, tree: dict[str, Any]) -> Any:
    return fill(message, tree, lambda kind: getattr(messages, kind)())
