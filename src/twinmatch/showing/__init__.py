"""Verdicts for people: tables, sentences and figures; and as JSON for other programs.

Terminal, live page, report and notebook all take their figures from here, so that they show the same values:
`sentence` and `row` for a line of text, `events` and `level_stretches` for a time line, `criterion_rows` for
the criterion table, `family` for the candidates with their models, `compare` for plant and twins side by
side, `twinmatch.showing.style` for colours and `twinmatch.showing.figures` for pictures.
"""

from __future__ import annotations

from twinmatch.showing.comparison import Comparison, compare, rolling_rms, root_mean_square
from twinmatch.showing.criteria import CRITERIA, OUTPUTS, Criterion, CriterionRow, criterion_rows
from twinmatch.showing.document import document
from twinmatch.showing.events import (
    STATUS_WORDS,
    Event,
    EventKind,
    Stretch,
    admitted,
    events,
    level_stretches,
)
from twinmatch.showing.family import Member, family
from twinmatch.showing.intervals import Interval, interval, value_of
from twinmatch.showing.line import print_header, print_line
from twinmatch.showing.news import News, news
from twinmatch.showing.quantities import Quantity, in_order, number, quantity
from twinmatch.showing.standing import Shown, last_verdict, nominal_score, shown_twin
from twinmatch.showing.summary import Summary, sentence, summarise
from twinmatch.showing.table import COLUMNS, STYLES, row
from twinmatch.showing.trust_range import TrustRange, trust_range

__all__ = [
    "COLUMNS",
    "CRITERIA",
    "OUTPUTS",
    "STATUS_WORDS",
    "STYLES",
    "Comparison",
    "Criterion",
    "CriterionRow",
    "Event",
    "EventKind",
    "Interval",
    "Member",
    "News",
    "Quantity",
    "Shown",
    "Stretch",
    "Summary",
    "TrustRange",
    "admitted",
    "compare",
    "criterion_rows",
    "document",
    "events",
    "family",
    "in_order",
    "interval",
    "last_verdict",
    "level_stretches",
    "news",
    "nominal_score",
    "number",
    "print_header",
    "print_line",
    "quantity",
    "rolling_rms",
    "root_mean_square",
    "row",
    "sentence",
    "shown_twin",
    "summarise",
    "trust_range",
    "value_of",
]
