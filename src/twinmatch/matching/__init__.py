"""Rig parameters from a window: behavioral matching, and the gate that accepts or refuses it.

`match` runs the closed-loop twin on the window's own reference and moves the free rig parameters until
temperature and PWM agree with the record as nearly as they can (nonlinear least squares, paper section
III). Seebeck coefficient, conductance and heat capacity trade off against each other, so a `Match` always
carries its covariance, its Fisher information and the bounds it ran into; the covariance follows the
camera's noise round the loop. It also says which parameters to believe, within which intervals, which
combination is known best, and which set-point step would show what is left open. Its `Status` is the
gate's answer: only an accepted match may join the family of candidates. `Limits` says where the gate
closes, and the gate's module in which order it asks. `fit_structure` does the same for plants that are richer
than the three parameters, over one window or several.
"""

from twinmatch.matching.bounds import (
    AUTHORS_BOUNDS,
    BOUNDS,
    SCALES,
    SINK_START,
    Bounds,
    MatchingError,
)
from twinmatch.matching.gate import Limits, Status
from twinmatch.matching.match import FREE, match
from twinmatch.matching.problem import Noise
from twinmatch.matching.result import Fit, Match
from twinmatch.matching.structures import STRUCTURES, Structure, StructureFit, fit_structure

__all__ = [
    "AUTHORS_BOUNDS",
    "BOUNDS",
    "FREE",
    "SCALES",
    "SINK_START",
    "STRUCTURES",
    "Bounds",
    "Fit",
    "Limits",
    "Match",
    "MatchingError",
    "Noise",
    "Status",
    "Structure",
    "StructureFit",
    "fit_structure",
    "match",
]
