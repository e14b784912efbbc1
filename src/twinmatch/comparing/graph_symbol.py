"""Right graph symbol of a model, a column of polynomials: the form in which ν-gaps are computed.

A model with one input and m outputs is a column P = N/d; every pair (input, output) that it allows is a
multiple of the column G = [d; N]. Poles on the stability boundary, such as integrators, need no special
treatment in G.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.comparing.chordal import with_derivatives, with_powers_of_j
from twinmatch.comparing.polynomials import (
    Column,
    DiscriminationError,
    column_of,
    even_part,
    exact,
    product,
    roots_of_even_part,
    split,
    to_half_plane,
    trim,
    trim_top,
    without_unstable_common_factor,
)
from twinmatch.comparing.state_space import StateSpace, inputs_of
from twinmatch.signals import FloatArray

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class GraphSymbol:
    """Right graph symbol [d; N] of a model with one input and m outputs, built once per model.

    Create it with `graph_symbol`, `of_polynomials`, `of_fractions` or `of_state_space`.
    """

    column: Column
    """d and the m numerators with exact integer coefficients in s (continuous) or w (discrete)."""
    period: float | bool | None
    """Sample time, s; 0 for continuous time, True for discrete with unknown period, None for any."""
    coefficients: tuple[FloatArray, FloatArray] = field(init=False, repr=False)
    """The column in double-double, shape (m + 1, n + 1) each."""
    signed: tuple[FloatArray, FloatArray] = field(init=False, repr=False)
    """The same with powers of j folded in."""
    stack: FloatArray = field(init=False, repr=False)
    """Values and derivatives for the kernels, shape (3, m + 1, n + 1)."""
    spectral_roots: NDArray[np.complex128] = field(init=False, repr=False)
    """Negated roots of the stable spectral factor of |d|² + |N|², so in the right half plane, (n,)."""

    def __post_init__(self) -> None:
        trimmed = trim(self.column)
        high, low = split(trimmed)
        column = without_unstable_common_factor(
            trimmed, high, discrete=bool(self.period)
        )
        if column is not trimmed:
            high, low = split(column)
        object.__setattr__(self, "column", column)
        object.__setattr__(self, "coefficients", (high, low))
        object.__setattr__(
            self, "signed", (with_powers_of_j(high), with_powers_of_j(low))
        )
        object.__setattr__(self, "stack", with_derivatives(self.signed[0]))
        roots = spectral_roots(column)
        if roots.size != high.shape[1] - 1 or not np.all(
            np.isfinite(roots) & (roots != 0)
        ):
            msg = f"model: its dynamics {roots} are too far apart or from 1 rad/s; use another unit of time"
            raise DiscriminationError(msg)
        object.__setattr__(self, "spectral_roots", roots)

    @property
    def outputs(self) -> int:
        """Number of outputs m."""
        return len(self.column) - 1

    @classmethod
    def of_polynomials(
        cls,
        denominator: ArrayLike,
        numerators: Sequence[ArrayLike],
        period: float | bool | None,
    ) -> GraphSymbol:
        """From one denominator and m numerators, highest power of s or z first.

        Raises:
            DiscriminationError: the denominator is zero or a coefficient is not finite.
        """
        return cls.of_transfer_functions([(n, denominator) for n in numerators], period)

    @classmethod
    def of_transfer_functions(
        cls,
        fractions: Sequence[tuple[ArrayLike, ArrayLike]],
        period: float | bool | None,
    ) -> GraphSymbol:
        """From (numerator, denominator) per output, highest power of s or z first; raises as above.

        Equal denominators are used once; the common denominator is the product of the different ones.
        """
        if not fractions:
            raise DiscriminationError(
                "model: it has no output; give at least one transfer function"
            )
        pairs = [(_ascending(n), _ascending(d)) for n, d in fractions]
        return cls(_exact_column(pairs, discrete=bool(period)), period)

    @classmethod
    def of_fractions(
        cls, fractions: Sequence[tuple[ArrayLike, ArrayLike]], period: float
    ) -> GraphSymbol:
        """From (B, F) per output in powers of z⁻¹, constant first, as identified; raises as above."""
        padded = []
        for pair in fractions:
            b, f = (np.atleast_1d(np.asarray(p, dtype=np.float64)) for p in pair)
            width = max(b.size, f.size)
            padded.append((_pad(b, width), _pad(f, width)))
        return cls.of_transfer_functions(padded, period)

    @classmethod
    def of_state_space(
        cls,
        A: FloatArray,
        B: FloatArray,
        C: FloatArray,
        D: FloatArray,
        period: float | bool | None,
    ) -> GraphSymbol:
        """From matrices of shapes (n, n), (n, 1), (m, n), (m, 1), in exact arithmetic.

        Raises:
            DiscriminationError: an entry is not finite.
        """
        column = trim_top(column_of(A, B, C, D))
        return cls(to_half_plane(column) if period else column, period)


def graph_symbol(system: Any) -> GraphSymbol:
    """The graph symbol of a `control` TransferFunction, or of a StateSpace, ours or that of `control`.

    A given symbol is returned unchanged. State-space models are converted in exact arithmetic.

    Raises:
        DiscriminationError: another type, more than one input, or coefficients that are not finite.
    """
    if isinstance(system, GraphSymbol):
        return system
    inputs = inputs_of(system)
    if not (hasattr(system, "num_array") or hasattr(system, "A")):
        msg = f"model: a {type(system).__name__} cannot be compared; give a TransferFunction or a StateSpace"
        raise DiscriminationError(msg)
    if inputs != 1:
        msg = f"model: it has {inputs} inputs; give a model with one input and any number of outputs"
        raise DiscriminationError(msg)
    if isinstance(system, StateSpace):
        any_period = None if not len(system.A) else 0.0
        return GraphSymbol.of_state_space(
            system.A, system.B, system.C, system.D, system.period or any_period
        )
    if hasattr(system, "A"):
        period = _time_base(system, dynamic=len(system.A) > 0)
        return GraphSymbol.of_state_space(
            system.A, system.B, system.C, system.D, period
        )
    fractions = list(zip(system.num_array[:, 0], system.den_array[:, 0], strict=True))
    dynamic = any(np.size(p) > 1 for pair in fractions for p in pair)
    return GraphSymbol.of_transfer_functions(
        fractions, _time_base(system, dynamic=dynamic)
    )


def _time_base(system: Any, *, dynamic: bool) -> float | bool | None:
    """The period; a model without a time base is continuous unless it is a pure gain."""
    if system.dt is None:
        return 0.0 if dynamic else None
    return True if system.dt is True else float(system.dt)


def _ascending(coefficients: ArrayLike) -> FloatArray:
    descending = np.atleast_1d(np.asarray(coefficients, dtype=np.float64))
    if descending.ndim != 1 or not descending.size:
        msg = f"model: a polynomial has shape {descending.shape}; give its coefficients in one row"
        raise DiscriminationError(msg)
    return descending[::-1]


def _pad(coefficients: FloatArray, width: int) -> FloatArray:
    """Pad with zeros to this width; `np.pad` takes longer than all the arithmetic."""
    filled = np.zeros(width)
    filled[: coefficients.size] = coefficients
    return filled


def _exact_column(
    pairs: list[tuple[FloatArray, FloatArray]], *, discrete: bool
) -> Column:
    """Column [d; N] over the product of the distinct denominators."""
    denominators: list[FloatArray] = []
    places = []
    for _, own_denominator in pairs:
        place = _place_of(own_denominator, denominators)
        if place is None:
            place = len(denominators)
            denominators.append(own_denominator)
        places.append(place)
    polynomials = exact([*denominators, *(numerator for numerator, _ in pairs)])
    below = polynomials[: len(denominators)]
    above = polynomials[len(denominators) :]
    for k, denominator in enumerate(below):
        if not any(denominator):
            msg = f"model: the denominator of output {places.index(k)} is zero; give one that is not"
            raise DiscriminationError(msg)
    column = [product(below)]
    for k, numerator in zip(places, above, strict=True):
        column.append(product([numerator, *below[:k], *below[k + 1 :]]))
    width = max(len(polynomial) for polynomial in column)
    column = trim_top(
        [polynomial + [0] * (width - len(polynomial)) for polynomial in column]
    )
    return to_half_plane(column) if discrete else column


def _place_of(wanted: FloatArray, denominators: Sequence[FloatArray]) -> int | None:
    for place, denominator in enumerate(denominators):
        if np.array_equal(wanted, denominator):
            return place
    return None


def spectral_roots(column: Column) -> NDArray[np.complex128]:
    """Square roots with positive real part of −λ, λ the roots in Ω² of Σ |p(jΩ)|²."""
    roots = np.sqrt(-roots_of_even_part(even_part(column)))
    # rounding may put one on the axis itself, where a spectral factor has no roots
    return np.asarray(np.maximum(roots.real, 1e-14 * np.abs(roots)) + 1j * roots.imag)
