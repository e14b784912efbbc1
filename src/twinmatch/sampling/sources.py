"""The map from columns of a table, or numbers in messages, to the signals of a plant.

On a command line, signal by signal:

    time=elapsed   output="t2, t3"   input="Heater 1 (%)"   "room=t_room; unit=K"   "input=duty; scale=100"

or as YAML, which may also give the plant and the sampling period:

    plant: incubator
    period: 3.0                # s; that of the rows if not given
    columns:
      time: {column: time, unit: ns}
      output: [t2, t3]         # the mean of both
      input: heater_on
      room: {column: t1, scale: 0.1, offset: -40}

A signal is scale · number + offset, converted from the given unit (by default the one in the column's title,
or that of the message type) to the plant's. Several places give their mean. For topics, a place is
TOPIC:FIELD, such as /joint_states:position[elbow]. The signals of a plant with several outputs or inputs have
the names in its file, and the set-point of an output `y` is `y_reference`; in the order of the file they are
also output.1, output.2, …, input.1, … and reference.1, ….
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, TypeVar

import msgspec

from twinmatch.decoding import FiniteNumber, decoded
from twinmatch.errors import TwinmatchError
from twinmatch.sampling.channels import Channel, SamplingError, parse_channel, usual_unit
from twinmatch.sessions.files import RecordingError
from twinmatch.signals import FloatArray
from twinmatch.units import Conversion, conversion, measure

OUTPUT: Final = "output"
INPUT: Final = "input"
REFERENCE: Final = "reference"
TIME: Final = "time"

_FORM: Final = "write SIGNAL=COLUMN, such as output=T or 'output=T; unit=K; scale=0.1; offset=-40'"
Number = TypeVar("Number", float, FloatArray)


@dataclass(frozen=True)
class SignalSource:
    """Where a signal of the plant comes from: the mean of some places, in the plant's unit."""

    places: tuple[str, ...]
    """Titles of columns, or channels as TOPIC:FIELD. A single text with commas may name several."""
    unit: str = ""
    """Unit of scale·number + offset; empty: what the column's title or the message type states, or the
    plant's."""
    scale: float = 1.0
    offset: float = 0.0

    @property
    def text(self) -> str:
        """The source as written on a command line."""
        parts = [", ".join(self.places)]
        if self.unit:
            parts.append(f"unit={self.unit}")
        if self.scale != 1:
            parts.append(f"scale={self.scale:g}")
        if self.offset != 0:
            parts.append(f"offset={self.offset:g}")
        return "; ".join(parts)

    @property
    def separate(self) -> tuple[str, ...]:
        """The places, where commas separate them."""
        return tuple(part for place in self.places for part in place.split(",") if part.strip())

    def channels(self, signal: str, parse: Callable[[str], Channel] = parse_channel) -> tuple[Channel, ...]:
        """The places as channels; `parse` reads one, by default of a topic of ROS.

        Raises:
            SamplingError: one names no topic.
        """
        try:
            return tuple(map(parse, self.separate))
        except SamplingError as error:
            raise SamplingError(f"{signal}: {error}") from None

    def change(self, signal: str, place: str, wanted: str, stated: str = "", why: str = "") -> Conversion:
        """Conversion of scale·number + offset to the unit that the plant's signal has.

        Args:
            signal: its name.
            place: the column or channel, for the message.
            wanted: unit of the plant's signal.
            stated: unit according to the title or the message type; empty without one.
            why: where `stated` is from, for the message.

        Raises:
            SamplingError: the units measure different things.
        """
        unit = self.unit or stated
        if not unit:
            return Conversion()
        try:
            return conversion(unit, wanted)
        except TwinmatchError:
            strange = "" if measure(unit).known else f" {unit!r} is not a known unit;"
            raise SamplingError(
                f"{place!r} is in {unit}{'' if self.unit else why}, but the plant's {signal} in "
                f"{wanted or 'plain numbers'};{strange} map another, or give its conversion: "
                f"'{signal}={place}; unit={wanted or 1}; scale=…'"
            ) from None

    def value(self, numbers: Sequence[Number], changes: Sequence[Conversion]) -> Number:
        """The signal in the plant's unit, from the number and the conversion of each place."""
        parts = [
            (self.scale * number + self.offset) * change.scale + change.offset
            for number, change in zip(numbers, changes, strict=True)
        ]
        return sum(parts[1:], parts[0]) / len(parts)

    def follow(
        self, signal: str, wanted: str, channels: Sequence[Channel], kinds: Sequence[str]
    ) -> FollowedSignal:
        """The signal from messages of topics.

        Args:
            signal: its name.
            wanted: unit of the plant's signal.
            channels: its channels, with full paths.
            kinds: message type of each.

        Raises:
            SamplingError: the units measure different things.
        """
        changes = []
        for channel, kind in zip(channels, kinds, strict=True):
            # A number that the map scales is not in the unit of its message type.
            scaled = (self.scale, self.offset) != (1.0, 0.0)
            stated = "" if scaled else usual_unit(kind, channel.path, wanted)
            changes.append(self.change(signal, channel.text, wanted, stated, f" (according to {kind})"))
        return FollowedSignal(self, tuple(channels), tuple(changes))


class FollowedSignal(NamedTuple):
    """A signal of which topics and units are known."""

    source: SignalSource
    channels: tuple[Channel, ...]
    """With full paths."""
    changes: tuple[Conversion, ...]
    """To the plant's unit, by channel."""

    def value(self, numbers: Sequence[Number]) -> Number:
        """The signal in the plant's unit, from one number for each channel."""
        return self.source.value(numbers, self.changes)


@dataclass(frozen=True)
class SignalMap:
    """Sources by signal: time, output, input, reference, and the plant's own names."""

    sources: Mapping[str, SignalSource] = field(default_factory=dict)
    plant: str = ""
    """Name or file; empty: not given."""
    period: float | None = None
    """Sampling period, s."""

    def joined(self, newer: SignalMap) -> SignalMap:
        """This map, updated with the entries of another."""
        return SignalMap(
            {**self.sources, **newer.sources},
            newer.plant or self.plant,
            self.period if newer.period is None else newer.period,
        )


def parse_map(entries: Sequence[str]) -> SignalMap:
    """Parse a map from a command line.

    Raises:
        RecordingError: an entry is not SIGNAL=COLUMN, or a signal is given twice.
    """
    sources: dict[str, SignalSource] = {}
    for entry in entries:
        signal, equals, text = entry.partition("=")
        signal = signal.strip()
        if not (equals and signal):
            raise RecordingError(f"--map {entry!r}: {_FORM}")
        if signal in sources:
            raise RecordingError(f"--map {entry!r}: {signal} is given twice; name each signal once")
        sources[signal] = parse_source(f"--map {entry!r}", text)
    return SignalMap(sources)


def parse_source(place: str, text: str) -> SignalSource:
    """Parse what follows the `=` of an entry, such as `T; unit=K`; error messages start with `place`.

    Raises:
        RecordingError: the column is missing, or a setting is unknown.
    """
    column, *settings = (part.strip() for part in text.split(";"))
    if not column:
        raise RecordingError(f"{place}: {_FORM}")
    entry: dict[str, Any] = {"column": column}
    for setting in settings:
        name, _, value = (part.strip() for part in setting.partition("="))
        entry[name] = value if name == "unit" else _plain_number(value)
    return source_of(place, entry)


class _Source(msgspec.Struct, forbid_unknown_fields=True):
    column: str | list[str] = ""
    columns: str | list[str] = ""
    unit: str = ""
    scale: FiniteNumber = 1.0
    offset: FiniteNumber = 0.0


def source_of(place: str, entry: Any) -> SignalSource:
    """The source in an entry of a map, as YAML and JSON have it; error messages start with `place`.

    Raises:
        RecordingError: the column is missing, or a setting is unknown.
    """
    if isinstance(entry, str) and ";" in entry:
        return parse_source(place, entry)
    if isinstance(entry, str | list):
        entry = {"column": entry}
    source = decoded(entry, _Source, place, RecordingError)
    columns = source.column or source.columns
    columns = [columns] if isinstance(columns, str) else columns
    if not columns or not all(columns):
        raise RecordingError(f"{place}: the column is missing; give one, or a list to average")
    if source.scale == 0:
        raise RecordingError(f"{place}: scale is 0, which makes the whole column 0; give another")
    return SignalSource(tuple(columns), source.unit, source.scale, source.offset)


def _plain_number(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text
