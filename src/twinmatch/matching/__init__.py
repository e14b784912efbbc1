"""Parameters of a plant from a window: behavioral matching, and the gate that accepts or refuses it.

`match` runs the twin on the window and moves the free parameters until it agrees with the record as nearly as
it can (nonlinear least squares, paper section III): closed into its loop on the window's own set-points where
the controller is known, else driven by the recorded input. Which parameters there are, where each is looked
for and what is unknown at a window's begin, the plant file says. Parameters trade off against each other, so
a `Match` always carries its covariance, its Fisher information and the bounds it ran into; the covariance
follows the sensor's noise round the loop. It also says which parameters to believe, within which intervals,
which combination is known best, and which set-point step would show what is left open. Its `Status` is the
gate's answer: only an accepted match may join the family of candidates. `Limits` says where the gate
closes, and the gate's module in which order it asks. `fit_structure` fits any structure of a plant, over one
window or several, without a gate.
"""

from twinmatch.matching.bounds import Bounds, MatchingError
from twinmatch.matching.gate import Limits, Status
from twinmatch.matching.match import match
from twinmatch.matching.noise import Noise
from twinmatch.matching.result import Fit, Match
from twinmatch.matching.structures import StructureFit, fit_structure

__all__ = [
    "Bounds",
    "Fit",
    "Limits",
    "Match",
    "MatchingError",
    "Noise",
    "Status",
    "StructureFit",
    "fit_structure",
    "match",
]
