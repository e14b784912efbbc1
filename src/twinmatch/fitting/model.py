"""The Box–Jenkins model, the result of an estimate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.fitting.data import checked_pair, checked_signal
from twinmatch.fitting.errors import IdentificationError
from twinmatch.fitting.filters import continue_outputs
from twinmatch.fitting.order import Order
from twinmatch.fitting.predictor import Polynomials, errors_of, smallest_errors
from twinmatch.signals import FloatArray

if TYPE_CHECKING:
    import control

__all__ = ["BoxJenkins"]


@dataclass(frozen=True, slots=True, eq=False)
class BoxJenkins:
    """y(t) = B(q)/F(q) u(t) + C(q)/D(q) e(t), polynomials in q⁻¹, one sample per `period`."""

    order: Order
    """nb, nc, nd, nf, nk."""
    B: FloatArray
    """Numerator with its nk leading zeros, shape (nk + nb,)."""
    C: FloatArray
    """Monic numerator of the noise, shape (nc + 1,)."""
    D: FloatArray
    """Monic denominator of the noise, shape (nd + 1,)."""
    F: FloatArray
    """Monic denominator, shape (nf + 1,)."""
    variance: float
    """V, mean squared one-step prediction error of the data it was estimated on; NaN when unknown."""
    covariance: FloatArray
    """Covariance of the coefficients in the order B (without its zeros), C, D, F (without their ones)."""
    initial_state: FloatArray
    """Initial conditions of the predictor on those data: m of C F e = D F y − D B u + Σ mⱼ δ(t−j)."""
    n_samples: int
    """N of those data; 0 for a model that was not estimated."""
    period: float = 1.0
    """Sample time, s."""
    converged: bool = True
    """Whether the search converged."""
    iterations: int = 0
    """Steps taken by the best search."""

    def __post_init__(self) -> None:
        for name in ("B", "C", "D", "F", "covariance", "initial_state"):
            values = np.array(getattr(self, name), dtype=np.float64)
            values.flags.writeable = False
            object.__setattr__(self, name, values)

    @classmethod
    def from_transfer_function(
        cls,
        system: control.TransferFunction,
        *,
        C: Sequence[float] = (1.0,),
        D: Sequence[float] = (1.0,),
        variance: float = math.nan,
    ) -> BoxJenkins:
        """The model whose B/F is a discrete transfer function, with white output noise unless C, D are given.

        Raises:
            IdentificationError: more than one input or output, continuous time, or not proper.
        """
        if system.ninputs != 1 or system.noutputs != 1:
            msg = (
                f"transfer function: {system.ninputs} inputs and {system.noutputs} outputs; give one of each"
            )
            raise IdentificationError(msg)
        if system.dt is None or not system.dt > 0:
            msg = f"transfer function: sample time {system.dt}; discretise it first"
            raise IdentificationError(msg)
        numerator = np.trim_zeros(np.atleast_1d(np.asarray(system.num[0][0], dtype=np.float64)), "f")
        denominator = np.trim_zeros(np.atleast_1d(np.asarray(system.den[0][0], dtype=np.float64)), "f")
        if numerator.size > denominator.size:
            msg = "transfer function: more zeros than poles, so it needs future inputs; give a proper one"
            raise IdentificationError(msg)
        delay = denominator.size - max(numerator.size, 1)
        B = np.concatenate((np.zeros(delay), numerator if numerator.size else np.zeros(1))) / denominator[0]
        order = Order(B.size - delay, len(C) - 1, len(D) - 1, denominator.size - 1, delay)
        return cls(
            order=order,
            B=B,
            C=np.asarray(C, dtype=np.float64),
            D=np.asarray(D, dtype=np.float64),
            F=denominator / denominator[0],
            variance=variance,
            covariance=np.full((order.coefficients, order.coefficients), math.nan),
            initial_state=np.zeros(order.predictor_state),
            n_samples=0,
            period=1.0 if system.dt is True else float(system.dt),
        )

    @property
    def polynomials(self) -> Polynomials:
        """B, C, D and F, as writable copies: kernels are compiled only for those."""
        return Polynomials(self.B.copy(), self.C.copy(), self.D.copy(), self.F.copy())

    @property
    def coefficients(self) -> FloatArray:
        """The free coefficients in the order of `covariance`, shape (n_parameters,)."""
        return np.concatenate((self.B[self.order.nk :], self.C[1:], self.D[1:], self.F[1:]))

    @property
    def n_parameters(self) -> int:
        """Number of coefficients; initial conditions are not counted."""
        return self.order.coefficients

    @property
    def standard_errors(self) -> FloatArray:
        """One standard deviation of each of `coefficients`, shape (n_parameters,)."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def transfer_function(self) -> control.TransferFunction:
        """B/F as a discrete transfer function in z with dt = period."""
        import control  # noqa: PLC0415  (slow to import, and only this needs it)

        size = max(self.B.size, self.F.size)
        numerator, denominator = (np.pad(part, (0, size - part.size)) for part in (self.B, self.F))
        return control.TransferFunction(numerator, denominator, self.period)

    def simulate(self, u: ArrayLike, *, outputs: ArrayLike = ()) -> FloatArray:
        """The output of B/F alone for input u, without noise; shape (N,).

        It starts from rest, or from recorded outputs: then the first len(outputs) samples are `outputs`
        and the difference equation continues from them. The paper's information gain copies len(F) samples
        in this way.

        Raises:
            IdentificationError: u is not a valid signal, or outputs are longer than u.
        """
        input_ = checked_signal(u, "input u")
        recorded = np.array(outputs, dtype=np.float64, ndmin=1)
        if recorded.size > input_.size:
            msg = f"simulate: {recorded.size} recorded outputs for {input_.size} inputs; give at most as many"
            raise IdentificationError(msg)
        return np.asarray(continue_outputs(self.B.copy(), self.F.copy(), input_, recorded))

    def prediction_errors(
        self, u: ArrayLike, y: ArrayLike, initial: str | ArrayLike = "estimate"
    ) -> FloatArray:
        """One-step prediction errors on any data; shape (N,).

        Args:
            u: input, shape (N,).
            y: output, shape (N,).
            initial: "estimate" (initial conditions by least squares on these data), "zero" (rest), or
                initial conditions such as `initial_state`.

        Raises:
            IdentificationError: invalid signals, or an unknown `initial`.
        """
        u, y = checked_pair(u, y)
        if not isinstance(initial, str):
            m = np.array(initial, dtype=np.float64)
        elif initial == "estimate":
            return np.asarray(smallest_errors(u, y, self.polynomials, self.order.predictor_state))
        elif initial == "zero":
            m = np.zeros(0)
        else:
            msg = f'initial: {initial!r} is unknown; use "estimate", "zero" or an array'
            raise IdentificationError(msg)
        return np.asarray(errors_of(u, y, self.polynomials, m))

    def loss(self, u: ArrayLike, y: ArrayLike, initial: str | ArrayLike = "estimate") -> float:
        """Mean squared prediction error on any data; arguments as for `prediction_errors`."""
        return float(np.mean(self.prediction_errors(u, y, initial) ** 2))
