"""Behavioral matching: parameters of a plant from a window, and the gate that accepts or refuses them.

`match` simulates the twin on the window and adjusts the free parameters to fit the record (nonlinear least
squares, paper section III): in closed loop on the window's own set-points if the controller is known,
otherwise driven by the recorded input. The plant file declares the parameters, their bounds and the unknown
initial states. Parameters trade off against each other, so a `Match` always carries its covariance, its
Fisher information and the bounds that were hit; the covariance includes the sensor's noise circulating in the
loop. A match also lists the parameters that are determined, their intervals, the best known combination, and
the set-point step that would determine the rest. Its `Status` is the decision of the gate: only an accepted
match may join the family of candidates. `Limits` are the limits of the gate; its module explains the order of
the checks. `fit_structure` fits any structure of a plant to one or several windows, without a gate.
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
