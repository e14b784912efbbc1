"""Convert between a plant's description (names, units, ranges) and its message."""

from __future__ import annotations

from twinmatch.description import Description, Quantity
from twinmatch.signals import SignalError
from twinmatch_msgs import msg as messages

__all__ = ["description_from", "description_message"]


def description_message(description: Description, period: float) -> messages.PlantDescription:
    """A plant as `PlantDescription`; `period` (s) is the sampling period it is run with."""
    return messages.PlantDescription(
        plant=description.plant,
        title=description.title,
        structures=list(description.structures),
        period=period,
        reference=[_signal_message(description.reference)],
        output=[_signal_message(description.output)],
        input=[_signal_message(description.input)],
        disturbances=[_signal_message(signal) for signal in description.disturbances],
        states=[_signal_message(state) for state in description.states],
    )


def description_from(message: messages.PlantDescription) -> Description:
    """A plant from `PlantDescription`.

    Raises:
        SignalError: it does not have one reference, one output and one input.
    """
    loop = [message.reference, message.output, message.input]
    if any(len(signals) != 1 for signals in loop):
        counts = ", ".join(str(len(signals)) for signals in loop)
        msg = f"description of {message.plant}: has {counts} references, outputs and inputs; give one of each"
        raise SignalError(msg)
    return Description(
        plant=message.plant,
        title=message.title,
        reference=_signal_from(message.reference[0]),
        output=_signal_from(message.output[0]),
        input=_signal_from(message.input[0]),
        disturbances=tuple(_signal_from(signal) for signal in message.disturbances),
        states=tuple(_signal_from(state) for state in message.states),
        structures=tuple(message.structures),
    )


def _signal_message(quantity: Quantity) -> messages.Signal:
    return messages.Signal(
        name=quantity.name, text=quantity.text, unit=quantity.unit, low=quantity.low, high=quantity.high
    )


def _signal_from(message: messages.Signal) -> Quantity:
    return Quantity(message.name, message.text, message.unit, message.low, message.high)
