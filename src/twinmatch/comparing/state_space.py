"""Linear systems in state space with any number of inputs and outputs, in the half plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinmatch.comparing.polynomials import DiscriminationError
from twinmatch.dynamics import Law, Linear, TwoLevel
from twinmatch.dynamics.laws import LOW, law_slopes
from twinmatch.signals import FloatArray

Matrix = NDArray[Any]
"""Real, or complex after a rotation of the unit circle."""

ON_AXIS = 1e-9
"""A pole this close to the axis, relative to the fastest of its system, may lie on it."""

NEAR_MINUS_ONE = 1e-6
"""Poles of sampled systems this close to −1 lie too far out in the half plane."""

NEGLIGIBLE = 1e-11
"""Coupling, relative to the largest, below which an input does not move a state."""


@dataclass(frozen=True, eq=False)
class StateSpace:
    """x' = A·x + B·u, y = C·x + D·u, where x' is the derivative or, if sampled, the next state.

    Raises:
        DiscriminationError: a shape does not fit, or a number is not finite.
    """

    A: Any
    """Shape (n, n)."""
    B: Any
    """Shape (n, m)."""
    C: Any
    """Shape (p, n)."""
    D: Any
    """Shape (p, m)."""
    period: float | None = None
    """Sample time, s; None for continuous time."""

    def __post_init__(self) -> None:
        for name in "ABCD":
            object.__setattr__(self, name, np.array(getattr(self, name), ndmin=2))
        p, m = self.D.shape
        n = len(self.A) if self.A.size else 0
        for name, shape in {"A": (n, n), "B": (n, m), "C": (p, n)}.items():
            value = getattr(self, name)
            if value.size == 0 and n == 0:
                object.__setattr__(self, name, np.zeros(shape))
            elif value.shape != shape:
                msg = f"model: {name} has shape {value.shape}; with this A and D it needs {shape}"
                raise DiscriminationError(msg)
        if not all(np.isfinite(getattr(self, name)).all() for name in "ABCD"):
            msg = "model: its matrices hold a number that is not finite; it cannot be compared"
            raise DiscriminationError(msg)

    @property
    def n_inputs(self) -> int:
        """Number of inputs m."""
        return int(self.D.shape[1])

    @property
    def n_outputs(self) -> int:
        """Number of outputs p."""
        return int(self.D.shape[0])

    @classmethod
    def of(cls, system: Any) -> StateSpace:
        """A linearised plant, the linear part of a law, or a `control` StateSpace; a StateSpace of
        this module is returned unchanged.

        A law becomes the controller C of u = −C·y, within its limits.

        Raises:
            DiscriminationError: another type, or a law of two levels, which has no linear part.
        """
        if isinstance(system, StateSpace):
            return system
        if isinstance(system, Linear):
            direct = np.zeros((len(system.C), system.B.shape[1]))
            return cls(system.A, system.B, system.C, direct, system.period)
        if isinstance(system, Law):
            return _of_law(system)
        if not hasattr(system, "A"):
            raise DiscriminationError(
                f"model: it has {inputs_of(system)} inputs, and a {type(system).__name__} has no matrices; "
                "give a StateSpace, a linearised plant or a law"
            )
        sampled = None if not system.dt else float(system.dt)
        return cls(system.A, system.B, system.C, system.D, sampled)

    @property
    def transposed(self) -> StateSpace:
        """The system from the outputs to the inputs, with the transposed response."""
        return StateSpace(self.A.T, self.C.T, self.B.T, self.D.T, self.period)

    @property
    def adjoint(self) -> StateSpace:
        """P~ of a continuous system: on the axis of frequencies its response is the conjugate transpose."""
        return StateSpace(-_h(self.A), _h(self.C), -_h(self.B), _h(self.D))

    def scaled(self, outputs: ArrayLike, inputs: ArrayLike) -> StateSpace:
        """The same with outputs and inputs counted in these units, shapes (p,) and (m,); of one a number."""
        input_units = np.atleast_1d(np.asarray(inputs, dtype=np.float64))
        output_units = np.atleast_1d(np.asarray(outputs, dtype=np.float64))[:, None]
        return StateSpace(
            self.A,
            self.B * input_units,
            self.C / output_units,
            self.D * input_units / output_units,
            self.period,
        )

    def response(self, frequencies: FloatArray) -> NDArray[np.complex128]:
        """Values of a continuous system at frequencies (rad/s; may be infinite): (frequencies, p, m)."""
        n = len(self.A)
        is_finite = np.isfinite(frequencies)
        values = np.broadcast_to(self.D + 0j, (frequencies.size, *self.D.shape)).copy()
        if n and is_finite.any():
            resolvent = 1j * frequencies[is_finite, None, None] * np.eye(n) - self.A
            values[is_finite] += self.C @ np.linalg.solve(resolvent, self.B[None])
        return values

    def minimal(self) -> StateSpace:
        """The same without modes that are not clearly stable and that no input moves or no output shows.

        A hidden stable mode changes nothing that is computed here, so a system without others stays as it is.
        """
        poles = np.linalg.eigvals(self.A)
        if not poles.size or (poles.real < -ON_AXIS * np.abs(poles).max()).all():
            return self
        moved = _reached(self.A, self.B)
        a = _h(moved) @ self.A @ moved
        b = _h(moved) @ self.B
        c = self.C @ moved
        shown = _reached(_h(a), _h(c))
        return StateSpace(_h(shown) @ a @ shown, _h(shown) @ b, c @ shown, self.D)


def _of_law(law: Law) -> StateSpace:
    if isinstance(law, TwoLevel):
        msg = "model: a law of two levels has no linear part; give a PID or a law in state space"
        raise DiscriminationError(msg)
    q = law.n_states
    m = law.n_inputs
    p = law.n_outputs
    slopes = np.zeros((m + q, q + p))
    code = law.code.copy()
    references = np.zeros((1, law.n_references))
    code[LOW : LOW + m] = -np.inf
    code[LOW + m : LOW + 2 * m] = np.inf
    of_kernel = law_slopes.py_func  # type: ignore[attr-defined]  # as kernel it has no entrance from Python
    of_kernel(code, np.zeros(q), references, 0, np.zeros(p), np.zeros(m), slopes)
    return StateSpace(
        slopes[m:, :q], slopes[m:, q:], -slopes[:m, :q], -slopes[:m, q:], law.period
    )


def _h(matrix: Matrix) -> Matrix:
    return np.asarray(matrix.conj().T)


def _reached(A: Matrix, B: Matrix) -> Matrix:
    """Orthonormal basis of the states that the inputs reach, shape (n, reached)."""
    basis = np.zeros((len(A), 0), dtype=A.dtype)
    block = B
    size = np.abs(B).max(initial=0.0)
    while size > 0 and basis.shape[1] < len(A):
        for _ in range(2):  # once leaves what rounding puts back
            block = block - basis @ (_h(basis) @ block)
        directions, lengths, _ = np.linalg.svd(block, full_matrices=False)
        new = directions[:, lengths > NEGLIGIBLE * size]
        if not new.shape[1]:
            break
        basis = np.hstack([basis, new])
        block = A @ new
        size = np.abs(A).max()
    return basis


def inputs_of(system: Any) -> int:
    """Number of inputs of a system of any type; a graph symbol has one."""
    return int(getattr(system, "n_inputs", getattr(system, "ninputs", 1)))


def half_plane(*systems: StateSpace) -> list[StateSpace]:
    """Sampled systems in w, z = (1 + w)/(1 − w), minimal; continuous ones minimal.

    The map leaves every value on the axis of frequencies, and what is stable, as it is. It has no place for a
    pole at z = −1: where one is close, the circle is rotated first, and the matrices become complex.

    Raises:
        DiscriminationError: they have different periods; one without states has any.
    """
    periods = {system.period for system in systems if len(system.A)}
    if len(periods) > 1:
        shown = " and ".join(sorted(map(str, periods)))
        msg = f"ν-gap: models have the periods {shown} s (None: continuous); they must be equal"
        raise DiscriminationError(msg)
    if periods <= {None}:
        return [
            StateSpace(system.A, system.B, system.C, system.D).minimal()
            for system in systems
        ]
    poles = np.concatenate([np.linalg.eigvals(system.A) for system in systems])
    turn: complex = 1.0
    if np.abs(poles + 1).min() < NEAR_MINUS_ONE:
        turns = np.exp(1j * np.linspace(0.1, 1.5, 8))
        turn = max(turns, key=lambda t: float(np.abs(poles * t + 1).min()))
    return [_mapped(system, turn).minimal() for system in systems]


def _mapped(system: StateSpace, turn: complex) -> StateSpace:
    a = system.A * turn
    b = system.B * turn
    identity = np.eye(len(system.A))
    inverse = np.linalg.inv(a + identity)
    through = system.C @ inverse
    root = np.sqrt(2.0)
    return StateSpace(
        inverse @ (a - identity),
        root * inverse @ b,
        root * through,
        system.D - through @ b,
    )
