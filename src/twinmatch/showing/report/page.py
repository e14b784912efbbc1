"""Layout of a report with its template."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from jinja2 import Environment, PackageLoader, StrictUndefined

from twinmatch.showing.report.words import as_sentence

__all__ = ["render"]

TEMPLATE = "report.html"


@cache
def _environment() -> Environment:
    """The template environment: all text is escaped, and an undefined name in the template is an error."""
    environment = Environment(
        loader=PackageLoader("twinmatch.showing.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["sentence"] = as_sentence
    environment.filters["short"] = lambda value: f"{value:g}"
    return environment


def render(content: Mapping[str, object]) -> str:
    """The template filled with this content."""
    return _environment().get_template(TEMPLATE).render(content)
