"""Samples and windows: the only data exchanged between the subpackages.

A `Sample` is one tick of the control loop. At tick k the reference r[k], the output y[k] of the plant and
its disturbances are read and the input u[k] is computed from them; u[k] then drives the plant until tick
k+1. A `Window` is a run of consecutive samples as arrays. The units are the plant's: on the Peltier rig
the output is the plate's temperature in °C and the input the PWM command, −255 to 255.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from twinmatch.errors import TwinmatchError

__all__ = [
    "KELVIN",
    "BoolArray",
    "FloatArray",
    "Sample",
    "SignalError",
    "Window",
    "bridge",
    "finite",
    "not_one_loop",
    "only",
    "unbroken",
]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

KELVIN = 273.15
"""Zero Celsius in kelvin."""

_NONE: FloatArray = np.empty((0, 0))
"""Default for a window without disturbances."""


def finite(values: FloatArray) -> bool:
    """Whether all values are finite; of a few values in a fraction of the time of `np.isfinite(…).all()`."""
    return math.isfinite(np.vdot(values, values)) or bool(np.isfinite(values).all())


class SignalError(TwinmatchError):
    """Arrays that do not make a window: unequal lengths, not finite, invalid period; or not a single loop."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One tick of the loop."""

    index: int
    """Count of ticks since the session began, without gaps."""
    stamp: int
    """Time of the tick in nanoseconds since the epoch of its clock."""
    reference: float
    """Set-point r, in the output's unit."""
    output: float
    """Measured output y of the plant."""
    input: float
    """Command u computed at this tick."""
    disturbances: tuple[float, ...] = ()
    """Measured disturbances, in the plant's order; the rig has none."""
    seen: bool = True
    """Whether it was received; False: its values are those that `bridge` puts in the place of a lost one."""


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Consecutive samples as read-only float64 arrays, one row per sample.

    Signals of one column may be given as arrays of shape (N,).
    """

    references: FloatArray
    """Set-points r, in the outputs' units, shape (N, r)."""
    outputs: FloatArray
    """Measured outputs y, shape (N, o)."""
    inputs: FloatArray
    """Commands u, shape (N, m)."""
    first: int = 0
    """Index of the first sample in its session."""
    period: float = 1.0
    """Sample time, s."""
    disturbances: FloatArray = field(default_factory=lambda: _NONE)
    """Measured disturbances, shape (N, m); by default none, m = 0."""
    seen: BoolArray | None = None
    """Which samples were received, shape (N,); the values of the others are estimates, which no fit and no
    score counts. None: all."""

    def __post_init__(self) -> None:
        lengths = set()
        for name in ("references", "outputs", "inputs"):
            values = np.array(getattr(self, name), dtype=np.float64)
            if values.ndim not in (1, 2):
                msg = f"window: {name} have shape {values.shape}; give one row per sample"
                raise SignalError(msg)
            self._keep(name, values[:, None] if values.ndim == 1 else np.ascontiguousarray(values))
            lengths.add(len(values))
        if len(lengths) != 1:
            msg = f"window: references, outputs and inputs have lengths {sorted(lengths)}; they must be equal"
            raise SignalError(msg)
        given = np.empty((len(self), 0)) if self.disturbances is _NONE else self.disturbances
        disturbances = np.array(given, dtype=np.float64)
        if disturbances.ndim != 2 or len(disturbances) != len(self):
            raise SignalError(
                f"window: disturbances have shape {disturbances.shape}; "
                f"give one row for each of the {len(self)} samples"
            )
        self._keep("disturbances", disturbances)
        if self.seen is not None:
            seen = np.array(self.seen, dtype=np.bool_)
            if seen.shape != (len(self),):
                msg = f"window: seen has shape {seen.shape}; give one truth value for each of {len(self)}"
                raise SignalError(msg)
            seen.flags.writeable = False
            object.__setattr__(self, "seen", None if seen.all() else seen)
        if not (np.isfinite(self.period) and self.period > 0):
            msg = f"window: the period is {self.period} s; it must be positive"
            raise SignalError(msg)

    def _keep(self, name: str, values: FloatArray) -> None:
        """Store finite values as a read-only field."""
        if not finite(values):
            bad = np.argwhere(~np.isfinite(values))[0]
            raise SignalError(
                f"window: {name} is {values[tuple(bad)]} at sample {self.first + int(bad[0])}; "
                "only finite values can be used"
            )
        values.flags.writeable = False
        object.__setattr__(self, name, values)

    @classmethod
    def from_samples(cls, samples: Sequence[Sample], period: float = 1.0) -> Window:
        """Gather consecutive samples.

        Raises:
            SignalError: there is no sample, their indices are not consecutive, or they have different
                numbers of disturbances.
        """
        if not samples:
            raise SignalError("window: there is no sample; give at least one")
        indices = np.array([s.index for s in samples])
        gaps = np.flatnonzero(np.diff(indices) != 1)
        if gaps.size:
            before, after = indices[gaps[0]], indices[gaps[0] + 1]
            msg = f"window: sample {after} follows sample {before}; give consecutive samples"
            raise SignalError(msg)
        number = len(samples[0].disturbances)
        for sample in samples:
            if len(sample.disturbances) != number:
                raise SignalError(
                    f"window: sample {sample.index} has {len(sample.disturbances)} disturbances, "
                    f"sample {samples[0].index} has {number}; they must be equal"
                )
        return cls(
            _array(s.reference for s in samples),
            _array(s.output for s in samples),
            _array(s.input for s in samples),
            first=int(indices[0]),
            period=period,
            disturbances=np.array([s.disturbances for s in samples]).reshape(len(samples), number),
            seen=np.array([s.seen for s in samples]),
        )

    def __len__(self) -> int:
        return len(self.references)

    @property
    def reference(self) -> FloatArray:
        """Set-point of a single loop, shape (N,)."""
        return only("reference", self.references)

    @property
    def output(self) -> FloatArray:
        """Output of a single loop, shape (N,)."""
        return only("output", self.outputs)

    @property
    def input(self) -> FloatArray:
        """Command of a single loop, shape (N,)."""
        return only("input", self.inputs)

    @property
    def last(self) -> int:
        """Index of the last sample in its session."""
        return self.first + len(self) - 1

    @property
    def time(self) -> FloatArray:
        """Seconds since the session began, shape (N,)."""
        return np.asarray((self.first + np.arange(len(self))) * self.period, dtype=np.float64)

    def part(self, first: int, last: int) -> Window:
        """The samples with session indices `first` to `last`, both included.

        Raises:
            SignalError: the window does not hold them all.
        """
        if not self.first <= first <= last <= self.last:
            held = f"{self.first} to {self.last}"
            msg = f"window: samples {first} to {last} requested; it holds only {held}"
            raise SignalError(msg)
        span = slice(first - self.first, last - self.first + 1)
        return Window(
            self.references[span],
            self.outputs[span],
            self.inputs[span],
            first=first,
            period=self.period,
            disturbances=self.disturbances[span],
            seen=None if self.seen is None else self.seen[span],
        )

    @property
    def share_seen(self) -> float:
        """Share of its samples that were received."""
        return 1.0 if self.seen is None else float(np.mean(self.seen))


def only(name: str, signal: FloatArray) -> FloatArray:
    """The single column of a signal, without that dimension.

    What is defined for a single loop asks for it: polynomial models from one set-point to one output, say.

    Raises:
        SignalError: it has not exactly one column.
    """
    if signal.shape[-1] != 1:
        raise SignalError(
            f"{name}: there are {signal.shape[-1]} of them; this is for a loop with one of each"
        )
    return signal[..., 0]


def bridge(before: Sample, after: Sample, longest: int) -> list[Sample]:
    """Stand-ins for the samples lost between two, oldest first.

    There are none if more than `longest` are missing, or if the clock was set back meanwhile.

    The loop is taken to have continued: set-point, input and disturbances are held, and the output is
    interpolated, so that what sums up its movements stays right. Stand-ins are marked as not seen.
    """
    steps = after.index - before.index
    alike = after.stamp > before.stamp and len(before.disturbances) == len(after.disturbances)
    if not (alike and 1 < steps <= longest + 1):
        return []
    return [
        replace(
            before,
            index=before.index + k,
            stamp=before.stamp + (after.stamp - before.stamp) * k // steps,
            output=before.output + (after.output - before.output) * k / steps,
            seen=False,
        )
        for k in range(1, steps)
    ]


def not_one_loop(index: int, lengths: Sequence[int]) -> str:
    """Error message for a sample with these numbers of references, outputs and inputs."""
    return (
        f"sample {index} has {lengths[0]} references, {lengths[1]} outputs and {lengths[2]} inputs; "
        "a twin runs one loop, with one of each (further measured inputs are disturbances)"
    )


def unbroken(samples: Sequence[Sample]) -> list[Sequence[Sample]]:
    """Stretches of samples with consecutive indices, in order."""
    stretches = []
    begin = 0
    for k in range(1, len(samples) + 1):
        if k == len(samples) or samples[k].index != samples[k - 1].index + 1:
            stretches.append(samples[begin:k])
            begin = k
    return stretches


def _array(values: Iterable[float]) -> FloatArray:
    return np.fromiter(values, dtype=np.float64)
