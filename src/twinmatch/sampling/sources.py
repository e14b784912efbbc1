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
TOPIC:FIELD, such as /joint_states:position[elbow]. Readings that begin again, as those of a compass after 360°,
have a `turn`, in the plant's unit (`twinmatch.sampling.turns`).

The signals of a plant with several outputs or inputs have the names in its file, and the set-point of an output
`y` is `y_reference`; in the order of the file they are also output.1, output.2, …, input.1, … and
reference.1, ….
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from typing import Any, Final, Literal, NamedTuple, TypeAlias, TypeVar

import msgspec
import numpy as np

from twinmatch.decoding import FiniteNumber, decoded
from twinmatch.errors import TwinmatchError
from twinmatch.sampling.channels import (
    Channel,
    SamplingError,
    UnreadableError,
    parse_channel,
    usual_unit,
)
from twinmatch.sampling.formulas import Computing, formula_of
from twinmatch.sampling.quoted import split_unquoted
from twinmatch.sampling.written_numbers import WrittenNumber, written_number
from twinmatch.sessions.files import RecordingError
from twinmatch.signals import FloatArray
from twinmatch.units import Conversion, conversion, measure

OUTPUT: Final = "output"
INPUT: Final = "input"
REFERENCE: Final = "reference"
TIME: Final = "time"

_FORM: Final = (
    "write SIGNAL=COLUMN, such as output=T or 'output=T; unit=K; scale=0.1; offset=-40'"
)
Interval: TypeAlias = Literal["after", "before"]
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
    missing: tuple[float, ...] = ()
    """Numbers that mean "no value", before scale and offset."""
    words: Mapping[str, float] = field(default_factory=dict)
    """Numbers of words, in small letters."""
    formula: str = ""
    """Arithmetic over `names`; empty: the mean of the places."""
    names: tuple[str, ...] = ()
    """What the formula calls each of the places; empty without a formula."""
    interval: Interval = "after"
    """Whether the number in a row of a table applies until the next row, or applied since the one before."""
    turn: float = 0.0
    """What the signal loses where it begins again, in the plant's unit; 0: as the plant file says."""

    @property
    def text(self) -> str:
        """The source as written on a command line."""
        parts = [self.formula or ", ".join(self.places)]
        if self.formula:
            parts += [
                f"{name}={place}"
                for name, place in zip(self.names, self.places, strict=True)
            ]
        if self.unit:
            parts.append(f"unit={self.unit}")
        if self.scale != 1:
            parts.append(f"scale={self.scale:g}")
        if self.offset != 0:
            parts.append(f"offset={self.offset:g}")
        if self.missing:
            parts.append(
                f"missing={' '.join(f'{number:g}' for number in self.missing)}"
            )
        if self.interval != "after":
            parts.append(f"interval={self.interval}")
        if self.turn != 0:
            parts.append(f"turn={self.turn:.12g}")
        parts += [f"{word}={number:g}" for word, number in self.words.items()]
        return "; ".join(parts)

    @property
    def separate(self) -> tuple[str, ...]:
        """The places, where commas separate them."""
        if self.formula:
            return self.places
        return tuple(
            part
            for place in self.places
            for part in split_unquoted(place, ",")
            if part.strip()
        )

    @property
    def is_plain(self) -> bool:
        """Whether the signal is the number as it is, so that the unit of a place is that of the signal."""
        return not self.formula and (self.scale, self.offset) == (1.0, 0.0)

    def number(self, value: float | str, wanted: str) -> float:
        """The number that a device's value means, in the unit that the map gives to the place.

        Args:
            value: a number, or a text such as `heating` or `20.6 °C`.
            wanted: unit of the plant's signal, into which a unit in the text is converted.

        Raises:
            UnreadableError: it is not a number, or one that means "no value".
        """
        if isinstance(value, str):
            written = written_number(value, self.words)
            number = written.value
            if written.unit and self.is_plain:
                number = _in_unit(value, written, self.unit or wanted)
        else:
            number = value
        if number in self.missing:
            raise UnreadableError(f"{number:g} means that there is no value")
        return number

    def channels(
        self, signal: str, parse: Callable[[str], Channel] = parse_channel
    ) -> tuple[Channel, ...]:
        """The places as channels; `parse` reads one, by default of a topic of ROS.

        Raises:
            SamplingError: one names no topic, or its numbers are said to apply before they come.
        """
        if self.interval != "after":
            raise SamplingError(
                f"{signal}: interval={self.interval} is for the rows of a table; leave it out"
            )
        try:
            return tuple(map(parse, self.separate))
        except SamplingError as error:
            raise SamplingError(f"{signal}: {error}") from None

    def without_missing(self, numbers: FloatArray) -> FloatArray:
        """Numbers with nan for those that mean "no value", shape (N,)."""
        return (
            np.where(np.isin(numbers, self.missing), np.nan, numbers)
            if self.missing
            else numbers
        )

    def change(
        self, signal: str, place: str, wanted: str, stated: str = "", why: str = ""
    ) -> Conversion:
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
        """The signal in the plant's unit, from the number and the conversion of each place.

        With a formula there is one number, its result.
        """
        parts = [
            (self.scale * number + self.offset) * change.scale + change.offset
            for number, change in zip(numbers, changes, strict=not self.formula)
        ]
        return sum(parts[1:], parts[0]) / len(parts)

    def computed(
        self, numbers: Sequence[FloatArray], seconds: FloatArray
    ) -> FloatArray:
        """The results of the formula, shape (N,), from the numbers of each place and their times (s)."""
        arguments = dict(zip(self.names, numbers, strict=True))
        return formula_of(self.formula).values(arguments, seconds)

    def follow(
        self,
        signal: str,
        wanted: str,
        channels: Sequence[Channel],
        kinds: Sequence[str],
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
            stated = usual_unit(kind, channel.path, wanted) if self.is_plain else ""
            changes.append(
                self.change(
                    signal, channel.text, wanted, stated, f" (according to {kind})"
                )
            )
        computing = Computing(formula_of(self.formula)) if self.formula else None
        return FollowedSignal(self, tuple(channels), tuple(changes), wanted, computing)


class FollowedSignal(NamedTuple):
    """A signal of which topics and units are known."""

    source: SignalSource
    channels: tuple[Channel, ...]
    """With full paths."""
    changes: tuple[Conversion, ...]
    """To the plant's unit, by channel."""
    unit: str
    """Unit of the plant's signal."""
    computing: Computing | None = None
    """Of a formula; it remembers the message before."""

    def number(self, value: float | str) -> float:
        """The number that a message's value means.

        Raises:
            UnreadableError: it is not a number, or one that means "no value".
        """
        return self.source.number(value, self.unit)

    def value(self, numbers: Sequence[float], seconds: float) -> float:
        """The signal in the plant's unit, from one number for each channel, at a time (s).

        It is nan if a formula has no result.
        """
        if self.computing is None:
            return self.source.value(numbers, self.changes)
        arguments = dict(zip(self.source.names, numbers, strict=True))
        return self.source.value(
            [self.computing.value(arguments, seconds)], self.changes
        )

    def values(self, numbers: Sequence[FloatArray], seconds: FloatArray) -> FloatArray:
        """The same for many times, shapes (N,)."""
        if self.computing is None:
            return self.source.value(numbers, self.changes)
        return self.source.value([self.source.computed(numbers, seconds)], self.changes)


def _in_unit(text: str, written: WrittenNumber, unit: str) -> float:
    """A number with a unit of its own, in another unit.

    Raises:
        UnreadableError: the units measure different things, or one is not known.
    """
    try:
        change = conversion(written.unit, unit)
    except TwinmatchError:
        change = None
    if change is None or not measure(written.unit).known:
        where = unit or "plain numbers"
        raise UnreadableError(
            f"{text[:40]!r} is not in {where}; if its number is, write '; scale=…' or unit="
        )
    return written.value * change.scale + change.offset


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
            raise RecordingError(
                f"--map {entry!r}: {signal} is given twice; name each signal once"
            )
        sources[signal] = parse_source(f"--map {entry!r}", text)
    return SignalMap(sources)


def parse_source(place: str, text: str) -> SignalSource:
    """Parse what follows the `=` of an entry, such as `T; unit=K`; error messages start with `place`.

    Raises:
        RecordingError: the column is missing, or a setting is unknown.
    """
    column, *settings = (part.strip() for part in split_unquoted(text, ";"))
    if not column:
        raise RecordingError(f"{place}: {_FORM}")
    entry: dict[str, Any] = {"column": column}
    for setting in filter(None, settings):
        name, _, value = (part.strip() for part in setting.partition("="))
        _add_setting(entry, name, value)
    return source_of(place, entry)


def _add_setting(entry: dict[str, Any], name: str, value: str) -> None:
    """Add what stands behind a semicolon to an entry: a setting, a word's number, or a name of a formula.

    What looks like a misspelt setting stays one, and is refused later.
    """
    number = _plain_number(value)
    if name in ("unit", "interval"):
        entry[name] = value
    elif name == "missing":
        entry[name] = [_plain_number(part) for part in value.replace(",", " ").split()]
    elif (
        name in _Source.__struct_fields__ or not name or not value or _is_misspelt(name)
    ):
        entry[name] = number
    elif isinstance(number, float):
        entry.setdefault("words", {})[name] = number
    else:
        entry.setdefault("names", {})[name] = value


def _is_misspelt(name: str) -> bool:
    """Whether a name is near that of a setting, or another word for one."""
    return name.lower() in _OTHER_WORDS or bool(
        get_close_matches(name.lower(), _SETTINGS, cutoff=0.7)
    )


_SETTINGS: Final = (
    "unit",
    "scale",
    "offset",
    "missing",
    "interval",
    "turn",
    "column",
)
_OTHER_WORDS: Final = (
    "factor",
    "gain",
    "multiplier",
    "mult",
    "bias",
    "shift",
    "add",
    "type",
    "period",
)


class _Source(msgspec.Struct, forbid_unknown_fields=True):
    column: str | list[str] = ""
    columns: str | list[str] = ""
    unit: str = ""
    scale: FiniteNumber = 1.0
    offset: FiniteNumber = 0.0
    missing: FiniteNumber | list[FiniteNumber] = []
    interval: Interval = "after"
    turn: FiniteNumber = 0.0
    words: dict[str, FiniteNumber] = {}
    names: dict[str, str] = {}


def source_of(place: str, entry: Any) -> SignalSource:
    """The source in an entry of a map, as YAML and JSON have it; error messages start with `place`.

    Raises:
        RecordingError: the column is missing, or a setting is unknown.
    """
    if isinstance(entry, str) and ";" in entry:
        return parse_source(place, entry)
    if isinstance(entry, str | list):
        entry = {"column": entry}
    if (
        isinstance(entry, dict)
        and isinstance(column := entry.get("column"), str)
        and _has_settings(column)
    ):
        settings = {name: value for name, value in entry.items() if name != "column"}
        return replace(parse_source(place, column), **settings)
    source = decoded(entry, _Source, place, RecordingError)
    columns = source.column or source.columns
    columns = [columns] if isinstance(columns, str) else columns
    if not columns or not all(columns):
        raise RecordingError(
            f"{place}: the column is missing; give one, or a list to average"
        )
    if source.scale == 0:
        raise RecordingError(
            f"{place}: scale is 0, which makes the whole column 0; give another"
        )
    if source.turn < 0:
        raise RecordingError(
            f"{place}: turn is {source.turn:g}; give what the signal loses where it begins again, such as 360"
        )
    missing = source.missing if isinstance(source.missing, list) else [source.missing]
    words = {word.lower(): number for word, number in source.words.items()}
    made = SignalSource(
        tuple(columns),
        source.unit,
        source.scale,
        source.offset,
        tuple(missing),
        words,
        interval=source.interval,
        turn=source.turn,
    )
    return _with_formula(place, made, source.names) if source.names else made


def _has_settings(column: str) -> bool:
    """Whether settings, words or names follow a column, as where a map was written to a file."""
    _, *settings = split_unquoted(column, ";")
    return any("=" in setting for setting in settings)


def _with_formula(
    place: str, source: SignalSource, names: Mapping[str, str]
) -> SignalSource:
    """The source with its text as a formula over these names.

    Raises:
        RecordingError: it is not a formula, or has other names.
    """
    try:
        formula = formula_of(source.places[0])
    except SamplingError as error:
        first = next(iter(names))
        raise RecordingError(
            f"{place}: {first}: is not a known key; there are {', '.join(_SETTINGS)}; if it is a name in a "
            f"formula: {error}"
        ) from None
    missing = [name for name in formula.names if name not in names]
    unused = [name for name in names if name not in formula.names]
    if unused:
        raise RecordingError(
            f"{place}: {unused[0]}: is not a known key; there are {', '.join(_SETTINGS)}, words with their "
            f"numbers, and the names of a formula, but {formula.text!r} has no {unused[0]}"
        )
    if missing:
        raise RecordingError(
            f"{place}: {missing[0]} in {formula.text!r} is not named; write '; {missing[0]}=PLACE' behind it"
        )
    return replace(
        source, places=tuple(names.values()), formula=formula.text, names=tuple(names)
    )


def _plain_number(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text
