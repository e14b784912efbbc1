"""What a person sees of verdicts: tables, sentences, figures, and JSON for other programs."""

from __future__ import annotations

from twinmatch.views.document import document, verdict_entry
from twinmatch.views.line import print_header, print_line
from twinmatch.views.news import News, news
from twinmatch.views.summary import Summary, sentence, summarise
from twinmatch.views.table import COLUMNS, STYLES, row
from twinmatch.views.trust_range import TrustRange, trust_range

__all__ = [
    "COLUMNS",
    "STYLES",
    "News",
    "Summary",
    "TrustRange",
    "document",
    "news",
    "print_header",
    "print_line",
    "row",
    "sentence",
    "summarise",
    "trust_range",
    "verdict_entry",
]
