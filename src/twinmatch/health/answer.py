"""Drive effect of a slow plant: whether the output still responds where lags lie between drive and sensor.

Where the drive moves the output within a sample, the balance of one sample shows it (`Effect`). Behind a
heater and a lag it does not: what the drive does now shows half a minute later. So an observer estimates the
states of the plant and the temperature of its surroundings, and past state estimates are simulated up to now
twice: under the recorded inputs, and with the drive at rest. The difference of the two runs is the drive's
expected effect; where the reading lies between them gives the share of it that was observed.

A missing effect counts where it is larger than what else moves a reading: its noise and steps, the usual
errors of the equations, a room that becomes colder.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np

from twinmatch.dynamics import Parameters, PlantError, State, begin, read, simulate_driven
from twinmatch.dynamics.observer import Observer, Wander
from twinmatch.health.balance import Movement
from twinmatch.health.stretch import Moment, Stretch, advanced
from twinmatch.health.usual import Usual
from twinmatch.signals import FloatArray, Sample

__all__ = ["Answer", "answers_late"]

_SPANS: Final = (10.0, 16.0, 25.0, 40.0, 64.0, 100.0)
"""Lengths of the stretches over which the drive's effect is estimated, s."""
_LEAST_NOISES: Final = 8.0
"""Least expected effect whose share is computed, in standard deviations of a reading's noise …"""
_LEAST_ERRORS: Final = 6.0
"""… and in the usual error of the equations over such a stretch."""
_LONG: Final = 2
"""From this of the stretches on, the missing part of a smaller effect counts, too; over a shorter one it is
only a step or two of the reading …"""
_MISSING: Final = 0.6
"""… if it is this share of the least effect: where both begin, a share of 0.4 is left."""
_MOST: Final = 1.6
"""It may exceed the expected effect by this factor, as typical parameters may be so far off; a larger error
has another cause than a dead drive."""
_ROOM_CHANGE: Final = 0.6
"""Change of the room that a missing effect has to exceed, in the scale of the parameter: for minutes, a
heater that was giving little and is lost looks like a room that becomes colder."""
_SETTLED: Final = 20.0
"""Time after which the observer knows the states, s: after a gap, how warm the heater is behind its lag."""
_DRIFT: Final = 0.01
"""Drift of a state from the equations per second, in its scale."""
_ROOM_DRIFT: Final = 0.03
"""The same for a parameter of the surroundings, such as the room temperature: for minutes, errors of the
equations look like a change of it."""
_AT_ONCE: Final = 0.6
"""Least ratio of ten times the effect after one sample to that after ten, if the drive acts at once."""
_FOLLOWS: Final = (0.6, 2.5)
"""Range of shares of the expected effect that prove that the drive works."""


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
    except PlantError:  # the equations have no solution in the middle of the range
        return False
    effect = np.abs(moved[0] - moved[1])
    return bool(10.0 * effect[1] < _AT_ONCE * effect[10])


class Answer:
    """Watches one plant; push every sample once, in order. Same attributes as `Effect`."""

    def __init__(self, parameters: Parameters, period: float) -> None:
        """Begin with a twin and the sample time, s."""
        self._parameters, self._period = parameters, period
        self._noise = parameters.model.plant.output.noise
        self._spans = [max(2, round(s / period)) for s in _SPANS]
        self._usual = (Usual.of(self._noise),) * len(_SPANS)
        self._held = False
        self.restart()

    def restart(self) -> None:
        """Start over after a gap, keeping the learned errors."""
        self._observer: Observer | None = None
        self._followed = 0  # samples since a gap
        self._past: deque[Moment] = deque(maxlen=2 * self._spans[-1] + 1)
        self._standing: FloatArray | None = None
        self._reading = math.nan
        self.share = math.nan
        """Least share of the expected effect over the judged stretches; NaN if none expects enough."""
        self.length = 0
        """Samples of that stretch."""
        self.expected = 0.0
        """Movement in it expected from the drive alone."""

    @property
    def follows(self) -> bool:
        """Whether the newest stretches prove that the drive works."""
        return _FOLLOWS[0] <= self.share <= _FOLLOWS[1]

    def take(self, parameters: Parameters) -> None:
        """Continue with other parameters of the same model; those of another model are ignored."""
        if parameters.model is self._parameters.model and not self._held:
            self._parameters = parameters
            if self._observer is not None:
                self._observer.parameters = parameters

    def hold(self, held: bool) -> None:
        """Stop learning during a fault: in time, a dead heater looks like a working one in the cold."""
        if held is self._held:
            return
        self._held = held
        if held and self._past:
            self._parameters, self._usual = self._past[0].parameters, self._past[0].usual
        self._observer = None

    def push(self, sample: Sample) -> Movement:
        """Take a sample; return the expected and the observed movement since the one before.

        While a reading is repeated, the plant is assumed to have moved on from its states before that.
        """
        row = np.array(sample.disturbances, dtype=np.float64)
        try:
            movement = self._movement(sample, row)
        except PlantError:  # the equations have no solution at the observer's states
            self.restart()
            return Movement(0.0, 0.0, 0.0)
        self._estimate(sample.output)
        return movement

    def _movement(self, sample: Sample, row: FloatArray) -> Movement:
        given = row if row.size else None
        if self._observer is None:
            scales = np.array([s.scale for s in self._states])
            self._observer = Observer(
                self._parameters,
                sample.output,
                period=self._period,
                drift=_DRIFT * scales,
                start=scales,
                input=sample.input,
                disturbances=given,
                wandering=self._wandering,
            )
        observer, moved = self._observer, 0.0
        if self._past and self._standing is not None:
            last = self._past[-1]
            on = advanced(
                last.parameters,
                self._standing,
                np.array([last.input]),
                last.disturbances[np.newaxis],
                self._period,
            )
            moved = read(last.parameters, on) - read(last.parameters, self._standing)
            self._standing = on
        change = sample.output - self._reading if self._past else 0.0
        observer.correct(sample.output, given)
        states = observer.states
        if self._standing is None or change != 0.0:
            self._standing = states
        self._reading = sample.output
        # While it is reported as lost, silence would count as its recovery.
        settled = self._held or self._followed * self._period >= _SETTLED
        self._past.append(Moment(observer.parameters, states, sample.input, row, self._usual, settled))
        self._followed += 1
        observer.predict(sample.input)
        return Movement(0.0, moved, change - moved)

    def _estimate(self, output: float) -> None:
        """Estimate the drive's effect over every stretch that ends now."""
        self.share = math.nan
        past = list(self._past)
        learned = list(self._usual)
        for k, length in enumerate(self._spans):
            first = len(past) - 1 - length
            if first < 0:
                break
            if not past[first].settled:
                continue
            stretch = Stretch(past[first:-1], self._period)
            before = past[max(0, first - self._spans[-1]) : first + 1]
            changed = stretch.changed(float(np.mean([m.input for m in before])), self._spans[0])
            error = output - stretch.works
            self._weigh(stretch, error, changed, stretch.first.usual[k])
            if not self._held:
                learned[k] = learned[k].learned(error, max(abs(changed), abs(stretch.moved)))
        self._usual = tuple(learned)

    def _weigh(self, stretch: Stretch, error: float, changed: float, usual: Usual) -> None:
        """Take the share of the expected effect that a stretch shows, if it is the least and counts.

        A drive that was turned down looks lost if it does more than its equations say, or sooner; `changed`
        is what they say it will have changed a little later.
        """
        effect = stretch.effect
        if effect == 0.0:
            return
        share = 1.0 + error / effect
        likely = usual.error(stretch.moved, changed if changed * effect < 0.0 else 0.0)
        least = max(_LEAST_NOISES * self._noise, _LEAST_ERRORS * likely)
        missing = abs(error) if share < 1.0 else 0.0
        counts = abs(effect) >= least
        if len(stretch) >= self._spans[_LONG]:
            counts = counts or _MISSING * least <= missing <= _MOST * abs(effect)
        if share >= self.share or not counts:
            return
        if missing > _MISSING * abs(effect) and missing < stretch.colder(_ROOM_CHANGE):
            return
        self.share, self.length, self.expected = share, len(stretch), effect

    @property
    def _wandering(self) -> dict[str, Wander]:
        declared = self._parameters.model.declared if not self._held else {}
        return {
            name: Wander(start=parameter.scale, drift=_ROOM_DRIFT * parameter.scale)
            for name, parameter in declared.items()
            if parameter.role == "room"
        }

    @property
    def _states(self) -> list[State]:
        model = self._parameters.model
        return [model.plant.states[name] for name in model.states]
