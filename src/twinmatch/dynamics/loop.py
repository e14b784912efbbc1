"""The loop around a plant as a user declares it: a PID, two levels with hysteresis, or a linear law.

The PID has the parallel form, forward Euler, and back-calculation against windup.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.dynamics import laws
from twinmatch.dynamics.declarations import PlantError
from twinmatch.dynamics.laws import LINEAR, LOW, PID, TWO_LEVEL, LawCode, commands_of
from twinmatch.signals import FloatArray, Window, finite

_MAX_AMPLIFICATION = 1e3


@dataclass(frozen=True)
class Law(ABC):
    """A law as a plant file declares it: q states, m commands from p readings and r set-points."""

    @property
    @abstractmethod
    def period(self) -> float:
        """Sample time, s."""

    def at_period(self, period: float) -> Law:
        """The same law at another sample time, s: its gains are per second, and its times in seconds.

        Raises:
            PlantError: its numbers hold at its own sample time only.
        """
        changes: dict[str, Any] = {"period": period}
        return self if period == self.period else replace(self, **changes)

    def require_period(self, period: float) -> None:
        """Raise `PlantError` if its sample time is another one, s."""
        if period != self.period:
            raise PlantError(
                f"the law runs every {self.period:g} s, the samples come every {period:g} s; give a law with "
                f"period={period:g}"
            )

    @property
    @abstractmethod
    def GAINS(self) -> Mapping[str, int]:  # noqa: N802
        """Places of the gains in its `code`, by name."""

    @property
    @abstractmethod
    def n_states(self) -> int:
        """Number of states q."""

    @property
    def n_outputs(self) -> int:
        """Number of readings p that it takes."""
        return 1

    @property
    def n_inputs(self) -> int:
        """Number of commands m."""
        return 1

    @property
    def n_references(self) -> int:
        """Number of set-points r."""
        return 1

    @property
    @abstractmethod
    def code(self) -> LawCode:
        """The same numbers for compiled code, written once; not to be changed."""

    @abstractmethod
    def state(self, window: Window) -> FloatArray:
        """Its state after the window's second sample, shape (q,)."""

    @abstractmethod
    def follow(
        self,
        state: FloatArray,
        reference: FloatArray,
        output: FloatArray,
        u: FloatArray,
    ) -> FloatArray:
        """The state after a sample with these commands."""

    @abstractmethod
    def saturates(self, u: float | FloatArray) -> bool:
        """Whether a command is on a limit."""


@dataclass(frozen=True)
class PidGains(Law):
    """Gains and limits of the controller, in units of the plant's input u and output y.

    Raises:
        PlantError: a value is not finite, the period is not positive, or the limits are not in order.
    """

    proportional: float
    """u per y."""
    integral: float
    """u per y and second."""
    derivative: float
    """u per y/s."""
    back_calculation: float
    """Back-calculation gain Kb, by which the integral tracks the limited u, 1/s; see `tracking`."""
    low: float
    """Least u."""
    high: float
    """Greatest u."""
    period: float = 1.0
    """Sample time Ts, s."""
    on_measurement: bool = False
    """Whether the derivative is that of −y, which avoids derivative kick at set-point steps."""

    n_states: ClassVar[int] = 2
    GAINS: ClassVar[Mapping[str, int]] = {
        "proportional": laws.PROPORTIONAL,
        "integral": laws.INTEGRAL,
        "derivative": laws.DERIVATIVE,
        "back_calculation": laws.BACK,
    }

    def __post_init__(self) -> None:
        if not all(math.isfinite(getattr(self, gain.name)) for gain in fields(self)):
            raise PlantError(f"PID gains: {self} holds a value that is not finite")
        if self.period <= 0 or not self.low < self.high:
            raise PlantError(
                f"PID gains: the period {self.period} s must be positive and the limits {self.low} and "
                f"{self.high} in increasing order"
            )

    @cached_property
    def code(self) -> LawCode:
        """The same numbers for compiled code."""
        head = [PID, self.period, 1, self.low, self.high]
        gains = [self.proportional, self.integral, self.derivative]
        numbers = [*head, *gains, self.tracking, self.on_measurement]
        return np.array(numbers, dtype=np.float64)

    @property
    def tracking(self) -> float:
        """The back-calculation gain that acts, 1/s: without integral gain nothing would undo what it adds."""
        return self.back_calculation if self.integral else 0.0

    def state(self, window: Window) -> FloatArray:
        """Its state after the window's second sample, shape (2,)."""
        return np.array(controller_state(window, self))

    def follow(
        self,
        state: FloatArray,
        reference: FloatArray,
        output: FloatArray,
        u: FloatArray,
    ) -> FloatArray:
        """The state after a sample with this command.

        With Kb·Ts = 1 the sample and the one before it determine it. Otherwise they do so if u was not
        limited; if it was, the integral is updated by the back-calculation, which forgets by the factor
        1 − Kb·Ts each sample.
        """
        error = float(reference[0] - output[0])
        command = float(u[0])
        moved = -float(output[0]) if self.on_measurement else error
        consistent = _consistent_integral(self, error, moved - float(state[1]), command)
        before = float(state[0]) if self.saturates(command) else consistent
        return np.array([_next_integral(self, before, consistent, error), moved])

    def saturates(self, u: float | FloatArray) -> bool:
        """Whether a command is on a limit."""
        return not self.low < float(u) < self.high


class PidState(NamedTuple):
    """State of the controller between two samples."""

    integral: float = 0.0
    """Integral part of the next u, in its unit."""
    previous: float = 0.0
    """The differentiated signal at the last sample: e = r − y, or −y."""


def controller_state(window: Window, gains: PidGains) -> PidState:
    """State of the controller after the window's second sample, found from the recorded signals.

    With Kb·Ts = 1 it follows exactly from the first two samples. Otherwise it is exact if the second
    sample is not limited; if it is, the state is computed backwards from the first sample that is not
    limited, unless there is none or that would amplify rounding more than a thousandfold: then the
    smallest state that explains the limited sample is used.

    Raises:
        PlantError: the window holds fewer than two samples.
    """
    if len(window) < 2:
        raise PlantError(
            f"controller state: the window holds {len(window)} sample; give at least two"
        )
    error = window.reference - window.output
    moved = -window.output if gains.on_measurement else error
    kept_share = 1.0 - gains.tracking * gains.period
    free = next(
        (
            k
            for k in range(1, len(window))
            if not gains.saturates(float(window.input[k]))
        ),
        None,
    )

    def consistent(k: int) -> float:
        change = float(moved[k] - moved[k - 1])
        return _consistent_integral(
            gains, float(error[k]), change, float(window.input[k])
        )

    integral = consistent(1)
    if (
        free is not None
        and free > 1
        and abs(kept_share) ** (free - 1) * _MAX_AMPLIFICATION >= 1
    ):
        integral = consistent(free)
        for k in range(free - 1, 0, -1):
            integral += (1 - kept_share) * (integral - consistent(k)) / kept_share
            integral -= gains.period * gains.integral * float(error[k]) / kept_share
    return PidState(
        _next_integral(gains, integral, consistent(1), float(error[1])), float(moved[1])
    )


def _consistent_integral(
    gains: PidGains, error: float, change: float, u: float
) -> float:
    """The integral with which the unlimited controller gives exactly this u."""
    return u - gains.proportional * error - gains.derivative * change / gains.period


def _next_integral(
    gains: PidGains, integral: float, consistent: float, error: float
) -> float:
    # u − v = consistent − integral; with Kb·Ts = 1 the integral before the sample drops out.
    excess = gains.tracking * gains.period * (consistent - integral)
    return integral + excess + gains.period * gains.integral * error


def _finite(**signals: ArrayLike) -> list[FloatArray]:
    rows = []
    for name, value in signals.items():
        row = np.array(value, dtype=np.float64, ndmin=1)
        if not finite(row):
            shown = row.item() if row.size == 1 else row.tolist()
            raise PlantError(
                f"controller: {name} is {shown}; the controller takes only finite values"
            )
        rows.append(row)
    return rows


@dataclass(frozen=True)
class TwoLevel(Law):
    """Two commands with hysteresis and dwell times: on where the reading falls below r − `below`, off where
    it rises above r + `above`.

    Raises:
        PlantError: a value is not finite or negative, or the levels are not in order.
    """

    off: float
    """Command while it is off."""
    on: float
    """Command while it is on, above `off`."""
    below: float
    """Unit of the output; as `above`."""
    above: float
    least_on: float = 0.0
    """Shortest time that it stays on, s."""
    least_off: float = 0.0
    """Shortest time that it stays off, s."""
    most_on: float = math.inf
    """Longest time that it stays on, s."""
    period: float = 1.0
    """Sample time, s."""

    n_states: ClassVar[int] = 3
    GAINS: ClassVar[Mapping[str, int]] = {
        "below": laws.BELOW,
        "above": laws.ABOVE,
        "least_on": laws.MIN_ON,
        "least_off": laws.MIN_OFF,
        "most_on": laws.MAX_ON,
    }

    def __post_init__(self) -> None:
        for name in ("off", "on", "below", "above", "least_on", "least_off", "period"):
            value = getattr(self, name)
            if not math.isfinite(value) or (
                value < 0 and name not in ("off", "on", "below", "above")
            ):
                raise PlantError(
                    f"two-level law: {name} is {value}; give a finite number, times not negative"
                )
        if (
            not self.off < self.on
            or not self.below + self.above >= 0
            or not self.period > 0
        ):
            raise PlantError(
                f"two-level law: {self}: give off below on, limits that do not cross, and a positive period"
            )
        if not self.most_on > self.least_on:
            raise PlantError(
                f"two-level law: most_on is {self.most_on} s; give more than least_on"
            )

    @cached_property
    def code(self) -> LawCode:
        """The same numbers for compiled code."""
        head = [TWO_LEVEL, self.period, 1]
        levels = [self.off, self.on, self.below, self.above]
        times = [self.least_on, self.least_off, self.most_on]
        return np.array([*head, *levels, *times], dtype=np.float64)

    def state(self, window: Window) -> FloatArray:
        """Its state after the window's second sample, shape (3,): whether it is on, for how long (since the
        first sample, if the command did not change), and the reading."""
        on = window.inputs[:2, 0] > 0.5 * (self.off + self.on)
        lasted = self.least_on + self.least_off if on[0] == on[1] else 0.0
        return np.array([float(on[1]), lasted, window.outputs[1, 0]])

    def saturates(self, u: float | FloatArray) -> bool:  # noqa: ARG002
        """Whether a command is on a limit: the two levels are its only commands."""
        return False

    def follow(
        self,
        state: FloatArray,
        reference: FloatArray,  # noqa: ARG002
        output: FloatArray,
        u: FloatArray,
    ) -> FloatArray:
        """The state after a sample with this command."""
        on = float(u[0] > 0.5 * (self.off + self.on))
        return np.array(
            [on, state[1] + self.period if on == state[0] else 0.0, output[0]]
        )


@dataclass(frozen=True, eq=False)
class LinearLaw(Law):
    """u = clip(C·x + D·y + E·r + offset), then x ← A·x + B·y + F·r + G·u + shift, with q states x.

    An observer with state feedback is such a law; G is how it takes the limited command into account.

    Raises:
        PlantError: a shape does not fit, a value is not finite, or the limits are not in order.
    """

    A: FloatArray
    """Shape (q, q)."""
    B: FloatArray
    """Of the readings, shape (q, p)."""
    C: FloatArray
    """Shape (m, q)."""
    D: FloatArray
    """Shape (m, p)."""
    E: FloatArray
    """Of the set-points, shape (m, r)."""
    F: FloatArray
    """Shape (q, r)."""
    G: FloatArray
    """Of the commands, shape (q, m)."""
    offset: FloatArray
    """Shape (m,)."""
    shift: FloatArray
    """Shape (q,)."""
    low: FloatArray
    """Least commands, shape (m,)."""
    high: FloatArray
    """Greatest commands, shape (m,)."""
    period: float = 1.0
    """Sample time, s."""
    drives: FloatArray | None = None
    """Least and greatest commands that the drives take, shape (2, m), of which the law does not know; None:
    they take all. Simulations count with them, derivatives do not."""

    def __post_init__(self) -> None:
        for part in fields(LinearLaw)[:-2]:
            object.__setattr__(
                self, part.name, np.array(getattr(self, part.name), dtype=np.float64)
            )
        if self.C.ndim != 2 or self.D.ndim != 2 or self.E.ndim != 2:
            raise PlantError(
                "linear law: C, D and E must be matrices with a row for each command"
            )
        m, q = self.C.shape
        p = self.D.shape[1]
        r = self.E.shape[1]
        shapes = {
            "A": (q, q),
            "B": (q, p),
            "D": (m, p),
            "E": (m, r),
            "F": (q, r),
            "G": (q, m),
            "offset": (m,),
            "shift": (q,),
            "low": (m,),
            "high": (m,),
        }
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value.shape != shape or np.isnan(value).any():
                raise PlantError(
                    f"linear law: {name} has shape {value.shape}; give numbers of shape {shape}"
                )
        if not (self.low < self.high).all() or not (
            math.isfinite(self.period) and self.period > 0
        ):
            raise PlantError(
                "linear law: give limits in increasing order, and a positive period"
            )

    def at_period(self, period: float) -> Law:
        """The law itself; its matrices hold at its own sample time, s.

        Raises:
            PlantError: another one is given.
        """
        self.require_period(period)
        return self

    @property
    def GAINS(self) -> Mapping[str, int]:  # noqa: N802
        """Places of the entries of its matrices in its `code`, by names such as "D[0,1]"."""
        m, q = self.C.shape
        p = self.D.shape[1]
        r = self.E.shape[1]
        width = q + p + r + 1 + m
        begin = LOW + 2 * m
        corners = {
            "C": (0, 0),
            "D": (0, q),
            "E": (0, q + p),
            "A": (m, 0),
            "B": (m, q),
            "F": (m, q + p),
        }
        places = {}
        for name, (row, column) in corners.items():
            for i, j in np.ndindex(getattr(self, name).shape):
                place = begin + (row + i) * width + column + j
                places[f"{name}[{i},{j}]"] = place
        return places

    @property
    def n_states(self) -> int:
        """Number of states q."""
        return int(self.C.shape[1])

    @property
    def n_outputs(self) -> int:
        """Number of readings p that it takes."""
        return int(self.D.shape[1])

    @property
    def n_inputs(self) -> int:
        """Number of commands m."""
        return int(self.C.shape[0])

    @property
    def n_references(self) -> int:
        """Number of set-points r."""
        return int(self.E.shape[1])

    @cached_property
    def code(self) -> LawCode:
        """The same numbers for compiled code."""
        m = self.n_inputs
        numbers = np.block(
            [
                [self.C, self.D, self.E, self.offset[:, None], np.zeros((m, m))],
                [self.A, self.B, self.F, self.shift[:, None], self.G],
            ]
        )
        drive_limits = np.zeros(0) if self.drives is None else self.drives.ravel()
        head = [LINEAR, self.period, m]
        flat = numbers.ravel()
        return np.concatenate([head, self.low, self.high, flat, drive_limits])

    def state(self, window: Window) -> FloatArray:
        """Its state after the window's second sample, shape (q,): the one with which it gives the recorded
        commands, as far as they are within the limits; of several, the smallest."""
        q = self.n_states
        y = window.outputs
        r = window.references
        u = window.inputs
        driven = y @ self.B.T + r @ self.F.T + u @ self.G.T + self.shift
        expected = u - y @ self.D.T - r @ self.E.T - self.offset
        free = (u > self.low) & (u < self.high)
        state_part = np.zeros(q)
        power = np.eye(q)
        rows = []
        unexplained = []
        for k in range(2, len(window)):
            rows.append((self.C @ power)[free[k]])
            unexplained.append((expected[k] - self.C @ state_part)[free[k]])
            state_part = self.A @ state_part + driven[k]
            power = self.A @ power
            if len(rows) >= 4 * q + 2:
                break
        state: FloatArray = np.linalg.lstsq(
            np.concatenate(rows), np.concatenate(unexplained), rcond=None
        )[0]
        return state

    def saturates(self, u: float | FloatArray) -> bool:
        """Whether a command is on a limit."""
        commands = np.array(u, dtype=np.float64)
        return bool(((commands <= self.low) | (commands >= self.high)).any())

    def follow(
        self,
        state: FloatArray,
        reference: FloatArray,
        output: FloatArray,
        u: FloatArray,
    ) -> FloatArray:
        """The state after a sample with these commands."""
        return (
            self.A @ state
            + self.B @ output
            + self.F @ reference
            + self.G @ u
            + self.shift
        )


def state_of(loop: Law, state: ArrayLike | None) -> FloatArray:
    """A copy of a law's state, by default zero, shape (q,).

    Raises:
        PlantError: it has another size than the law's, or is not finite.
    """
    values = (
        np.zeros(loop.n_states) if state is None else np.array(state, dtype=np.float64)
    )
    if values.shape != (loop.n_states,) or not finite(values):
        raise PlantError(
            f"controller: state {values.tolist()} given; give {loop.n_states} finite values"
        )
    return values


class Controller:
    """A law in operation, sample by sample, from a given state or zero.

    Raises:
        PlantError: the state has another size than the law's, or is not finite.
    """

    def __init__(self, loop: Law, state: ArrayLike | None = None) -> None:
        self.loop = loop
        self.state = state_of(loop, state)
        """Shape (q,)."""
        self._law = loop.code

    def step(self, reference: ArrayLike, output: ArrayLike) -> FloatArray:
        """Compute the commands of one sample, shape (m,), from set-points and readings, shape (r,) and (p,);
        single ones may be numbers.

        Raises:
            PlantError: a value is not finite; the state is unchanged.
        """
        rows = _finite(reference=reference, output=output)
        u, self.state = commands_of(self._law, self.state, rows[0][None], rows[1][None])
        row: FloatArray = u[0]
        return row

    def follow(self, reference: ArrayLike, output: ArrayLike, u: ArrayLike) -> None:
        """Adopt the state after a sample whose commands another controller with the same law computed.

        Raises:
            PlantError: a value is not finite; the state is unchanged.
        """
        self.state = self.loop.follow(
            self.state, *_finite(reference=reference, output=output, input=u)
        )
