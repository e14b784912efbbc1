"""The node behind the page: subscribes to the graph, fills the state, carries out requests of the page."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.qos import (
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_profile_sensor_data,
)
from sensor_msgs.msg import Image

from twinmatch.description import UNDESCRIBED
from twinmatch.ending import end_in_order
from twinmatch.nodes.health import PLANT_REPORT, Level, Report
from twinmatch.nodes.messages import nanoseconds, record_of
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.nodes.topics import LATCHED
from twinmatch.parameters.declared import Setting
from twinmatch.parameters.twin import read_settings
from twinmatch.plants import plant_named
from twinmatch.plants.records import description_of
from twinmatch.showing.page.goal import ASKED_EVERY, Goal, number_in
from twinmatch.showing.page.requests import Requests
from twinmatch.showing.page.shown import Shown
from twinmatch.showing.page.state import DriveReport, TwinRow
from twinmatch.showing.serving import Hosts, place_settings, warn_if_open
from twinmatch.signals import OperatingPoint, Sample
from twinmatch.twin import TwinSettings
from twinmatch_msgs import msg as messages
from twinmatch_msgs.msg import (
    EstimatedReading,
    Forecast,
    LoopSample,
    ModelScore,
    PlantApplied,
    PlantDescription,
    PwmApplied,
    TwinState,
)

ALL = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=2000, reliability=ReliabilityPolicy.RELIABLE
)
"""The queue holds two seconds of a recording played at a thousand times its speed."""
SUM_UP = 1.0
"""Seconds between checks for a new verdict, after which the session is summarised again."""
POLL = 0.1
"""Seconds between checks for requests of the page."""


class Dashboard(TwinmatchNode):
    """Shows the graph of its namespace; without `control` it publishes only its health."""

    NAME = "dashboard"
    PARAMETERS = (
        *place_settings(5006),
        Setting(
            "config", "", "Parameter file of the twin's nodes; empty: their defaults."
        ),
        Setting(
            "control",
            False,
            "Whether the page may set the set-point, clear faults and stop.",
        ),
        Setting(
            "reach", "", "Level of which to say when the output is there; empty: none."
        ),
        Setting(
            "by",
            "",
            "Time of day, HH:MM, of which to say when one must begin; empty: none.",
        ),
        Setting(
            "tell",
            "",
            "Broker to publish over MQTT to, such as mqtt://HOST; empty: none.",
        ),
    )
    CLOSING = 10

    _shown: Shown | None = None

    def read_parameters(self) -> None:
        """Read the parameters of the twin's nodes."""
        path = self.values["config"]
        self._settings = read_settings(Path(path) if path else None)

    def open(self) -> None:
        """Subscribe to the graph and serve the page."""
        described = (
            description_of(self._settings.plant)
            if self.values["config"]
            else UNDESCRIBED
        )
        self._shown = Shown(described, lambda: self._settings)
        self.state = self._shown.state
        self._requested: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._requests = Requests(
            self,
            self.state,
            self._requested.put,
            control=self.values["control"],
            settings=lambda: self._settings,
        )
        if described.plant:
            self._requests.prepare(len(described.loops))
        self._subscribe()
        self._begin_timers()
        if self.values["tell"]:
            self._shown.publish_to(self.values["tell"])
        address = self.values["address"]
        self._shown.serve(
            self._requests,
            self.values["port"],
            address,
            Hosts.of(address, self.values["hosts"]),
        )
        able = (
            "read this page and command the plant"
            if self.values["control"]
            else "read this page"
        )
        warn_if_open("PAGE", address, able)
        self.report_on()

    def _subscribe(self) -> None:
        """Have the state take what the graph says."""
        state = self.state

        def drive(
            message: PwmApplied | PlantApplied, applied: OperatingPoint, current: float
        ) -> None:
            stamp = nanoseconds(message.header.stamp)
            state.push_drive(
                DriveReport(applied, current, message.fault, stamp or None)
            )

        def take_sample(sample: Sample) -> None:
            self._requests.prepare(len(sample.references))
            state.push_sample(sample, time.monotonic())

        def take_twin(message: TwinState) -> None:
            values = (
                tuple(map(float, getattr(message, name))) for name in TwinRow._fields
            )
            state.push_twin(message.index, TwinRow(*values))

        for kind, topic, take, qos in (
            (PlantDescription, "plant/description", self._on_description, LATCHED),
            (LoopSample, "plant/sample", take_sample, ALL),
            (TwinState, "twin/state", take_twin, ALL),
            (EstimatedReading, "plant/estimate", state.push_estimate, ALL),
            (
                messages.ExperimentReport,
                "twin/experiment",
                state.push_experiment,
                LATCHED,
            ),
            (messages.LawReport, "twin/law", state.push_law, ALL),
            (messages.LawReport, "plant/law", state.push_law, LATCHED),
            (Forecast, "twin/forecast", state.push_forecast, ALL),
            (ModelScore, "twin/model_score", state.push_verdict, ALL),
            (
                PwmApplied,
                "plant/pwm_applied",
                lambda m: drive(m, m.pwm, m.current),
                ALL,
            ),
            (
                PlantApplied,
                "plant/applied",
                lambda m: drive(m, tuple(m.input), math.nan),
                ALL,
            ),
            (DiagnosticArray, "/diagnostics", self._on_health, ALL),
            (Image, "thermal/image", self._on_image, qos_profile_sensor_data),
        ):
            self.create_subscription(kind, topic, take, qos)

    def _begin_timers(self) -> None:
        """Ask, sum up and carry out requests from time to time, on a clock that is never set."""
        if self.values["reach"]:
            goal = Goal(
                number_in(self.values["reach"], "dashboard: reach"), self.values["by"]
            )
            ask = partial(self._requests.reach, goal)
            self.create_timer(
                ASKED_EVERY, ask, clock=Clock(clock_type=ClockType.STEADY_TIME)
            )
        self.create_timer(
            SUM_UP, self._sum_up, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self.create_timer(
            POLL, self._run_requests, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    @property
    def failure(self) -> Exception | None:
        """The error that ended the server."""
        return None if self._shown is None else self._shown.failure

    def report(self) -> Report:
        """Report the page's address and the number of open tabs."""
        if self._shown is not None:
            self.health.set("page", self._shown.url)
            self.health.set("tabs", self._shown.tabs)
        return super().report()

    def close(self) -> bool:
        """Stop the server, and say goodbye to the broker."""
        shown = [] if self._shown is None else [self._shown.close]
        return end_in_order(*shown, super().close)

    def _on_description(self, message: PlantDescription) -> None:
        self.state.describe(record_of(message))
        self._requests.prepare(len(self.state.described.loops))
        if not self.values["config"] and message.plant != self._settings.plant.name:
            self._settings = TwinSettings.of(
                plant_named(message.plant), period=message.period
            )

    def _on_health(self, message: DiagnosticArray) -> None:
        time_received = time.monotonic()
        for status in message.status:
            if status.name.endswith(PLANT_REPORT):
                self.state.push_plant_report(status.message)
                continue
            values = {pair.key: pair.value for pair in status.values}
            level = int.from_bytes(status.level, "little")
            self.state.push_health(
                status.name, level, status.message, values, time_received
            )

    def _on_image(self, message: Image) -> None:
        if message.encoding != "32FC1":
            return
        kind = np.dtype(">f4" if message.is_bigendian else "<f4")
        pixels = np.frombuffer(bytes(message.data), dtype=kind)
        self.state.push_image(
            pixels.astype(np.float32).reshape(message.height, message.width)
        )

    def _sum_up(self) -> None:
        """Summarise the session after a new verdict, and publish the state to the broker."""
        trouble = None if self._shown is None else self._shown.tell()
        if trouble is not None:
            self.health.flag_if(bool(trouble), "tell", Level.WARN, trouble)

    def _run_requests(self) -> None:
        """Do what the page has requested since the last call."""
        with suppress(Empty):
            while True:
                self._requested.get_nowait()()
