"""Convert between forecasts and their messages."""

from __future__ import annotations

import math
from array import array
from typing import Any

import numpy as np

from twinmatch.forecasting import Band, Forecast, Question, WhatIfResult
from twinmatch.nodes.sample_messages import stamp_header
from twinmatch.signals import FloatArray, SignalError
from twinmatch_msgs import msg as messages
from twinmatch_msgs import srv as services

__all__ = ["SHOWN", "answer_message", "forecast_from", "forecast_message", "question_from", "shown_samples"]

SHOWN = (1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0, 180.0, 240.0, 300.0)
"""Times ahead at which a forecast is published, s: closely spaced where the forecast is sharp."""


def shown_samples(period: float, horizons: tuple[int, ...]) -> tuple[int, ...]:
    """Samples ahead at which a forecast is published, with a period in s: all horizons, some between."""
    longest = max(horizons)
    between = {round(seconds / period) for seconds in SHOWN}
    return tuple(sorted({*horizons, *(ahead for ahead in between if 1 <= ahead <= longest)}))


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

    def numbers(values: FloatArray) -> array[float]:
        return array("d", values[rows].tobytes())

    message = messages.Forecast(
        sample=forecast.sample,
        candidate=forecast.candidate,
        structure=forecast.structure,
        confidence=forecast.confidence,
        time=numbers(forecast.time),
        reference=numbers(forecast.reference),
        output=numbers(forecast.output.mean),
        output_low=numbers(forecast.output.low),
        output_high=numbers(forecast.output.high),
        input=numbers(forecast.input.mean),
        input_low=numbers(forecast.input.low),
        input_high=numbers(forecast.input.high),
        notes=list(forecast.notes),
    )
    stamp_header(message.header, stamp)
    return message


def forecast_from(message: messages.Forecast) -> Forecast:
    """A forecast from `Forecast`."""
    output, entry = (
        Band(*(np.array(getattr(message, f"{name}{edge}")) for edge in ("", "_low", "_high")))
        for name in ("output", "input")
    )
    return Forecast(
        sample=message.sample,
        candidate=message.candidate,
        structure=message.structure,
        confidence=message.confidence,
        time=np.array(message.time),
        reference=np.array(message.reference),
        output=output,
        input=entry,
        notes=tuple(message.notes),
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
    reached, held, largest = answer.reached, answer.settled, answer.largest
    return services.WhatIf.Response(
        success=True,
        forecast=forecast_message(answer.forecast, stamp),
        level=[answer.level],
        tolerance=[answer.tolerance],
        reach=_seconds(reached.expected),
        reach_earliest=_seconds(reached.earliest),
        reach_latest=_seconds(reached.latest),
        hold=_seconds(held.expected),
        hold_earliest=_seconds(held.earliest),
        hold_latest=_seconds(held.latest),
        largest_input=largest.expected,
        largest_input_time=largest.time,
        largest_input_least=largest.least,
        largest_input_most=largest.most,
    )


def _single(request: Any, name: str) -> float | None:
    values = getattr(request, name)
    if len(values) > 1:
        msg = f"what if: {name} has {len(values)} values; a twin runs one loop, so give one or none"
        raise SignalError(msg)
    return None if not values or math.isnan(values[0]) else float(values[0])


def _seconds(moment: float | None) -> float:
    return math.nan if moment is None else moment
