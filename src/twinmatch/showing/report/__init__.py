"""A judged session as a document to share: one HTML file, and its figures.

`make_report` judges a session again, whether or not verdicts were recorded, and collects the content;
`Report.write` lays it out as one file that loads nothing else, needs no script and prints well.
`write_pictures` writes the figures as separate files. The content comes from `twinmatch.showing`, as on the
live page and the terminal, so that all of them show the same values.

Names are imported on first use, so that `twinmatch report --help` does not wait for numpy.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twinmatch.showing.report.judging import Judged, judge
    from twinmatch.showing.report.pictures import FORMATS, Picture, write_pictures
    from twinmatch.showing.report.report import Report, build_report, make_report

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
