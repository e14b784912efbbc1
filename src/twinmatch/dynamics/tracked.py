"""What stays while a plant is followed: the form in which the compiled code takes it."""

from __future__ import annotations

from typing import Any, NamedTuple

from twinmatch.signals import FloatArray

__all__ = ["Tracked"]


class Tracked(NamedTuple):
    """Of m parameters that are followed, of a belief of n numbers."""

    vector: FloatArray
    """All parameters of the plant where the following begins."""
    places: Any
    """Where the m parameters stand among them, integers, shape (m,)."""
    which: Any
    """Where their tangents stand, integers, shape (m,)."""
    logged: Any
    """Whether a parameter is followed by the logarithm of its share of the start, shape (m,)."""
    least: FloatArray
    """Least that is believed of it, in that form, shape (m,)."""
    most: FloatArray
    """Most that is believed of it, shape (m,)."""
    keeps: FloatArray
    """What is left after a period of everything that fades, 1 of what stays, shape (n,)."""
    rest: float
    """Drive at rest."""
    period: float
    """Sample time, s."""
    steps: int
    """Runge–Kutta steps per sample."""
