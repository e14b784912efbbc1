"""Controls the plant: readings and the set-point in, one command and one sample per tick out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.time import Time
from sensor_msgs.msg import Temperature
from std_msgs.msg import Float64

from twinmatch.control import ControlError, Loop, Profile
from twinmatch.dynamics import Controller, Plant, PlantError
from twinmatch.nodes.health import Level, Report
from twinmatch.nodes.messages import sample_message, time_message
from twinmatch.nodes.node import READERS, Missed, Readers, TwinmatchNode
from twinmatch.nodes.topics import LATCHED, NEWEST, RELIABLE
from twinmatch.parameters.declared import ParameterError, Setting, Values, group
from twinmatch.parameters.twin import loop_parameters, pid_gains
from twinmatch.plants import Peltier, find_plant, written_name
from twinmatch.safety import is_limit
from twinmatch_msgs.msg import LoopSample, PlantApplied, PlantCommand, PlantReading, PwmApplied, PwmCommand

_SOURCE = "Where the set-point comes from: the profile below, or the topic plant/reference."
_LOWEST = "Lowest accepted set-point, also from the topic; it can only be raised while the node runs."
_HIGHEST = "Highest accepted set-point; it can only be lowered while the node runs."
_RAMP = "Rate at which the set-point changes; 0: in steps."
_REPEATED = "Interval at which the command is repeated; the bridge treats silence as a fault."
_LEVELS = (1 / 7, 3 / 7, 5 / 7, 3 / 7)
"""Levels of the default profile, as fractions of the range of sensible set-points."""


def controller_table(plant: type[Plant] = Peltier) -> tuple[Setting, ...]:
    """Name, default, meaning, unit and range of the parameters of a plant's controller.

    Raises:
        PlantError: the plant file defines no controller.
    """
    if plant.loop is None:
        raise PlantError(
            f"plant {plant.name}: its file has no `loop`; only a plant with one can be controlled"
        )
    y, (low, high) = plant.output, plant.output.span
    first, last = y.set_points or y.span
    levels = [first + (last - first) * share for share in _LEVELS]
    sources = ("profile", "topic")
    changing = partial(Setting, changeable=True)
    return (
        Setting("plant", written_name(plant), "The plant: its name, or the file that defines it."),
        *loop_parameters(plant),
        Setting("reference_source", sources[0], _SOURCE, choices=sources),
        changing("profile.levels", levels, "Set-points, one after the other.", y.unit, low, high),
        changing("profile.holds", [300.0] * 4, "How long each of them is held.", "s", 0.1, 1e6),
        changing("profile.repeat", True, "Repeat the profile; otherwise the last level is held."),
        changing("profile.ramp", 0.0, _RAMP, f"{y.unit}/s", 0.0, high - low),
        changing("profile.lowest", max(low, y.safe[0]), _LOWEST, y.unit, low, high),
        changing("profile.highest", min(high, y.safe[1]), _HIGHEST, y.unit, low, high),
        Setting("exit_at_end", False, "Exit at the end of a profile that is not repeated."),
        Setting("max_age", 2.0, "A reading older than this switches the output off.", "s", 0.05, 10.0),
        Setting("command_period", 0.25, _REPEATED, "s", 0.01, 1.0),
        Setting("wait_for", 0, "Readers of plant/sample to wait for before the first tick.", "", 0, 100),
        READERS,
        Setting("wait_timeout", 10.0, "Longest wait for them, by the wall clock.", "s", 0.1, 3600.0),
    )


def profile_from(values: Mapping[str, Any]) -> Profile | None:
    """The profile from checked parameter values; None if the set-point comes from the topic.

    Raises:
        ControlError: the profile cannot be run, a range is empty, or `exit_at_end` would never take effect.
    """
    low, high = values["profile.lowest"], values["profile.highest"]
    unit = find_plant(values["plant"]).output.unit
    if not low < high:
        msg = f"controller: profile.lowest {low:g} must be below profile.highest {high:g} {unit}"
        raise ControlError(msg)
    if values["reference_source"] == "topic":
        if values["exit_at_end"]:
            raise ControlError("controller: exit_at_end needs a profile; a topic has no end")
        return None
    if values["exit_at_end"] and values["profile.repeat"]:
        raise ControlError(
            "controller: with profile.repeat, exit_at_end would never take effect; set one of them to false"
        )
    given = group(values, "profile.")
    given |= {name: tuple(given[name]) for name in ("levels", "holds")}
    return Profile(**given, unit=unit)


def changed_profile(before: Mapping[str, Any], values: Mapping[str, Any]) -> Profile | None:
    """The profile from values some of which were changed while the controller runs.

    The range of set-points was chosen for this rig when the controller started, so it can only shrink.

    Raises:
        ControlError: as for `profile_from`, or the range would grow.
    """
    for name, outside in (("lowest", float.__lt__), ("highest", float.__gt__)):
        was, wanted = before[f"profile.{name}"], values[f"profile.{name}"]
        if outside(wanted, was):
            raise ControlError(
                f"controller: profile.{name} can only narrow the range while it runs; {wanted:g} "
                f"is outside {was:g}; restart the controller with it"
            )
    return profile_from(values)


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
    "plant/reading", PlantReading, "output", "plant/command", PlantCommand, "input",
    "plant/applied", PlantApplied,
)  # fmt: skip
"""The topics of any plant."""
PELTIER = PlantTopics(
    "plant/temperature", Temperature, "temperature", "plant/pwm_command", PwmCommand, "pwm",
    "plant/pwm_applied", PwmApplied,
)  # fmt: skip
"""The Peltier rig has its own, older topics, which are named for its temperature and its PWM."""

ROUNDED = 0.5
"""Difference of applied and commanded drive that is rounding, in the drive's unit."""
RESEND = 0.2
"""Interval at which the command is repeated in step, wall s."""


class ControllerNode(TwinmatchNode):
    """Runs the loop on the ROS clock.

    Between ticks the current command is repeated, because the bridge treats silence as a fault. Without a
    usable reading the drive is at rest and there are no samples. However the node ends, its last command
    puts the drive at rest.
    """

    NAME = "controller"

    @classmethod
    def table_for(cls, given: Mapping[str, Any]) -> tuple[Sequence[Setting], Mapping[str, Any]]:
        """The parameters of the plant that is named."""
        try:
            return controller_table(find_plant(str(given.get("plant", Peltier.name)))), given
        except PlantError as error:
            raise ParameterError(f"{cls.NAME}: {error}") from error

    def read_parameters(self) -> None:
        """Create profile and loop."""
        values = self.values
        self._plant: type[Plant] = find_plant(values["plant"])
        self._profile: Profile | None = profile_from(values)
        self._begun = 0.0
        """Start of the profile, s since sample 0."""
        self._gains = pid_gains(values)
        self._loop = Loop(self._plant, self._gains, max_age=values["max_age"])
        self._set_point: float | None = None
        """Set-point published or received last."""
        self._missed = Missed(self.health)
        self._wiring = PELTIER if self._plant is Peltier else GENERAL
        self._commands: Any = None

    def open(self) -> None:
        """Subscribe to readings and start to tick."""
        # Loading the compiled step takes a quarter of a second: too long for the first tick.
        Controller(self._gains).step(0.0, 0.0)
        wiring = self._wiring
        self.create_subscription(wiring.reading_type, wiring.reading, self._on_reading, NEWEST)
        self.create_subscription(wiring.applied_type, wiring.applied, self._on_applied, RELIABLE)
        self._commands = self.create_publisher(wiring.command_type, wiring.command, 10)
        self._samples = self.create_publisher(LoopSample, "plant/sample", RELIABLE)
        timeout, number = self.values["wait_timeout"], self.values["wait_for"]
        self._readers = Readers(self, self._samples.topic_name, timeout, number)
        if self._profile is None:
            # A latched reader gets the set-point published before it started, but nothing from publishers
            # that do not latch.
            quiet = SubscriptionEventCallbacks(use_default_callbacks=False)
            for qos in (LATCHED, RELIABLE):
                self.create_subscription(
                    Float64, "plant/reference", self._on_reference, qos, event_callbacks=quiet
                )
        else:
            self._references = self.create_publisher(Float64, "plant/reference", LATCHED)
        every = self.create_timer if self.step is None else self.step.every
        every(self._gains.period, self._on_tick)
        every(self.values["command_period"], self._on_repeat)
        if self.step is not None:  # while the plant waits for a command, none may be lost
            self.wall_timer(RESEND, self._on_repeat)
        self.health.say("waiting")
        self.report_on()

    def change(self, values: Values) -> None:
        """Adopt a new profile or a narrower range; new levels start now, with the first of them."""
        self._profile = changed_profile(self.values, values)
        if any(values[name] != self.values[name] for name in ("profile.levels", "profile.holds")):
            self._begun = self._loop.time
        if self._profile is None and self._set_point is not None:
            low, high = values["profile.lowest"], values["profile.highest"]
            self._set_point = min(max(self._set_point, low), high)

    def report(self) -> Report:
        """Ticks, lateness, and the reason if there are no samples."""
        loop = self._loop
        self.health.set("output", loop.input)
        self.health.set("set-point", "none" if self._set_point is None else f"{self._set_point:g}")
        self.health.set("tick late by", f"{1000 * loop.jitter:.1f} ms")
        self.health.set("missed ticks", loop.missed)
        self.health.set("ticks without sample", loop.idle)
        self.health.set("unusable readings", loop.refused)
        return super().report()

    def close(self) -> bool:
        """Put the drive at rest."""
        if self._commands is not None:
            self._command(self._plant.drive.rest)
            self._commands.wait_for_all_acked(Duration(seconds=0.2))
            self._commands = None
        return True

    def _on_reading(self, message: Any) -> None:
        now, stamp = self._now(), Time.from_msg(message.header.stamp).nanoseconds
        output = getattr(message, self._wiring.output)
        disturbances = tuple(getattr(message, "disturbances", ()))
        # A reading stamped in the future would never become stale; one without a stamp counts as new.
        self._loop.measure(output, min(stamp, now) if stamp else now, disturbances)

    def _on_applied(self, message: Any) -> None:
        """While a fault holds or limits the drive, a sample with another input would blame the drive."""
        applied, loop, limited = getattr(message, self._wiring.input), self._loop, is_limit(message.fault)
        loop.held = bool(message.fault) and not limited
        if not limited:
            loop.limit = math.inf
        elif message.sequence == self._index:  # boards round to whole counts
            loop.limit = applied if loop.input - applied > ROUNDED else math.inf
        self.health.flag_if(loop.held, "held", Level.WARN, f"the drive is held at rest: {message.fault}")
        self.health.flag_if(limited, "limited", Level.WARN, f"the drive is {message.fault}")

    def _on_reference(self, message: Float64) -> None:
        low, high = self.values["profile.lowest"], self.values["profile.highest"]
        if not low <= message.data <= high:
            unit = self._plant.output.unit
            text = f"set-point {message.data:g} {unit} refused; the safe range is {low:g} to {high:g} {unit}"
            self.health.flag("set-point", Level.ERROR, text)
            return
        self.health.withdraw("set-point")
        self._set_point = message.data

    def _on_tick(self) -> None:
        if not self._readers.there():
            return
        if self.step is not None:
            self.step.drive()
        sample = self._loop.tick(self._now(), self._reference)
        if self.exit_code is not None:
            return
        if sample is not None:
            self._command(self._loop.input)
            self._samples.publish(sample_message(sample))
            self.health.set("sample", sample.index)
            self.health.say("ticking")
            self.health.withdraw("idle")
        elif not self._loop.running:
            self._command(self._plant.drive.rest)
            # Before sample 0 this is how every run begins.
            level = Level.ERROR if self._loop.idle else Level.WARN
            self.health.flag("idle", level, f"the output is off: {self._loop.trouble}")
        self._missed.watch(self._loop.missed, self._index)

    def _on_repeat(self) -> None:
        if not self._readers.awaited and self.exit_code is None:
            self._command(self._loop.input)

    def _reference(self, at: float) -> float | None:
        """The set-point at a time since sample 0 (s); published when it changes."""
        if self._profile is None:
            return self._set_point
        at -= self._begun
        if self.values["exit_at_end"] and self._profile.ended(at):
            self.get_logger().info("the profile has ended")
            self.exit_code = 0
            return None
        reference = self._profile.reference(at)
        if reference != self._set_point:
            self._set_point = reference
            self._references.publish(Float64(data=reference))
        return reference

    def _command(self, value: float) -> None:
        if self._commands is not None:
            now = self._now()
            message = self._wiring.command_type(index=self._index, **{self._wiring.input: value})
            message.header.stamp = time_message(now)
            self._commands.publish(message)
            if self.step is not None:
                self.step.sent(now)

    @property
    def _index(self) -> int:
        """Index of the newest tick."""
        return round(self._loop.time / self._gains.period)

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds) if self.step is None else self.step.now
