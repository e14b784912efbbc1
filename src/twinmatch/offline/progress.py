"""Progress of a long command, on standard error."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich import progress

__all__ = ["Progress"]


class Progress:
    """A context manager with a progress bar on standard error, shown from the first call of `advance`.

    Without a terminal, or on a dumb one, nothing is shown.
    """

    def __init__(self, doing: str = "judging") -> None:
        """Set the label of the bar."""
        self._doing = doing
        self._bar: progress.Progress | None = None
        self._shown = False

    def __enter__(self) -> Progress:
        self._shown = sys.stderr.isatty() and os.environ.get("TERM", "").lower() not in {"dumb", "unknown"}
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def advance(self, done: int, total: int) -> None:
        """Show that `done` of `total` are done."""
        self._show(self._doing, done, total)

    def reading(self, done: int, total: int) -> None:
        """Show that `done` of `total` bytes of the file are read, before the work itself."""
        self._show("reading", done, total)

    def _show(self, doing: str, done: int, total: int) -> None:
        if self._bar is None and self._shown:
            self._begin()
        if self._bar is not None:
            self._bar.update(self._task, description=doing, completed=done, total=total)

    def _begin(self) -> None:
        from rich.console import Console  # noqa: PLC0415 — needed only for the bar
        from rich.progress import Progress as Bar  # noqa: PLC0415

        self._bar = Bar(console=Console(stderr=True), transient=True, redirect_stdout=False)
        self._task = self._bar.add_task(self._doing, total=None)
        self._bar.start()
