"""The style of the page: colours and fonts from `twinmatch.showing.style`, sizes for a screen."""

from __future__ import annotations

from pathlib import Path

from bokeh.models import Div
from bokeh.themes import Theme

from twinmatch.comparing import TrustLevel
from twinmatch.showing.style import GRID, LEVELS, SET_POINT, TEXT
from twinmatch.showing.verdicts import Mark

FONT = "system-ui, 'Segoe UI', Roboto, 'Noto Sans', 'DejaVu Sans', sans-serif"

SIGNS = {
    TrustLevel.UNKNOWN: "?",
    TrustLevel.TRUSTED: "✓",
    TrustLevel.DOUBTFUL: "!",
    TrustLevel.FAULT: "✕",
}
"""Shown beside the word and the colour of a level."""

MARKS = {
    Mark.GOOD: LEVELS[TrustLevel.TRUSTED],
    Mark.NOTE: SET_POINT,
    Mark.WARNING: LEVELS[TrustLevel.DOUBTFUL],
    Mark.BAD: LEVELS[TrustLevel.FAULT],
}
"""Colours of the marks in charts."""
MARK_SIGNS = {Mark.GOOD: "●", Mark.NOTE: "◆", Mark.WARNING: "▲", Mark.BAD: "✕"}
"""The same marks in text."""
MARK_INKS = {
    Mark.GOOD: "#00664B",
    Mark.NOTE: SET_POINT,
    Mark.WARNING: "#8A5A00",
    Mark.BAD: "#B3001B",
}
"""Colours of the marks, dark enough for text."""
DARK = (TrustLevel.UNKNOWN, TrustLevel.TRUSTED, TrustLevel.DOUBTFUL)
"""Levels with dark text on their colour, for a contrast of at least 4.5."""
BUTTONS = """
.bk-btn-primary { background: #0072B2; border-color: #005a8e; color: #fff; }
.bk-btn-warning { background: #E69F00; border-color: #a87400; color: #1a1a1a; }
.bk-btn-danger { background: #B3001B; border-color: #8a0015; color: #fff; }
.bk-btn:focus-visible, .bk-input:focus-visible { outline: 3px solid #1a1a1a; outline-offset: 2px; }
"""
"""Buttons in the colours of the page, with a contrast of at least 4.5 and a ring for the keyboard focus."""
SHAPES = {
    Mark.GOOD: "circle",
    Mark.NOTE: "diamond",
    Mark.WARNING: "triangle",
    Mark.BAD: "x",
}
"""Markers of the time line: their shape distinguishes them without colour."""


def _letters(kind: str) -> dict[str, object]:
    """Font of one kind of text in a chart."""
    return {f"{kind}_text_font": FONT, f"{kind}_text_font_size": "12px"}


_BORDERS = {
    "min_border_left": 78,
    "min_border_right": 12,
    "min_border_top": 4,
    "min_border_bottom": 4,
}
_ATTRIBUTES = {
    "Plot": {
        "background_fill_color": "#FFFFFF",
        **dict.fromkeys(("border_fill_color", "outline_line_color")),
        **_BORDERS,
    },
    "Axis": {
        **_letters("axis_label"),
        **_letters("major_label"),
        "axis_label_text_font_style": "normal",
        **dict.fromkeys(("axis_label_text_color", "major_label_text_color"), TEXT),
        **dict.fromkeys(("axis_line_color", "major_tick_line_color"), "#8C8C8C"),
        "minor_tick_line_color": None,
    },
    "Grid": {"grid_line_color": GRID, "grid_line_alpha": 0.7},
    "Legend": {
        **_letters("label"),
        **{
            "border_line_color": None,
            "background_fill_alpha": 0.0,
            "padding": 0,
            "margin": 0,
        },
        **{"spacing": 14, "glyph_width": 22},
    },
    "BaseColorBar": {
        **_letters("major_label"),
        **_letters("title"),
        "title_text_font_style": "normal",
    },
}
THEME = Theme(json={"attrs": _ATTRIBUTES})

_STYLE = Path(__file__).with_name("panel.css").read_text(encoding="utf-8")


def panel(name: str, html: str = "") -> Div:
    """An HTML element that fills its card; `name` is its place in the template."""
    return Div(
        name=name,
        text=html,
        margin=0,
        sizing_mode="stretch_width",
        stylesheets=[_STYLE],
    )
