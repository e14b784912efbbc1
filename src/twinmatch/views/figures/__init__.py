"""Figures of a judged session, drawn with matplotlib.

Each module draws one kind of figure and writes no files; `save`, `png` and `svg` do that. Importing this
package does not import matplotlib, which is slow; drawing the first figure does.
"""

from __future__ import annotations

from twinmatch.views.figures.discrimination import draw_criteria, draw_matrix
from twinmatch.views.figures.drawing import png, save, svg
from twinmatch.views.figures.forecasts import draw_forecasts
from twinmatch.views.figures.health import draw_health
from twinmatch.views.figures.parameters import draw_parameters
from twinmatch.views.figures.responses import draw_responses, draw_uncertainty
from twinmatch.views.figures.session import draw_session
from twinmatch.views.figures.verdict import draw_verdict

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
