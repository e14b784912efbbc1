"""Names of a plant's signals in maps and parameters, in tables, bags and beside a running rig alike."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain
from typing import NamedTuple, TypeVar

from twinmatch.description import Quantity
from twinmatch.dynamics import Plant
from twinmatch.plants.records import description_of
from twinmatch.sampling.channels import SamplingError
from twinmatch.sampling.sources import (
    INPUT,
    OUTPUT,
    REFERENCE,
    TIME,
    SignalSource,
)
from twinmatch.sessions.files import RecordingError

_Value = TypeVar("_Value")


class LoopNames(NamedTuple):
    """Names of a plant's signals in a map: `reference`, `output` and `input`, if there is one of each."""

    references: tuple[str, ...] = (REFERENCE,)
    outputs: tuple[str, ...] = (OUTPUT,)
    inputs: tuple[str, ...] = (INPUT,)

    @classmethod
    def of(cls, plant: type[Plant]) -> LoopNames:
        """Of several outputs or inputs, the names are those of the plant file; `y_reference` is the set-point
        of an output y."""
        outputs = tuple(plant.outputs)
        inputs = tuple(plant.drives)
        return cls(
            (REFERENCE,)
            if len(outputs) == 1
            else tuple(f"{y}_{REFERENCE}" for y in outputs),
            (OUTPUT,) if len(outputs) == 1 else outputs,
            (INPUT,) if len(inputs) == 1 else inputs,
        )


def signals_of(plant: type[Plant]) -> dict[str, Quantity]:
    """The signals of a plant: references, outputs, inputs and disturbances, in the order of its file."""
    is_ = description_of(plant)
    names = chain(*LoopNames.of(plant), plant.disturbances)
    return dict(
        zip(
            names,
            chain(is_.references, is_.outputs, is_.inputs, is_.disturbances),
            strict=True,
        )
    )


def turns_of(
    plant: type[Plant], sources: Mapping[str, SignalSource]
) -> dict[str, float]:
    """What each mapped signal loses where it begins again, in the plant's unit; only of those that do.

    The map says it, or the plant's file. A set-point is an angle if its output is one.

    Raises:
        SamplingError: such a signal is the mean of several places.
    """
    loop = LoopNames.of(plant)
    turns = {name: source.turn for name, source in sources.items() if source.turn}
    for name, output in zip(loop.outputs, plant.outputs.values(), strict=True):
        if name in sources and output.turn:
            turns.setdefault(name, output.turn)
    for name, output_name in zip(loop.references, loop.outputs, strict=False):
        turns.pop(name, None)
        if name in sources and output_name in turns:
            turns[name] = turns[output_name]
    for name, turn in turns.items():
        if not sources[name].formula and len(sources[name].separate) > 1:
            raise SamplingError(
                f"{name} begins again after {turn:.6g}, and is mapped to {sources[name].text}: the mean of "
                "359 and 1 would be 180; map one of them"
            )
    return turns


def accepted_names(plant: type[Plant]) -> dict[str, tuple[str, ...]]:
    """By signal, and for the time, the names by which a map may call it; its own first."""
    loop = LoopNames.of(plant)
    spellings = (
        ("setpoint", "set_point", "set-point")
        if loop.references == (REFERENCE,)
        else ()
    )
    references = _numbered(REFERENCE, loop.references)
    return {
        TIME: (TIME,),
        **_numbered(OUTPUT, loop.outputs, tuple(plant.outputs)),
        **_numbered(INPUT, loop.inputs, tuple(plant.drives)),
        **{signal: (*names, *spellings) for signal, names in references.items()},
        **{name: (name,) for name in plant.disturbances},
    }


def _numbered(
    kind: str, signals: tuple[str, ...], names: tuple[str, ...] = ()
) -> dict[str, tuple[str, ...]]:
    """Accepted names of each signal; where there are several, one is its number, such as output.2."""
    accepted = {}
    for k, (signal, name) in enumerate(zip(signals, names or signals, strict=True), 1):
        number = (f"{kind}.{k}",) if len(signals) > 1 else ()
        accepted[signal] = tuple(dict.fromkeys((signal, name, *number)))
    return accepted


def signal_called(plant: type[Plant]) -> dict[str, str]:
    """The signal that each accepted name means."""
    names = accepted_names(plant)
    meant = {name: signal for signal, accepted in names.items() for name in accepted}
    # also where a drive is called output
    return meant | {signal: signal for signal in names}


def by_signal(
    plant: type[Plant], named_entries: Mapping[str, _Value]
) -> dict[str, _Value]:
    """The entries of a map by signal, from entries by any accepted name.

    Raises:
        RecordingError: the plant has no signal of that name, or a signal is given twice.
    """
    meant = signal_called(plant)
    entries = dict[str, _Value]()
    names_used = dict[str, str]()
    for name, entry in named_entries.items():
        if name not in meant:
            raise RecordingError(
                f"--map: plant {plant.name} has no signal {name!r}; it has {_listed_signals(plant)}"
            )
        signal = meant[name]
        if signal in entries:
            raise RecordingError(
                f"--map: {names_used[signal]} and {name} are the same signal; give it once"
            )
        entries[signal] = entry
        names_used[signal] = name
    return entries


def _listed_signals(plant: type[Plant]) -> str:
    """The plant's signals, each with another name if it has one."""
    listed = []
    for signal, names in accepted_names(plant).items():
        has_another = len(names) > 1 and signal not in (TIME, REFERENCE)
        listed.append(f"{signal} ({names[1]})" if has_another else signal)
    return ", ".join(listed)
