"""The cells of a table in a text file: numbers, words for them, and numbers with their unit."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from twinmatch.sampling import written_numbers
from twinmatch.signals import FloatArray
from twinmatch.units import quantity_in

__all__ = ["WORDS", "Cells", "number"]

_WITHOUT_VALUE: Final = (
    "",
    "-",
    "--",
    "---",
    "----",
    "?",
    "nan",
    "-nan",
    "nan(ind)",
    "-nan(ind)",
    "1.#qnan",
    "-1.#ind",
    "1.#ind",
    "na",
    "n/a",
    "n.a.",
    "#n/a",
    "#nv",
    "#value!",
    "#div/0!",
    "#ref!",
    "#num!",
    "null",
    "none",
    "nil",
    "no data",
    "missing",
    "invalid",
    "unavailable",
    "unknown",
)
"""What loggers and spreadsheets write where there is no value, in small letters."""
WORDS: Final = {**written_numbers.WORDS, **dict.fromkeys(_WITHOUT_VALUE, math.nan)}
"""Words of cells, in small letters, and the numbers that they mean; nan: no value."""
_THOUSANDS: Final = re.compile(r"[-+]?\d{1,3}(,\d{3})+(\.\d*)?")
"""A number with commas between its thousands."""


def number(text: str, decimal: str = ".") -> float | None:
    """The number in a cell; nan without a value, None for other text."""
    plain = text.strip().lower()
    if plain in WORDS:
        return WORDS[plain]
    try:
        return float(plain.replace(",", ".") if decimal == "," else plain)
    except ValueError:
        return None


class Cells:
    """The cells of a table, taken in row by row, or many plain rows at once."""

    def __init__(
        self, width: int, separator: str, decimal: str, *, thousands: bool = False
    ) -> None:
        """Begin without rows; `thousands`: whether commas are known to separate thousands."""
        self.places = array("q")
        """The line of each row in the file."""
        self.texts: list[dict[int, str]] = [{} for _ in range(width)]
        """Of each column, the cells that are not numbers, by row."""
        self.units = [""] * width
        """Of each column, the unit behind its numbers; empty without one."""
        self._numbers = [array("d") for _ in range(width)]
        self._separator = separator
        self._decimal = decimal
        self._thousands = thousands
        self._empty = re.compile(
            rf"(^|{re.escape(separator)})(?={re.escape(separator)}|$)"
        )

    def take_rows(self, rows: Iterable[tuple[int, list[str]]]) -> None:
        """Take rows of any cells, each with its place."""
        for place, cells in rows:
            for column, text in enumerate(cells):
                try:
                    self._numbers[column].append(float(text))
                except ValueError:
                    self._numbers[column].append(self._value_of_text(column, text))
            self.places.append(place)

    def _value_of_text(self, column: int, text: str) -> float:
        """The number that a cell means; nan without one, and the cell is kept unless it is empty."""
        value = number(text, self._decimal)
        if value is None and self._thousands and _THOUSANDS.fullmatch(text.strip()):
            value = float(text.replace(",", ""))
        if value is not None:
            return value
        quantity = quantity_in(text)
        if quantity is not None and self.units[column] in ("", quantity.unit):
            self.units[column] = quantity.unit
            return quantity.number
        self.texts[column][len(self.places)] = text
        return math.nan

    def take_plain(self, lines: Sequence[tuple[int, str]]) -> bool:
        """Take lines if all their cells are numbers or empty; return whether they are. If not, take none.

        NumPy reads them: much faster than `take_rows`, and digits become the same numbers as in Python.
        """
        texts = [line for _, line in lines]
        if self._decimal == "," and self._separator != ",":
            texts = [text.replace(",", ".") for text in texts]
        values = self._loaded(texts)
        if values is None:
            values = self._loaded([self._empty.sub(r"\1nan", text) for text in texts])
        if values is None:
            return False
        if values.shape != (len(lines), len(self._numbers)):
            return False
        for column, numbers in zip(self._numbers, values.T, strict=True):
            column.frombytes(numbers.tobytes())
        self.places.extend(place for place, _ in lines)
        return True

    def _loaded(self, texts: list[str]) -> FloatArray | None:
        """The numbers of plain lines, shape (lines, columns); None if a cell is not a number."""
        try:
            return np.loadtxt(texts, delimiter=self._separator, comments=None, ndmin=2)
        except ValueError:
            return None

    def columns(self) -> list[FloatArray]:
        """The numbers of each column; nan without one."""
        return [np.frombuffer(column) for column in self._numbers]
