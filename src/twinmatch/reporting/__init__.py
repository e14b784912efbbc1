"""A judged session as a document to hand around: one HTML file, and its pictures.

`make_report` judges a session anew, whatever was recorded of verdicts, and gathers what is to be said of it;
`Report.write` lays that out as one file that loads nothing from anywhere, reads without a script and prints
well. `write_pictures` writes the same pictures by themselves. What they show comes from `twinmatch.views`,
as do the live page and the terminal, so that all of them show the same figures.

Names are fetched when they are used, so that the command line need not wait for numpy to say how it is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twinmatch.reporting.judging import Judged, judge
    from twinmatch.reporting.pictures import FORMATS, Picture, write_pictures
    from twinmatch.reporting.report import Report, build_report, make_report

__all__ = ["FORMATS", "Judged", "Picture", "Report", "build_report", "judge", "make_report", "write_pictures"]

_MODULES = {
    "Judged": "judging",
    "judge": "judging",
    "FORMATS": "pictures",
    "Picture": "pictures",
    "write_pictures": "pictures",
    "Report": "report",
    "build_report": "report",
    "make_report": "report",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        msg = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(msg)
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
