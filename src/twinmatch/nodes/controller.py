"""Controls the plant: readings and the set-point in, one command and one sample per tick out."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.time import Time
from std_msgs.msg import Float64

from twinmatch.control import Loop, Profile
from twinmatch.dynamics import Pid, Plant, PlantError
from twinmatch.nodes.controller_parameters import changed_profile, controller_table, profile_from
from twinmatch.nodes.node import Level, Report, TwinmatchNode, count_readers, missing_readers
from twinmatch.nodes.runner import run
from twinmatch.nodes.sample_messages import sample_message
from twinmatch.nodes.topics import LATCHED, RELIABLE
from twinmatch.nodes.wires import Wires, wires_of
from twinmatch.parameters.declared import Parameter, ParameterError, Values
from twinmatch.parameters.loop import pid_gains
from twinmatch.plants import Peltier, find_plant
from twinmatch_msgs.msg import LoopSample

__all__ = ["ControllerNode", "main"]

RESEND = 0.2
"""Interval at which the command is repeated in step, wall s."""
REMEMBER = 60
"""Ticks for which a missed one is reported."""


class ControllerNode(TwinmatchNode):
    """Runs the loop on the ROS clock.

    Between ticks the current command is repeated, because the bridge treats silence as a fault. Without a
    usable reading the drive is at rest and there are no samples. However the node ends, its last command
    puts the drive at rest.
    """

    NAME = "controller"

    @classmethod
    def table_for(cls, given: Mapping[str, Any]) -> tuple[Sequence[Parameter], Mapping[str, Any]]:
        """The parameters of the plant that is named."""
        try:
            return controller_table(find_plant(str(given.get("plant", Peltier.name)))), given
        except PlantError as error:
            raise ParameterError(f"{cls.NAME}: {error}") from error

    def read_parameters(self) -> None:
        """Create profile and loop.

        Raises:
            TwinmatchError: the profile cannot be run, or the gains cannot be used.
        """
        values = self.values
        self._plant: type[Plant] = find_plant(values["plant"])
        self._profile: Profile | None = profile_from(values)
        self._begun = 0.0
        """Start of the profile, s since sample 0."""
        self._gains = pid_gains(values)
        self._loop = Loop(self._plant, self._gains, max_age=values["max_age"])
        self._set_point: float | None = None
        """Set-point published or received last."""
        self._waiting_until: float | None = time.monotonic() + values["wait_timeout"]
        self._missed_at = (0, 0)  # count and index
        self._wires: Wires | None = None

    def open(self) -> None:
        """Subscribe to readings and start to tick."""
        # Loading the compiled step takes a quarter of a second: too long for the first tick.
        Pid(self._gains).step(0.0, 0.0)
        self._wires = wires_of(self._plant)(self, self._on_reading)
        self._samples = self.create_publisher(LoopSample, "plant/sample", RELIABLE)
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
            self.create_timer(RESEND, self._on_repeat, clock=Clock(clock_type=ClockType.STEADY_TIME))
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
        if self._wires is not None:
            self._command(self._plant.drive.rest)
            self._wires.publisher.wait_for_all_acked(Duration(seconds=0.2))
            self._wires = None
        return True

    def _on_reading(self, stamped: Any, output: float, disturbances: tuple[float, ...]) -> None:
        now, stamp = self._now(), Time.from_msg(stamped).nanoseconds
        # A reading stamped in the future would never become stale; one without a stamp counts as new.
        self._loop.measure(output, min(stamp, now) if stamp else now, disturbances)

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
        if not self._readers_there():
            return
        sample = self._loop.tick(self._now(), self._reference)
        if self.exit_code is not None:
            return
        if sample is not None:
            self._command(sample.input)
            self._samples.publish(sample_message(sample))
            self.health.set("sample", sample.index)
            self.health.say("ticking")
            self.health.withdraw("idle")
        elif not self._loop.running:
            self._command(self._plant.drive.rest)
            # Before sample 0 this is how every run begins.
            level = Level.ERROR if self._loop.idle else Level.WARN
            self.health.flag("idle", level, f"the output is off: {self._loop.trouble}")
        self._watch_missed()

    def _on_repeat(self) -> None:
        if self._waiting_until is None and self.exit_code is None:
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
        if self._wires is not None:
            index = round(self._loop.time / self._gains.period)
            now = self._now()
            self._wires.command(value, index, Time(nanoseconds=now).to_msg())
            if self.step is not None:
                self.step.sent(now)

    def _readers_there(self) -> bool:
        """Whether all nodes that must not miss a sample subscribe, or the wait for them is over."""
        if self._waiting_until is None:
            return True
        wanted, found = self.values["wait_for"], count_readers(self, self._samples.topic_name)
        missing = missing_readers(self, self._samples.topic_name, self.values["readers"])
        if (found < wanted or missing) and time.monotonic() < self._waiting_until:
            return False
        if found < wanted or missing:
            text = (
                f"{self._samples.topic_name} has only {found} of {wanted} subscribers; started without them"
            )
            if missing:
                text = f"{', '.join(missing)} did not subscribe to {self._samples.topic_name} in time"
            self.get_logger().warning(text)
            self.health.flag("readers", Level.WARN, text)
        self._waiting_until = None
        if self.step is not None:
            self.step.drive()
        return True

    def _watch_missed(self) -> None:
        missed, number = self._loop.missed, round(self._loop.time / self._gains.period)
        if missed != self._missed_at[0]:
            self._missed_at = (missed, number)
            text = f"ticks were missed, {missed} in all; windows start over"
            self.health.flag("missed", Level.WARN, text)
        elif number - self._missed_at[1] > REMEMBER:
            self.health.withdraw("missed")

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds) if self.step is None else self.step.now


def main() -> None:
    """Console script."""
    sys.exit(run([ControllerNode]))


if __name__ == "__main__":
    main()
