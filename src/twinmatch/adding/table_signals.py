"""The signals of a table, by their names in a map, as a first plant file takes them."""

from __future__ import annotations

import keyword
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics import Plant
from twinmatch.importing.mapped import (
    in_rows,
    notes_on_impossible,
    notes_on_times,
    require_columns,
    times_of,
    with_titles,
    without_impossible,
    without_marks,
    without_means_of,
)
from twinmatch.importing.resampling import (
    Kind,
    Resampled,
    complete_rows,
    repeated,
    resample,
    second_pace,
)
from twinmatch.importing.tables import Table, split_title
from twinmatch.sampling.sources import SignalMap, SignalSource
from twinmatch.sampling.turns import angle_words, counted_on, shown_turn
from twinmatch.sessions.files import RecordingError
from twinmatch.signals import FloatArray
from twinmatch.units import is_unit

__all__ = ["Signal", "TableSignals", "is_signal", "names_of"]

_MOST: Final = 1e100
"""Size from which squares of values are not numbers any longer."""
_ROLES: Final = ("output", "input", "reference")
"""Signals of a loop; in a map of several they have a number, as in `output.1`. What else has a name, but the time, is
a disturbance."""
_RENAMED: Final = {"output": "measured", "input": "drive"}
"""Names of these signals where the table calls them by the name of another one, as PID libraries do."""
_OFFSET_UNITS: Final = {
    "degc": "°C",
    "c": "°C",
    "°c": "°C",
    "celsius": "°C",
    "degf": "°F",
    "sec": "s",
}
_WORDS_OF_FILE: Final = frozenset(
    {
        *vars(Plant),
        *Plant.__annotations__,
        "gain",
        "lag",
        "rest",
        "inner",
        "seen",
        "sensor_lag",
        "acting",
        *(f"acting_{k}" for k in range(4)),
        "dead_time",
        "store",
        "store_lag",
        "store_share",
    }
) - {"output"}
"""Names that a plant file uses for something else."""


class Signal(NamedTuple):
    """A signal of the proposed plant."""

    name: str
    unit: str
    low: float
    high: float
    text: str = ""
    turn: float = 0.0
    """What it loses where it begins again, as an angle does; 0: it never does."""


def is_signal(name: str, role: str) -> bool:
    """Whether a name in a map is that of an output, an input or a reference, such as `input` or `input.2`."""
    return re.fullmatch(rf"{role}(\.\d+)?", name) is not None


def names_of(signal_map: SignalMap, role: str) -> list[str]:
    """The names in a map of all outputs, inputs or references."""
    return [name for name in signal_map.sources if is_signal(name, role)]


class TableSignals:
    """The signals of a table, in its rows and on one clock, and the names that they get in a plant file."""

    def __init__(
        self,
        table: Table,
        signal_map: SignalMap,
        needed: Sequence[str] = ("output", "input"),
        *,
        longest: float | None = None,
    ) -> None:
        """Read a table.

        Args:
            table: the table.
            signal_map: columns of time and signals.
            needed: signals that the map has to have.
            longest: longest step between rows that is interpolated, s; judged by the rows if not given.

        Raises:
            RecordingError: a column is missing, the rows cannot be resampled, or values are too large for squares.
        """
        require_columns(table, signal_map, needed)
        self._table = table
        self._map = signal_map
        self._sources = {
            name: with_titles(table, source)
            for name, source in signal_map.sources.items()
        }
        self._times = times_of(table, self._sources.get("time"), signal_map.period)
        self._names_in_file: list[str] = []
        self._turns = self._turns_by_signal()
        self.bridge = longest
        """Longest step between rows that is interpolated, s; None: the usual one."""
        self.resampled = self._on_one_clock()
        """All signals on one clock, from the rows that have all of them."""

    def _on_one_clock(self) -> Resampled:
        kinds = self._kinds()
        in_table = without_means_of(kinds, self._turns)
        table, times = in_rows(self._table, self._sources, in_table, self._times)
        signals = {name: self._values_in(table, name) for name in kinds}
        _require_usual_sizes(table, signals)
        columns = (times.seconds, *signals.values())
        rows = complete_rows(*columns)
        if rows.size < 2:
            raise RecordingError(
                f"{table.path}: fewer than two rows have a value of {', '.join(kinds)}"
            )
        rows = np.setdiff1d(rows, repeated(rows, *columns))
        if self.bridge is None:
            self.bridge = second_pace(times.seconds[rows])
        return resample(
            times.seconds[rows],
            {name: values[rows] for name, values in signals.items()},
            kinds,
            self._map.period,
            longest=self.bridge,
            gaps="split",
            place=str(table.path),
            row=lambda i: table.row_name(int(rows[i])),
        )

    def _kinds(self) -> dict[str, Kind]:
        """What each signal is between its rows; outputs come first, as what they lack is said of them."""
        names = sorted(
            (name for name in self._sources if name != "time"),
            key=lambda name: not is_signal(name, "output"),
        )
        kinds: dict[str, Kind] = dict.fromkeys(names, "reading")
        for name in names:
            if is_signal(name, "input"):
                kinds[name] = "held"
            elif is_signal(name, "reference"):
                kinds[name] = "set"
        return kinds

    @property
    def disturbances(self) -> list[str]:
        """The names in the map that belong to none of its loops."""
        of_loops = {name for role in _ROLES for name in names_of(self._map, role)}
        return [name for name in self._map.sources if name not in {"time", *of_loops}]

    @cached_property
    def longest_stretch(self) -> dict[str, FloatArray]:
        """The signals of the longest stretch without a gap: across a gap there are no rates."""
        longest = max(
            self.resampled.stretches, key=lambda stretch: stretch.stop - stretch.start
        )
        return {
            name: column[longest] for name, column in self.resampled.columns.items()
        }

    def values(self, signal: str) -> FloatArray:
        """The mean of the columns of a signal, in their unit, shape (N,) of all rows; nan where there is no
        reading."""
        return self._values_in(self._table, signal)

    def _values_in(self, table: Table, signal: str) -> FloatArray:
        readings = self._readings_in(table, signal)
        turn = self.turn(signal)
        return counted_on(readings, turn) if turn else readings

    def _readings_in(self, table: Table, signal: str) -> FloatArray:
        """The mean of the columns of a signal as they are: turns are not counted."""
        source = self._sources[signal]
        columns = [
            source.scale * without_marks(table.values(title)) + source.offset
            for title in source.places
        ]
        mean = np.asarray(np.mean(columns, axis=0), dtype=np.float64)
        return without_impossible(mean, self.unit(signal))

    def turn(self, signal: str) -> float:
        """What a signal loses where it begins again, by its map or as its column shows; 0: it never does."""
        return self._turns.get(signal, 0.0)

    def _turns_by_signal(self) -> dict[str, float]:
        """What each signal that begins again loses there. Set-points are not read for a first file."""
        turns = {}
        for signal, kind in self._kinds().items():
            source = self._sources[signal]
            if source.turn:
                turns[signal] = source.turn
            elif len(source.places) == 1 and kind == "reading":
                name = " ".join((signal, *source.places))
                readings = self._readings_in(self._table, signal)
                if turn := shown_turn(readings, self.unit(signal), name):
                    turns[signal] = turn
        return turns

    def unit(self, signal: str) -> str:
        """The unit of a signal by its map or its title; empty where neither has one."""
        source = self._sources[signal]
        unit = source.unit or self._table.unit(source.places[0])
        unit = _OFFSET_UNITS.get(unit.lower(), unit)
        return unit if is_unit(unit) else ""

    def name_in_file(self, signal: str) -> str:
        """A name after the signal's column, which no other signal gets."""
        title, _ = split_title(self._sources[signal].places[0])
        role = signal.partition(".")[0]
        if title.lower() in ("time", *_ROLES) and title.lower() != role:
            title = _RENAMED[role]
        says_something = re.search(r"[a-zA-Z]{2}|[a-zA-Z]_?\d", title)
        return self._unused(title if says_something else signal)

    def _unused(self, title: str) -> str:
        """A valid Python name that does not yet occur in the file."""
        # as Python reads names
        text = unicodedata.normalize("NFKC", split_title(title)[0].strip().lower())
        plain = "".join(c if f"_{c}".isidentifier() else " " for c in text)
        plain = re.sub(r"[\s_]+", "_", plain).strip("_") or "signal"
        plain = plain if plain.isidentifier() else f"n{plain}"
        taken = _WORDS_OF_FILE.union(self._names_in_file)
        while keyword.iskeyword(plain) or plain in taken:
            plain += "_"
        self._names_in_file.append(plain)
        return plain

    def disturbance_signals(self) -> dict[str, Signal]:
        """The disturbances of a plant by their names in the map, with the ranges that they had."""
        disturbances = {}
        for name in self.disturbances:
            values = self.resampled.columns[name]
            disturbances[name] = Signal(
                self._unused(name),
                self.unit(name),
                float(values.min()),
                float(values.max()),
            )
        return disturbances

    def sources_in_file(
        self, disturbances: Mapping[str, Signal]
    ) -> dict[str, SignalSource]:
        """The sources of the map with the names that disturbances have in the file."""
        sources = {}
        for name, source in self._map.sources.items():
            if name in disturbances:
                turned = replace(source, turn=self.turn(name))
                sources[disturbances[name].name] = turned
            elif is_signal(name, "output"):
                # the plant's file has it
                sources[name] = replace(source, turn=0.0)
            else:
                sources[name] = source
        return sources

    @property
    def notes(self) -> tuple[str, ...]:
        """How the table was read, in sentences for the user."""
        of_times = notes_on_times(self._table, self._sources.get("time"), self._times)
        return (
            *self._table.notes,
            *self._notes_on_readings(),
            *self._notes_on_turns(),
            *of_times,
        )

    def _notes_on_turns(self) -> list[str]:
        """A note on each signal that was seen to begin again."""
        notes = []
        for signal, turn in self._turns.items():
            if not self._sources[signal].turn:
                where = "Output" if is_signal(signal, "output") else "source in the map"
                notes.append(
                    f"{angle_words(signal, turn)}: turn={turn:.6g} is written into its "
                    f"{where}, and its turns are counted."
                )
        return notes

    def _notes_on_readings(self) -> list[str]:
        """Notes on columns with values below absolute zero."""
        notes: list[str] = []
        for signal, source in self._sources.items():
            if signal != "time":
                unit = self.unit(signal)
                for title in source.places:
                    values = without_marks(self._table.values(title))
                    scaled = source.scale * values + source.offset
                    notes += notes_on_impossible(
                        self._table, signal, values, without_impossible(scaled, unit)
                    )
        return notes


def _require_usual_sizes(table: Table, signals: Mapping[str, FloatArray]) -> None:
    """Refuse values too large for squares, in any row: limits are taken from all of them."""
    for name, values in signals.items():
        largest = np.abs(values[~np.isnan(values)]).max(initial=0.0)
        if not largest < _MOST:
            raise RecordingError(
                f"{table.path}: {name} reaches {largest:g}; correct its values"
            )
