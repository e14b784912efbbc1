"""A verdict as one line, for a log that grows."""

from __future__ import annotations

from typing import TYPE_CHECKING

from twinmatch.discrimination import Verdict
from twinmatch.views.table import STYLES, row

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["print_header", "print_line"]

_WIDTHS = (7, 9, 12, 6, 6, 10, 10, 11, 6)
_NAMES = ("t / s", "level", "nominal", "order", "gain", "Σ ν-gap", "ν-gap now", "rms y / °C", "rms u")


def print_line(console: Console, verdict: Verdict, period: float = 1.0) -> None:
    """Print time, level, nominal and figures in columns, then the reason."""
    from rich.text import Text  # noqa: PLC0415 — replay starts without it

    cells = row(verdict, period)
    columns = "".join(cell.ljust(width) for cell, width in zip(cells, _WIDTHS, strict=False))
    console.print(Text(f"{columns} {cells[-1]}", style=STYLES[verdict.level]), soft_wrap=True)


def print_header(console: Console) -> None:
    """Print the names of the columns."""
    from rich.text import Text  # noqa: PLC0415

    columns = "".join(name.ljust(width) for name, width in zip(_NAMES, _WIDTHS, strict=True))
    console.print(Text(f"{columns} why", style="bold"), soft_wrap=True)
