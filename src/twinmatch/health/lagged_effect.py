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
from itertools import starmap
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.compiled import compiled
from twinmatch.dynamics import (
    Model,
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


class ErrorModel(NamedTuple):
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
    record: Record = Record()
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


class PastArrays(NamedTuple):
    """The newest N samples, and what was known of the plant at each."""

    vectors: FloatArray
    """Parameters, shape (N, p)."""
    steps: NDArray[np.int64]
    """Integration steps of a period with these parameters, shape (N,)."""
    states: FloatArray
    """Estimated states, before the input acts, shape (N, n)."""
    inputs: FloatArray
    """Of the drive, shape (N,)."""
    rows: FloatArray
    """Disturbances, shape (N, m)."""
    stood: FloatArray
    """Mean input of the longest stretch that ended there, at which the drive stood, shape (N,)."""


class Past:
    """The newest samples, and what was known of the plant and of the equations' errors at each.

    They lie in arrays of twice their number, from which all stretches are simulated in one call: to collect
    them at each sample would take longer than to simulate.
    """

    def __init__(self, model: Model, longest: int) -> None:
        """Keep samples for stretches of up to `longest` samples, and as many before these."""
        self._most = 2 * longest + 1
        self._mean_of = longest + 1
        size = 2 * self._most
        self._arrays = PastArrays(
            vectors=np.zeros((size, len(model.names))),
            steps=np.zeros(size, dtype=np.int64),
            states=np.zeros((size, len(model.states))),
            inputs=np.zeros(size),
            rows=np.zeros((size, model.disturbances.size)),
            stood=np.zeros(size),
        )
        self._outputs = np.zeros(size)
        self._settled = np.zeros(size, dtype=np.bool_)
        self._errors: deque[tuple[ErrorModel, ...]] = deque(maxlen=self._most)
        self._end = 0

    def __len__(self) -> int:
        return len(self._errors)

    def append(  # noqa: PLR0917
        self,
        observer: Observer,
        states: FloatArray,
        input: float,
        output: float,
        row: FloatArray,
        errors: tuple[ErrorModel, ...],
        *,
        settled: bool,
    ) -> None:
        """Take a sample under an input and a row of disturbances, which an observer has predicted on from its
        `states`; `settled`: whether these had been followed for long enough to be known."""
        if self._end == self._outputs.size:
            self._move_to_front()
        end = self._end
        arrays = self._arrays
        arrays.vectors[end] = observer.vector
        arrays.steps[end] = observer.steps
        arrays.states[end] = states
        arrays.inputs[end] = input
        arrays.rows[end] = row
        self._outputs[end] = output
        self._settled[end] = settled
        self._errors.append(errors)
        self._end = end + 1
        newest = arrays.inputs[max(self._begin, self._end - self._mean_of) : self._end]
        arrays.stood[end] = math.fsum(newest.tolist()) / newest.size

    def errors_at(self, place: int) -> tuple[ErrorModel, ...]:
        """The usual errors known at a sample, so that a fault does not hide itself."""
        return self._errors[place]

    def settled_at(self, place: int) -> bool:
        """Whether the states at a sample had been followed for long enough to be known."""
        return bool(self._settled[self._begin + place])

    @property
    def arrays(self) -> PastArrays:
        """What stretches are simulated from, the oldest sample first."""
        kept = slice(self._begin, self._end)
        vectors, steps, states, inputs, rows, stood = self._arrays
        return PastArrays(
            vectors[kept],
            steps[kept],
            states[kept],
            inputs[kept],
            rows[kept],
            stood[kept],
        )

    @property
    def outputs(self) -> FloatArray:
        """Readings, shape (N,)."""
        return self._outputs[self._begin : self._end]

    @property
    def _begin(self) -> int:
        return self._end - len(self._errors)

    def _move_to_front(self) -> None:
        kept = slice(self._begin, self._end)
        count = len(self)
        for array in (*self._arrays, self._outputs, self._settled):
            array[:count] = array[kept].copy()
        self._end = count


@compiled
def _drive_effects(  # noqa: PLR0917
    code: Code,
    vectors: FloatArray,
    steps: NDArray[np.int64],
    states: FloatArray,
    inputs: FloatArray,
    rows: FloatArray,
    stood: FloatArray,
    firsts: NDArray[np.int64],
    resting: FloatArray,
    usual: FloatArray,
    period: float,
    later: int,
    instant: bool,
) -> FloatArray:
    """What the equations say of stretches that begin at the samples at `firsts` and end at the newest; arrays as
    in `PastArrays`, results as in `Stretch`, shape (k, 4).

    Each is simulated under the recorded inputs, with the drive at rest, and with it as it `stood`; the first
    and the last continue for `later` samples, for which the last but one input is held on, as are the disturbances.
    The output is read as `dynamics.read` does; an `instant` one shows the last input at the end and, where the
    drive did not follow the recorded inputs, the first: estimated states suit that.
    """
    effects = np.empty((firsts.size, 4))
    outputs = np.empty((3, 3))
    u = np.empty(1)
    row = np.empty(rows.shape[1])
    read = resting.copy()
    for k in range(firsts.size):
        first = firsts[k]
        n = inputs.size - 1 - first
        work = work_for(code, vectors[first])
        for run in range(3):
            x = states[first].copy()
            last = n if run == 1 else n + later
            for i in range(last + 1):
                for place, wanted in enumerate((0, n, last)):
                    if i == wanted:
                        if instant:
                            read[0] = inputs[first + (min(i, n) if run == 0 else 0)]
                        call(code[SWITCHES], x, read, usual, work.p, work.b, work.b)
                        call(
                            code[OUTPUTS], x, read, usual, work.p, work.b, work.outputs
                        )
                        outputs[run, place] = work.outputs[0]
                if i < last:
                    place_of_input = first + min(i, n - 1)
                    if run == 0:
                        u[0] = inputs[place_of_input]
                    else:
                        u[0] = resting[0] if run == 1 else stood[first]
                    for m in range(row.size):
                        row[m] = rows[place_of_input, m]
                    tick(code, x, u, row, work, period, steps[first])
        effects[k, 0] = outputs[0, 1]
        effects[k, 1] = outputs[0, 1] - outputs[0, 0]
        effects[k, 2] = outputs[0, 1] - outputs[1, 1]
        effects[k, 3] = outputs[0, 2] - outputs[2, 2]
    return effects


class Stretch(NamedTuple):
    """What the equations say of the samples from one of the past to the newest, in the output's unit."""

    driven: float
    """The output at the newest sample under the recorded inputs."""
    moved: float
    """How far the output moves until then."""
    effect: float
    """What the drive contributes to that output."""
    changed: float
    """What the drive's changes since it stood, before the first sample, will have contributed when it was held on
    for the shortest stretch."""


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
        self._past = Past(self._parameters.model, self._spans[-1])
        self._standing: FloatArray | None = None
        self._reading = math.nan
        self._shown = math.nan  # the reading with what it is shifted by
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
            self._parameters = self._parameters_at(0)
            self._errors = self._past.errors_at(0)
        self._observer = None

    def push(self, sample: Sample, shift: float = 0.0) -> float:
        """Take a sample whose reading is known to be shifted; return the movement expected since the one before
        if it repeats that one's reading, in the output's unit; 0 if it does not.

        While a reading is repeated, the plant is assumed to have moved on from its states before that.
        """
        if abs(shift - self._shift) > _EFFECT.shifted * self._noise:
            # what was estimated since is wrong
            self.restart()
        self._shift = shift
        output = sample.output - shift
        try:
            moved = self._moved_while_repeated(sample, output)
            self._follow(sample, output)
        except PlantError:  # the equations have no solution at the observer's states
            self.restart()
            return 0.0
        if self._followed % self._apart == 0:
            self._estimate(output)
        return moved

    def _moved_while_repeated(self, sample: Sample, output: float) -> float:
        """How far the plant is expected to have moved since a reading that is repeated."""
        repeats_output = output == self._reading
        if self._standing is None or not (
            repeats_output or sample.output == self._shown
        ):
            self._standing = None
            return 0.0
        last = len(self._past) - 1
        parameters = self._parameters_at(last)
        arrays = self._past.arrays
        input_before = float(arrays.inputs[last])
        on = advance(
            parameters, self._standing, input_before, self._period, arrays.rows[last]
        )
        before = read(parameters, self._standing, input=input_before)
        moved = read(parameters, on, input=sample.input) - before
        self._standing = on if repeats_output else None
        return moved

    def _follow(self, sample: Sample, output: float) -> None:
        """Estimate the states at a sample, and move on to the next."""
        row = self._parameters.model.disturbance_row(sample.disturbances or None)
        observer = self._observer or self._new_observer(sample, output, row)
        self._observer = observer
        observer.correct(output, row, sample.input)
        states = observer.states
        if self._standing is None:
            self._standing = states
        self._reading = output
        self._shown = sample.output
        # While it is reported as lost, silence would count as its recovery.
        settled = (
            self._frozen
            or self._followed * self._period >= _DRIFTS.settled * self._scale
        )
        self._followed += 1
        observer.predict(sample.input)
        self._past.append(
            observer,
            states,
            sample.input,
            output,
            row,
            self._errors,
            settled=settled,
        )

    def _new_observer(self, sample: Sample, output: float, row: FloatArray) -> Observer:
        scales = np.array([s.scale for s in self._states])
        return Observer(
            self._parameters,
            output,
            period=self._period,
            drift=_DRIFTS.state * scales / math.sqrt(self._scale),
            start=scales,
            input=sample.input,
            disturbances=row,
            random_walks=self._random_walks,
        )

    def _parameters_at(self, place: int) -> Parameters:
        """The parameters as they were known at a sample of the past."""
        model = self._parameters.model
        values = self._past.arrays.vectors[place].tolist()
        return model.parameters(**dict(zip(model.names, values, strict=True)))

    def _estimate(self, output: float) -> None:
        """Estimate the drive's effect over every stretch that ends now."""
        self.share = math.nan
        self.rival = None
        self._compared = False
        learned = list(self._errors)
        firsts = self._firsts()
        stretches = self._simulated(self._past.arrays, [*firsts.values()])
        for (k, first), stretch in zip(firsts.items(), stretches, strict=True):
            errors = self._past.errors_at(first)[k]
            error = output - stretch.driven
            self._weigh(stretch, first, error, errors, output)
            if not self._frozen:
                learned[k] = learned[k].learned(
                    error, max(abs(stretch.changed), abs(stretch.moved))
                )
        self._errors = tuple(learned)

    def _firsts(self) -> dict[int, int]:
        """Where the stretches begin whose states were known then, by their places among the spans."""
        firsts = {}
        for k, length in enumerate(self._spans):
            first = len(self._past) - 1 - length
            if first < 0:
                break
            if self._past.settled_at(first):
                firsts[k] = first
        return firsts

    def _simulated(self, arrays: PastArrays, firsts: list[int]) -> list[Stretch]:
        """The stretches that begin at some samples and end at the newest, with one call for all of them."""
        if not firsts:
            return []
        model = self._parameters.model
        effects = model.kernels.call(
            _drive_effects,
            *arrays,
            np.array(firsts),
            model.rest,
            model.disturbances,
            self._period,
            self._spans[0],
            model.instant,
        )
        return list(starmap(Stretch, effects.tolist()))

    def _weigh(
        self,
        stretch: Stretch,
        first: int,
        error: float,
        errors: ErrorModel,
        output: float,
    ) -> None:
        """Take the share of the expected effect that a stretch shows, if it is the least and counts."""
        if stretch.effect == 0.0:
            return
        share = 1.0 + error / stretch.effect
        if share >= self.share:
            return
        length = len(self._past) - 1 - first
        missing = abs(error) if share < 1.0 else 0.0
        if not self._counts(stretch, share, length, missing, errors):
            return
        if self._has_other_reason(stretch, share, first, missing, output):
            return
        self.share = share
        self.length = length
        self.expected = stretch.effect

    def _counts(
        self,
        stretch: Stretch,
        share: float,
        length: int,
        missing: float,
        errors: ErrorModel,
    ) -> bool:
        """Whether a stretch of so many samples expects more than what else moves a reading.

        A drive that was turned down looks lost if it does more than its equations say, or sooner.
        """
        effect = stretch.effect
        least_effect = _EFFECT.noises * self._noise
        if abs(effect) < least_effect and missing < _EFFECT.missing * least_effect:
            return False  # however small the usual errors are
        changed = stretch.changed
        turned_down = changed if changed * effect < 0.0 else 0.0
        usual_error = errors.error(stretch.moved, turned_down)
        if self.newcomer:
            usual_error = max(usual_error, errors.mean)
        least_effect = max(least_effect, _EFFECT.errors * usual_error)
        shows_nothing = length >= self._spans[-1] and share <= NOTHING
        sees_drive = errors.record.sees_drive(self._noise)
        if share < FOLLOWS[0] and not (shows_nothing or sees_drive):
            return False
        if abs(effect) >= least_effect:
            return True
        if length < self._spans[_EFFECT.long] or not sees_drive:
            return False
        least_missing = _EFFECT.missing * least_effect
        return least_missing <= missing <= _EFFECT.most_missing * abs(effect)

    def _has_other_reason(
        self,
        stretch: Stretch,
        share: float,
        first: int,
        missing: float,
        output: float,
    ) -> bool:
        """Whether something else than the drive may be why a part of its effect is missing."""
        effect = stretch.effect
        if missing > _EFFECT.missing * abs(effect) and missing < self._colder(
            stretch, first
        ):
            return True
        if share >= FOLLOWS[0]:
            return False
        delays = [delay for delay in self.delays if delay > 0]
        if any(
            self._explains(self._with_later_inputs(first, delay), output, effect)
            for delay in delays
        ):
            return True
        return not self._frozen and self._has_rival()

    def _colder(self, stretch: Stretch, first: int) -> float:
        """How far the output would have moved over a stretch in a colder room."""
        twin = self._parameters_at(first)
        arrays = self._past.arrays
        moved = 0.0
        for name, parameter in twin.model.declared.items():
            if parameter.role != "room":
                continue
            lowest = 0.5 * twin[name] if parameter.positive else parameter.least
            change = _EFFECT.room_change * parameter.scale
            room = twin.replace(**{name: max(twin[name] - change, lowest)})
            vectors = arrays.vectors.copy()
            vectors[first] = room.vector
            steps = arrays.steps.copy()
            steps[first] = room.steps(self._period)
            in_room = arrays._replace(vectors=vectors, steps=steps)
            (colder,) = self._simulated(in_room, [first])
            moved = max(moved, abs(colder.driven - stretch.driven))
        return moved

    def _with_later_inputs(self, first: int, delay: int) -> Stretch:
        """A stretch if inputs act so many samples later."""
        arrays = self._past.arrays
        places = np.maximum(np.arange(len(self._past)) - delay, 0)
        (later,) = self._simulated(
            arrays._replace(inputs=arrays.inputs[places]), [first]
        )
        return later

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
        first = max(0, len(self._past) - self._spans[_MINUTE] - 1)
        if not self._past.settled_at(first):
            return None
        arrays = self._past.arrays
        effects = effects_of_causes(
            self._parameters_at(first),
            arrays.states[first],
            arrays.inputs[first:],
            self._past.outputs[first:],
            rows=arrays.rows[first:],
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
    def _explains(stretch: Stretch, output: float, effect: float) -> bool:
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
