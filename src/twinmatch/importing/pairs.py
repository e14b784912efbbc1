"""Which columns belong together: those of one thing share a word, and an output moves with its inputs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

import numpy as np

from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

__all__ = ["moving", "share_a_word", "shared_words", "standard_errors", "things_in"]


class _MovingRule(Rule):
    """When an output moves with an input, by regressions of its changes over blocks of rows."""

    sure: float = 8.0
    """Least ratio of an effect to its standard error: residuals of neighbours are alike, blocks are tried."""
    longest: int = 6
    """Blocks are of up to 2 to this power rows."""
    fewest: int = 30
    """Fewest blocks."""


_RULE: Final = _MovingRule()
_WORDS: Final = re.compile(r"[A-Z]?[a-zà-ÿ]+|[A-Z]+(?![a-z])|\d+")
_GENERAL: Final = frozenset(
    [
        "t",
        "temp",
        "temperature",
        "y",
        "u",
        "q",
        "r",
        "x",
        "pv",
        "sp",
        "mv",
        "op",
        "v",
        "i",
        "f",
        "p",
        "c",
        "degc",
        "set",
        "point",
        "setpoint",
        "target",
        "desired",
        "reference",
        "ref",
        "actual",
        "measured",
        "value",
        "val",
        "heater",
        "heating",
        "heat",
        "cool",
        "cooling",
        "cooler",
        "power",
        "pwm",
        "duty",
        "cmd",
        "command",
        "drive",
        "valve",
        "pump",
        "fan",
        "relay",
        "switch",
        "state",
        "sensor",
        "output",
        "input",
        "out",
        "in",
        "speed",
        "level",
        "pressure",
        "flow",
        "position",
        "angle",
        "rate",
        "pct",
        "percent",
        "on",
        "off",
        "status",
        "number",
        "climate",
        "avg",
        "mean",
        "raw",
    ]
)
"""Words that say what a column is, not of which thing."""


def things_in(name: str) -> frozenset[str]:
    """The words of a name that may name a thing, in small letters: `bed` of `bed_pwm`, `1` of `Heater 1`."""
    return frozenset(word.lower() for word in _WORDS.findall(name)) - _GENERAL


def shared_words(name: str, other: str) -> int:
    """How many words that may name a thing two names share: both of `TIC1.PV` and `TIC1.OP`, one of `TIC2.OP`."""
    return len(things_in(name) & things_in(other))


def share_a_word(name: str, other: str) -> bool:
    """Whether two names may be of one thing."""
    return shared_words(name, other) > 0


def moving(output: FloatArray, inputs: Sequence[FloatArray]) -> list[bool]:
    """Which of the inputs an output moves with, once the others are accounted for; each of shape (N,)."""
    is_moving = np.zeros(len(inputs), dtype=np.bool_)
    complete = np.all([np.isfinite(column) for column in (output, *inputs)], axis=0)
    signals = [column[complete] for column in (output, *inputs)]
    for power in range(_RULE.longest + 1):
        block = 2**power
        whole = signals[0].size - signals[0].size % block
        if whole < _RULE.fewest * block:
            break
        means = [signal[:whole].reshape(-1, block).mean(axis=1) for signal in signals]
        is_moving |= np.abs(_effects(means)) > _RULE.sure
    return [bool(moves) for moves in is_moving]


def _effects(means: Sequence[FloatArray]) -> FloatArray:
    """Effects of the inputs on the change of the output to the next block, in standard errors, shape (m,)."""
    output = means[0]
    table = np.column_stack(
        [np.ones(output.size - 1), output[:-1], *(signal[:-1] for signal in means[1:])]
    )
    scales = np.linalg.norm(table, axis=0)
    scales[scales == 0.0] = 1.0
    table /= scales
    changes = np.diff(output)
    coefficients, _, rank, _ = np.linalg.lstsq(table, changes, rcond=None)
    if rank < table.shape[1]:
        return np.zeros(len(means) - 1)
    errors = np.maximum(standard_errors(table, changes - table @ coefficients), 1e-150)
    return np.asarray(coefficients[2:] / errors[2:], dtype=np.float64)


def standard_errors(table: FloatArray, left: FloatArray) -> FloatArray:
    """Standard errors of the coefficients of a regression on the columns of a table, shape (N, n), that left
    these residuals, shape (N,); shape (n,).

    Where columns depend on each other, those of the smallest coefficients.
    """
    scales = np.linalg.norm(table, axis=0)
    scales[scales == 0.0] = 1.0
    variance = float(left @ left) / max(left.size - table.shape[1], 1)
    inverse = np.linalg.pinv(table / scales)
    return np.asarray(np.sqrt(variance) * np.linalg.norm(inverse, axis=1) / scales)
