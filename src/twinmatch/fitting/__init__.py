"""Models from recorded windows: parameters by behavioral matching, Box–Jenkins models by prediction errors.

`match` simulates the twin on the window and adjusts the free parameters to fit the record (nonlinear least
squares, paper section III): in closed loop on the window's own set-points if the controller is known,
otherwise driven by the recorded input. The plant file declares the parameters, their bounds and the unknown
initial states. Parameters trade off against each other, so a `Match` always carries its covariance, its
Fisher information and the bounds that were hit; the covariance includes the sensor's noise circulating in the
loop. A match also lists the parameters that are determined, their intervals, the best known combination, and
the set-point step that would determine the rest. Its `Status` is the decision of the gate: only an accepted
match may join the family of candidates. `GateLimits` are its limits; its module explains the order of the
checks. `fit_structure` fits any structure of a plant to one or several windows, without a gate, and
`fit_session` to a whole session.

`estimate` fits one Box–Jenkins model y = B/F u + C/D e, `estimate_ladder` the paper's ladder of nested orders
22221 to 55551. Short windows of a running loop need correct initial conditions: those of B/F and of the noise
filter are estimated exactly, together with the coefficients. A `BoxJenkins` model simulates, computes its
prediction errors on any data and converts to a transfer function.
"""

from twinmatch.fitting.box_jenkins import BoxJenkins, estimate, estimate_ladder
from twinmatch.fitting.data import ORDERS, FittingError, parse_order
from twinmatch.fitting.gate import GateLimits, Status
from twinmatch.fitting.match import Match, match
from twinmatch.fitting.problem import Expectation, Noise, Prior
from twinmatch.fitting.structures import (
    StructureFit,
    fit_session,
    fit_structure,
    held_back_costs,
    in_parts,
    observed_covariance,
)

__all__ = [
    "ORDERS",
    "BoxJenkins",
    "Expectation",
    "FittingError",
    "GateLimits",
    "Match",
    "Noise",
    "Prior",
    "Status",
    "StructureFit",
    "estimate",
    "estimate_ladder",
    "fit_session",
    "fit_structure",
    "held_back_costs",
    "in_parts",
    "match",
    "observed_covariance",
    "parse_order",
]
