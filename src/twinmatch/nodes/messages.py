"""Convert between the twin's objects and messages, without losing a bit.

`twinmatch.record` describes the recorded form of verdicts and matches; this module fills the messages. In a
message every signal is an array, so that a plant with two inputs needs no other message type.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from builtin_interfaces.msg import Time

from twinmatch.comparing import ForecastScore, Verdict
from twinmatch.comparing.verdict import CandidateScore
from twinmatch.description import Description, Quantity
from twinmatch.dynamics import Parameters, PlantError
from twinmatch.forecasting import Band, Forecast, Question, WhatIfResult
from twinmatch.health import EstimatedReading
from twinmatch.record import fill, object_of, parameters_of, parameters_tree, tree_of, tree_of_message
from twinmatch.safety import LawReport
from twinmatch.sessions.encoding import SAMPLED, description_tree
from twinmatch.signals import NANOSECONDS, Sample, SignalError, Window, point_of, point_values
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
    "closed_output", "closed_input", "driven_output", "closed_residual_y", "closed_residual_u",
    "driven_residual_y", "closed_rms_y", "closed_rms_u", "driven_rms_y",
)  # fmt: skip

SHOWN = (1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0, 180.0, 240.0, 300.0)
"""Times ahead at which a forecast is published, s: closely spaced where the forecast is sharp."""


def state_message(state: MirrorState, leader: str, states: Iterable[str]) -> messages.TwinState:
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
}
"""The message of each record; all their fields have the same names."""


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


def description_message(description: Description, period: float) -> messages.PlantDescription:
    """A plant as `PlantDescription`; `period` (s) is the sampling period it is run with."""
    return _fill(messages.PlantDescription(), description_tree(description, period))


def description_from(message: messages.PlantDescription) -> Description:
    """A plant from `PlantDescription`, which was checked."""
    tree = tree_of_message(message)
    del tree["period"]
    for name, field in (*SAMPLED.items(), ("states", "states")):
        tree[field] = tuple(Quantity(**quantity) for quantity in tree.pop(name))
    return Description(**tree | {"structures": tuple(tree["structures"])})


def request_message(request: MatchRequest, stamp: int) -> messages.MatchRequest:
    """A request as `MatchRequest`; `stamp` (ns) is that of the sample that triggered it."""
    window = request.window
    message = messages.MatchRequest(
        sample=request.sample,
        operating_point=list(point_values(request.operating_point)),
        first=window.first,
        period=window.period,
        start=parameters_message(request.start),
        incumbent=parameters_message(request.incumbent),
        lost=window.lost,
        **{name: getattr(window, field).ravel().tolist() for name, field in SAMPLED.items()},
    )
    return stamped(message, stamp)


def request_from(message: messages.MatchRequest) -> MatchRequest:
    """A request from `MatchRequest`.

    Raises:
        TwinmatchError: its window or its parameters cannot be used.
    """
    start = parameters_from(message.start)
    incumbent = parameters_of(tree_of_message(message.incumbent))
    samples = len(message.output) // len(start.model.plant.outputs)
    signals = {}
    for name, field in SAMPLED.items():
        values = np.array(getattr(message, name))
        if not samples or values.size % samples:
            msg = (
                f"match request: {values.size} values of {name} do not divide evenly among {samples} samples"
            )
            raise SignalError(msg)
        signals[field] = values.reshape(samples, -1)
    lost = np.array(message.lost, dtype=np.int64) - message.first
    if lost.size and not (lost.min() >= 0 and lost.max() < samples):
        msg = f"match request: lost samples {list(message.lost)} lie outside its window of {samples} samples"
        raise SignalError(msg)
    is_seen = np.ones(samples, dtype=np.bool_)
    is_seen[lost] = False
    window = Window(**signals, first=message.first, period=message.period, seen=is_seen)
    return MatchRequest(message.sample, point_of(message.operating_point), window, start, incumbent)


def shown_samples(period: float, horizons: tuple[int, ...]) -> tuple[int, ...]:
    """Samples ahead at which a forecast is published, with a period in s: all horizons, some between."""
    longest = max(horizons)
    between = {round(seconds / period) for seconds in SHOWN}
    return tuple(sorted({*horizons, *(ahead for ahead in between if 1 <= ahead <= longest)}))


_EDGES: Final = {"": "mean", "_low": "low", "_high": "high"}
"""Parts of a band by the endings of their fields."""


def forecast_message(
    forecast: Forecast, stamp: int, samples: tuple[int, ...] | None = None
) -> messages.Forecast:
    """A forecast as `Forecast`.

    Args:
        forecast: the forecast of one candidate.
        stamp: stamp of the newest sample it was made from, ns.
        samples: how many samples ahead are written, from 1; None: all.
    """
    rows = slice(None) if samples is None else np.array(samples) - 1
    columns = {"time": forecast.time, "reference": forecast.references}
    for name, bands in (("output", forecast.outputs), ("input", forecast.inputs)):
        for edge, band_field in _EDGES.items():
            columns[f"{name}{edge}"] = np.stack([getattr(band, band_field) for band in bands], axis=1)
    message = messages.Forecast(
        sample=forecast.sample,
        candidate=forecast.candidate,
        structure=forecast.structure,
        confidence=forecast.confidence,
        notes=list(forecast.notes),
        **{name: array("d", values[rows].tobytes()) for name, values in columns.items()},
    )
    return stamped(message, stamp)


def forecast_from(message: messages.Forecast) -> Forecast:
    """A forecast from `Forecast`."""
    return Forecast(
        sample=message.sample,
        candidate=message.candidate,
        structure=message.structure,
        confidence=message.confidence,
        time=np.array(message.time),
        references=np.array(message.reference),
        outputs=_bands_from(message, "output"),
        inputs=_bands_from(message, "input"),
        notes=tuple(message.notes),
    )


def _bands_from(message: messages.Forecast, name: str) -> tuple[Band, ...]:
    """The band of each output, or of each input, of a forecast."""
    size = len(message.time)
    edges = [np.array(getattr(message, f"{name}{edge}")).reshape(size, -1).T for edge in _EDGES]
    return tuple(map(Band, *edges))


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


def _moment(moment: float | None) -> float:
    return math.nan if moment is None else moment


def answer_message(answer: WhatIfResult, stamp: int) -> services.WhatIf.Response:
    """An answer as a response; `stamp` (ns) is that of the newest sample it was made from."""
    moments = {}
    for name, crossing in (("reach", answer.reached), ("hold", answer.settled)):
        moments[name] = _moment(crossing.expected)
        moments[f"{name}_earliest"] = _moment(crossing.earliest)
        moments[f"{name}_latest"] = _moment(crossing.latest)
    return services.WhatIf.Response(
        success=True,
        forecast=forecast_message(answer.forecast, stamp),
        level=[answer.level],
        tolerance=[answer.tolerance],
        largest_input=answer.largest.expected,
        largest_input_time=answer.largest.time,
        largest_input_least=answer.largest.least,
        largest_input_most=answer.largest.most,
        **moments,
    )


def _single(request: Any, name: str) -> float | None:
    values = getattr(request, name)
    if len(values) > 1:
        msg = f"what if: {name} has {len(values)} values; a twin runs one loop, so give one or none"
        raise SignalError(msg)
    return None if not values or math.isnan(values[0]) else float(values[0])


def _fill(message: Any, tree: dict[str, Any]) -> Any:
    return fill(message, tree, lambda kind: getattr(messages, kind)())
