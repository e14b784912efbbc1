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
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.dynamics import (
    Parameters,
    PlantError,
    State,
    advance,
    begin,
    read,
    simulate_driven,
)
from twinmatch.dynamics.kernels import OUTPUTS, SWITCHES, Code, call, tick, work_for
from twinmatch.dynamics.observer import Observer, RandomWalk
from twinmatch.dynamics.pace import slow_scale
from twinmatch.health.balance import Movement
from twinmatch.health.earned import NOTHING, Record
from twinmatch.health.rivals import Cause, costs_of_causes, effects_of_causes
from twinmatch.health.traces import FOLLOWS, DriveEffect
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray, Sample

_MEMORY: Final = (300.0, 600.0)
"""Number of stretches over which the variance at rest and that of the share are averaged."""
_FIRST: Final = (10.0, 100.0)
"""Number of stretches for which the assumed ones count: a hundred that overlap are a few movements."""


class _ErrorRule(Rule):
    """What is assumed of the errors of the equations over a stretch."""

    clip: float = 3.0
    """Errors are clipped to so many times the usual one, so that a fault does not pass as usual."""
    at_rest: float = 3.0
    """Assumed error at rest before anything is learned, in standard deviations of a reading's noise."""
    share: float = 0.3
    """Share of the movement by which equations with typical parameters are usually wrong."""
    least_share: float = 0.15
    """The share is never trusted to be smaller: other movements may show other errors."""
    moving_share: float = 0.2
    """The share counts as no larger while the drive moves the plant: one that is lost is then missing by
    as much as it moves."""


_ERRORS: Final = _ErrorRule()


_KEPT: Final = 1.0 - 1.0 / 2000.0
"""What a stretch leaves of the record before."""


@dataclass(frozen=True)
class ErrorModel:
    """Variances of the two parts, learned by expectation maximisation, one stretch at a time.

    Equations with a wrong gain or lag err in proportion to how far the plant moves; at rest only the noise
    and the steps of a reading and the estimated states are wrong. One variance for both would be that of the
    last step of the set-point, and hide for minutes what the readings show.
    """

    rest: float
    """Variance at rest, in the output's unit squared."""
    share: float = _ERRORS.share**2
    """Variance of the error as a share of the movement."""
    seen: tuple[float, float] = _FIRST
    """Number of stretches that each of the two is known from."""
    record: Record = field(default_factory=Record)
    """Of all stretches so far."""

    @classmethod
    def of(cls, noise: float) -> ErrorModel:
        """Before anything is learned, for readings with this noise (1 σ)."""
        return cls((_ERRORS.at_rest * noise) ** 2)

    def error(self, moved: float, turned_down: float) -> float:
        """Usual error (1 σ) of a stretch over which the plant moves so far, and so far because the drive was
        turned down."""
        share = max(math.sqrt(self.share), _ERRORS.least_share)
        return math.hypot(
            math.sqrt(self.rest),
            min(share, _ERRORS.moving_share) * moved,
            share * turned_down,
        )

    @property
    def mean(self) -> float:
        """RMS error of the first stretches, at rest or not; of more than are remembered, an upper bound."""
        return math.sqrt(self.record.error / max(self.seen[0] - _FIRST[0], 1.0))

    def learned(self, error: float, moved: float) -> ErrorModel:
        """After one more stretch: its error, and how far the equations moved the plant in it."""
        at_rest = self.rest
        moving = self.share * moved**2
        total = at_rest + moving
        square = min(error**2, _ERRORS.clip**2 * total)
        # The expected squares of both parts, given their sum.
        square_at_rest = at_rest * moving / total + (at_rest / total) ** 2 * square
        share = (
            self.share * at_rest / total + (self.share * moved / total) ** 2 * square
        )
        counts = (
            min(self.seen[0] + 1.0, _MEMORY[0]),
            min(self.seen[1] + moving / total, _MEMORY[1]),
        )
        return ErrorModel(
            self.rest + (square_at_rest - self.rest) / counts[0],
            self.share + (share - self.share) / counts[1],
            counts,
            self.record.after(error, moved, _KEPT),
        )


class TrackedSample(NamedTuple):
    """A sample, and what was known of the plant and of the equations' errors then."""

    parameters: Parameters
    states: FloatArray
    """Estimated states, before the input acts."""
    input: float
    output: float
    disturbances: FloatArray
    errors: tuple[ErrorModel, ...]
    """The usual errors known then, so that a fault does not hide itself."""
    settled: bool
    """Whether the states had been followed for long enough to be known."""


@compiled
def _outputs_under(  # noqa: PLR0917
    code: Code,
    vector: FloatArray,
    x: FloatArray,
    inputs: FloatArray,
    levels: FloatArray,
    d: FloatArray,
    later: NDArray[np.int64],
    resting: FloatArray,
    usual: FloatArray,
    period: float,
    steps: int,
    instant: bool,
) -> FloatArray:
    """The output at the beginning, after all n samples and after `later` more, under inputs, shape (n + 1,),
    and, instead, at each of some levels; shape (1 + levels, 3). `later` has a value for each of these, shape
    (1 + levels,). The last but one input is held on, as are the last disturbances, shape (n, nd). The output
    is read as `dynamics.read` does; an `instant` one shows the last input at the end and, at other levels,
    the first: estimated states suit that."""
    work = work_for(code, vector)
    outputs = np.empty((1 + levels.size, 3))
    n = inputs.size - 1
    u = np.empty(1)
    row = np.empty(d.shape[1])
    read = resting.copy()
    for k in range(1 + levels.size):
        states = x.copy()
        last = n + later[k]
        for i in range(last + 1):
            for place, wanted in enumerate((0, n, last)):
                if i == wanted:
                    if instant:
                        read[0] = inputs[min(i, n) if k == 0 else 0]
                    call(code[SWITCHES], states, read, usual, work.p, work.b, work.b)
                    call(
                        code[OUTPUTS], states, read, usual, work.p, work.b, work.outputs
                    )
                    outputs[k, place] = work.outputs[0]
            if i < last:
                place_of_input = min(i, n - 1)
                u[0] = inputs[place_of_input] if k == 0 else levels[k - 1]
                for m in range(row.size):
                    row[m] = d[place_of_input, m]
                tick(code, states, u, row, work, period, steps)
    return outputs


class SimulatedSpan:
    """Simulations from the first of some samples to the end of the last; all results in the output's unit."""

    def __init__(
        self,
        first: TrackedSample,
        inputs: FloatArray,
        rows: FloatArray,
        before: float,
        *,
        period: float,
        later: int,
    ) -> None:
        """`inputs` and `rows` of disturbances from the `first` sample on, and the input after them; `before`:
        input at which the drive stood; `period` in s; `later`: for how many samples they are held on."""
        self.first = first
        self._given = (inputs, rows)
        self._period = period
        # What the drive at rest leads to is asked at the end of the last sample only.
        levels = (first.parameters.model.rest[0], before)
        (begun, self.driven, held_on), (_, resting, _), (_, _, stood) = self._outputs(
            first.parameters, levels, (later, 0, later)
        )
        """The output when the last sample ends, under the recorded inputs."""
        self.moved = self.driven - begun
        """How far the output moves until then."""
        self.effect = self.driven - resting
        """What the drive contributes to that output."""
        self.changed = held_on - stood
        """What the drive's changes since it stood at `before` will have contributed when it was held on."""

    def __len__(self) -> int:
        return len(self._given[1])

    def colder(self, change: float) -> float:
        """How far the output would have moved in a colder room; `change` in the scale of that parameter."""
        twin = self.first.parameters
        moved = 0.0
        for name, parameter in twin.model.declared.items():
            if parameter.role == "room":
                lowest = 0.5 * twin[name] if parameter.positive else parameter.least
                room = twin.replace(
                    **{name: max(twin[name] - change * parameter.scale, lowest)}
                )
                moved = max(
                    moved, abs(self._outputs(room, (), (0,))[0][1] - self.driven)
                )
        return moved

    def _outputs(
        self, twin: Parameters, levels: tuple[float, ...], later: tuple[int, ...]
    ) -> list[list[float]]:
        model = twin.model
        inputs, rows = self._given
        outputs = model.kernels.call(
            _outputs_under,
            twin.vector,
            self.first.states,
            inputs,
            np.array(levels),
            rows,
            np.array(later),
            model.rest,
            model.disturbances,
            self._period,
            twin.steps(self._period),
            model.instant,
        )
        return cast("list[list[float]]", outputs.tolist())


_SPANS: Final = (10.0, 16.0, 25.0, 40.0, 64.0, 100.0)
"""Lengths of the stretches over which the drive's effect is estimated, s."""


class _EffectRule(Rule):
    """Which effects of a drive are compared with the readings, and what is missing of one that is lost."""

    apart: float = 1.0
    """How far apart the ends of the stretches are at least, s: a plant sampled faster shows nothing more."""
    noises: float = 8.0
    """Least expected effect whose share is computed, in standard deviations of a reading's noise."""
    errors: float = 6.0
    """Least expected effect whose share is computed, in the usual error of the equations over such a
    stretch."""
    long: int = 2
    """From this of the stretches on, the missing part of a smaller effect counts, too; over a shorter one
    it is only a step or two of the reading."""
    missing: float = 0.6
    """Share of the least effect that the missing part of a smaller one must be: where both begin, a share
    of 0.4 is left."""
    most_missing: float = 1.6
    """The missing part may exceed the expected effect by this factor, as typical parameters may be so far
    off; a larger error has another cause than a dead drive."""
    shifted: float = 3.0
    """Change of what is known of a shift of the readings after which it starts over, in their noises."""
    far_better: float = 10.0
    """Nats by which something else has to explain them better, and a reading that stands than all the
    rest."""
    room_change: float = 0.6
    """Change of the room that a missing effect has to exceed, in the scale of the parameter: for minutes,
    a heater that was giving little and is lost looks like a room that becomes colder."""
    at_once: float = 0.6
    """Least ratio of ten times the effect after one sample to that after ten, if the drive acts at once."""


_EFFECT: Final = _EffectRule()


_MINUTE: Final = -2
"""Place in `_SPANS` of the stretch whose readings are all compared with what else could explain them: a
minute."""


class _ObserverDrifts(Rule):
    """How the observer of the states is set."""

    settled: float = 20.0
    """Time after which the observer knows the states, s: after a gap, how warm the heater is behind its
    lag."""
    state: float = 0.01
    """Drift of a state from the equations per second, in its scale."""
    room: float = 0.03
    """Drift of a parameter of the surroundings per second, such as the room temperature, in its scale:
    for minutes, errors of the equations look like a change of it."""


_DRIFTS: Final = _ObserverDrifts()


def is_lagged(parameters: Parameters, period: float) -> bool:
    """Whether the drive moves the output of a plant much more in ten samples than ten times in one, or moves
    it at once, without a movement from sample to sample."""
    model = parameters.model
    if model.instant:
        return True
    low, high = model.plant.drive.limits
    drive = high if abs(high) >= abs(low) else low
    level = sum(model.plant.output.set_points or model.plant.output.span) / 2
    moved = []
    try:
        for u in (drive, model.plant.drive.rest):
            run = simulate_driven(
                parameters,
                np.full(12, u),
                states=begin(parameters, level),
                period=period,
            )
            moved.append(run.output)
    except PlantError:  # the equations have no solution in the middle of the range
        return False
    effect = np.abs(moved[0] - moved[1])
    return bool(10.0 * effect[1] < _EFFECT.at_once * effect[10])


class LaggedEffect(DriveEffect):
    """The effect of a drive that moves the output only after many samples; push every sample, in order."""

    def __init__(self, parameters: Parameters, period: float) -> None:
        """Begin with a twin and the sample time, s."""
        self._parameters = parameters
        self._period = period
        self._noise = parameters.model.plant.output.noise
        self._scale = slow_scale(parameters.model.plant, period)
        self._spans = [max(2, round(s * self._scale / period)) for s in _SPANS]
        self._apart = max(1, round(_EFFECT.apart * self._scale / period))
        self._errors = (ErrorModel.of(self._noise),) * len(_SPANS)
        self._frozen = False
        self._shift = 0.0
        self.restart()

    newcomer = True
    """Whether too little was seen of the plant to tell its errors at rest from those of movements."""
    delays: tuple[int, ...] = ()
    """By how much later than it is given the input may act, samples."""

    def restart(self) -> None:
        """Start over after a gap, keeping the learned errors."""
        super().restart()
        self._observer: Observer | None = None
        self._followed = 0  # samples since a gap
        self._past: deque[TrackedSample] = deque(maxlen=2 * self._spans[-1] + 1)
        # Their inputs and disturbances as arrays: to collect them at each sample would take longer than to
        # simulate.
        self._inputs = np.zeros(0)
        self._rows = np.zeros((0, self._parameters.model.disturbances.size))
        self._standing: FloatArray | None = None
        self._reading = math.nan
        self.rival: Cause | None = None
        """What explains the newest readings far better than a drive without effect, if that seems missing."""
        self._compared = False  # whether that has been asked of the newest readings

    @property
    def earned(self) -> bool:
        """Whether it has predicted the plant over every stretch."""
        return all(errors.record.earned(self._noise) for errors in self._errors)

    def take(self, parameters: Parameters) -> None:
        """Continue with other parameters of the same model; those of another model are ignored."""
        if parameters.model is self._parameters.model and not self._frozen:
            self._parameters = parameters
            if self._observer is not None:
                self._observer.parameters = parameters

    def freeze(self, frozen: bool) -> None:
        """Stop learning during a fault: in time, a dead heater looks like a working one in the cold."""
        if frozen is self._frozen:
            return
        self._frozen = frozen
        if frozen and self._past:
            self._parameters = self._past[0].parameters
            self._errors = self._past[0].errors
        self._observer = None

    def push(self, sample: Sample, shift: float = 0.0) -> Movement:
        """Take a sample whose reading is known to be shifted; return the expected and the observed movement
        since the one before.

        While a reading is repeated, the plant is assumed to have moved on from its states before that.
        """
        if abs(shift - self._shift) > _EFFECT.shifted * self._noise:
            # what was estimated since is wrong
            self.restart()
        self._shift = shift
        if shift:
            sample = replace(sample, outputs=(sample.output - shift,))
        try:
            movement = self._movement(sample)
        except PlantError:  # the equations have no solution at the observer's states
            self.restart()
            return Movement(0.0, 0.0, 0.0)
        if self._followed % self._apart == 0:
            self._estimate(sample.output)
        return movement

    def _movement(self, sample: Sample) -> Movement:
        row = self._parameters.model.disturbance_row(sample.disturbances or None)
        if self._observer is None:
            scales = np.array([s.scale for s in self._states])
            self._observer = Observer(
                self._parameters,
                sample.output,
                period=self._period,
                drift=_DRIFTS.state * scales / math.sqrt(self._scale),
                start=scales,
                input=sample.input,
                disturbances=row,
                random_walks=self._random_walks,
            )
        observer = self._observer
        moved = 0.0
        if self._past and self._standing is not None:
            last = self._past[-1]
            on = advance(
                last.parameters,
                self._standing,
                last.input,
                self._period,
                last.disturbances,
            )
            before = read(last.parameters, self._standing, input=last.input)
            moved = read(last.parameters, on, input=sample.input) - before
            self._standing = on
        change = sample.output - self._reading if self._past else 0.0
        observer.correct(sample.output, row, sample.input)
        states = observer.states
        if self._standing is None or change != 0.0:
            self._standing = states
        self._reading = sample.output
        # While it is reported as lost, silence would count as its recovery.
        settled = (
            self._frozen
            or self._followed * self._period >= _DRIFTS.settled * self._scale
        )
        self._past.append(
            TrackedSample(
                observer.parameters,
                states,
                sample.input,
                sample.output,
                row,
                self._errors,
                settled,
            )
        )
        self._inputs = np.append(self._inputs, sample.input)[-len(self._past) :]
        self._rows = np.append(self._rows, row[None, :], axis=0)[-len(self._past) :]
        self._followed += 1
        observer.predict(sample.input)
        return Movement(0.0, moved, change - moved)

    def _estimate(self, output: float) -> None:
        """Estimate the drive's effect over every stretch that ends now."""
        self.share = math.nan
        self.rival = None
        self._compared = False
        past = list(self._past)
        learned = list(self._errors)
        inputs = self._inputs
        rows = self._rows
        for k, length in enumerate(self._spans):
            first = len(past) - 1 - length
            if first < 0:
                break
            if not past[first].settled:
                continue
            inputs_before = inputs[max(0, first - self._spans[-1]) : first + 1].tolist()
            stood = math.fsum(inputs_before) / len(inputs_before)
            stretch = SimulatedSpan(
                past[first],
                inputs[first:],
                rows[first:-1],
                stood,
                period=self._period,
                later=self._spans[0],
            )
            error = output - stretch.driven

            def later(
                delay: int, first: int = first, stood: float = stood
            ) -> SimulatedSpan:
                """The same stretch if inputs act so many samples later."""
                places = np.maximum(np.arange(first, len(past)) - delay, 0)
                return SimulatedSpan(
                    past[first],
                    inputs[places],
                    rows[first:-1],
                    stood,
                    period=self._period,
                    later=self._spans[0],
                )

            self._weigh(stretch, error, stretch.first.errors[k], later, output)
            if not self._frozen:
                learned[k] = learned[k].learned(
                    error, max(abs(stretch.changed), abs(stretch.moved))
                )
        self._errors = tuple(learned)

    def _weigh(
        self,
        stretch: SimulatedSpan,
        error: float,
        errors: ErrorModel,
        later: Callable[[int], SimulatedSpan],
        output: float,
    ) -> None:
        """Take the share of the expected effect that a stretch shows, if it is the least and counts.

        A drive that was turned down looks lost if it does more than its equations say, or sooner.
        """
        effect = stretch.effect
        changed = stretch.changed
        if effect == 0.0:
            return
        share = 1.0 + error / effect
        accuses_drive = share < FOLLOWS[0]
        usual_error = errors.error(
            stretch.moved, changed if changed * effect < 0.0 else 0.0
        )
        if self.newcomer:
            usual_error = max(usual_error, errors.mean)
        least_effect = max(_EFFECT.noises * self._noise, _EFFECT.errors * usual_error)
        shows_nothing = len(stretch) >= self._spans[-1] and share <= NOTHING
        sees_drive = errors.record.sees_drive(self._noise)
        if accuses_drive and not (shows_nothing or sees_drive):
            return
        missing = abs(error) if share < 1.0 else 0.0
        counts = abs(effect) >= least_effect
        if len(stretch) >= self._spans[_EFFECT.long] and sees_drive:
            least_missing = _EFFECT.missing * least_effect
            counts = counts or least_missing <= missing <= _EFFECT.most_missing * abs(
                effect
            )
        if share >= self.share or not counts:
            return
        if missing > _EFFECT.missing * abs(effect) and missing < stretch.colder(
            _EFFECT.room_change
        ):
            return  # a colder room may be what is missing
        if accuses_drive and any(
            self._explains(later(delay), output, effect)
            for delay in self.delays
            if delay > 0
        ):
            return  # the input may act later
        if accuses_drive and not self._frozen and self._has_rival():
            return
        self.share = share
        self.length = len(stretch)
        self.expected = effect

    def _has_rival(self) -> bool:
        """Whether something explains the newest readings far better than a lost drive; asked of them once."""
        if not self._compared:
            self.rival = self._better_cause()
            self._compared = True
        return self.rival is not None

    def _better_cause(self) -> Cause | None:
        """What explains the last minute far better than a drive that has lost its effect; None if nothing.

        A slow error of the equations makes any cause likely; but it may also be what a lost drive does to a
        plant nearly at rest, where a reading that stands is told from it only without such an error.
        """
        past = list(self._past)[-self._spans[_MINUTE] - 1 :]
        first = past[0]
        if not first.settled:
            return None
        readings = np.array([sample.output for sample in past])
        effects = effects_of_causes(
            first.parameters,
            first.states,
            self._inputs[-len(past) :],
            readings,
            rows=self._rows[-len(past) :],
            period=self._period,
        )
        for slow_error, causes in ((True, {*Cause}), (False, {Cause.FROZEN})):
            costs = costs_of_causes(effects, slow_error=slow_error)
            best, second = sorted(costs, key=costs.__getitem__)[:2]
            if best is Cause.FROZEN and costs[second] < _EFFECT.far_better:
                best = second  # under other losses, too, a plant comes to rest
            if costs[Cause.DRIVE] >= _EFFECT.far_better and best in causes:
                return best
        return None

    @staticmethod
    def _explains(stretch: SimulatedSpan, output: float, effect: float) -> bool:
        """Whether a later input leaves no effect missing: it acts, or cannot have acted enough yet."""
        missing = (stretch.driven - output) / stretch.effect if stretch.effect else 0.0
        return stretch.effect / effect < FOLLOWS[0] or missing < 1.0 - FOLLOWS[0]

    @property
    def _random_walks(self) -> dict[str, RandomWalk]:
        declared = self._parameters.model.declared if not self._frozen else {}
        return {
            name: RandomWalk(
                start=parameter.scale, drift=_DRIFTS.room * parameter.scale
            )
            for name, parameter in declared.items()
            if parameter.role == "room"
        }

    @property
    def _states(self) -> list[State]:
        model = self._parameters.model
        return [model.plant.states[name] for name in model.states]
