"""What is expected of every message that a node reads: one table, by its type.

What concerns one field of a record is declared beside that field, with `twinmatch.requirements`. A check
raises `MessageError` with a sentence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain, pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import (
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, Temperature
from std_msgs.msg import Float64, Float64MultiArray

from twinmatch.comparing import ADMITTED, REFUSED, CandidateScore, Verdict
from twinmatch.dynamics import Plant
from twinmatch.forecasting import Forecast
from twinmatch.health import EstimatedReading
from twinmatch.nodes import messages as converted
from twinmatch.nodes.fields import GREATEST_INDEX, Expected, MessageError, check_fields
from twinmatch.nodes.messages import LOOP, nanoseconds, sample_from
from twinmatch.plants import UnknownPlantError
from twinmatch.record import SAMPLED
from twinmatch.record.fields import Form, RecordField, fields_of, values_name
from twinmatch.requirements import FINITE, Requirement, Within, unknown_word, wrong_size
from twinmatch.safety import LawReport
from twinmatch.signals import FloatArray, counted, incomplete
from twinmatch.twin import MatchReport, MatchRequest
from twinmatch.twin.experiment import ExperimentPhase, ExperimentReport
from twinmatch_msgs import msg as ours
from twinmatch_msgs.srv import ApplyLaw, Experiment, Past, TryLaw, WhatIf

_PERIODS: Final = Within(1e-4, 1e6, may_be_absent=False)
"""Sampling periods, s."""


def check(message: Any, plant: Expected = None) -> None:
    """Check a message of a type in the table; others pass. `plant`: the only one expected; None: any.

    Raises:
        MessageError: it is not what is expected.
    """
    kind = MESSAGES.get(type(message))
    if kind is not None:
        check_fields(message, plant)
        kind.check(message)
    if plant is not None and isinstance(message, ours.LoopSample):
        _check_signals(message, plant)
    elif plant is not None and isinstance(message, ours.PlantReading):
        _check_size(message, len(plant.outputs), "output", of="the plant's outputs")
        _check_size(
            message, len(plant.outputs), "taken", of="the plant's outputs", empty=True
        )
    elif plant is not None and isinstance(message, ours.PlantApplied):
        _check_size(message, len(plant.drives), "input", of="the plant's drives")


def check_readable(message: Any) -> None:
    """Check that a message of a type in the table can be read, as far as this process can tell: the plant of
    a file is known only where it was loaded.

    Raises:
        TwinmatchError: it cannot.
    """
    with suppress(UnknownPlantError):
        MESSAGES[type(message)].read(message)


def check_record(message: Any, kind: type, owner: Any = None) -> None:
    """Check a message, or a part of its `owner`, by what is declared beside the fields of its record.

    Raises:
        MessageError: a field is not what is expected.
    """
    for field in fields_of(kind):
        _check_form(message, field, owner)
        for requirement in field.requirements:
            for name in _names_of(field):
                _refuse(
                    requirement.problem(name, getattr(message, name), message, owner)
                )
        if field.form is Form.BANDS:
            _check_size(
                message,
                len(getattr(message, field.key)),
                *_names_of(field),
                of="its means",
            )


def _check_form(message: Any, field: RecordField, owner: Any) -> None:
    """Check what follows from the form of a field, and the parts in it."""
    if field.form is Form.WORD:
        _check_word(message, field.key, [member.value for member in field.kind])
    elif field.form is Form.POINT:
        _check_point(message, field.key)
    elif field.form is Form.NAMED:
        _check_size(
            message,
            len(getattr(message, field.key)),
            values_name(field.key),
            of=f"its {field.key}",
        )
    elif field.form is Form.PART:
        check_record(getattr(message, field.key), field.kind, message)
    elif field.form is Form.PARTS:
        for part in getattr(message, field.key):
            check_record(part, field.kind, message)
    elif field.form is Form.INLINE and not field.prefix:
        check_record(message, field.kind, owner)


def _names_of(field: RecordField) -> tuple[str, ...]:
    """The fields of a message with the values of a record's field."""
    return (
        tuple(field.columns_of_bands.values())
        if field.form is Form.BANDS
        else (field.key,)
    )


def _refuse(problem: str) -> None:
    if problem:
        raise MessageError(problem)


def _check_size(
    message: Any, size: int, *names: str, of: str, empty: bool = False
) -> None:
    for name in names:
        length = len(getattr(message, name))
        if length != size and not (empty and length == 0):
            raise MessageError(wrong_size(name, length, size, of))


def _check_each(message: Any, requirement: Requirement, *names: str) -> None:
    """Check fields of a message that is not a record."""
    for name in names:
        _refuse(requirement.problem(name, getattr(message, name), message, None))


def _check_word(message: Any, name: str, words: Sequence[str]) -> None:
    """Check that a number is that of one of these words, and that its word says the same."""
    number = getattr(message, name)
    word = getattr(message, f"{name}_name")
    if word not in words or getattr(type(message), word.upper()) != number:
        expected = ", ".join(words)
        raise MessageError(
            f"{name} is {number} with the word {word[:40]!r}; expected one of {expected}"
        )


def _check_point(message: Any, name: str) -> None:
    _check_each(message, FINITE, name)
    if not getattr(message, name):
        raise MessageError(f"{name} is empty; expected a value for each output")


def _check_window(message: Any) -> None:
    """Check that the window ends at the sample that triggered it, or before."""
    if not 0 <= message.first <= message.last <= message.sample:
        window = f"{message.first} to {message.last}"
        raise MessageError(
            f"its window is {window} at sample {message.sample}; it must end there or before"
        )


def _check_sample(message: Any) -> None:
    if missing := incomplete(
        message.index, [len(getattr(message, name)) for name in LOOP]
    ):
        raise MessageError(missing)
    _check_each(message, FINITE, *SAMPLED)


def _check_signals(message: Any, plant: type[Plant]) -> None:
    """Check that a sample has the signals of a plant."""
    lengths = [len(getattr(message, name)) for name in LOOP]
    outputs = len(plant.outputs)
    expected = [outputs, outputs, len(plant.drives)]
    if lengths != expected:
        raise MessageError(
            f"{counted(message.index, lengths)}; plant {plant.name} has {', '.join(map(str, expected))} "
            "(further measured inputs are disturbances)"
        )


def _check_state(message: Any) -> None:
    outputs = len(message.closed_output)
    inputs = len(message.closed_input)
    if not (len(message.reference) and outputs and inputs):
        raise MessageError(
            "has no reference, no output or no input; a plant has at least one of each"
        )
    for name in converted.STATE_FIGURES:
        if name.endswith(("_input", "_u")):
            _check_size(message, inputs, name, of="its inputs")
        else:
            _check_size(message, outputs, name, of="its outputs")
    _check_size(
        message,
        len(message.driven_states),
        "closed_states",
        of="the states of the driven twin",
    )


def _check_forecast(message: Any) -> None:
    if not len(message.time):
        raise MessageError("time is empty; a forecast has at least one")
    check_record(message, Forecast)


def _check_match(message: Any) -> None:
    _check_window(message)
    check_record(message, MatchReport)
    _refuse(
        unknown_word(
            message.free, {*message.parameters.names, *message.starts}, "parameter"
        )
    )
    if len(set(message.free)) != len(message.free):
        raise MessageError("free: a name is given twice")
    ends = zip(message.intervals[::2], message.intervals[1::2], strict=True)
    if any(low > high for low, high in ends):
        raise MessageError("intervals: a low end is above its high end")
    if message.status == message.ACCEPTED:
        _check_accepted(message, len(message.free))


def _check_accepted(message: Any, size: int) -> None:
    """Check what the twin computes with: its numbers are finite, and its covariance is one."""
    _check_each(message, Within(-math.inf, 1.0), "fit_y", "fit_u")
    _check_each(message, Within(0.0, math.inf, may_be_absent=False), "chi2")
    for name in ("covariance", "fisher", "eigenvalues", "start_values"):
        if not all(map(math.isfinite, getattr(message, name))):
            raise MessageError(f"{name} of an accepted match is not finite")
    covariance = np.array(message.covariance).reshape(size, size)
    if not _is_positive(covariance):
        raise MessageError(
            "covariance is none: it has an eigenvalue that is not positive"
        )
    if not np.allclose(covariance, covariance.T, rtol=1e-6):
        raise MessageError("covariance is not symmetric")


def _is_positive(covariance: FloatArray) -> bool:
    """Whether all variances are positive, and all eigenvalues of the correlations, but for rounding."""
    variances = np.diag(covariance)
    if not (variances > 0).all():
        return False
    errors = np.sqrt(variances)
    correlations = covariance / np.outer(errors, errors)
    return bool(np.linalg.eigvalsh(correlations).min(initial=0.0) >= -1e-6)


def _check_verdict(message: Any) -> None:
    names = [candidate.name for candidate in message.candidates]
    _check_window(message)
    if len(set(names)) != len(names):
        raise MessageError("candidates: a name is given twice")
    check_record(message, Verdict)
    modelled = sum(bool(candidate.orders) for candidate in message.candidates)
    _check_size(
        message,
        modelled**2,
        "identified_gap",
        of="its candidates with models",
        empty=True,
    )
    _refuse(unknown_word([message.match], {ADMITTED, REFUSED}, "match"))
    for candidate in chain(message.candidates, message.forecasts):
        _check_named(candidate)


def _check_estimate(message: Any) -> None:
    check_record(message, EstimatedReading)
    if not (message.signal and message.since <= message.sample):
        raise MessageError("it names no signal, or begins behind its sample")


def _check_experiment(message: Any) -> None:
    check_record(message, ExperimentReport)
    if message.phase_name != ExperimentPhase.REFUSED.value:
        _check_each(message, FINITE, "expected", "brought", "levels", "holds")


def _check_law(message: Any) -> None:
    check_record(message, LawReport)


def _check_candidate(candidate: Any) -> None:
    check_record(candidate, CandidateScore)
    _check_named(candidate)


def _check_score(score: Any) -> None:
    """Check the score of a candidate alone: the horizons it belongs to are not in the message."""
    _check_each(score, Within(0.0, math.inf), "forecasts")
    _check_named(score)


def _check_named(candidate: Any) -> None:
    if not candidate.name or not candidate.parameters.names:
        raise MessageError("a candidate has no name or no parameters")


def _check_request(message: Any) -> None:
    _check_point(message, "operating_point")
    _check_each(message, FINITE, *SAMPLED)
    _check_each(message, _PERIODS, "period")


def _request_with_stamp(message: Any) -> tuple[MatchRequest, int]:
    """A request and its stamp, ns."""
    request = converted.record_of(message)
    if request.window.last > request.sample:
        raise MessageError(f"its window ends behind its sample {request.sample}")
    return request, nanoseconds(message.header.stamp)


def _check_description(message: Any) -> None:
    for name in LOOP:
        if not getattr(message, name):
            raise MessageError(f"{name} is empty; a plant has at least one")
    _check_each(message, _PERIODS, "period")
    if not message.plant:
        raise MessageError("plant is empty; expected its name")
    for signal in chain(*(getattr(message, name) for name in (*SAMPLED, "states"))):
        if not signal.low <= signal.high:
            raise MessageError(
                f"{signal.name[:40]} is from {signal.low} to {signal.high}"
            )


def _check_image(message: Any) -> None:
    if not (message.height and message.width) or message.step * message.height != len(
        message.data
    ):
        size = f"{message.height} rows of {message.step} bytes"
        raise MessageError(f"data has {len(message.data)} bytes for {size}")
    if message.encoding == "32FC1" and message.step != 4 * message.width:
        raise MessageError(
            f"a row has {message.step} bytes for {message.width} values of 4 bytes"
        )


def _check_health(message: Any) -> None:
    for status in message.status:
        if int.from_bytes(status.level, "little") > 3:
            raise MessageError(
                f"level of {status.name[:40]} is {status.level!r}; expected 0 to 3"
            )


def _check_past(answer: Any) -> None:
    size = len(answer.index)
    _check_size(answer, size, "stamp", of="its samples")
    _check_each(answer, FINITE, *SAMPLED)
    for name in SAMPLED:
        values = len(getattr(answer, name))
        if values % max(1, size) or (name in LOOP and values < size):
            raise MessageError(f"{name} has {values} values for {size} samples")
    if any(a >= b for a, b in pairwise(answer.index)) or (
        size and answer.index[-1] >= GREATEST_INDEX
    ):
        raise MessageError("index does not rise")
    if any(stamp < 0 for stamp in answer.stamp):
        raise MessageError("stamp is negative")
    for part in chain(answer.match, answer.score):
        MESSAGES[type(part)].check(part)
        check_readable(part)


def _check_what_if_answer(answer: Any) -> None:
    if answer.success:
        _check_forecast(answer.forecast)
        _check_size(answer, 1, "level", "tolerance", of="one loop")


def _check_names(request: Any) -> None:
    if len(request.names) > 1000:
        raise MessageError(f"names has {len(request.names)} entries; 1000 is the most")


def _check_parameter_values(request: Any) -> None:
    for parameter in request.parameters:
        if (
            not parameter.name
            or parameter.value.type > ParameterType.PARAMETER_STRING_ARRAY
        ):
            name = parameter.name[:40]
            raise MessageError(
                f"parameter {name!r} has type {parameter.value.type}; expected 0 to 9"
            )


def _check_values(answer: Any) -> None:
    for value in answer.values:
        if value.type > ParameterType.PARAMETER_STRING_ARRAY:
            raise MessageError(f"a parameter has type {value.type}; expected 0 to 9")


@dataclass(frozen=True)
class SampleStride:
    """How far the index of a sample may be ahead of the one before."""

    min_period: int = 1_000_000
    """Shortest time between two samples, ns."""
    untimed: int = 100
    """Indices that may be missing without time between the samples."""

    def longest(self, elapsed: int) -> int:
        """Most indices ahead after so much time (ns)."""
        return self.untimed + max(0, elapsed) // self.min_period


_SAMPLE_STRIDE: Final = SampleStride()


def _sample_departs(before: Any, message: Any, _: float) -> str:
    """Why a sample does not follow another one; empty if it does."""
    if message.index <= before.index:
        return f"sample {message.index} came after sample {before.index}"
    elapsed = nanoseconds(message.header.stamp) - nanoseconds(before.header.stamp)
    if message.index - before.index > _SAMPLE_STRIDE.longest(elapsed):
        return f"sample {message.index} came {elapsed / 1e9:g} s after sample {before.index}"
    for name in SAMPLED:
        length_before = len(getattr(before, name))
        length = len(getattr(message, name))
        if length_before != length:
            return f"it has {length} values of {name}; those before had {length_before}"
    return ""


@dataclass(frozen=True)
class ClockStride:
    """How far /clock may be ahead of the one before."""

    fastest: float = 1000.0
    """Highest speed of a virtual plant, plant s per wall s; at `max` no machine reaches it."""
    untimed: float = 2.0
    """Longest way from one /clock to the next in no time, plant s: a plant in step tells where it stands."""

    def longest(self, elapsed: float) -> float:
        """Most plant seconds ahead after so much time (wall s)."""
        return self.untimed + self.fastest * elapsed


CLOCK_STRIDE: Final = ClockStride()


def _clock_departs(before: Any, message: Any, elapsed: float) -> str:
    ahead = (nanoseconds(message.clock) - nanoseconds(before.clock)) / 1e9
    if ahead < 0:
        return f"the time goes back by {-ahead:g} s"
    if ahead > CLOCK_STRIDE.longest(elapsed):
        return f"the time jumps ahead by {ahead:g} s within {elapsed:.3g} s"
    return ""


class MessageRules(NamedTuple):
    """What is expected of the messages of a type."""

    check: Callable[[Any], object] = lambda _: None
    """Checks a message whose fields have passed `check_fields`."""
    read: Callable[[Any], Any] = lambda message: message
    """What subscribers get in place of a message."""
    departs: Callable[[Any, Any, float], str] | None = None
    """Why a message does not follow the one so many wall seconds before it; empty if it does."""
    owned: bool = False
    """Whether the topic belongs to the publisher that began, however many others agree."""


MESSAGES: Final[dict[Any, MessageRules]] = {
    ours.LoopSample: MessageRules(_check_sample, sample_from, _sample_departs),
    ours.TwinState: MessageRules(_check_state),
    ours.Forecast: MessageRules(_check_forecast, converted.record_of),
    ours.Match: MessageRules(_check_match, converted.record_of),
    ours.MatchRequest: MessageRules(_check_request, _request_with_stamp),
    ours.ModelScore: MessageRules(_check_verdict, converted.record_of),
    ours.Candidate: MessageRules(_check_candidate),
    ours.ForecastScore: MessageRules(_check_score, converted.record_of),
    ours.EstimatedReading: MessageRules(_check_estimate, converted.record_of),
    ours.ExperimentReport: MessageRules(_check_experiment, converted.record_of),
    ours.LawReport: MessageRules(_check_law, converted.record_of),
    ours.PlantDescription: MessageRules(_check_description),
    Clock: MessageRules(departs=_clock_departs, owned=True),
    Image: MessageRules(_check_image),
    DiagnosticArray: MessageRules(_check_health),
    Past.Response: MessageRules(_check_past),
    WhatIf.Response: MessageRules(_check_what_if_answer),
    GetParameters.Request: MessageRules(_check_names),
    GetParameters.Response: MessageRules(_check_values),
    SetParameters.Request: MessageRules(_check_parameter_values),
    SetParametersAtomically.Request: MessageRules(_check_parameter_values),
    # A value that is out of range is a fault of the plant's, which the guard latches: it must see it.
    **dict.fromkeys(
        (ours.PlantReading, ours.PlantCommand, ours.PwmCommand, Temperature),
        MessageRules(),
    ),
    # Ranges are judged where the plant is known.
    **dict.fromkeys(
        (ours.PlantApplied, ours.PwmApplied, Float64, Float64MultiArray), MessageRules()
    ),
    # Refused in words by the services themselves.
    **dict.fromkeys(
        (Experiment.Request, TryLaw.Request, ApplyLaw.Request), MessageRules()
    ),
    **dict.fromkeys(
        (Past.Request, WhatIf.Request, ListParameters.Request), MessageRules()
    ),
}
"""All types that a node reads; others pass."""
