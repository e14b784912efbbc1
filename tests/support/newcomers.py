"""Plants of people who have recorded nothing yet: a kettle, a room, a hot end and a tank, each by its own
physics, and a newcomer who does what the commands print."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from tests.support.processes import run_twinmatch
from twinmatch.signals import FloatArray

_STEPS: Final = 20
"""Steps of integration in a sample."""
_LEVEL: Final = re.compile(
    r"(?:rest first: |then )\w+ at (?P<level>\S+)(?: \S+)? for (?P<hold>\S+) s"
)
_ENDS: Final = re.compile(r"leaves (?P<low>\S+)(?: \S+)? to (?P<high>[^\s,]+)")
_PERIOD: Final = re.compile(r"one sample every (?P<period>\S+) s")

Rates = Callable[[FloatArray, float], FloatArray]
"""Rates of the states, shape (n,), from them and the input that acts."""


@dataclass(frozen=True)
class UnknownPlant:
    """A plant as its owner has it."""

    name: str
    rates: Rates
    start: tuple[float, ...]
    """States at rest; the last one is what the sensor shows."""
    dead_time: float
    """s"""
    noise: float
    measured: str
    """What its owner says of the signal that is measured, as `new-plant` takes it."""
    moved: str
    takes: float
    """What its owner believes of how long two thirds of a change take, s; off by up to a factor of two."""
    safe: tuple[float, float]
    drive: tuple[float, float]


class RunningPlant:
    """One plant that runs, sample by sample."""

    def __init__(self, plant: UnknownPlant, period: float, seed: int) -> None:
        self._plant = plant
        self._states = np.array(plant.start)
        self._step = period / _STEPS
        self._waiting = [0.0] * max(round(plant.dead_time / self._step), 0)
        self._random = np.random.default_rng(seed)

    def reading(self) -> float:
        """A reading of the sensor, with its noise."""
        return float(
            self._states[-1] + self._plant.noise * self._random.standard_normal()
        )

    def advance(self, command: float) -> None:
        """Let one sample pass under a command."""
        for _ in range(_STEPS):
            self._waiting.append(command)
            acting = self._waiting.pop(0)
            self._states = self._states + self._step * self._plant.rates(
                self._states, acting
            )


def kettle(rng: np.random.Generator) -> UnknownPlant:
    """An element that heats water, which loses heat to the kitchen."""
    gain = float(rng.uniform(0.6, 1.3))
    lag = float(rng.uniform(300.0, 900.0))
    element = float(rng.uniform(10.0, 40.0))

    def rates(x: FloatArray, heat: float) -> FloatArray:
        return np.array([(heat - x[0]) / element, (20.0 + gain * x[0] - x[1]) / lag])

    takes = lag * float(rng.uniform(0.5, 2.0))
    dead_time = float(rng.uniform(0.0, 10.0))
    safe = (5.0, 98.0)
    measured = "temperature [°C] 5 to 98"
    return UnknownPlant(
        "kettle",
        rates,
        (0.0, 20.0),
        dead_time,
        0.1,
        measured,
        "heater [%] 0 to 100",
        takes,
        safe,
        (0.0, 100.0),
    )


def room(rng: np.random.Generator) -> UnknownPlant:
    """A radiator that heats the air, which heats the walls."""
    gain = float(rng.uniform(0.12, 0.25))
    lag = float(rng.uniform(1800.0, 5400.0))
    radiator = float(rng.uniform(200.0, 500.0))
    walls = float(rng.uniform(0.05, 0.3))

    def rates(x: FloatArray, valve: float) -> FloatArray:
        air = (16.0 + gain * x[1] - x[2] + walls * (x[0] - x[2])) / lag
        return np.array([(x[2] - x[0]) / (8.0 * lag), (valve - x[1]) / radiator, air])

    takes = lag * float(rng.uniform(0.5, 2.0))
    safe = (5.0, 32.0)
    measured = "air [°C] 5 to 32"
    return UnknownPlant(
        "room",
        rates,
        (16.0, 0.0, 16.0),
        0.0,
        0.03,
        measured,
        "valve [%] 0 to 100",
        takes,
        safe,
        (0.0, 100.0),
    )


def hot_end(rng: np.random.Generator) -> UnknownPlant:
    """A block of aluminium that loses heat by convection and radiation, with a sensor beside it."""
    gain = float(rng.uniform(2.5, 4.5))
    lag = float(rng.uniform(60.0, 160.0))
    sensor = float(rng.uniform(2.0, 8.0))

    def rates(x: FloatArray, heat: float) -> FloatArray:
        lost = (x[0] - 25.0) * (1.0 + 4e-4 * (x[0] - 25.0))
        return np.array([(gain * heat - lost) / lag, (x[0] - x[1]) / sensor])

    takes = lag * float(rng.uniform(0.5, 2.0))
    safe = (0.0, 280.0)
    measured = "block [°C] 0 to 280"
    return UnknownPlant(
        "hot_end",
        rates,
        (25.0, 25.0),
        1.0,
        0.2,
        measured,
        "heater [%] 0 to 100",
        takes,
        safe,
        (0.0, 100.0),
    )


def tank(rng: np.random.Generator) -> UnknownPlant:
    """A tank with a pump in and an opening out, through which the flow goes with the root of the level."""
    top = float(rng.uniform(60.0, 140.0))
    lag = float(rng.uniform(40.0, 150.0))
    pump = float(rng.uniform(1.0, 4.0))

    def rates(x: FloatArray, command: float) -> FloatArray:
        out = np.sqrt(max(x[1], 0.0) / top)
        return np.array(
            [(command / 100.0 - x[0]) / pump, (x[0] - out) * top / (2.0 * lag)]
        )

    takes = lag * float(rng.uniform(0.5, 2.0))
    safe = (-5.0, 100.0)
    measured = "level [cm] -5 to 100"
    return UnknownPlant(
        "tank",
        rates,
        (0.0, 0.0),
        0.0,
        0.1,
        measured,
        "pump [%] 0 to 100",
        takes,
        safe,
        (0.0, 100.0),
    )


KINDS: Final = (kettle, room, hot_end, tank)


@dataclass(frozen=True)
class PrintedCourse:
    """A course as a newcomer reads it on the terminal."""

    levels: tuple[float, ...]
    holds: tuple[float, ...]
    low: float
    high: float

    @classmethod
    def read(cls, text: str) -> PrintedCourse:
        """From the lines of a command."""
        steps = list(_LEVEL.finditer(text))
        ends = _ENDS.search(text)
        assert steps
        assert ends is not None
        levels = tuple(float(step["level"]) for step in steps)
        holds = tuple(float(step["hold"]) for step in steps)
        return cls(levels, holds, float(ends["low"]), float(ends["high"]))


@dataclass
class Led:
    """How far a newcomer was led."""

    plant: UnknownPlant
    commands: int = 0
    recordings: int = 0
    trusted: bool = False
    highest: float = -np.inf
    lowest: float = np.inf
    hours: float = 0.0
    """Time spent on recordings, h."""
    error: float = np.nan
    """Largest distance from the set-point in the last quarter of a step under the PID, in the range."""
    overshoot: float = np.nan
    """Of that step, as a share."""
    words: str = ""

    @property
    def kept(self) -> bool:
        """Whether the output never left its range."""
        return self.plant.safe[0] <= self.lowest and self.highest <= self.plant.safe[1]

    def record(
        self, course: PrintedCourse, period: float, path: Path, seed: int
    ) -> None:
        """Follow a course from rest on, and end its steps if the output leaves the range printed."""
        plant = self.plant
        running = RunningPlant(plant, period, seed)
        name = plant.measured.partition(" ")[0]
        drive = plant.moved.partition(" ")[0]
        rows = [f"time,{name},{drive}"]
        is_ended = False
        for k, level in enumerate(_levels(course, period)):
            reading = running.reading()
            is_ended = is_ended or not course.low <= reading <= course.high
            command = course.levels[0] if is_ended else level
            rows.append(f"{k * period:.3f},{reading:.4f},{command:g}")
            running.advance(command)
            self.lowest = min(self.lowest, reading)
            self.highest = max(self.highest, reading)
        path.write_text("\n".join(rows) + "\n", "utf-8")
        self.recordings += 1
        self.hours += (len(rows) - 1) * period / 3600.0


def lead(plant: UnknownPlant, folder: Path, seed: int) -> Led:
    """Lead the newcomer of a plant: three commands and as many recordings at most, then the PID runs."""
    led = Led(plant)
    file = folder / f"{plant.name}.py"
    said = [
        "--measured",
        plant.measured,
        "--moved",
        plant.moved,
        "--takes",
        f"{plant.takes:.0f}",
    ]
    now = ["--now", f"{plant.start[-1]:g}"]
    text = _printed_by(
        ["new-plant", plant.name, "--nothing-recorded", *said, *now, "-o", str(folder)]
    )
    led.commands += 1
    period = float(_found(_PERIOD, text))
    gains = folder / "pid.json"
    while led.commands < 3:
        log = folder / f"log_{led.recordings}.csv"
        led.record(PrintedCourse.read(text), period, log, seed + led.recordings)
        document = folder / "answer.json"
        text = _printed_by(
            [
                "experiment",
                str(log),
                "--plant",
                str(file),
                "--pid",
                str(gains),
                "--json",
                str(document),
            ]
        )
        led.commands += 1
        led.words = text
        led.trusted = json.loads(document.read_text("utf-8"))["trusted"]
        if led.trusted:
            break
    if led.trusted and gains.exists():
        _run_pid(plant, json.loads(gains.read_text("utf-8")), led, seed + 9)
    return led


def _printed_by(arguments: list[str]) -> str:
    """What a command prints; it has to succeed."""
    completed = run_twinmatch(*arguments)
    assert completed.returncode in {0, 3}, completed.stdout + completed.stderr
    return completed.stdout


def _found(pattern: re.Pattern[str], text: str) -> str:
    match = pattern.search(text)
    assert match is not None, text
    return match[1]


def _levels(course: PrintedCourse, period: float) -> Iterator[float]:
    for level, hold in zip(course.levels, course.holds, strict=True):
        for _ in range(round(hold / period)):
            yield level


def _run_pid(plant: UnknownPlant, gains: dict[str, float], led: Led, seed: int) -> None:
    """Run the PID on the plant itself, from rest to the middle of what was visited, and compare."""
    period = gains["period"]
    running = RunningPlant(plant, period, seed)
    start = plant.start[-1]
    target = 0.5 * (start + led.highest)
    integral = 0.0
    outputs = []
    for _ in range(round(12.0 * plant.takes / period)):
        reading = running.reading()
        error = target - reading
        wanted = gains["proportional"] * error + integral
        command = min(max(wanted, plant.drive[0]), plant.drive[1])
        integral += period * (
            gains["integral"] * error + gains["back_calculation"] * (command - wanted)
        )
        running.advance(command)
        outputs.append(reading)
    size = abs(target - start)
    last = np.array(outputs[-len(outputs) // 4 :])
    led.error = float(np.max(np.abs(last - target))) / size
    led.overshoot = max(float(np.max(outputs)) - target, 0.0) / size
    led.highest = max(led.highest, *outputs)
    led.lowest = min(led.lowest, *outputs)
