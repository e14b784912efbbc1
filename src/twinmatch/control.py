"""The control loops: set-points over time, and one step of each PID per tick, without clock or ROS.

`Profile` is a set-point as a function of time. `Loop` takes readings and the time, and makes one `Sample`
per tick. Where it cannot (no fresh reading, a missed tick) it makes none, so the index of the next sample
shows how many are missing.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import accumulate, repeat
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.dynamics import Controller, Law, PidGains, Plant, law_of, pids_of
from twinmatch.errors import TwinmatchError
from twinmatch.safety import LawTrial, TrialPhase
from twinmatch.signals import (
    NANOSECONDS,
    FloatArray,
    Sample,
    Signals,
    one_of_each,
    point_values,
)

__all__ = ["ControlError", "Loop", "Profile"]


class ControlError(TwinmatchError):
    """A profile or a loop cannot be run."""


@dataclass(frozen=True)
class Profile:
    """A sequence of levels, each held for its time.

    With a ramp the set-point moves to a level at that rate, starting when the level's time starts; the first
    level applies from the start.

    Raises:
        ControlError: there is no level, the numbers of levels and times differ, a level is outside the safe
            range, a time or rate is invalid, or a ramp takes longer than the level's time.
    """

    levels: tuple[float, ...]
    """Set-points."""
    holds: tuple[float, ...]
    """Time of each level, s."""
    repeat: bool = False
    """Start over at the end."""
    ramp: float = 0.0
    """Rate of change, per second; 0: steps."""
    lowest: float = field(kw_only=True)
    """Lower end of the safe range, such as the plant's `output.safe`."""
    highest: float = field(kw_only=True)
    """Upper end."""
    unit: str = field(kw_only=True)
    """Unit of the set-points, for messages."""
    name: str = field(default="profile", kw_only=True)
    """What it is called in messages."""

    def __post_init__(self) -> None:
        if problem := next(self._problems(), ""):
            raise ControlError(f"{self.name}: {problem}")

    def _problems(self) -> Iterator[str]:
        """Why the profile cannot be run; each holds if there is none before it."""
        unit = self.unit
        allowed = f"{self.lowest:g} to {self.highest:g} {self.unit}"
        if not self.lowest < self.highest:
            yield f"the range {allowed} is empty"
        if not self.levels or len(self.levels) != len(self.holds):
            numbers = f"{len(self.levels)} levels and {len(self.holds)} times are given"
            yield f"{numbers}; give one time per level, and at least one level"
        for number, (level, hold) in enumerate(
            zip(self.levels, self.holds, strict=True), 1
        ):
            if not self.lowest <= level <= self.highest:
                yield f"level {number} is {level:g} {unit}; give one in the safe range, {allowed}"
            if not (math.isfinite(hold) and hold > 0):
                yield f"the time of level {number} is {hold:g} s; give a positive time"
        if not (math.isfinite(self.ramp) and self.ramp >= 0):
            yield f"the ramp is {self.ramp:g} {unit}/s; give a positive rate, or 0 for steps"
        first = 0 if self.repeat else 1
        for number in range(first, len(self.levels) if self.ramp > 0 else 0):
            needed = abs(self.levels[number] - self.levels[number - 1]) / self.ramp
            if needed > self.holds[number]:
                yield (
                    f"the ramp to level {number + 1} takes {needed:g} s, longer than its time of "
                    f"{self.holds[number]:g} s; hold it longer or choose a faster ramp"
                )

    @property
    def duration(self) -> float:
        """Time until the end of the last level, s; infinite for a profile that repeats."""
        return math.inf if self.repeat else sum(self.holds)

    def ended(self, time: float) -> bool:
        """Whether the profile is over at this time (s since its start)."""
        return time >= self.duration

    def reference(self, time: float) -> float:
        """The set-point at a time (s since the start); after the end, the last level.

        Raises:
            ControlError: the time is not finite.
        """
        if not math.isfinite(time):
            raise ControlError(f"{self.name}: the time is {time} s; it must be finite")
        round_ = sum(self.holds)
        first_round = not self.repeat or time < round_
        position = max(time, 0.0) if not self.repeat else max(time, 0.0) % round_
        starts = [0.0, *accumulate(self.holds[:-1])]
        number = bisect_right(starts, position) - 1
        level = self.levels[number]
        if self.ramp == 0 or (number == 0 and first_round):
            return level
        before = self.levels[number - 1]
        moved = self.ramp * (position - starts[number])
        if moved >= abs(level - before):
            return level
        return before + math.copysign(moved, level - before)


class _TickGrid:
    """Ticks one period apart: the number of each, how late it was, and which were missed.

    A tick slightly before its time moves the grid, because those before it were late. One that is early by
    half a period or more does not count: a busy machine makes up for a late call with an immediate second
    one. If the clock is set back, the grid restarts after a gap.
    """

    def __init__(self, period: int) -> None:
        """Begin before tick 0; `period` is the time between two ticks, ns."""
        self._period = period
        self.number: int | None = None
        """Number of the newest tick; None before tick 0."""
        self.missed = 0
        """Ticks missed since tick 0."""
        self.jitter = 0.0
        """Lateness of the newest tick, s."""
        self._newest = 0
        """Time of the newest tick that counts, ns."""
        self._origin = 0
        """When tick 0 was due, ns."""

    def begin(self, now: int) -> None:
        """Have the grid start with the tick at this time, ns, as tick 0."""
        self.number = 0
        self._origin = now

    def is_set_back(self, now: int) -> bool:
        """Whether the clock shows an earlier time, ns, than at the newest tick."""
        return self.number is not None and now < self._newest

    def place(self, now: int) -> int | None:
        """Take the tick at this time, ns; returns its number, or None if it does not count. Before the grid has begun
        every tick would be tick 0."""
        number = self._place(now)
        if number is not None:
            self._newest = now
            if self.number is not None:
                self.number = number
        return number

    def _place(self, now: int) -> int | None:
        if self.number is None:
            return 0
        expected = self.number + 1
        if self.is_set_back(now):
            self._origin = now - (expected + 1) * self._period
            self.missed += 1
            self.jitter = 0.0
            return expected + 1
        late = now - self._origin - expected * self._period
        if late <= -self._period // 2:
            return None
        if late < 0:
            self._origin += late
            late = 0
        skipped, lateness = divmod(late, self._period)
        self.missed += skipped
        self.jitter = lateness / NANOSECONDS
        return expected + skipped


class _Readings(NamedTuple):
    """What was measured at one moment."""

    stamp: int
    """When, ns."""
    outputs: Signals
    disturbances: Signals
    taken: Signals
    """What the law is given in place of each output; NaN: the output itself."""


class Loop:
    """The PIDs of a plant's loops on a grid of ticks, one period apart.

    The first tick that has a reading and a set-point starts the grid and is sample 0. A tick without them
    (none yet, or the newest reading is stale) makes no sample and switches the output off; a tick that is
    late by a period or more means that others were missed. Neither is filled in: a sample's index is the
    number of its tick on the grid, so a gap in the indices is a gap in time; behind a long one windows of
    samples start over. The controller restarts after a gap too, bumplessly from the current output. A tick that is
    early by half a period or more does not count; where the clock is set back, there is a gap.
    """

    pids: list[Controller]
    """The controllers, one of each output; new ones after a gap."""

    def __init__(
        self,
        plant: type[Plant],
        law: Law | None = None,
        *,
        max_age: float = 2.0,
        state: ArrayLike | None = None,
    ) -> None:
        """Start with the output off and without readings.

        Args:
            plant: the controlled plant.
            law: one PID for each output; default: that of the plant file, at 1 s.
            max_age: age from which a reading is stale, s.
            state: state of the PIDs at sample 0, a row each; default: their outputs start at zero.

        Raises:
            ControlError: the age is not positive, or the law is not one PID for each output.
            PlantError: no law is given and the plant file has none.
        """
        if not (math.isfinite(max_age) and max_age > 0):
            raise ControlError(f"loop: max_age is {max_age} s; it must be positive")
        self._plant = plant
        law = law or law_of(plant, 1.0)
        self._gains = pids_of(law)
        if len(self._gains) != len(plant.outputs) or len(self._gains) != len(
            plant.drives
        ):
            raise ControlError(
                f"loop: the law of plant {plant.name} is a {type(law).__name__}; give a PID for each of its "
                f"{len(plant.outputs)} outputs and {len(plant.drives)} drives"
            )
        self.inputs = [0.0] * len(self._gains)
        """The current commands to the plant, in its units."""
        self.trouble = "no tick yet"
        """Why the output is off; empty while there are samples."""
        self.idle = 0
        """Ticks since sample 0 at which there was no usable reading or set-point."""
        self.refused = 0
        """Number of unusable readings."""
        self.held = False
        """Whether a fault holds the drives at rest: then the inputs are rest, in the samples too, and the
        controller continues from there."""
        self.limits = [math.inf] * len(self._gains)
        """The most that passes: samples have no higher inputs, and the controller continues from there."""
        rows = (
            repeat(None) if state is None else np.reshape(state, (len(self._gains), -1))
        )
        self.pids = [
            Controller(gains, row)
            for gains, row in zip(self._gains, rows, strict=False)
        ]
        self.trial: LawTrial | None = None
        """Watches a law on trial; None: there never was one."""
        self._beside: tuple[PidGains, ...] = ()
        """Gains of the law that does not drive: the one on trial, later the one before."""
        self.shadow: tuple[float, ...] = ()
        """What the law in the shadow would command now."""
        self._shadows: list[Controller] = []
        self._tried_at: Signals = ()
        """Set-points of the first tick of a trial."""
        self._restart = state is None
        self.period = law.period
        """Between two ticks, s."""
        self._grid = _TickGrid(round(law.period * NANOSECONDS))
        self._max_age = round(max_age * NANOSECONDS)
        self._readings: _Readings | None = None
        """The newest ones; None before the first, and once the clock was set back."""
        self._stood_in = [False] * len(self._gains)
        """Whether each law was given something in place of its output at the newest tick."""

    @property
    def time(self) -> float:
        """Time from sample 0 to the newest tick in whole periods, s; 0 before sample 0."""
        return (self._grid.number or 0) * self.period

    @property
    def missed(self) -> int:
        """Ticks missed since sample 0."""
        return self._grid.missed

    @property
    def jitter(self) -> float:
        """Lateness of the newest tick, s."""
        return self._grid.jitter

    @property
    def input(self) -> float:
        """The current command of a single loop."""
        return one_of_each("input", tuple(self.inputs))

    @property
    def running(self) -> bool:
        """Whether the newest tick made a sample."""
        return not self.trouble

    @property
    def trying(self) -> bool:
        """Whether a law is on trial, in the shadow or driving."""
        return self.trial is not None and not self.trial.ended

    def measure(
        self,
        outputs: Sequence[float] | float,
        stamp: int,
        disturbances: Sequence[float] = (),
        taken: Sequence[float] = (),
    ) -> None:
        """Take the readings measured at `stamp` (ns), with the disturbances if they are measured too.

        The law is given `taken` in place of the outputs; NaN, or none at all: the output itself. Where that
        changes, its controller continues without a bump. Samples have the readings.

        Readings that are not finite or not one of each output, or that have some but not all of the plant's
        disturbances or of what is taken, are only counted.
        """
        readings = _Readings(
            stamp, point_values(outputs), tuple(disturbances), tuple(taken)
        )
        if not self._can_use(readings):
            self.refused += 1
        elif taken:
            self._readings = readings
        else:
            each_output_itself = (math.nan,) * len(readings.outputs)
            self._readings = readings._replace(taken=each_output_itself)

    def _can_use(self, readings: _Readings) -> bool:
        """Whether all readings are there that belong together, and are finite."""
        if len(readings.outputs) != len(self.pids):
            return False
        if len(readings.disturbances) not in (0, len(self._plant.disturbances)):
            return False
        if len(readings.taken) not in (0, len(self.pids)):
            return False
        if any(map(math.isinf, readings.taken)):
            return False
        return all(map(math.isfinite, (*readings.outputs, *readings.disturbances)))

    def tick(
        self, now: int, profile: Callable[[float], Sequence[float] | float | None]
    ) -> Sample | None:
        """Take the time of a tick; return its sample, if there is one.

        If there is none, `trouble` says why the output is off, or the tick did not count.

        Args:
            now: the time, ns.
            profile: returns the set-points, or None, at a time since sample 0 (s), which is in whole periods
                so that a late tick does not shift a step of the set-point.
        """
        if self._grid.is_set_back(now):
            # stamped by the old time, they would seem fresh until the clock caught up
            self._readings = None
        number_before = self._grid.number
        number = self._grid.place(now)
        if number is None:
            return None
        wanted = profile(number * self.period)
        references = None if wanted is None else point_values(wanted)
        readings = self._readings
        trouble = self._doubt(now, readings, references)
        if trouble or readings is None or references is None:
            self._switch_off(trouble)
            return None
        if number_before is None:
            self._grid.begin(now)
        elif number != number_before + 1:
            self._continue_after_gap(number - number_before - 1)
        self.trouble = ""
        if self.trying and (self.held or min(self.limits) < math.inf):
            self.take_back("the guard holds or limits the drive")
        commands = self._commands(references, readings)
        return Sample(
            number,
            now,
            references,
            readings.outputs,
            tuple(commands),
            readings.disturbances,
        )

    def _switch_off(self, trouble: str) -> None:
        """Switch the output off at a tick that makes no sample."""
        self.trouble = trouble
        self.inputs = [0.0] * len(self.pids)
        self._restart = True
        if self.trying:
            self.take_back(trouble)
        if self._grid.number is not None:
            self.idle += 1

    def _continue_after_gap(self, missed: int) -> None:
        """Restart the controllers behind missed ticks, of which a trial has no readings."""
        self._restart = True
        if self.trial is not None and self.trying:
            lost = (math.nan,) * len(self.pids)
            self._show(self.trial, repeat(lost, missed))

    def _commands(self, references: Signals, readings: _Readings) -> list[float]:
        """The commands of this tick as far as they pass; at rest while a fault holds the drives."""
        if self.held:
            self.inputs = [drive.rest for drive in self._plant.drives.values()]
            self._restart = True
            return self.inputs
        if self.trial is not None and self.trying:
            self._watch(self.trial, references, readings.outputs)
        commands = [
            self._step(k, references[k], readings.outputs[k], readings.taken[k])
            for k in range(len(self.pids))
        ]
        self._restart = False
        return commands

    def try_law(self, law: Law, trial: LawTrial) -> None:
        """Put a law on trial: in the shadow of the one that runs, or driving from the next tick on.

        Whichever drives takes over without a bump: its integral is set so that the command does not move.

        Raises:
            ControlError: it is not a PID for each output at this loop's period, or another is on trial.
        """
        gains = pids_of(law)
        if len(gains) != len(self._gains) or law.period != self.period:
            raise ControlError(
                f"loop: a law on trial is {len(self._gains)} PIDs, every {self.period:g} s; give those"
            )
        if not all(loop_gains.integral for loop_gains in gains):
            raise ControlError(
                "loop: a law without integral gain cannot take over without a bump; give one"
            )
        if self.trying:
            raise ControlError(
                "loop: a law is on trial already; take it back first, or wait"
            )
        self.trial = trial
        self._beside = gains
        self._shadows = [Controller(loop_gains) for loop_gains in gains]
        self._tried_at = ()
        if trial.drives:
            self._exchange()

    def take_back(self, reason: str) -> None:
        """Give the plant back to the law before, if one on trial drives it; end the trial."""
        if self.trial is None or self.trial.phase is TrialPhase.BACK:
            return
        drove = self.trial.drives
        self.trial.take_back(reason)
        self.shadow = ()
        if drove:
            self._exchange()

    def _exchange(self) -> None:
        """Have the other law drive, continued from the current command."""
        driving = self._gains
        self._gains = self._beside
        self._beside = driving
        self.shadow = ()
        self.pids = [Controller(loop_gains) for loop_gains in self._gains]
        self._restart = True

    def _show(self, trial: LawTrial, read: Iterable[Signals]) -> None:
        """Show a trial what was read at one tick after another; have the law drive that is then to drive."""
        drove = trial.drives
        for outputs in read:
            trial.push(outputs)
        if trial.drives != drove:
            self._exchange()

    def _watch(self, trial: LawTrial, references: Signals, outputs: Signals) -> None:
        """Show a trial the readings of this tick; compute the law in the shadow."""
        if references != (self._tried_at or references):
            self.take_back("the set-point has moved, for which its bands are not")
            return
        self._tried_at = references
        before = self.shadow
        self._show(trial, [outputs])
        if not trial.drives and not trial.ended:
            for k, pid in enumerate(self._shadows if not before else ()):
                pid.state = self._continued(
                    k, references[k], outputs[k], self._beside[k]
                )
            loops = zip(self._shadows, references, outputs, strict=True)
            self.shadow = tuple(float(pid.step(r, y)[0]) for pid, r, y in loops)

    def _step(self, k: int, reference: float, reading: float, taken: float) -> float:
        """One step of a PID, which is given `taken` in place of the reading unless that is NaN; returns what passes
        of its command."""
        pid = self.pids[k]
        stands_in = not math.isnan(taken)
        output = taken if stands_in else reading
        if self._restart or stands_in != self._stood_in[k]:
            pid.state = self._continued(k, reference, output)
        self._stood_in[k] = stands_in
        self.inputs[k] = float(pid.step(reference, output)[0])
        excess = max(0.0, self.inputs[k] - self.limits[k])
        if excess and self._gains[k].integral:  # it must not wind up
            pid.state = pid.state - np.array([excess, 0.0])
        return self.inputs[k] - excess

    def _doubt(
        self, now: int, readings: _Readings | None, references: Signals | None
    ) -> str:
        """Why there is no sample now; empty if there is one."""
        names = " and ".join(self._plant.outputs)
        sensors = dict.fromkeys(
            output.sensor for output in self._plant.outputs.values()
        )
        working = f"is the {' and the '.join(sensors)} working?"
        if readings is None:
            return f"no {names} yet; {working}"
        if now - readings.stamp > self._max_age:
            age = (now - readings.stamp) / NANOSECONDS
            return f"the newest {names} is {age:.1f} s old; {working}"
        if references is None:
            return "no set-point yet"
        if len(references) != len(self.pids):
            return f"{len(references)} set-points are given for {names}"
        wrong = next(
            (reference for reference in references if not math.isfinite(reference)),
            None,
        )
        return "" if wrong is None else f"the set-point is {wrong}, not a finite number"

    def _continued(
        self, k: int, reference: float, output: float, gains: PidGains | None = None
    ) -> FloatArray:
        """The state of a PID whose output continues from the current one; without integral action it cannot,
        since the difference would stay for good."""
        gains = gains or self._gains[k]
        error = reference - output
        integral = (
            self.inputs[k] - gains.proportional * error
            if gains.integral
            else self.pids[k].state[0]
        )
        return np.array([integral, -output if gains.on_measurement else error])
