"""An observer without the sensor: where the drive alone must have taken the plant.

A reading that lies is followed by every filter that corrects its states with it, only more slowly. So here
the states get nothing but the drive. A model with typical parameters and one for each parameter at either
side of its typical value run side by side; the readings only decide, late, which of them this plant is like:

    y = y₀ + Σ zᵢ·Dᵢ,    Dᵢ = (yᵢ₊ − yᵢ₋)/2,    z ~ N(0, I) before the first reading,

with y₀ of the typical model and yᵢ± of those with parameter i moved. A Kalman filter estimates z, a random
walk, from readings that are `LEARNING.after` old: what a lie has taught must not explain it. A lie that
is slow enough is learned all the same; the `Ceiling` does not believe its sensor, and limits the drive.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from twinmatch.dynamics import Parameters, advance_side_by_side, begin
from twinmatch.dynamics.pace import time_constant
from twinmatch.safety.ceiling import Ceiling
from twinmatch.safety.likeness import PERIOD, Likeness
from twinmatch.safety.limits import SafetyError, positive
from twinmatch.settings import Rule, setting
from twinmatch.signals import FloatArray


class Learning(Rule):
    """What readings teach of the plant."""

    after: float = 240.0
    """Age at which a reading is learned from, s: a drift of 0.05 °C/s has left the band by then. At the
    start, when little is known, it is half the time that has passed."""
    memory: float = 3600.0
    """Time in which z may move by one, s: rooms and fans change from hour to hour."""
    doubt: float = 0.3
    """Standard deviation of reading minus model, in bands: the errors of consecutive samples are alike, so it
    is far above the sensor's noise."""


class KindSpread(Rule):
    """How much plants of one kind differ: standard deviations of their parameters."""

    relative: float = 0.6
    """Of a parameter that is equally likely anywhere within the spread, in spreads."""
    other: float = 2.0
    """Of a parameter that is not relative, such as the room, in spreads: 15 to 28 °C."""
    measured: float = 0.1
    """Of a parameter that was measured, relative or in its scale: of a room a degree."""


@dataclass(frozen=True)
class Surroundings:
    """What may change around a plant; within both the drive is limited, not ended."""

    draught: float = 0.5
    """Part by which a draught raises the losses."""
    cooling: float = 12.0
    """Temperature by which a room cools, K."""


LEARNING: Final = Learning()
SPREAD: Final = KindSpread()
SURROUNDINGS: Final = Surroundings()
SIGMAS: Final = 3.0
"""Standard deviations of the estimate that the band has at least."""
HOTTER: Final = 2.0
"""Bands by which a reading may be above the estimate: what else heats is not the work of the drive."""
LOST: Final = 600.0
"""Time without a look after which the observer begins again, s."""


@dataclass(frozen=True)
class ObserverLimits:
    """Limits from which a reading contradicts the drive."""

    band: float = setting(
        9.0, "Distance of the reading from what the drive explains.", "{y}", 1.0, 150.0
    )
    patience: float = setting(4.0, "Time beyond it that is a fault.", "s", 1.0, 600.0)
    spread: float = setting(
        0.25,
        "Usual relative difference of the plant's parameters from the typical ones.",
        "",
        0.01,
        1.0,
    )
    margin: float = setting(
        13.0,
        "How far the drive may take the plant beyond set-point and reading.",
        "{y}",
        1.0,
        150.0,
    )
    known: str = setting(
        "",
        "Measured parameters of this plant, such as `losses = 11.3, heating = 0.0088`: right to a tenth.",
    )

    def __post_init__(self) -> None:
        numbers = {name: value for name, value in vars(self).items() if name != "known"}
        positive("observer", numbers)
        self.measured()

    def measured(self) -> dict[str, float]:
        """The measured parameters by name, in their units.

        Raises:
            SafetyError: the text is not a list of names with numbers.
        """
        values = {}
        for part in filter(str.strip, self.known.split(",")):
            name, _, number = part.partition("=")
            try:
                values[name.strip()] = float(number)
            except ValueError:
                message = f"observer limits: known has {part.strip()!r}; write it as losses = 11.3"
                raise SafetyError(message) from None
        return values


class DriveObserver:
    """Follows a plant with one input and one output by its drive, and compares the sensor with that."""

    ceiling: Ceiling
    """What limits the drive."""
    _waiting: deque[tuple[FloatArray, float]]
    """What is not learned yet: slopes, and reading less typical plant."""

    def __init__(
        self,
        typical: Parameters,
        limits: ObserverLimits | None = None,
        *,
        thing: str = "plate",
        sensor: str = "camera",
        highest: float = math.inf,
    ) -> None:
        """Begin with the first reading.

        Args:
            typical: parameters of a usual plant of this kind.
            limits: when a reading contradicts the drive.
            thing: what is driven, for messages.
            sensor: what measures it, for messages.
            highest: output, in its unit, that the plant must not reach.
        """
        self.limits = limits or ObserverLimits()
        self.estimate = math.nan
        """Output to which the drive has taken the plant, in its unit; NaN before the first comparison."""
        self._measured = self.limits.measured()
        typical = _with_measured(typical, self._measured)
        self._typical = typical
        self._thing = thing
        self._sensor = sensor
        self._highest = highest
        self._unit = typical.model.plant.output.unit
        self._sides = list(_either_side(typical, self.limits.spread))
        # Loading the compiled step takes a quarter of a second: too long while a drive is waited for.
        self._begin(float(np.mean(typical.model.plant.output.span)), None)
        self._step(0.0, None)
        self._compare(0.0)
        self._begun = False
        self.estimate = math.nan
        self.ceiling = Ceiling(self.limits.margin, self._deviations)

    def take(
        self,
        elapsed: float,
        drive: float,
        reading: float,
        disturbances: FloatArray | None = None,
        *,
        reference: float = math.inf,
        believed: bool = True,
    ) -> str | None:
        """Take the drive of the last `elapsed` seconds, the newest reading and the set-point; returns an
        error message, or None. Nothing is compared or learned while the reading is not `believed`."""
        if not self._begun or elapsed > LOST:
            self._begin(reading, disturbances)
            self._begun = True
            return None
        message = None
        while elapsed > 0.0:
            part = min(elapsed, PERIOD - self._passed)
            elapsed -= part
            self._passed += part
            self._drive += drive * part
            if self._passed >= PERIOD - 1e-9:
                self._step(self._drive / self._passed, disturbances)
                message = (
                    self._compare(reading, reference, believed=believed) or message
                )
        return message

    def believe(self) -> None:
        """Learn the ceiling again from the readings, for which somebody vouches."""
        self.ceiling = Ceiling(
            self.limits.margin, self._deviations, mean=self._z.mean, seen=True
        )

    def hotter(self, reading: float) -> str:
        """Why no more drive passes than the ceiling allows."""
        unit = self._unit
        driven_part = self._thing
        sensor = self._sensor
        return (
            f"by its drive the {driven_part} is at {self.ceiling.estimate:.0f} {unit}, but the {sensor} "
            f"reads {reading:.1f} {unit}: no more drive passes than holds it there; measure the "
            f"{driven_part} with something else, and clear this if the reading is right"
        )

    def _begin(self, reading: float, disturbances: FloatArray | None) -> None:
        model = self._typical.model
        self._twins = [self._typical, *(side for pair in self._sides for side in pair)]
        states = [
            begin(twin, reading, disturbances=disturbances) for twin in self._twins
        ]
        # Sensors are off by some degrees, and the first reading may be a frozen one.
        for first in (reading - self.limits.band / 2, reading + self.limits.band / 2):
            self._twins.append(self._typical)
            states.append(begin(self._typical, first, disturbances=disturbances))
        for name in model.structure.free_starts:
            # what no sensor shows may have any temperature
            place = model.states.index(name)
            for side in (-1.0, 1.0):
                moved = states[0].copy()
                moved[place] += side * model.declared_states[place].scale
                self._twins.append(self._typical)
                states.append(moved)
        self._states = np.array(states)
        self._outputs = np.full(len(states), reading)
        self._z = Likeness(np.ones(len(states) // 2))
        self._deviations = self._how_plants_differ(len(states) // 2)
        self._surroundings = self._how_surroundings_change(len(states) // 2)
        self.ceiling = Ceiling(self.limits.margin, self._deviations)
        self._waiting = deque()
        self._passed = self._drive = self._doubted = self._explained = 0.0
        self._compared = 0

    def _how_plants_differ(self, size: int) -> FloatArray:
        """Standard deviations of the weights before the first reading, shape (size,)."""
        deviations = np.full(size, SPREAD.relative)
        for place, name in enumerate(self._typical.model.structure.free):
            if name in self._measured:
                deviations[place] = SPREAD.relative * min(
                    1.0, SPREAD.measured / self.limits.spread
                )
            elif not self._typical.model.declared[name].relative:
                deviations[place] = SPREAD.other
        return deviations

    def _how_surroundings_change(self, size: int) -> FloatArray:
        """What a draught or a room that cools adds to each weight, shape (size,)."""
        changes = np.zeros(size)
        for place, name in enumerate(self._typical.model.structure.free):
            declared = self._typical.model.declared[name]
            if declared.role == "losses":
                draught = SURROUNDINGS.draught
                changes[place] = draught / (1.0 + draught) / self.limits.spread
            elif declared.role == "room":
                changes[place] = SURROUNDINGS.cooling / (
                    self.limits.spread * declared.scale
                )
        return changes

    def _step(self, drive: float, disturbances: FloatArray | None) -> None:
        self._states, outputs = advance_side_by_side(
            self._twins, self._states, drive, PERIOD, disturbances
        )
        self._outputs = outputs[:, 0]
        self._passed = self._drive = 0.0

    def _compare(
        self, reading: float, reference: float = math.inf, *, believed: bool = True
    ) -> str | None:
        slopes = (self._outputs[2::2] - self._outputs[1::2]) / 2
        typical = float(self._outputs[0])
        moved, deviation = self._z.moves(slopes)
        self.estimate = estimate = typical + moved
        band = max(self.limits.band, SIGMAS * deviation)
        error = reading - estimate
        hotter = error > HOTTER * band or estimate - band > self._highest
        beyond = hotter or error < -band
        self.ceiling.take(
            slopes,
            typical,
            reading,
            reference,
            learns=believed and not beyond,
            at_least=estimate if error < -band else -math.inf,
        )
        if not believed:
            self._waiting.clear()
            self._doubted = 0.0
            return None
        self._waiting.append((slopes, math.nan if beyond else reading - typical))
        self._compared += 1
        while len(self._waiting) > min(LEARNING.after / PERIOD, self._compared / 2):
            self._learn(*self._waiting.popleft())
        colder = self._much_colder(slopes, error, band) or self._limited_in_vain(
            slopes, reading
        )
        self._doubted = self._doubted + PERIOD if hotter or colder else 0.0
        if self._doubted < self.limits.patience:
            return None
        return self.contradicts(reading, estimate, band)

    def _much_colder(self, slopes: FloatArray, error: float, band: float) -> bool:
        """Whether neither a draught nor a room that cools explains how far a reading is below the estimate:
        both take the plant's time constant, while a sensor may slip at once."""
        if error > -band / 2:
            self._explained = 0.0
            return False
        at_last = self._surroundings_explain(slopes)
        increase = at_last * PERIOD / time_constant(self._typical.model.plant)
        self._explained = min(at_last, self._explained + increase)
        return error < -(band + self._explained)

    def _limited_in_vain(self, slopes: FloatArray, reading: float) -> bool:
        """Whether they do not explain either how cold a limited drive leaves the reading."""
        ceiling = self.ceiling
        band = max(self.limits.band, SIGMAS * ceiling.deviation)
        coldest = ceiling.estimate - band - self._surroundings_explain(slopes)
        return ceiling.share < 1.0 and reading < coldest

    def _surroundings_explain(self, slopes: FloatArray) -> float:
        """By how much a draught or a room that cools lowers the output at last, in its unit."""
        return float(np.max(np.abs(slopes) * self._surroundings))

    def _learn(self, slopes: FloatArray, deviation: float) -> None:
        """Learn from a reading; one that contradicted the drive teaches nothing."""
        self._z.covariance = (
            self._z.covariance + np.eye(slopes.size) * PERIOD / LEARNING.memory
        )
        if not math.isnan(deviation):
            self._z.learn(slopes, deviation, LEARNING.doubt * self.limits.band)

    def contradicts(self, reading: float, estimate: float, band: float) -> str:
        """What a reading outside the band about an estimate says."""
        unit = self._unit
        driven_part = self._thing
        sensor = self._sensor
        another_heater = ", something else heats it" if reading > estimate else ""
        return (
            f"by its drive the {driven_part} is at {estimate:.0f} ± {band:.0f} {unit}, but the {sensor} "
            f"reads {reading:.1f} {unit}: the drive is lost{another_heater}, or the {sensor} does not see "
            f"the {driven_part}; check both"
        )


def _with_measured(typical: Parameters, measured: Mapping[str, float]) -> Parameters:
    """The typical plant with the measured parameters.

    Raises:
        SafetyError: the plant has no such parameter, or it cannot have this value.
    """
    declared = typical.model.declared
    for name, value in measured.items():
        if name not in typical:
            raise SafetyError(
                f"observer limits: known names {name!r}; parameters: {', '.join(typical)}"
            )
        low, high = declared[name].bounds
        if not low <= value <= high:  # true for NaN too
            raise SafetyError(
                f"observer limits: known has {name} = {value:g}; allowed: {low:g} to {high:g}"
            )
    return typical.replace(**measured)


def _either_side(
    typical: Parameters, spread: float
) -> list[tuple[Parameters, Parameters]]:
    """For each free parameter, the plant with it below and above its typical value, within its bounds."""
    pairs = []
    for name in typical.model.structure.free:
        declared = typical.model.declared[name]
        value = typical[name]
        low, high = declared.bounds

        step = spread * declared.scale
        ratio = math.exp(spread)
        sides = (
            (value / ratio, value * ratio)
            if declared.relative
            else (value - step, value + step)
        )
        below, above = (
            typical.replace(**{name: min(max(side, low), high)}) for side in sides
        )
        pairs.append((below, above))
    return pairs
