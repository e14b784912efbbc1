"""Box–Jenkins models of the loop, y = B/F u + C/D e, by the prediction error method.

`estimate` fits one model, `estimate_ladder` the paper's ladder of nested orders 22221 to 55551. Short
windows of a running loop need correct initial conditions: those of B/F and of the noise filter are estimated
exactly, together with the coefficients. A `BoxJenkins` model simulates, computes its prediction errors on any
data and converts to a transfer function.
"""

from __future__ import annotations

from twinmatch.identification.errors import IdentificationError
from twinmatch.identification.estimation import estimate, estimate_ladder
from twinmatch.identification.model import BoxJenkins
from twinmatch.identification.order import ORDERS, Order, parse_order

__all__ = [
    "ORDERS",
    "BoxJenkins",
    "IdentificationError",
    "Order",
    "estimate",
    "estimate_ladder",
    "parse_order",
]
