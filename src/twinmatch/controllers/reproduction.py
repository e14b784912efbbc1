"""The commands that a law gives for recorded readings: whether it is the one that ran."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from twinmatch.controllers.responses import state_holding
from twinmatch.dynamics import LinearLaw, TwoLevel, commands_of
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

_NEAR: Final = 0.01
"""Distance up to which a command is reproduced, as a share of its range: recordings are rounded."""


class _FirstSamples(Rule):
    """How a law's first state is estimated.

    As recordings are rounded, several samples count for each of the law's states, and directions that
    rounding alone would determine are left out.
    """

    per_state: int = 20
    """Samples for each state, at most."""
    determined: float = 1e-9
    """Singular values below this share of the largest determine nothing."""


_FIRST: Final = _FirstSamples()


class Reproduction(NamedTuple):
    """A law that has run over a recording."""

    state: FloatArray
    """Its state before the first sample, shape (q,)."""
    share: float
    """Share of the recorded commands that it gives, to within 1 % of their range."""


def reproduced(
    law: LinearLaw | TwoLevel,
    references: FloatArray,
    readings: FloatArray,
    inputs: FloatArray,
) -> Reproduction:
    """Run a law over recorded set-points, shape (N, r), and readings, shape (N, o), beside the recorded
    commands, shape (N, m).

    Its state at the beginning follows from the first commands within their limits. Where the recording begins
    at a limit, it is zero: a law that has just been switched on.
    """
    if isinstance(law, TwoLevel):
        state = state_holding(law, references[0], readings[0], inputs[0])
        ranges = np.array(law.on - law.off)
    else:
        state = _first_state(law, references, readings, inputs)
        ranges = law.high - law.low
    commands = commands_of(law.code, state, references, readings)[0]
    is_reproduced = np.abs(commands - inputs) <= _NEAR * np.abs(ranges)
    return Reproduction(state, float(np.mean(is_reproduced)))


def _first_state(
    law: LinearLaw, references: FloatArray, readings: FloatArray, inputs: FloatArray
) -> FloatArray:
    """The state with which the first commands within their limits are reproduced best, shape (q,)."""
    beginning = inputs[: _FIRST.per_state * law.n_states]
    is_limited = ((beginning <= law.low) | (beginning >= law.high)).any(axis=1)
    size = int(is_limited.argmax()) if is_limited.any() else len(beginning)
    zero = np.zeros(law.n_states)
    if not size:
        return zero
    powers = [law.C]
    for _ in range(size - 1):
        powers.append(powers[-1] @ (law.A + law.G @ law.C))
    from_zero = commands_of(law.code, zero, references[:size], readings[:size])[0]
    of_state = (inputs[:size] - from_zero).ravel()
    return np.array(
        np.linalg.lstsq(np.vstack(powers), of_state, rcond=_FIRST.determined)[0]
    )
