"""Test whether all roots of a polynomial lie in the open left half plane, without rounding."""

from __future__ import annotations

import math

from twinmatch.comparing.polynomials import Polynomial

__all__ = ["is_hurwitz"]


def is_hurwitz(polynomial: Polynomial) -> bool:
    """Routh's test on integers, constant first; a highest coefficient of zero is a root at infinity.

    Roots on the imaginary axis or at infinity are not stable.
    """
    sign = -1 if polynomial[-1] < 0 else 1
    descending = [sign * c for c in reversed(polynomial)]
    if not all(c > 0 for c in descending):
        return False
    above, row = descending[::2], descending[1::2]
    while row:
        if row[0] <= 0:
            return False
        padded = row + [0] * (len(above) - len(row))
        below = [row[0] * above[k] - above[0] * padded[k] for k in range(1, len(above))]
        divisor = math.gcd(*below) or 1
        above, row = row, [c // divisor for c in below]
    return True
