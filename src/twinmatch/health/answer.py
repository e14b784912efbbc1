"""Whether a plant answers its drive that takes many samples to: through what is between drive and sensor.

Where the drive moves the output within a sample, the balance of one sample tells it (`Effect`). Behind a
heater and a lag it does not: what the drive does now shows half a minute later. So an observer follows the
plant, and with it what it gives its heat to, and its states of some time ago are let run to now twice: under
the commands that were given, and with the drive at rest. What lies between both is the drive's effect; where
the reading lies between them is the share of it that came.

How far the plant usually is from the first of the two is learned for each length, so that equations that are
off by more ask for more effect before they speak.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics import Parameters, PlantError, State, begin, read, simulate_driven
from twinmatch.dynamics.observer import Observer, Wander
from twinmatch.health.balance import Movement
from twinmatch.signals import FloatArray, Sample

__all__ = ["Answer", "answers_late"]

_SPANS: Final = (10.0, 15.0, 22.0, 32.0)
"""Lengths of the stretches over which the drive's effect is asked for, s."""
_LEAST_NOISES: Final = 8.0
"""Effect that a stretch has to expect, in noises of a reading …"""
_LEAST_ERRORS: Final = 6.0
"""… and in what the equations were off by over stretches like it: a share of 0.4 is off by 3.6 of those."""
_MEMORY: Final = 300
"""Stretches over which that is learned."""
_SURPRISE: Final = 3.0
"""Errors beyond so many of the usual ones count as that: a fault must not teach that it is usual."""
_FIRST: Final = 3.0
"""What the equations are off by before anything is learned, in noises."""
_DRIFT: Final = 0.01
"""How far a state strays from the equations in a second, in its scale."""
_ROOM: Final = 0.03
"""The same of a parameter that says to what the plant gives its heat, or the like: what equations get wrong
looks like another one, for minutes."""
_AT_ONCE: Final = 0.6
"""Share of the effect of ten samples that ten times the first one's makes, if the drive acts at once."""
_FOLLOWS: Final = (0.6, 2.5)
"""Shares of the expected effect that prove the drive to work."""


class _Moment(NamedTuple):
    parameters: Parameters
    states: FloatArray
    input: float
    disturbances: FloatArray


def answers_late(parameters: Parameters, period: float) -> bool:
    """Whether the drive moves the output of a plant much more in ten samples than ten times in one."""
    model = parameters.model
    low, high = model.plant.drive.limits
    drive = high if abs(high) >= abs(low) else low
    level = sum(model.plant.output.set_points or model.plant.output.span) / 2
    moved = []
    try:
        for u in (drive, model.plant.drive.rest):
            run = simulate_driven(parameters, np.full(12, u), states=begin(parameters, level), period=period)
            moved.append(run.output)
    except PlantError:  # the equations mean nothing in the middle of the range
        return False
    effect = np.abs(moved[0] - moved[1])
    return bool(10.0 * effect[1] < _AT_ONCE * effect[10])


class Answer:
    """Watches one plant; feed it every sample once, in order. Same words as `Effect`."""

    def __init__(self, parameters: Parameters, period: float) -> None:
        """Begin with a twin and the sample time, s."""
        self._parameters, self._period = parameters, period
        self._noise = parameters.model.plant.output.noise
        self._spans = [max(2, round(s / period)) for s in _SPANS]
        self._errors = [(_FIRST * self._noise) ** 2] * len(_SPANS)
        self._seen = [10] * len(_SPANS)
        self._held = False
        self.restart()

    def restart(self) -> None:
        """Begin anew behind a gap, keeping what was learned."""
        self._observer: Observer | None = None
        self._past: deque[_Moment] = deque(maxlen=self._spans[-1] + 1)
        self._standing: FloatArray | None = None
        self._reading = math.nan
        self.share = math.nan
        """Least share of the expected effect seen in a stretch that expects enough; NaN if none does."""
        self.length = 0
        """Samples of that stretch."""
        self.expected = 0.0
        """Movement expected in it of the drive alone."""

    @property
    def follows(self) -> bool:
        """Whether the newest stretches prove the drive to work."""
        return _FOLLOWS[0] <= self.share <= _FOLLOWS[1]

    def take(self, parameters: Parameters) -> None:
        """Go on with other parameters of the same twin; those of another are passed over."""
        if parameters.model is self._parameters.model and not self._held:
            self._parameters = parameters
            if self._observer is not None:
                self._observer.parameters = parameters

    def hold(self, held: bool) -> None:
        """Learn nothing while a fault is on: a dead heater looks, in time, like a working one in the cold."""
        if held is self._held:
            return
        self._held = held
        if held and self._past:
            self._parameters = self._past[0].parameters
        self._observer = None

    def push(self, sample: Sample) -> Movement:
        """Take a sample; how far the plant should have gone since the one before, and how far it did.

        While a reading is repeated, the plant is taken to have gone on from where it was before that.
        """
        row = np.array(sample.disturbances, dtype=np.float64)
        try:
            movement = self._followed(sample, row)
        except PlantError:  # the equations mean nothing where the observer has come to
            self.restart()
            return Movement(0.0, 0.0, 0.0)
        self._ask(sample.output)
        return movement

    def _followed(self, sample: Sample, row: FloatArray) -> Movement:
        given = row if row.size else None
        if self._observer is None:
            scales = np.array([s.scale for s in self._states])
            self._observer = Observer(
                self._parameters,
                sample.output,
                period=self._period,
                drift=_DRIFT * scales,
                start=scales,
                disturbances=given,
                wandering=self._wandering,
            )
        observer, moved = self._observer, 0.0
        if self._past and self._standing is not None:
            last = self._past[-1]
            on = self._run(last.parameters, self._standing, [last])
            moved = read(last.parameters, on) - read(last.parameters, self._standing)
            self._standing = on
        change = sample.output - self._reading if self._past else 0.0
        observer.correct(sample.output, given)
        states = observer.states
        if self._standing is None or change != 0.0:
            self._standing = states
        self._reading = sample.output
        self._past.append(_Moment(observer.parameters, states, sample.input, row))
        observer.predict(sample.input)
        return Movement(0.0, moved, change - moved)

    def _ask(self, output: float) -> None:
        """Ask every stretch that ends now for the drive's effect."""
        self.share = math.nan
        rest = self._parameters.model.plant.drive.rest
        past = list(self._past)
        for k, length in enumerate(self._spans):
            if length >= len(past):
                break
            stretch = past[-1 - length : -1]
            twin, states = stretch[0].parameters, stretch[0].states
            works = read(twin, self._run(twin, states, stretch))
            idle = [moment._replace(input=rest) for moment in stretch]
            effect = works - read(twin, self._run(twin, states, idle))
            error = output - works
            usual = self._errors[k]
            if abs(effect) >= max(_LEAST_NOISES * self._noise, _LEAST_ERRORS * math.sqrt(usual)):
                share = 1.0 + error / effect
                if not share >= self.share:
                    self.share, self.length, self.expected = share, length, effect
            if self._held:
                continue
            self._seen[k] = min(self._seen[k] + 1, _MEMORY)
            self._errors[k] += (min(error**2, _SURPRISE**2 * usual) - usual) / self._seen[k]

    def _run(self, twin: Parameters, states: FloatArray, moments: list[_Moment]) -> FloatArray:
        rows = np.array([m.disturbances for m in moments])
        run = simulate_driven(
            twin,
            np.array([m.input for m in moments]),
            states=states,
            period=self._period,
            disturbances=rows if rows.size else None,
        )
        return np.asarray(run.states[-1], dtype=np.float64)

    @property
    def _wandering(self) -> dict[str, Wander]:
        declared = self._parameters.model.declared if not self._held else {}
        return {
            name: Wander(start=parameter.scale, drift=_ROOM * parameter.scale)
            for name, parameter in declared.items()
            if parameter.role == "room"
        }

    @property
    def _states(self) -> list[State]:
        model = self._parameters.model
        return [model.plant.states[name] for name in model.states]
