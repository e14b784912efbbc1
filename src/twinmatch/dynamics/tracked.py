"""The constants of a tracker, in the form that compiled code takes."""

from __future__ import annotations

from typing import Any, NamedTuple

from twinmatch.signals import FloatArray

__all__ = ["Tracked"]


class Tracked(NamedTuple):
    """Constants for m tracked parameters and a belief of n numbers."""

    vector: FloatArray
    """Initial values of all parameters of the plant."""
    places: Any
    """Indices of the m parameters among them, integers, shape (m,)."""
    which: Any
    """Indices of their tangents, integers, shape (m,)."""
    logged: Any
    """Whether a parameter is tracked as the logarithm of its ratio to the initial value, shape (m,)."""
    least: FloatArray
    """Lower limit of each parameter, in that form, shape (m,)."""
    most: FloatArray
    """Upper limit, shape (m,)."""
    keeps: FloatArray
    """Factor per period on each number: below 1 for those that fade, 1 for the others, shape (n,)."""
    rest: float
    """Rest value of the drive."""
    period: float
    """Sample time, s."""
    steps: int
    """Runge–Kutta steps per sample."""
