"""A table as cells of text, ready for layout."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

__all__ = ["Cell", "Table", "head", "words"]


class Cell(NamedTuple):
    """One cell."""

    text: str
    best: bool = False
    """Set in bold."""
    head: bool = False
    """Heads its row."""
    number: bool = True
    """Aligned right."""
    rows: int = 1
    """Number of rows it spans."""
    mark: str = ""
    """CSS class."""


@dataclass(frozen=True)
class Table:
    """One table; the template explains it."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    marked: frozenset[int] = frozenset()
    """Highlighted rows."""

    @property
    def right(self) -> tuple[bool, ...]:
        """Whether each column name is aligned right, like the numbers below it."""
        first = self.rows[0] if self.rows else ()
        return tuple(cell.number for cell in first) or (False,) * len(self.columns)


def words(text: str, *, mark: str = "") -> Cell:
    """A cell of text."""
    return Cell(text, number=False, mark=mark)


def head(text: str, rows: int = 1) -> Cell:
    """A cell that heads its row, or several rows."""
    return Cell(text, head=True, number=False, rows=rows)
