"""How everything that is drawn looks, wherever it is drawn: colours, line styles, lettering.

One meaning has one colour in every picture, on the live page and in the report. The colours are those of
Okabe and Ito, which people with any of the common colour deficiencies tell apart; where a colour says
something important (a trust level, an accepted match), a shape or a word says it too.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

from twinmatch.discrimination import TrustLevel

__all__ = [
    "CLOSED",
    "DRIVEN",
    "FAMILY_MAP",
    "GRID",
    "LEVELS",
    "LEVEL_WORDS",
    "MATRIX_MAP",
    "MODEL",
    "ORDERS",
    "PLANT",
    "SET_POINT",
    "TEXT",
    "rc",
]

PLANT: Final = "#0072B2"
"""What was measured on the plant."""
CLOSED: Final = "#D55E00"
"""The closed-loop twin: it is given the set-point."""
DRIVEN: Final = "#A3417C"
"""The driven twin: it is given the measured control."""
MODEL: Final = "#1A1A1A"
"""A Box–Jenkins model."""
SET_POINT: Final = "#5C5C5C"
TEXT: Final = "#1A1A1A"
GRID: Final = "#D9D9D9"

LEVELS: Final[Mapping[TrustLevel, str]] = MappingProxyType(
    {
        TrustLevel.UNKNOWN: "#B5B5B5",
        TrustLevel.TRUSTED: "#009E73",
        TrustLevel.DOUBTFUL: "#E69F00",
        TrustLevel.FAULT: "#B3001B",
    }
)
LEVEL_WORDS: Final[Mapping[TrustLevel, str]] = MappingProxyType(
    {
        TrustLevel.UNKNOWN: "nothing has come yet of what a twin foretold",
        TrustLevel.TRUSTED: "what comes is what the twin foretold",
        TrustLevel.DOUBTFUL: "what comes lies outside the bands that were given",
        TrustLevel.FAULT: "no twin explains what the plant does",
    }
)

ORDERS: Final = ("#56B4E9", "#0072B2", "#E69F00", "#5C5C5C")
"""Of the Box–Jenkins orders, lowest first."""
FAMILY_MAP: Final = "cividis"
"""Colour map over the candidates of the family, coldest operating point first."""
MATRIX_MAP: Final = "cividis_r"
"""Colour map of the ν-gap matrix: light is near, dark is far."""


def rc() -> dict[str, Any]:
    """Settings for `matplotlib.rc_context`: dark text on white, quiet axes, the same file on every run."""
    return {
        "axes.axisbelow": True,
        "axes.edgecolor": "#8C8C8C",
        "axes.grid": True,
        "axes.labelcolor": TEXT,
        "axes.linewidth": 0.8,
        "axes.spines.right": False,
        "axes.spines.top": False,
        "axes.titlelocation": "left",
        "axes.titlesize": 10,
        "figure.facecolor": "white",
        "font.family": ["DejaVu Sans"],
        "font.size": 9,
        "grid.color": GRID,
        "grid.linewidth": 0.6,
        "legend.fontsize": 8,
        "legend.frameon": False,
        "lines.linewidth": 1.2,
        "path.simplify": True,
        "path.simplify_threshold": 0.3,
        "pdf.fonttype": 42,
        "savefig.dpi": 130,
        "svg.fonttype": "path",
        "svg.hashsalt": "twinmatch",
        "text.color": TEXT,
        "xtick.color": TEXT,
        "xtick.labelsize": 8,
        "ytick.color": TEXT,
        "ytick.labelsize": 8,
    }
