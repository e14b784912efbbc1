"""Whether a polynomial has all its roots in the open left half plane, decided without rounding."""

from __future__ import annotations

import math

from twinmatch.discrimination.polynomials import Polynomial

__all__ = ["is_hurwitz"]


def is_hurwitz(polynomial: Polynomial) -> bool:
    """Routh's test on integers, the constant first; a vanishing highest coefficient is a root at infinity.

    Roots on the imaginary axis or at infinity are not stable.
    """
    sign = -1 if polynomial[-1] < 0 else 1
    falling = [sign * c for c in reversed(polynomial)]
    if not all(c > 0 for c in falling):
        return False
    above, row = falling[::2], falling[1::2]
    while row:
        if row[0] <= 0:
            return False
        padded = row + [0] * (len(above) - len(row))
        below = [row[0] * above[k] - above[0] * padded[k] for k in range(1, len(above))]
        divisor = math.gcd(*below) or 1
        above, row = row, [c // divisor for c in below]
    return True
