"""Columns of a table that its map computes: formulas, numbers of words, and marks that mean "no value".

They become columns of numbers, so that all that reads a table needs to know nothing of them.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Final

import numpy as np

from twinmatch.importing.cells import WORDS
from twinmatch.importing.mapped import times_of
from twinmatch.importing.tables import Table
from twinmatch.sampling.channels import UnreadableError
from twinmatch.sampling.formulas import formula_of
from twinmatch.sampling.sources import TIME, SignalMap, SignalSource
from twinmatch.sampling.written_numbers import WrittenNumber, written_number
from twinmatch.sessions.files import RecordingError
from twinmatch.signals import FloatArray

_GAPS: Final = ("", "unavailable", "unknown", "none", "null")
"""Texts that loggers write where there is no value."""


def with_derived(table: Table, signal_map: SignalMap) -> tuple[Table, SignalMap]:
    """A table with the columns that a map computes, and the map in which they are plain columns.

    Raises:
        RecordingError: a column is missing, or a text in it is not a number.
    """
    derived = table
    sources = dict(signal_map.sources)
    for signal, source in signal_map.sources.items():
        if source.formula:
            title = _title(source)
            columns = {**derived.columns, title: _computed(table, signal_map, source)}
            derived = replace(derived, columns=columns)
            sources[signal] = SignalSource(
                (title,),
                source.unit,
                source.scale,
                source.offset,
                interval=source.interval,
                turn=source.turn,
            )
        elif source.words or source.missing:
            _require_words(table, source)
            for place in source.separate:
                title = table.find(place)
                numbers = _numbers(table, title, source)
                derived = _with_numbers(derived, title, numbers)
        else:
            for title in _titles(table, source):
                derived, sources[signal] = _with_texts_read(
                    derived, title, sources[signal]
                )
    return derived, replace(signal_map, sources=sources)


def _require_words(table: Table, source: SignalSource) -> None:
    """Refuse words that no cell has: they are misspelt, or meant as settings.

    Raises:
        RecordingError: a word is in none of the source's columns.
    """
    cells: set[str] = set()
    for place in source.separate:
        cells.update(
            text.strip().lower()
            for text in table.texts.get(table.find(place), {}).values()
        )
    for word, meaning in source.words.items():
        if word in WORDS:
            _require_meaning(table, word, meaning)
        elif word not in cells:
            raise RecordingError(
                f"{table.path}: no cell of {', '.join(source.places)} is {word!r}; correct the word of its "
                "map, or write one of the settings unit, scale, offset, missing"
            )


def _require_meaning(table: Table, word: str, meaning: float) -> None:
    """Refuse another meaning of a word that every table's reader takes for a number.

    Raises:
        RecordingError: it has another one.
    """
    if not meaning == WORDS[word]:
        raise RecordingError(
            f"{table.path}: {word!r} is read as {WORDS[word]:g} in tables; leave it out of the map, and give "
            "the setting scale or offset instead"
        )


def _with_numbers(table: Table, title: str, numbers: FloatArray) -> Table:
    """The table with these numbers in a column, and no texts."""
    texts = {other: cells for other, cells in table.texts.items() if other != title}
    return replace(table, columns={**table.columns, title: numbers}, texts=texts)


def _titles(table: Table, source: SignalSource) -> list[str]:
    """The titles of a source's columns that have texts; those that are not there are reported later."""
    titles = []
    for place in source.separate:
        with suppress(RecordingError):
            title = table.find(place)
            if table.texts.get(title):
                titles.append(title)
    return titles


def _with_texts_read(
    table: Table, title: str, source: SignalSource
) -> tuple[Table, SignalSource]:
    """The table with texts such as `17.99 °C` or `heating` as numbers, and the source with their unit.

    Both are as before if a text is not a number, as the date and time of day.
    """
    numbers = np.array(table.columns[title], dtype=float)
    units = set()
    for row, text in table.texts[title].items():
        try:
            written = written_number(text)
        except UnreadableError:
            return table, source
        numbers[row] = written.value
        units.add(written.unit)
    if len(units) > 1 or (units != {""} and np.isfinite(table.columns[title]).any()):
        return table, source
    return _with_numbers(table, title, numbers), replace(
        source, unit=source.unit or units.pop()
    )


def _title(source: SignalSource) -> str:
    """The formula and what it computes with, as a map has it.

    The semicolon at the end keeps a unit in the last column's title from being that of the result.
    """
    return f"{replace(source, unit='', scale=1.0, offset=0.0, turn=0.0).text};"


def _computed(table: Table, signal_map: SignalMap, source: SignalSource) -> FloatArray:
    """What a formula gives in each row, shape (N,)."""
    numbers = [_numbers(table, table.find(place), source) for place in source.places]
    seconds = np.arange(len(table.lines), dtype=float)
    if formula_of(source.formula).has_rate:
        time = signal_map.sources.get(TIME)
        if time is not None:
            time = replace(time, places=tuple(map(table.find, time.places)))
        seconds = times_of(table, time, signal_map.period).seconds
    return source.computed(numbers, seconds)


def _numbers(table: Table, title: str, source: SignalSource) -> FloatArray:
    """The numbers of a column, shape (N,), nan where it has none or a mark that means none."""
    numbers = np.array(table.columns[title], dtype=float)
    for row, text in table.texts.get(title, {}).items():
        if text.strip().lower() not in _GAPS or text.strip().lower() in source.words:
            numbers[row] = _written(table, row, text, source).value
    return source.without_missing(numbers)


def _written(table: Table, row: int, text: str, source: SignalSource) -> WrittenNumber:
    """The number that a cell's text is.

    Raises:
        RecordingError: it is not one.
    """
    try:
        return written_number(text, source.words)
    except UnreadableError as error:
        raise RecordingError(f"{table.place(row)}: {error}") from None
