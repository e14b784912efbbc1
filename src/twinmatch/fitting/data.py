"""What is given to a fit, checked: signals, and the orders of Box–Jenkins models."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.errors import TwinmatchError
from twinmatch.signals import FloatArray

ORDERS = ("22221", "33331", "44441", "55551")
"""The ladder of orders of the paper (table II), each nb nc nd nf nk."""

MAX_ORDER = 50
"""Upper limit on the coefficients of a polynomial and on the delay."""


class FittingError(TwinmatchError):
    """Data, orders, bounds or names with which nothing can be fitted."""


class Order(NamedTuple):
    """Coefficients per polynomial and the delay; see `parse_order` for the ways to write one."""

    nb: int
    """Coefficients of B, at least 1."""
    nc: int
    """Degree of the monic C."""
    nd: int
    """Degree of the monic D."""
    nf: int
    """Degree of the monic F."""
    nk: int
    """Delay from u to y in samples: the leading zeros of B."""

    @property
    def predictor_state(self) -> int:
        """Number of initial conditions of the one-step predictor, for B/F and C/D together."""
        return max(self.nf + max(self.nc, self.nd), self.nd + self.nb + self.nk - 1)

    @property
    def coefficients(self) -> int:
        """Free coefficients of B, C, D and F together."""
        return self.nb + self.nc + self.nd + self.nf

    def covers(self, other: Order) -> bool:
        """Whether every model of order `other` is also one of this order."""
        return (
            self.nk <= other.nk
            and self.nk + self.nb >= other.nk + other.nb
            and self.nc >= other.nc
            and self.nd >= other.nd
            and self.nf >= other.nf
        )

    def __str__(self) -> str:
        """As in the paper, `22221`; separated by spaces if a number has two digits."""
        return ("" if max(self) < 10 else " ").join(str(n) for n in self)


def parse_order(order: str | Sequence[int]) -> Order:
    """Read an order from five digits ("22221"), five words ("2 2 2 2 1") or five integers.

    Raises:
        FittingError: not five whole numbers, no coefficient in B, or a number out of range.
    """
    words: Sequence[object] = order
    if isinstance(order, str):
        words = order.replace(",", " ").split()
        if len(words) == 1:
            words = list(order.strip())
    try:
        numbers = [int(str(word)) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != len(Order._fields):
        msg = f'order: {order!r} is not five whole numbers nb nc nd nf nk, such as "22221" or (2, 2, 2, 2, 1)'
        raise FittingError(msg)
    parsed = Order(*numbers)
    if parsed.nb < 1:
        raise FittingError(
            f"order: {order!r} leaves no coefficient for B; nb must be at least 1"
        )
    if min(parsed) < 0 or max(parsed) > MAX_ORDER:
        raise FittingError(
            f"order: {order!r} has a number outside 0 to {MAX_ORDER}; give smaller ones"
        )
    return parsed


def checked_signal(values: ArrayLike, name: str) -> FloatArray:
    """One signal as a float array of shape (N,).

    Raises:
        FittingError: not one-dimensional, empty, or not finite.
    """
    # a copy: kernels are compiled for writable arrays
    signal = np.array(values, dtype=np.float64, order="C")
    if signal.ndim != 1 or signal.size == 0:
        raise FittingError(
            f"{name}: has shape {signal.shape}; give one value per sample"
        )
    bad = np.flatnonzero(~np.isfinite(signal))
    if bad.size:
        raise FittingError(
            f"{name}: {signal[bad[0]]} at sample {bad[0]}; only finite values can be used"
        )
    return signal


def checked_pair(u: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Input and output as float arrays of one length.

    Raises:
        FittingError: as `checked_signal`, or the lengths differ.
    """
    input_ = checked_signal(u, "input u")
    output = checked_signal(y, "output y")
    if input_.size != output.size:
        raise FittingError(
            f"input u has {input_.size} samples and output y {output.size}; give equally many"
        )
    return input_, output
