"""PIDs with a filtered derivative and set-point weights, written as one linear law; several act side by side.

v = Kp·(β·r − y) + I + D, u = clip(v), I ← I + Ts·(Ki·(r − y) + Kb·(u − v)), and D is Kd times the
derivative of γ·r − y through a first-order filter with time constant Tf, by backward differences (Åström and
Hägglund, Advanced PID Control, section 13.4). With Tf = 0, β = 1 and γ = 1 or 0 it is `PidGains`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np

from twinmatch.dynamics.declarations import PlantError
from twinmatch.dynamics.loop import Law, LinearLaw, PidGains
from twinmatch.signals import FloatArray

GREATEST: Final = 1e12
"""Greatest size of a number in a law, in any unit: products of some of them stay finite."""


@dataclass(frozen=True, kw_only=True)
class FilteredPid:
    """A PID of one reading, in units of its command u and its reading y.

    Raises:
        PlantError: a value is not finite or absurdly large, a time is negative, or the limits are not in
            increasing order.
    """

    proportional: float
    """Kp, u per y."""
    integral: float = 0.0
    """Ki, u per y and second."""
    derivative: float = 0.0
    """Kd, u per y/s."""
    back_calculation: float = 0.0
    """Kb, by which the integral tracks the limited command, 1/s."""
    filter: float = 0.0
    """Time constant Tf of the derivative's filter, s."""
    weight: float = 1.0
    """Set-point weight β of the proportional part."""
    derivative_weight: float = 1.0
    """Set-point weight γ of the derivative; 0: the derivative is that of −y."""
    offset: float = 0.0
    """Added to the command, u."""
    low: float
    """Least u."""
    high: float
    """Greatest u."""

    def __post_init__(self) -> None:
        for gain in fields(self):
            if not abs(getattr(self, gain.name)) <= GREATEST:  # true for NaN, too
                raise PlantError(
                    f"pid: {gain.name} is {getattr(self, gain.name):g}; give a finite number, of at most "
                    f"{GREATEST:g} in size"
                )
        if self.filter < 0 or not self.low < self.high:
            raise PlantError(
                f"pid: the filter {self.filter:g} s must not be negative, and the limits {self.low:g} and "
                f"{self.high:g} must be in increasing order"
            )

    @classmethod
    def of(cls, gains: PidGains) -> FilteredPid:
        """The same controller."""
        return cls(
            proportional=gains.proportional,
            integral=gains.integral,
            derivative=gains.derivative,
            back_calculation=gains.back_calculation,
            derivative_weight=0.0 if gains.on_measurement else 1.0,
            low=gains.low,
            high=gains.high,
        )


def pid_law(pids: Sequence[FilteredPid], period: float) -> LinearLaw:
    """The PIDs side by side as one law at a sample time, s: the k-th takes reading and set-point k and gives
    command k. Each has two states, its integral and what its filter remembers; without integral gain only the
    second, since nothing would move the first.

    Raises:
        PlantError: there is none, or the sample time is not positive.
    """
    if not pids or not (math.isfinite(period) and period > 0):
        raise PlantError(
            f"pid: {len(pids)} given at a period of {period:g} s; give one, and a positive period"
        )
    parts = [_matrices(pid, period) for pid in pids]
    A, B, C, D, E, F, G = (
        _block_diagonal(matrices) for matrices in zip(*parts, strict=True)
    )
    offset = np.array([pid.offset for pid in pids])
    return LinearLaw(
        A=A,
        B=B,
        C=C,
        D=D,
        E=E,
        F=F,
        G=G,
        offset=offset,
        shift=-G @ offset,
        low=np.array([pid.low for pid in pids]),
        high=np.array([pid.high for pid in pids]),
        period=period,
    )


def _block_diagonal(blocks: Sequence[FloatArray]) -> FloatArray:
    """As `scipy.linalg.block_diag`, whose package takes a fifth of a start to import."""
    ends = np.cumsum([block.shape for block in blocks], axis=0)
    matrix = np.zeros(ends[-1])
    for block, (last_row, last_column) in zip(blocks, ends, strict=True):
        rows, columns = block.shape
        matrix[last_row - rows : last_row, last_column - columns : last_column] = block
    return matrix


@dataclass(frozen=True, slots=True, eq=False)
class PidLoops(LinearLaw):
    """The PIDs of several loops as one law, which has another sample time if they have."""

    pids: tuple[PidGains, ...] = ()
    """The k-th takes reading and set-point k and gives command k."""

    @classmethod
    def of(cls, *pids: PidGains) -> PidLoops:
        """These PIDs side by side.

        Raises:
            PlantError: there is none, or they have several sample times.
        """
        periods = {gains.period for gains in pids}
        if len(periods) != 1:
            raise PlantError(
                f"pid: {len(pids)} given, every {sorted(periods)} s; give PIDs of one period"
            )
        law = pid_law([FilteredPid.of(gains) for gains in pids], periods.pop())
        return cls(
            **{field.name: getattr(law, field.name) for field in fields(law)}, pids=pids
        )

    def at_period(self, period: float) -> PidLoops:
        """The same PIDs at another sample time, s."""
        if period == self.period:
            return self
        return PidLoops.of(*(replace(gains, period=period) for gains in self.pids))


def pids_of(law: Law | None) -> tuple[PidGains, ...]:
    """The PIDs of which a law consists; of another law, or none, no PIDs."""
    if isinstance(law, PidGains):
        return (law,)
    return law.pids if isinstance(law, PidLoops) else ()


def _matrices(pid: FilteredPid, period: float) -> tuple[np.ndarray, ...]:
    """A, B, C, D, E, F and G of one; its second state is what the filter adds to the next derivative."""
    kept_share = pid.filter / (pid.filter + period)
    rate = pid.derivative / (pid.filter + period)
    tracking = period * pid.back_calculation
    integrated = period * pid.integral
    filtered = rate * (1.0 - kept_share)
    by_reading = -pid.proportional - rate
    by_reference = pid.proportional * pid.weight + rate * pid.derivative_weight
    c = np.array([[1.0, 1.0]])
    d = np.array([[by_reading]])
    e = np.array([[by_reference]])
    a = (
        np.array([[1.0, 0.0], [0.0, kept_share]])
        - tracking * np.array([[1.0], [0.0]]) @ c
    )
    b = np.array([[-integrated - tracking * by_reading], [filtered]])
    f = np.array(
        [[integrated - tracking * by_reference], [-filtered * pid.derivative_weight]]
    )
    g = np.array([[tracking], [0.0]])
    if pid.integral == 0:
        return a[1:, 1:], b[1:], c[:, 1:], d, e, f[1:], g[1:]
    return a, b, c, d, e, f, g


def as_linear(law: Law) -> LinearLaw:
    """The law as a linear one.

    Raises:
        PlantError: it switches between two levels.
    """
    if isinstance(law, LinearLaw):
        return law
    if isinstance(law, PidGains):
        return pid_law([FilteredPid.of(law)], law.period)
    raise PlantError(
        f"{type(law).__name__}: it is not linear; its cycle says what eigenvalues say of others"
    )
