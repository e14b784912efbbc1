"""The stability margin b(P, C): how far a plant may change and still be stabilised (Vinnicombe 1993).

A controller C that stabilises P stabilises every plant whose ν-gap to P is smaller than b(P, C), and there
is a plant at exactly that distance which it does not stabilise. b is the inverse of the H∞ norm of the four
transfer functions of the loop, ‖[P; 1](1 + C P)⁻¹[1 C]‖∞, and 0 when the loop is not stable.

With one plant input this norm is a quotient of polynomials: for P = N/d and C = M/c, with G = [d; N] and
K = [c, M], it is |G||K|/|K G|, where K G = c d + M N is the closed loop's characteristic polynomial. So its
largest value is found in the same way as the largest chordal distance, and to the same accuracy, from the
closed loop's poles; and whether these are stable is decided in exact arithmetic.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from twinmatch.comparing import chordal, peak
from twinmatch.comparing import double_double as dd
from twinmatch.comparing.errors import DiscriminationError
from twinmatch.comparing.graph_symbol import GraphSymbol, graph_symbol, spectral_roots
from twinmatch.comparing.hurwitz import is_hurwitz
from twinmatch.comparing.nu_gap import common_period
from twinmatch.comparing.polynomials import multiply
from twinmatch.compiled import compiled
from twinmatch.signals import FloatArray

__all__ = ["stability_margin"]


def stability_margin(plant: Any, controller: Any) -> float:
    """Stability margin b(P, C) of the loop u = −C y around y = P u, 0 (not stable) to 1.

    It depends on the units of u and y: scale them so that equal numbers are equally important.

    Args:
        plant: `control` TransferFunction or StateSpace, or `GraphSymbol`; one input, m outputs.
        controller: the same with m inputs and one output; a `GraphSymbol` of the transposed controller.

    Raises:
        DiscriminationError: numbers of signals that do not fit, different time bases, or a system that
            is not a valid model.
    """
    g = graph_symbol(plant)
    k = controller if isinstance(controller, GraphSymbol) else graph_symbol(_transposed(controller))
    if g.outputs != k.outputs:
        msg = (
            f"stability margin: the plant has {g.outputs} outputs, the controller {k.outputs} inputs; "
            "they must be equal"
        )
        raise DiscriminationError(msg)
    common_period(g, k)
    products = [multiply(a, b) for a, b in zip(g.column, k.column, strict=True)]
    characteristic = [sum(terms) for terms in zip(*products, strict=True)]
    if not is_hurwitz(characteristic):
        return 0.0
    return _smallest(g.coefficients, k.coefficients, spectral_roots([characteristic]))


def _transposed(controller: Any) -> Any:
    """Transpose a controller with one output into a model with one input."""
    if getattr(controller, "noutputs", None) != 1 or controller.ninputs == 1:
        return controller
    if hasattr(controller, "A"):
        matrices = (controller.A, controller.C, controller.B, controller.D)
        return type(controller)(*(matrix.T for matrix in matrices), controller.dt)
    numerators, denominators = (
        [[entry] for entry in array[0]] for array in (controller.num_array, controller.den_array)
    )
    return type(controller)(numerators, denominators, controller.dt)


@compiled
def _smallest(
    plant: tuple[FloatArray, FloatArray],
    controller: tuple[FloatArray, FloatArray],
    poles: Any,
) -> float:
    """Smallest |K G|/|K||G| over all frequencies."""
    high, low = _inner(plant[0], plant[1], controller[0], controller[1])
    high, low = chordal.with_powers_of_j(high), chordal.with_powers_of_j(low)
    one = np.ones((1, 1))
    # as the search needs it: a sum of squares |G|²|K|² over |K G|², largest where the margin is smallest
    products = chordal.with_powers_of_j(_products(plant[0], controller[0]))
    grid = peak.frequency_grid(poles, poles[:0])
    _, place = peak.highest(
        chordal.with_derivatives(high),
        chordal.with_derivatives(one),
        chordal.with_derivatives(products),
        grid,
    )
    signed_plant = (chordal.with_powers_of_j(plant[0]), chordal.with_powers_of_j(plant[1]))
    signed_controller = (chordal.with_powers_of_j(controller[0]), chordal.with_powers_of_j(controller[1]))
    return chordal.exact_distance(signed_plant, signed_controller, (high, low), place)


@compiled
def _inner(
    high1: FloatArray, low1: FloatArray, high2: FloatArray, low2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Coefficients of the sum of products in double-double, shape (1, n1 + n2 + 1) each."""
    rows, width1 = high1.shape
    width2 = high2.shape[1]
    high = np.zeros((1, width1 + width2 - 1))
    low = np.zeros_like(high)
    for row in range(rows):
        for a in range(width1):
            for b in range(width2):
                p, e = dd.multiply(high1[row, a], low1[row, a], high2[row, b], low2[row, b])
                high[0, a + b], low[0, a + b] = dd.add(high[0, a + b], low[0, a + b], p, e)
    return high, low


@compiled
def _products(rows1: FloatArray, rows2: FloatArray) -> FloatArray:
    """Every polynomial of the one times every one of the other, shape (m1 m2, n1 + n2 + 1)."""
    products = np.zeros((rows1.shape[0] * rows2.shape[0], rows1.shape[1] + rows2.shape[1] - 1))
    for i in range(rows1.shape[0]):
        for j in range(rows2.shape[0]):
            for a in range(rows1.shape[1]):
                for b in range(rows2.shape[1]):
                    products[i * rows2.shape[0] + j, a + b] += rows1[i, a] * rows2[j, b]
    return products
