"""The console on which tables and views are drawn; it makes the texts in them printable."""

from __future__ import annotations

from collections.abc import Iterable
from typing import IO, Any

import rich.console
from rich.console import ConsoleOptions, RenderableType
from rich.segment import Segment

from twinmatch.printing import original, printable


class Console(rich.console.Console):
    """A console of rich whose only control sequences are rich's own; `[words]` and `:words:` are texts."""

    def __init__(self, **settings: Any) -> None:
        """Take rich's settings."""
        super().__init__(
            **{"highlight": False, "markup": False, "emoji": False, **settings}
        )

    @property
    def file(self) -> IO[str]:
        """The stream that is written to."""
        stream: IO[str] = original(rich.console.Console.file.fget(self))  # type: ignore[attr-defined]
        return stream

    @file.setter
    def file(self, stream: IO[str]) -> None:
        self._file = stream

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """The segments of what is printed."""
        for segment in super().render(renderable, options):
            yield (
                segment
                if segment.control
                else segment._replace(text=printable(segment.text))
            )
