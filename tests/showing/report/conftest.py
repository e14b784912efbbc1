"""Reports that several tests read; each session is judged once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from html.parser import HTMLParser

import pytest

from tests.support.places import SHIPPED
from twinmatch.showing.report.report import SessionReport, make_report

_VOID = {"meta", "img", "br", "link", "hr", "input", "base", "source"}


@dataclass
class Element:
    """One element of a parsed document."""

    tag: str
    attributes: dict[str, str]
    children: list[Element | str] = field(default_factory=list)

    def all(self, tag: str) -> Iterator[Element]:
        """Every element of this name, in the order of the document."""
        for child in self.children:
            if isinstance(child, Element):
                if child.tag == tag:
                    yield child
                yield from child.all(tag)

    @property
    def text(self) -> str:
        """All its text, spaces and line ends as one space."""
        parts = [c if isinstance(c, str) else c.text for c in self.children]
        return " ".join(" ".join(parts).split())

    @property
    def classes(self) -> set[str]:
        return set(self.attributes.get("class", "").split())


class Tree(HTMLParser):
    """Parses strictly: every element that was opened has to be closed, in order."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.root = Element("", {})
        self._open = [self.root]
        self.feed(text)
        self.close()
        assert len(self._open) == 1, f"never closed: {[e.tag for e in self._open[1:]]}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        element = Element(tag, {name: value or "" for name, value in attrs})
        self._open[-1].children.append(element)
        if tag not in _VOID:
            self._open.append(element)

    def handle_endtag(self, tag: str) -> None:
        assert self._open[-1].tag == tag, f"</{tag}> closes <{self._open[-1].tag}>"
        self._open.pop()

    def handle_data(self, data: str) -> None:
        self._open[-1].children.append(data)


def parse(text: str) -> Element:
    return Tree(text).root


def tables_of(document: Element) -> dict[str, Element]:
    """The tables by their captions."""
    return {next(t.all("caption")).text: t for t in document.all("table")}


def grid(table: Element) -> list[list[Element]]:
    """The body of a table with cells that span rows repeated in each of them."""
    rows: list[list[Element]] = []
    spans: dict[int, tuple[Element, int]] = {}
    for row in next(table.all("tbody")).all("tr"):
        cells: list[Element] = []
        row_cells = [c for c in row.children if isinstance(c, Element)]
        while row_cells or len(cells) in spans:
            place = len(cells)
            if place in spans and spans[place][1]:
                cell, rows_left = spans[place]
                spans[place] = (cell, rows_left - 1)
            elif row_cells:
                cell = row_cells.pop(0)
                spans[place] = (cell, int(cell.attributes.get("rowspan", "1")) - 1)
            else:
                break
            cells.append(cell)
        rows.append(cells)
    return rows


@pytest.fixture(scope="session")
def shipped() -> SessionReport:
    """The report on the sample session."""
    return make_report(SHIPPED, command="twinmatch report bags/four_setpoints")


@pytest.fixture(scope="session")
def shipped_page(shipped: SessionReport) -> str:
    return shipped.html()
