"""Style of all figures: colours, line styles, fonts.

A colour has the same meaning in every figure, on the live page and in the report. The colours are those of
Okabe and Ito, which people with the common colour deficiencies can distinguish; where a colour carries
information (a trust level, an accepted match), a shape or a word repeats it.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

from twinmatch.comparing import TrustLevel

PLANT: Final = "#0072B2"
"""Measurements of the plant."""
CLOSED: Final = "#D55E00"
"""The closed-loop twin, driven by the set-point."""
DRIVEN: Final = "#A3417C"
"""The driven twin, driven by the measured input."""
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
ORDERS: Final = ("#56B4E9", "#0072B2", "#E69F00", "#5C5C5C")
"""Colours of the Box–Jenkins orders, lowest first."""
FAMILY_MAP: Final = "cividis"
"""Colour map over the candidates of the family, coldest operating point first."""
MATRIX_MAP: Final = "cividis_r"
"""Colour map of the ν-gap matrix: light is close, dark is far."""

SIDE_BY_SIDE: Final = 4
"""Most signals of one kind beside one another; more are below them."""


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
        # otherwise every layout measures the axes again to look for ticks above them
        "axes.titley": 1.0,
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
