"""Controls the plant: readings and the set-point in, one command and one sample per tick out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.time import Time
from sensor_msgs.msg import Temperature
from std_msgs.msg import Float64, Float64MultiArray

from twinmatch.control import ControlError, Loop, Profile
from twinmatch.dynamics import (
    Controller,
    Law,
    Output,
    PidGains,
    PidLoops,
    Plant,
    PlantError,
    pids_of,
)
from twinmatch.errors import TwinmatchError
from twinmatch.nodes.health import Level, Report
from twinmatch.nodes.messages import message_of, sample_message, time_message
from twinmatch.nodes.node import Missed, Readers, TwinmatchNode
from twinmatch.nodes.signature import WITHOUT, RunSignature
from twinmatch.nodes.topics import LATCHED, NEWEST, RELIABLE
from twinmatch.parameters.declared import READERS, ParameterError, Setting, Values
from twinmatch.parameters.twin import (
    joined_units,
    loop_parameters,
    one_or_each,
    running_law,
)
from twinmatch.plants import Peltier, find_plant, written_name
from twinmatch.safety import (
    LawReport,
    LawTrial,
    TrialBands,
    TrialPhase,
    is_limit,
    nominal_eigenvalue,
)
from twinmatch.safety.trial import GAINS
from twinmatch.signals import Signals, point_values
from twinmatch_msgs.msg import LawReport as LawMessage
from twinmatch_msgs.msg import (
    LoopSample,
    PlantApplied,
    PlantCommand,
    PlantReading,
    PwmApplied,
    PwmCommand,
)
from twinmatch_msgs.srv import ApplyLaw

_SOURCE = (
    "Where the set-point comes from: the profile below, or the topic plant/reference."
)
_LOWEST = "Lowest accepted set-point, also from the topic; it can only be raised while the node runs."
_HIGHEST = "Highest accepted set-point; it can only be lowered while the node runs."
_RAMP = "Rate at which the set-point changes; 0: in steps."
_REPEATED = (
    "Interval at which the command is repeated; the bridge treats silence as a fault."
)
_COURSE = "Set-points of a course, in place of the profile: one of each output, then the next of each."
_HOLDS = "How long each of them is held; the last one stays."
_FOLLOWED = (
    "Follow the course; the profile waits meanwhile, and continues where it was."
)
_LEVELS = (1 / 7, 3 / 7, 5 / 7, 3 / 7)
"""Levels of the default profile, as fractions of the range of sensible set-points."""
_LEVELS_OF_ONE = "Set-points, one after the other."
_LEVELS_OF_SEVERAL = "Set-points: one of each output, then the next of each."


def _level(output: Output, number: int) -> float:
    """A level of the default profile; each output is one ahead of the one before, so that they move apart."""
    first, last = output.set_points or output.span
    return first + (last - first) * _LEVELS[number % len(_LEVELS)]


def controller_table(plant: type[Plant] = Peltier) -> tuple[Setting, ...]:
    """Name, default, meaning, unit and range of the parameters of a plant's controller.

    Raises:
        PlantError: the plant file defines no controller.
    """
    if plant.loop is None:
        raise PlantError(
            f"plant {plant.name}: its file has no `loop`; only a plant with one can be controlled"
        )
    outputs = tuple(plant.outputs.values())
    low = min(y.span[0] for y in outputs)
    high = max(y.span[1] for y in outputs)
    unit = joined_units(y.unit for y in outputs)
    sources = ("profile", "topic")
    levels = [
        _level(y, k + n) for k in range(len(_LEVELS)) for n, y in enumerate(outputs)
    ]
    lowest = one_or_each([max(y.span[0], y.safe[0]) for y in outputs])
    highest = one_or_each([min(y.span[1], y.safe[1]) for y in outputs])
    ramp = one_or_each([0.0 for _ in outputs])
    meaning = _LEVELS_OF_SEVERAL if len(outputs) > 1 else _LEVELS_OF_ONE
    changing = partial(Setting, changeable=True)
    return (
        Setting(
            "plant",
            written_name(plant),
            "The plant: its name, or the file that defines it.",
        ),
        *loop_parameters(plant),
        Setting("reference_source", sources[0], _SOURCE, choices=sources),
        changing("profile.levels", levels, meaning, unit, low, high),
        changing(
            "profile.holds",
            [300.0] * 4,
            "How long each of them is held.",
            "s",
            0.1,
            1e6,
        ),
        changing(
            "profile.repeat",
            True,
            "Repeat the profile; otherwise the last level is held.",
        ),
        changing("profile.ramp", ramp, _RAMP, f"{unit}/s", 0.0, high - low),
        changing("profile.lowest", lowest, _LOWEST, unit, low, high),
        changing("profile.highest", highest, _HIGHEST, unit, low, high),
        changing("course.levels", levels[: len(outputs)], _COURSE, unit, low, high),
        changing("course.holds", [1.0], _HOLDS, "s", 1e-3, 1e6),
        changing("course.followed", False, _FOLLOWED),
        Setting(
            "exit_at_end", False, "Exit at the end of a profile that is not repeated."
        ),
        Setting(
            "max_age",
            2.0,
            "A reading older than this switches the output off.",
            "s",
            0.05,
            10.0,
        ),
        Setting("command_period", 0.25, _REPEATED, "s", 0.01, 1.0),
        Setting(
            "wait_for",
            0,
            "Readers of plant/sample to wait for before the first tick.",
            "",
            0,
            100,
        ),
        READERS,
        Setting(
            "wait_timeout",
            10.0,
            "Longest wait for them, by the wall clock.",
            "s",
            0.1,
            3600.0,
        ),
    )


def profiles_from(values: Mapping[str, Any]) -> tuple[Profile, ...] | None:
    """The profile of each output from checked parameter values; None if the set-points come from the topic.

    Raises:
        ControlError: a profile cannot be run, a range is empty, values are missing, or `exit_at_end` would
            never take effect.
    """
    outputs = find_plant(values["plant"]).outputs
    ranges = list(
        zip(
            *(_by_output(values, name) for name in ("lowest", "highest", "ramp")),
            strict=True,
        )
    )
    for (low, high, _), output in zip(ranges, outputs.values(), strict=True):
        if not low < high:
            msg = f"controller: profile.lowest {low:g} must be below profile.highest {high:g} {output.unit}"
            raise ControlError(msg)
    if values["reference_source"] == "topic":
        if values["exit_at_end"]:
            raise ControlError(
                "controller: exit_at_end needs a profile; a topic has no end"
            )
        return None
    if values["exit_at_end"] and values["profile.repeat"]:
        raise ControlError(
            "controller: with profile.repeat, exit_at_end would never take effect; set one of them to false"
        )
    ramps = [ramp for *_, ramp in ranges]
    return _staircases("profile", values, ramps, repeats=values["profile.repeat"])


def course_from(values: Mapping[str, Any]) -> tuple[Profile, ...] | None:
    """The course of each output that is followed in place of its profile; None if the profiles are.

    Raises:
        ControlError: the course cannot be run, or the set-points come from the topic.
    """
    if not values["course.followed"]:
        return None
    if values["reference_source"] == "topic":
        raise ControlError(
            "controller: course.followed needs a profile; give these levels on the topic"
        )
    return _staircases(
        "course",
        values,
        [0.0] * len(find_plant(values["plant"]).outputs),
        repeats=False,
    )


def _staircases(
    kind: str, values: Mapping[str, Any], ramps: Sequence[float], *, repeats: bool
) -> tuple[Profile, ...]:
    """The set-points of each output from the levels and times of a profile or a course.

    Raises:
        ControlError: they cannot be run.
    """
    outputs = find_plant(values["plant"]).outputs
    levels = values[f"{kind}.levels"]
    holds = tuple(values[f"{kind}.holds"])
    several = len(outputs) > 1
    if several and len(levels) != len(outputs) * len(holds):
        raise ControlError(
            f"controller: {kind}.levels has {len(levels)} values for {len(holds)} times; give one of "
            f"each output ({', '.join(outputs)}) for each time"
        )
    lows = _by_output(values, "lowest")
    highs = _by_output(values, "highest")
    profiles = []
    for k, (name, output) in enumerate(outputs.items()):
        profiles.append(
            Profile(
                tuple(levels[k :: len(outputs)]),
                holds,
                repeats,
                ramps[k],
                lowest=lows[k],
                highest=highs[k],
                unit=output.unit,
                name=f"{kind} of {name}" if several else kind,
            )
        )
    return tuple(profiles)


def _by_output(values: Mapping[str, Any], name: str) -> list[float]:
    """What a parameter of the profile says of each output.

    Raises:
        ControlError: it does not have a value of each.
    """
    parameter = values[f"profile.{name}"]
    outputs = find_plant(values["plant"]).outputs
    by_output: list[float] = parameter if isinstance(parameter, list) else [parameter]
    if len(by_output) != len(outputs):
        raise ControlError(
            f"controller: profile.{name} has {len(by_output)} values; give one for {' and '.join(outputs)}"
        )
    return by_output


def changed_profiles(
    before: Mapping[str, Any], values: Mapping[str, Any]
) -> tuple[Profile, ...] | None:
    """The profiles from values some of which were changed while the controller runs.

    The range of set-points was chosen for this rig when the controller started, so it can only shrink.

    Raises:
        ControlError: as for `profiles_from`, or a range would grow.
    """
    for name, outside in (("lowest", float.__lt__), ("highest", float.__gt__)):
        for was, wanted in zip(
            _by_output(before, name), _by_output(values, name), strict=True
        ):
            if outside(wanted, was):
                raise ControlError(
                    f"controller: profile.{name} can only narrow the range while it runs; {wanted:g} "
                    f"is outside {was:g}; restart the controller with it"
                )
    return profiles_from(values)


class PlantTopics(NamedTuple):
    """The topics of a controller's readings and commands, and the fields of their messages."""

    reading: str
    reading_type: Any
    output: str
    command: str
    command_type: Any
    input: str
    applied: str
    applied_type: Any


GENERAL = PlantTopics(
    "plant/reading",
    PlantReading,
    "output",
    "plant/command",
    PlantCommand,
    "input",
    "plant/applied",
    PlantApplied,
)
"""The topics of any plant."""
PELTIER = PlantTopics(
    "plant/temperature",
    Temperature,
    "temperature",
    "plant/pwm_command",
    PwmCommand,
    "pwm",
    "plant/pwm_applied",
    PwmApplied,
)
"""The Peltier rig has its own, older topics, which are named for its temperature and its PWM."""


def _law_of(gains: Sequence[PidGains]) -> Law:
    """The law of these PIDs, one for each output."""
    return gains[0] if len(gains) == 1 else PidLoops.of(*gains)


class ControllerNode(TwinmatchNode):
    """Runs the loops of a plant on the ROS clock.

    Between ticks the current commands are repeated, because the bridge treats silence as a fault. Without
    usable readings the drives are at rest and there are no samples. However the node ends, its last command
    puts the drives at rest.
    """

    ROUNDED: Final = 0.5
    """Difference of applied and commanded drive that is rounding, in the drive's unit."""
    EXPIRES: Final = 120
    """Samples after which an answer about a law has expired."""
    RESEND: Final = 0.2
    """Interval at which the command is repeated in step, wall s."""

    NAME = "controller"

    @classmethod
    def table_for(
        cls, overrides: Mapping[str, Any]
    ) -> tuple[Sequence[Setting], Mapping[str, Any]]:
        """The parameters of the plant that is named."""
        try:
            return controller_table(
                find_plant(str(overrides.get("plant", Peltier.name)))
            ), overrides
        except PlantError as error:
            raise ParameterError(f"{cls.NAME}: {error}") from error

    def read_parameters(self) -> None:
        """Create profile and loop."""
        values = self.values
        self._plant: type[Plant] = find_plant(values["plant"])
        self.entrance.plant = self._plant
        self._profiles = profiles_from(values)
        self._course = course_from(values)
        """The course that is followed while the profiles wait; None: the profiles are followed."""
        self._begun = 0.0
        """Start of the profiles, or of the course, s since sample 0."""
        self._waited_at = 0.0
        """Time of the profiles at which they wait for a course to end, s since their start."""
        law = running_law(values, self._plant.loop)
        self._loop = Loop(self._plant, law, max_age=values["max_age"])
        self._pids = pids_of(law)
        self._set_points: Signals | None = None
        """Set-points published or received last."""
        self._single = len(self._plant.outputs) == 1
        self._missed = Missed(self.health)
        self._topics = PELTIER if self._plant is Peltier else GENERAL
        self._commands: Any = None
        self._on_trial = LawReport(0, TrialPhase.KEPT)
        """What was reported last of a law on trial."""
        self._signature = RunSignature.of_run()
        self._taken_answers: set[str] = set()
        """Signatures of the requests that were taken: each puts a law on trial once."""

    def open(self) -> None:
        """Subscribe to readings and start to tick."""
        # Loading the compiled step takes a quarter of a second: too long for the first tick.
        Controller(self._pids[0]).step(0.0, 0.0)
        if self._signature is not None:
            self._eigenvalue(self._pids)
        topics = self._topics
        self.create_subscription(
            topics.reading_type, topics.reading, self._on_reading, NEWEST
        )
        self.create_subscription(
            topics.applied_type, topics.applied, self._on_applied, RELIABLE
        )
        self._commands = self.create_publisher(topics.command_type, topics.command, 10)
        self._samples = self.create_publisher(LoopSample, "plant/sample", RELIABLE)
        timeout = self.values["wait_timeout"]
        number = self.values["wait_for"]
        self._readers = Readers(self, self._samples.topic_name, timeout, number)
        kind = Float64 if self._single else Float64MultiArray
        if self._profiles is None:
            # A latched reader gets the set-point published before it started, but nothing from publishers
            # that do not latch.
            quiet = SubscriptionEventCallbacks(use_default_callbacks=False)
            for qos in (LATCHED, RELIABLE):
                self.create_subscription(
                    kind,
                    "plant/reference",
                    self._on_reference,
                    qos,
                    event_callbacks=quiet,
                )
        else:
            self._references = self.create_publisher(kind, "plant/reference", LATCHED)
        self._laws = self.create_publisher(LawMessage, "plant/law", LATCHED)
        self.create_service(ApplyLaw, "plant/apply_law", self._on_law)
        call_periodically = self.create_timer if self.step is None else self.step.every
        call_periodically(self._loop.period, self._on_tick)
        call_periodically(self.values["command_period"], self._on_repeat)
        if self.step is not None:
            # while the plant waits for a command, none may be lost
            self.wall_timer(self.RESEND, self._on_repeat)
        self.health.say("waiting")
        self.report_on()

    def change(self, values: Values) -> None:
        """Adopt a new profile or course, or a narrower range; new levels start now, with the first of them.

        While a course is followed, the time of the profile stands still.
        """
        profiles = changed_profiles(self.values, values)
        course = course_from(values)
        loop_time = self._loop.time
        if course is not None and self._course is None:
            self._waited_at = loop_time - self._begun
            self._begun = loop_time
        elif course is not None and self._differ(values, "course"):
            self._begun = loop_time
        elif course is None and self._course is not None:
            self._begun = loop_time - self._waited_at
        if self._differ(values, "profile"):
            self._waited_at = 0.0
            self._begun = loop_time if course is None else self._begun
        self._profiles = profiles
        self._course = course
        if self._profiles is None and self._set_points is not None:
            ranges = _by_output(values, "lowest"), _by_output(values, "highest")
            with_ranges = zip(self._set_points, *ranges, strict=True)
            self._set_points = tuple(
                min(max(set_point, low), high) for set_point, low, high in with_ranges
            )

    def _differ(self, values: Values, kind: str) -> bool:
        """Whether the levels or times of a profile or a course are others than those in use."""
        return any(
            values[name] != self.values[name]
            for name in (f"{kind}.levels", f"{kind}.holds")
        )

    def report(self) -> Report:
        """Ticks, lateness, and the reason if there are no samples."""
        loop = self._loop
        self.health.set("output", ", ".join(map(str, loop.inputs)))
        set_points = self._set_points
        shown = (
            ["none"]
            if set_points is None
            else [f"{set_point:g}" for set_point in set_points]
        )
        self.health.set("set-point", ", ".join(shown))
        self.health.set(
            "set-point from",
            "course" if self._course else self.values["reference_source"],
        )
        self.health.set("tick late by", f"{1000 * loop.jitter:.1f} ms")
        self.health.set("missed ticks", loop.missed)
        self.health.set("ticks without sample", loop.idle)
        self.health.set("unusable readings", loop.refused)
        return super().report()

    def close(self) -> bool:
        """Put the drives at rest."""
        if self._commands is not None:
            self._command(self._resting_commands)
            self._commands.wait_for_all_acked(Duration(seconds=0.2))
            self._commands = None
        return True

    def _on_reading(self, message: Any) -> None:
        plant_now = self._now()
        stamp = Time.from_msg(message.header.stamp).nanoseconds
        outputs = getattr(message, self._topics.output)
        disturbances = tuple(getattr(message, "disturbances", ()))
        # A reading stamped in the future would never become stale; one without a stamp counts as new.
        samplings = tuple(getattr(message, "taken", ()))
        self._loop.measure(
            outputs,
            min(stamp, plant_now) if stamp else plant_now,
            disturbances,
            samplings,
        )

    def _on_applied(self, message: Any) -> None:
        """Tell the loop what holds or limits the drive.

        Otherwise a sample would have an input that did not act, and the drive would be blamed.
        """
        loop = self._loop
        limited = is_limit(message.fault)
        loop.held = bool(message.fault) and not limited
        if not limited:
            loop.limits = [math.inf] * len(loop.inputs)
        elif message.sequence == self._index:
            applied = point_values(getattr(message, self._topics.input))
            # Boards round to whole counts.
            loop.limits = [
                value if command - value > self.ROUNDED else math.inf
                for command, value in zip(loop.inputs, applied, strict=True)
            ]
        self.health.flag_if(
            loop.held, "held", Level.WARN, f"the drive is held at rest: {message.fault}"
        )
        self.health.flag_if(
            limited, "limited", Level.WARN, f"the drive is {message.fault}"
        )

    def _on_reference(self, message: Any) -> None:
        set_points = point_values(message.data)
        outputs = self._plant.outputs
        if self._loop.trying:
            self.health.flag(
                "set-point",
                Level.WARN,
                "set-point refused: a law is on trial, which holds it",
            )
            return
        if len(set_points) != len(outputs):
            text = f"{len(set_points)} set-points refused; give one of each output: {', '.join(outputs)}"
            self.health.flag("set-point", Level.ERROR, text)
            return
        ranges = _by_output(self.values, "lowest"), _by_output(self.values, "highest")
        for set_point, low, high, output in zip(
            set_points, *ranges, outputs.values(), strict=True
        ):
            if not low <= set_point <= high:
                safe = f"the safe range is {low:g} to {high:g} {output.unit}"
                text = f"set-point {set_point:g} {output.unit} refused; {safe}"
                self.health.flag("set-point", Level.ERROR, text)
                return
        self.health.withdraw("set-point")
        self._set_points = set_points

    def _on_law(
        self, request: ApplyLaw.Request, _: ApplyLaw.Response
    ) -> ApplyLaw.Response:
        """Put a law on trial, or give the law before back, by the operator's word."""
        loop = self._loop
        try:
            if request.back:
                if loop.trial is None or loop.trial.phase is TrialPhase.BACK:
                    return ApplyLaw.Response(
                        success=False, message="the law of the configuration drives"
                    )
                loop.take_back("given back by the operator")
            else:
                self._try(request)
        except (TwinmatchError, ValueError) as error:
            return ApplyLaw.Response(success=False, message=str(error))
        self._report_law()
        return ApplyLaw.Response(
            success=True, message="done; plant/law has what comes of it"
        )

    def _try(self, request: ApplyLaw.Request) -> None:
        """Put a law on trial.

        Raises:
            TwinmatchError: the twin of this run has not asked for it, it is not safe, its answer has
                expired, or gains or bands cannot be used.
            ValueError: the bands are not whole rows.
        """
        loop = self._loop
        size = len(self._pids)
        self._check_signature(request)
        if request.decision != "safe" and not request.although:
            raise ControlError(
                f"loop: the law is {request.decision or 'not tried'}, not safe"
            )
        if not (loop.running and 0 <= self._index - request.sample <= self.EXPIRES):
            raise ControlError(
                f"loop: the answer is from sample {request.sample}, and now is {self._index}; ask again"
            )
        if {len(getattr(request, name)) for name in GAINS} != {size}:
            raise ControlError(f"loop: give {size} of each gain, one for each output")
        rows = zip(*(getattr(request, name) for name in GAINS), strict=True)
        gains = []
        for running, row in zip(self._pids, rows, strict=True):
            gains.append(replace(running, **dict(zip(GAINS, row, strict=True))))
        self._check_gains(gains)
        eigenvalue = self._eigenvalue(gains)
        if eigenvalue >= 1.0 and not request.although:
            raise ControlError(
                "loop: with this law the plant of its file is not stable (largest eigenvalue "
                f"{eigenvalue:.4g}); it is run with --although only"
            )
        low = np.reshape(request.low, (-1, size))
        high = np.reshape(request.high, (-1, size))
        trial = LawTrial(TrialBands(low, high, request.shadow, request.patience))
        loop.try_law(_law_of(gains), trial)
        self._taken_answers.add(request.signature)
        report = LawReport(
            self._index,
            TrialPhase.ANSWERED,
            decision=request.decision,
            family=request.family,
            although=request.although,
            request=request.request,
        )
        self._on_trial = report.of(gains)

    def _check_signature(self, request: ApplyLaw.Request) -> None:
        """Refuse what the twin of this run has not signed, or what was taken before.

        Raises:
            ControlError: it is refused.
        """
        if self._signature is None:
            raise ControlError(f"loop: the controller {WITHOUT}")
        if not self._signature.signs(request):
            raise ControlError(
                "loop: the request lacks the signature of this run's twin; ask the twin (twinmatch apply)"
            )
        if request.signature in self._taken_answers:
            raise ControlError(
                "loop: that answer has put its law on trial already; ask again"
            )

    def _check_gains(self, gains: Sequence[PidGains]) -> None:
        """Refuse gains that the configuration would refuse: of the wrong sign, or absurdly large.

        Raises:
            ParameterError: there is one.
        """
        for setting in loop_parameters(self._plant):
            name = setting.name.removeprefix("pid.")
            if name in GAINS:
                values = [getattr(loop_gains, name) for loop_gains in gains]
                setting.accept(one_or_each(values), "loop: a law on trial")

    def _eigenvalue(self, gains: Sequence[PidGains]) -> float:
        """Size of the largest eigenvalue of the loop of these PIDs with the plant of the file, where the
        set-point is; NaN if it has none there."""
        return nominal_eigenvalue(
            self._plant.model().typical(), _law_of(gains), self._set_points or ()
        )

    def _report_law(self) -> None:
        """Publish how far a trial is, when that changes."""
        trial = self._loop.trial
        if trial is not None and trial.phase is not self._on_trial.phase:
            begun = trial.phase is TrialPhase.DRIVING
            self._on_trial = replace(
                self._on_trial,
                sample=self._index,
                phase=trial.phase,
                first=self._index if begun else self._on_trial.first,
                reason=trial.reason,
            )
            self._laws.publish(message_of(self._on_trial, self._now()))
            self.get_logger().warning(
                f"law on trial: {trial.phase.value} {trial.reason}".rstrip()
            )
            self.health.set("law on trial", trial.phase.value)

    def _on_tick(self) -> None:
        if not self._readers.there():
            return
        if self.step is not None:
            self.step.drive()
        sample = self._loop.tick(self._now(), self._reference)
        self._report_law()
        if self.exit_code is not None:
            return
        if sample is not None:
            self._command(self._loop.inputs)
            self._samples.publish(sample_message(sample))
            self.health.set("sample", sample.index)
            self.health.say("ticking")
            self.health.withdraw("idle")
        elif not self._loop.running:
            self._command(self._resting_commands)
            # Before sample 0 this is how every run begins.
            level = Level.ERROR if self._loop.idle else Level.WARN
            self.health.flag("idle", level, f"the output is off: {self._loop.trouble}")
        self._missed.watch(self._loop.missed, self._index)

    def _on_repeat(self) -> None:
        if not self._readers.awaited and self.exit_code is None:
            self._command(self._loop.inputs)

    def _reference(self, seconds: float) -> Signals | None:
        """The set-points at a time since sample 0 (s); published when they change."""
        if self._loop.trying:  # its bands are for this set-point; the profile waits
            self._begun += self._loop.period
            return self._set_points
        if self._profiles is None:
            return self._set_points
        seconds -= self._begun
        if (
            self._course is None
            and self.values["exit_at_end"]
            and self._profiles[0].ended(seconds)
        ):
            self.get_logger().info("the profile has ended")
            self.exit_code = 0
            return None
        references = tuple(
            profile.reference(seconds) for profile in self._course or self._profiles
        )
        if references != self._set_points:
            self._set_points = references
            data = (
                Float64(data=references[0])
                if self._single
                else Float64MultiArray(data=references)
            )
            self._references.publish(data)
        return references

    def _command(self, values: Sequence[float]) -> None:
        if self._commands is not None:
            plant_now = self._now()
            topics = self._topics
            inputs = values[0] if topics is PELTIER else list(values)
            message = topics.command_type(index=self._index, **{topics.input: inputs})
            message.header.stamp = time_message(plant_now)
            self._commands.publish(message)
            if self.step is not None:
                self.step.sent(plant_now)

    @property
    def _resting_commands(self) -> list[float]:
        """Commands that put the drives at rest."""
        return [drive.rest for drive in self._plant.drives.values()]

    @property
    def _index(self) -> int:
        """Index of the newest tick."""
        return round(self._loop.time / self._loop.period)

    def _now(self) -> int:
        return (
            int(self.get_clock().now().nanoseconds)
            if self.step is None
            else self.step.now
        )
