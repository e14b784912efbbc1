"""Code length and information gain (paper, section II-A).

A table of numbers costs the characters it takes to write it. A number is rounded to the decimals of the
score and then written as its sign and its digits, with

* no decimal point and no leading zeros: 10.34 is `+1034`, five characters; −0.45 is `-45`, three;
* no trailing zeros after the decimal point: 323.10 K is `+3231`, five; but 320.00 K is `+320`, four,
  because the zeros of the integer part are digits like any other. This is how a single number prints,
  and what the published lengths show: 5.87 to 5.94 characters per temperature sample, where keeping
  both decimals would give 6 exactly;
* zero as `+0`, two characters. The paper leaves it open; a sample cannot cost less than its sign and a
  digit. A value that rounds to zero is zero, whatever its sign.

Rounding is of the exact value of the float, ties to even, as Python prints it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.comparing.polynomials import DiscriminationError
from twinmatch.compiled import compiled
from twinmatch.signals import FloatArray

TRIVIAL_PROGRAM = 15
"""Length of the program that only prints the table (paper, section IV)."""

MODEL_PROGRAM = 176
"""Length of the program that runs a Box–Jenkins model of any order (paper, section IV)."""

MAX_DECIMALS = 15

_EXACT = 2.0**52  # below this a scaled value still resolves halves


@dataclass(frozen=True, slots=True)
class InformationGain:
    """Saving in length when a signal is written with a model."""

    trivial_length: int
    """l(t): program and table of the measured values, characters."""
    model_length: int
    """l(p): program and table of what the model leaves unexplained, characters."""

    @property
    def gain(self) -> int:
        """I = l(t) − l(p), characters; negative when the model is worse than the bare table."""
        return self.trivial_length - self.model_length

    @property
    def explanation(self) -> float:
        """I / l(t), at most 1; negative when the model is worse than the bare table."""
        return self.gain / self.trivial_length


def code_length(values: ArrayLike, decimals: int) -> int:
    """Characters of a table of numbers, each rounded to `decimals` first.

    Args:
        values: numbers of any shape, in the unit they are to be written in.
        decimals: digits kept after the decimal point, 0 to 15.

    Raises:
        DiscriminationError: a value is not finite, or `decimals` is out of range.
    """
    if not 0 <= decimals <= MAX_DECIMALS:
        raise DiscriminationError(
            f"code length: {decimals} decimals; give 0 to {MAX_DECIMALS}"
        )
    table = np.array(values, dtype=np.float64).ravel()
    bad = np.flatnonzero(~np.isfinite(table))
    if bad.size:
        raise DiscriminationError(
            f"code length: entry {bad[0]} of the table is {table[bad[0]]}; only finite values can be written"
        )
    plain, exceptions = _characters(table, decimals, 10.0**decimals)
    return plain + sum(len(_text_of(table[place], decimals)) for place in exceptions)


def information_gain(
    measured: ArrayLike, simulated: ArrayLike, decimals: int = 2, copied: int = 0
) -> InformationGain:
    """Information gain of a simulated signal over the bare table of the measured one (paper, section II-A).

    Give temperatures in kelvin to compare with the published gains.

    Args:
        measured: signal of the plant, shape (N,).
        simulated: the model's output, shape (N,), same unit.
        decimals: digits kept after the decimal point in both tables, 0 to 15.
        copied: number of samples at the start that are the model's initial conditions: its table holds
            the measured values there, not the differences.

    Raises:
        DiscriminationError: unequal shapes, no sample, values that are not finite, `decimals` or
            `copied` out of range.
    """
    observed = np.asarray(measured, dtype=np.float64)
    modelled = np.asarray(simulated, dtype=np.float64)
    if observed.ndim != 1 or observed.shape != modelled.shape or not observed.size:
        raise DiscriminationError(
            f"information gain: the measured signal has shape {observed.shape}, the simulated one "
            f"{modelled.shape}; give two signals of the same number of samples"
        )
    if not 0 <= copied <= observed.size:
        msg = f"information gain: {copied} of {observed.size} samples copied; give 0 to {observed.size}"
        raise DiscriminationError(msg)
    trivial = code_length(observed, decimals)
    with np.errstate(over="ignore", invalid="ignore"):
        errors = observed[copied:] - modelled[copied:]
    bad = np.flatnonzero(~np.isfinite(errors))
    if bad.size:
        k = copied + int(bad[0])
        raise DiscriminationError(
            f"information gain: at sample {k} the measured value is {observed[k]} and the simulated one "
            f"{modelled[k]}; their difference must be finite"
        )
    model = code_length(observed[:copied], decimals) + code_length(errors, decimals)
    return InformationGain(TRIVIAL_PROGRAM + trivial, MODEL_PROGRAM + model)


def two_part_length(model_length: float, parameters: int, samples: int) -> float:
    """Length of a model's program and table, including the parameters that the program needs.

    The published length charges 176 characters for the program of any order, as if its coefficients were
    known beforehand. In a two-part code (Rissanen, Automatica 14, 1978) they are transmitted before the
    table. N samples determine a parameter to about 1/√N of its size, and a finer resolution lengthens the
    total: each takes ½ log₂ N bits, which are ½ log₁₀ N digits, and its sign. So

        l₂(p) = l(p) + n (1 + ½ log₁₀ N) characters.

    Args:
        model_length: l(p), characters.
        parameters: n, the number of coefficients that the program needs: those of B and F, because the
            table belongs to the simulated B/F.
        samples: N, the number of samples in the table.

    Raises:
        DiscriminationError: no samples, or a number of parameters below zero.
    """
    if samples < 1 or parameters < 0:
        msg = f"two-part length: {parameters} parameters and {samples} samples; give at least 0 and 1"
        raise DiscriminationError(msg)
    return model_length + parameters * (1 + 0.5 * math.log10(samples))


@compiled
def _characters(
    table: FloatArray, decimals: int, scale: float
) -> tuple[int, list[int]]:
    """Characters of the numbers that exact arithmetic can round, and the places of the others."""
    total = 0
    exceptions = [0][:0]
    for place in range(table.size):
        scaled = abs(table[place]) * scale
        nearest = np.rint(scaled)
        # A product that rounds to a half may be a little more or less.
        if not scaled < _EXACT or abs(scaled - nearest) == 0.5:
            exceptions.append(place)
            continue
        digits = int(nearest)
        after = decimals
        while after > 0 and digits > 0 and digits % 10 == 0:
            digits //= 10
            after -= 1
        total += 2
        while digits > 9:
            digits //= 10
            total += 1
    return total, exceptions


def _text_of(value: float, decimals: int) -> str:
    """Format one number as in the table; exact where integer arithmetic is not."""
    whole, _, fraction = f"{abs(value):.{decimals}f}".partition(".")
    text = (whole + fraction.rstrip("0")).lstrip("0") or "0"
    return ("-" if value < 0 and text != "0" else "+") + text
