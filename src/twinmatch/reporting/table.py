"""A table as cells of text that a template only has to lay out."""

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
    """Names its row."""
    number: bool = True
    """Set flush right."""
    rows: int = 1
    """How many rows it spans."""
    mark: str = ""
    """A word for the style sheet."""


@dataclass(frozen=True)
class Table:
    """One table; what it means stands beside it in the template."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    marked: frozenset[int] = frozenset()
    """Rows that are set off."""

    @property
    def right(self) -> tuple[bool, ...]:
        """Whether the names of the columns are set flush right, as the figures below them are."""
        first = self.rows[0] if self.rows else ()
        return tuple(cell.number for cell in first) or (False,) * len(self.columns)


def words(text: str, *, mark: str = "") -> Cell:
    """A cell of words."""
    return Cell(text, number=False, mark=mark)


def head(text: str, rows: int = 1) -> Cell:
    """A cell that names its row, or several."""
    return Cell(text, head=True, number=False, rows=rows)
