"""Figures of a judged session, drawn with matplotlib.

Each module draws one kind of figure and writes no files; `save`, `png` and `svg` do that. Importing this
package does not import matplotlib, which is slow; drawing the first figure does.
"""

from __future__ import annotations

from twinmatch.showing.figures.discrimination import draw_criteria, draw_matrix
from twinmatch.showing.figures.drawing import png, save, svg
from twinmatch.showing.figures.forecasts import draw_forecasts
from twinmatch.showing.figures.health import draw_health
from twinmatch.showing.figures.parameters import draw_parameters
from twinmatch.showing.figures.responses import draw_responses, draw_uncertainty
from twinmatch.showing.figures.session import draw_session
from twinmatch.showing.figures.verdict import draw_verdict

__all__ = [
    "draw_criteria",
    "draw_forecasts",
    "draw_health",
    "draw_matrix",
    "draw_parameters",
    "draw_responses",
    "draw_session",
    "draw_uncertainty",
    "draw_verdict",
    "png",
    "save",
    "svg",
]
