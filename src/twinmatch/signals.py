"""Samples and windows: the only data exchanged between the subpackages.

A `Sample` is one tick of the control loop. At tick k the references r[k], the outputs y[k] of the plant and
its disturbances are read and the inputs u[k] are computed from them; u[k] then drives the plant until tick
k+1. A `Window` is a run of consecutive samples as arrays. The units are the plant's: on the Peltier rig
the output is the plate's temperature in °C and the input the PWM command, −255 to 255.

Both carry any number of signals. What makes sense for a single loop only asks for *the* `reference`, `output`
or `input`, and is refused where there is not exactly one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from operator import attrgetter
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from twinmatch.errors import TwinmatchError

__all__ = [
    "KELVIN",
    "MEDIAN_TO_SIGMA",
    "NANOSECONDS",
    "SIGNALS",
    "BoolArray",
    "FloatArray",
    "OperatingPoint",
    "Sample",
    "SignalError",
    "Signals",
    "Window",
    "column_of",
    "counted",
    "decimals_of_time",
    "finite",
    "incomplete",
    "joined",
    "one_of_each",
    "only",
    "point_of",
    "point_text",
    "point_values",
    "rms",
    "stretches",
    "time_text",
    "unbroken",
]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_Value = TypeVar("_Value")

KELVIN = 273.15
"""Zero Celsius in kelvin."""
NANOSECONDS = 1_000_000_000
"""In a second; stamps count them."""
MEDIAN_TO_SIGMA: Final = 1.4826
"""Standard deviation of normal noise in units of its median absolute value."""

_NONE: FloatArray = np.empty((0, 0))
"""Default for a window without disturbances."""


_FEW: Final = 8
"""Number of values up to which Python looks at each sooner than numpy at all."""


def finite(values: FloatArray) -> bool:
    """Whether all values are finite, in a fraction of the time of `np.isfinite(…).all()`."""
    if values.size <= _FEW:
        return all(map(math.isfinite, values.ravel().tolist()))
    return math.isfinite(np.vdot(values, values)) or bool(np.isfinite(values).all())


def rms(
    values: FloatArray, unit: FloatArray | float = 1.0, axis: int = -1
) -> FloatArray:
    """Root mean square along an axis, in a unit of one's choice.

    An error counts in units of its signal's noise, or of the spread of its forecast.
    """
    squares = np.square(values / unit)
    # As `np.mean`, to the bit, without the checks that take most of its time for a few hundred values.
    return np.asarray(np.sqrt(np.add.reduce(squares, axis=axis) / squares.shape[axis]))


class SignalError(TwinmatchError):
    """Arrays that do not make a window: unequal lengths, not finite, invalid period; or not a single loop."""


SIGNALS: Final = ("references", "outputs", "inputs", "disturbances")
"""The signals of samples and windows, in their order."""

Signals = tuple[float, ...]
"""Values of one kind of signal at one tick, in the plant's order."""

OperatingPoint = float | Signals
"""Set-points, or outputs, at which a plant was; of a single loop a number."""


@dataclass(frozen=True, slots=True, init=False)
class Sample:
    """One tick of the loop."""

    index: int
    """Count of ticks since the session began, without gaps."""
    stamp: int
    """Time of the tick in nanoseconds since the epoch of its clock."""
    references: Signals
    """Set-points r, in the outputs' units."""
    outputs: Signals
    """Measured outputs y of the plant."""
    inputs: Signals
    """Commands u computed at this tick."""
    disturbances: Signals = ()
    """Measured disturbances; the rig has none."""
    seen: bool = True
    """Whether its outputs were measured; False: they are a stand-in's, as `twin.door` makes them for a sample
    that was lost and for a reading that was refused, and count nowhere."""
    refused: Signals = ()
    """The outputs as they were read, if they were refused as implausible."""
    usable: bool = True
    """False: more readings in a row were refused than stand-ins may replace; this one is only reported."""
    shape: tuple[int, int, int, int] = field(init=False, repr=False, compare=False)
    """Numbers of references, outputs, inputs and disturbances: a dozen parts compare those of a sample with
    those of the one before."""

    def __init__(  # noqa: PLR0917
        self,
        index: int,
        stamp: int,
        references: Signals | float,
        outputs: Signals | float,
        inputs: Signals | float,
        disturbances: Signals = (),
        *,
        seen: bool = True,
        refused: Signals = (),
        usable: bool = True,
    ) -> None:
        """Signals with a single value may be given as a number."""
        if not isinstance(references, tuple):
            references = (references,)
        if not isinstance(outputs, tuple):
            outputs = (outputs,)
        if not isinstance(inputs, tuple):
            inputs = (inputs,)
        shape = len(references), len(outputs), len(inputs), len(disturbances)
        keep = object.__setattr__
        keep(self, "index", index)
        keep(self, "stamp", stamp)
        keep(self, "references", references)
        keep(self, "outputs", outputs)
        keep(self, "inputs", inputs)
        keep(self, "disturbances", disturbances)
        keep(self, "seen", seen)
        keep(self, "refused", refused)
        keep(self, "usable", usable)
        keep(self, "shape", shape)

    @property
    def reference(self) -> float:
        """Set-point of a single loop."""
        return one_of_each("reference", self.references)

    @property
    def output(self) -> float:
        """Output of a single loop."""
        return one_of_each("output", self.outputs)

    @property
    def input(self) -> float:
        """Command of a single loop."""
        return one_of_each("input", self.inputs)

    def continues(self, before: Sample) -> bool:
        """Whether it is a later sample of the same run; samples in between may be lost."""
        return self.index > before.index and self.shape == before.shape

    def follows(self, before: Sample) -> bool:
        """Whether it is the next sample of the same run, with nothing lost in between."""
        usable = self.usable and before.usable
        return usable and self.index == before.index + 1 and self.shape == before.shape


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
    """Which samples were measured, shape (N,); those of the others are estimates, which no fit and no score
    counts. None: all."""

    def __post_init__(self) -> None:
        lengths = set()
        for name in ("references", "outputs", "inputs"):
            values = np.array(getattr(self, name), dtype=np.float64)
            if values.ndim not in (1, 2):
                raise SignalError(
                    f"window: {name} have shape {values.shape}; give one row per sample"
                )
            self._keep(
                name,
                values[:, None] if values.ndim == 1 else np.ascontiguousarray(values),
            )
            lengths.add(len(values))
        if len(lengths) != 1:
            msg = f"window: references, outputs and inputs have lengths {sorted(lengths)}; they must be equal"
            raise SignalError(msg)
        measured = (
            np.empty((len(self), 0))
            if self.disturbances is _NONE
            else self.disturbances
        )
        disturbances = np.array(measured, dtype=np.float64)
        if disturbances.ndim != 2 or len(disturbances) != len(self):
            raise SignalError(
                f"window: disturbances have shape {disturbances.shape}; "
                f"give one row for each of the {len(self)} samples"
            )
        self._keep("disturbances", disturbances)
        if self.seen is not None:
            is_seen = np.array(self.seen, dtype=np.bool_)
            if is_seen.shape != (len(self),):
                msg = f"window: seen has shape {is_seen.shape}; give one truth value for each of {len(self)}"
                raise SignalError(msg)
            is_seen.flags.writeable = False
            object.__setattr__(self, "seen", None if is_seen.all() else is_seen)
        if not (np.isfinite(self.period) and self.period > 0):
            raise SignalError(
                f"window: the period is {self.period} s; it must be positive"
            )

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
                numbers of signals.
        """
        if not samples:
            raise SignalError("window: there is no sample; give at least one")
        indices = np.array(list(map(attrgetter("index"), samples)))
        gaps = np.flatnonzero(np.diff(indices) != 1)
        if gaps.size:
            before = indices[gaps[0]]
            after = indices[gaps[0] + 1]
            raise SignalError(
                f"window: sample {after} follows sample {before}; give consecutive samples"
            )
        _check_shapes(samples)
        columns = {}
        for name, width in zip(SIGNALS, samples[0].shape, strict=True):
            rows = map(attrgetter(name), samples)
            values = np.fromiter(chain.from_iterable(rows), dtype=np.float64)
            columns[name] = values.reshape(len(samples), width)
        is_seen = np.array(list(map(attrgetter("seen"), samples)))
        return cls(**columns, first=int(indices[0]), period=period, seen=is_seen)

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
        return np.asarray(
            (self.first + np.arange(len(self))) * self.period, dtype=np.float64
        )

    def part(self, first: int, last: int) -> Window:
        """The samples with session indices `first` to `last`, both included.

        Raises:
            SignalError: the window does not hold them all.
        """
        if not self.first <= first <= last <= self.last:
            extent = f"{self.first} to {self.last}"
            raise SignalError(
                f"window: samples {first} to {last} requested; it holds only {extent}"
            )
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

    def alone(self, k: int) -> Window:
        """Its k-th reference, output and input; of fewer the last."""
        references, outputs, inputs = (
            column_of(getattr(self, name), k) for name in SIGNALS[:3]
        )
        return replace(self, references=references, outputs=outputs, inputs=inputs)

    def joined(self, newer: Window) -> Window:
        """This window, continued by the later samples of another one.

        Raises:
            SignalError: samples are missing in between, or the windows differ in their period or numbers of
                signals.
        """
        if newer.first > self.last + 1:
            msg = f"window: sample {newer.first} follows sample {self.last}; give consecutive samples"
            raise SignalError(msg)
        if newer.period != self.period:
            raise SignalError(
                f"window: periods of {self.period} s and {newer.period} s; they must be equal"
            )
        if newer.last <= self.last:
            return self
        newer = newer.part(self.last + 1, newer.last)
        columns = {}
        for name in SIGNALS:
            older = getattr(self, name)
            newer_values = getattr(newer, name)
            if older.shape[1] != newer_values.shape[1]:
                raise SignalError(
                    f"window: {older.shape[1]} and {newer_values.shape[1]} {name}; they must be equal"
                )
            columns[name] = np.concatenate([older, newer_values])
        is_seen = np.concatenate([self.marks, newer.marks])
        return Window(**columns, first=self.first, period=self.period, seen=is_seen)

    def samples(self, begin: int) -> list[Sample]:
        """Its samples; `begin` is the stamp of index 0, ns, from which they are a period apart."""
        rows = zip(
            *(map(tuple, getattr(self, name).tolist()) for name in SIGNALS), strict=True
        )
        return [
            Sample(
                index, begin + round(index * self.period * 1e9), *values, seen=is_seen
            )
            for index, (values, is_seen) in enumerate(
                zip(rows, self.marks.tolist(), strict=True), start=self.first
            )
        ]

    @property
    def marks(self) -> BoolArray:
        """Which samples were measured, shape (N,)."""
        return np.ones(len(self), dtype=np.bool_) if self.seen is None else self.seen

    def received(self, values: FloatArray) -> FloatArray:
        """Of values at its last samples, those at samples that were received."""
        return (
            values
            if self.seen is None
            else values[self.seen[len(self) - len(values) :]]
        )

    @property
    def lost(self) -> list[int]:
        """Indices of the samples that were not received."""
        return (self.first + np.flatnonzero(~self.marks)).tolist()

    @property
    def share_seen(self) -> float:
        """Share of its samples that were received."""
        return 1.0 if self.seen is None else float(np.mean(self.seen))


def decimals_of_time(period: float) -> int:
    """Decimals with which the times of neighbouring samples differ, s; none from a period of 1 s on."""
    return max(0, math.ceil(-math.log10(period)))


def time_text(sample: int, period: float) -> str:
    """The time of a sample, or how long so many samples last, in a sentence, s."""
    return f"{sample * period:.{decimals_of_time(period)}f}"


def _check_shapes(samples: Sequence[Sample]) -> None:
    """Check that all samples have the same numbers of signals.

    Raises:
        SignalError: one has others than the first.
    """
    if len(set(map(attrgetter("shape"), samples))) == 1:
        return
    first = samples[0]
    other = next(sample for sample in samples if sample.shape != first.shape)
    for name, number, expected in zip(SIGNALS, other.shape, first.shape, strict=True):
        if number != expected:
            raise SignalError(
                f"window: sample {other.index} has {number} {name}, "
                f"sample {first.index} has {expected}; they must be equal"
            )


def column_of(signals: FloatArray, k: int) -> FloatArray:
    """The k-th of some signals, shape (N, 1); of fewer the last."""
    return signals[:, [min(k, signals.shape[1] - 1)]]


def only(name: str, signal: FloatArray) -> FloatArray:
    """The single column of a signal, without that dimension.

    What is defined for a single loop asks for it: polynomial models from one set-point to one output, say.

    Raises:
        SignalError: it has not exactly one column.
    """
    if signal.shape[-1] != 1:
        raise _several(name, signal.shape[-1])
    return signal[..., 0]


def point_of(values: Sequence[float] | FloatArray) -> OperatingPoint:
    """The operating point with these values, one of each set-point or output."""
    return float(values[0]) if len(values) == 1 else tuple(map(float, values))


def point_values(point: Iterable[float] | float) -> Signals:
    """The values of an operating point, or of any one kind of signal, of which a single one is a number."""
    return (point,) if isinstance(point, float | int) else tuple(point)


def point_text(point: OperatingPoint) -> str:
    """An operating point with as many digits as it needs: 50, or 54.7, 47.9."""
    return ", ".join(f"{value:g}" for value in point_values(point))


def one_of_each(name: str, values: Sequence[_Value]) -> _Value:
    """The only one of some values.

    Raises:
        SignalError: there is not exactly one.
    """
    if len(values) != 1:
        raise _several(name, len(values))
    return values[0]


def _several(name: str, number: int) -> SignalError:
    return SignalError(
        f"{name}: there are {number} of them; this is for a loop with one of each"
    )


def incomplete(index: int, numbers: Sequence[int]) -> str:
    """Error message for a sample with these numbers of references, outputs and inputs; empty if there is at
    least one of each."""
    if all(numbers):
        return ""
    return f"{counted(index, numbers)}; every sample has at least one of each"


def counted(index: int, numbers: Sequence[int]) -> str:
    """The numbers of references, outputs and inputs of a sample, as text."""
    return f"sample {index} has {numbers[0]} references, {numbers[1]} outputs and {numbers[2]} inputs"


def joined(pieces: Iterable[Sequence[Sample]]) -> list[Sample]:
    """The pieces of a run as one: of each, the samples that continue those before it; pieces may overlap."""
    whole: list[Sample] = []
    for piece in pieces:
        whole += (
            [sample for sample in piece if sample.continues(whole[-1])]
            if whole
            else piece
        )
    return whole


def unbroken(samples: Sequence[Sample]) -> list[Sequence[Sample]]:
    """Stretches of samples that follow one another, in order."""
    parts = []
    begin = 0
    for k in range(1, len(samples) + 1):
        if k == len(samples) or not samples[k].follows(samples[k - 1]):
            parts.append(samples[begin:k])
            begin = k
    return parts


def stretches(samples: Sequence[Sample], period: float) -> tuple[Window, ...]:
    """These stretches as windows; `period` is the sample time, s."""
    return tuple(Window.from_samples(stretch, period) for stretch in unbroken(samples))
