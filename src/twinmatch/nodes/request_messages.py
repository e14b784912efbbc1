"""Convert between match requests and their messages."""

from __future__ import annotations

import numpy as np

from twinmatch.nodes.conversions import parameters_from, parameters_if_any, parameters_message
from twinmatch.nodes.sample_messages import stamp_header
from twinmatch.signals import SignalError, Window
from twinmatch.twin import MatchRequest
from twinmatch_msgs import msg as messages

__all__ = ["request_from", "request_message"]


def request_message(request: MatchRequest, stamp: int) -> messages.MatchRequest:
    """A request as `MatchRequest`; `stamp` (ns) is that of the sample that triggered it."""
    window = request.window
    message = messages.MatchRequest(
        sample=request.sample,
        operating_point=request.operating_point,
        first=window.first,
        period=window.period,
        reference=window.reference.tolist(),
        output=window.output.tolist(),
        input=window.input.tolist(),
        disturbances=window.disturbances.ravel().tolist(),
        start=parameters_message(request.start),
        incumbent=parameters_message(request.incumbent),
    )
    stamp_header(message.header, stamp)
    return message


def request_from(message: messages.MatchRequest) -> MatchRequest:
    """A request from `MatchRequest`.

    Raises:
        TwinmatchError: its window or its parameters cannot be used.
    """
    samples, disturbances = len(message.reference), len(message.disturbances)
    if not samples or disturbances % samples:
        msg = f"match request: {disturbances} disturbance values do not divide evenly among {samples} samples"
        raise SignalError(msg)
    window = Window(
        reference=np.array(message.reference),
        output=np.array(message.output),
        input=np.array(message.input),
        first=message.first,
        period=message.period,
        disturbances=np.array(message.disturbances).reshape(samples, -1),
    )
    start, incumbent = parameters_from(message.start), parameters_if_any(message.incumbent)
    return MatchRequest(message.sample, message.operating_point, window, start, incumbent)
