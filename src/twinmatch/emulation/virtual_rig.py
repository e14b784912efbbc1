"""The virtual rig: plate, heat sink, board and camera behind the real serial port and TCP stream.

One process owns plant time. It steps the board in small slices, reads the driver's pins, advances the plate,
passes the driver's current to the board and the plate's temperature to the camera program, and serves the
time. Nothing of the production path is replaced: a host opens the serial port and connects to the camera as
on a real rig; only time may pass faster.
"""

from __future__ import annotations

import math
import os
from contextlib import ExitStack
from typing import ClassVar, Final

import numpy as np

from twinmatch.dynamics import Parameters, advance, begin, quantities, read
from twinmatch.emulation.arduino import PinDrive
from twinmatch.emulation.arduino_virtual import make_board
from twinmatch.emulation.clock import ClockServer
from twinmatch.emulation.faults import OF_READINGS
from twinmatch.emulation.plant_time import VirtualPlantTime
from twinmatch.emulation.virtual_camera import Serving, VirtualCamera
from twinmatch.plants import Peltier

RICH_RIG = Peltier.model("sink with mass").parameters(
    seebeck=0.06,
    resistance=3.3,
    conductance=0.5,
    heat_capacity=27.0,
    ambient=295.0,
    sink_heat_capacity=250.0,
    sink_convection=6.0,
)
"""The true parameters of the virtual rig, deliberately richer than the twin's start: its heat sink has a
mass, and a fan cools it."""


class VirtualPlant:
    """The plant between the driver's pins and the camera, in any structure of the Peltier rig."""

    _STILL_AIR: Final = 0.1
    """Fraction of the convection that remains without the fan."""
    _AMBIENT_STEP: Final = 10.0
    """Change of the room's temperature under `ambient-step`, K."""
    _OPEN: Final = 1e-9
    """Current limit of an open circuit, A: no current flows, not even from the Seebeck voltage."""

    FAULTS: ClassVar = {
        "drive-lost": "wire_broken",
        "fan-failed": "fan_failed",
        "ambient-step": "warm_room",
    }
    """Faults that change the plant itself, and the attribute of each."""

    def __init__(self, parameters: Parameters = RICH_RIG) -> None:
        self.states = begin(parameters, parameters["ambient"] - Peltier.output.absolute)
        self.wire_broken = False
        self.fan_failed = False
        self.warm_room = False
        self._parameters = parameters
        self._parameters_by_case: dict[tuple[bool, ...], Parameters] = {}
        # The first tick loads the plant's compiled code, which must not delay board time later.
        advance(self._under(enabled=False), self.states, 0.0, 1e-3)
        quantities(parameters, self.states, 0.0)

    @property
    def parameters(self) -> Parameters:
        """The rig's current parameters, including faults of the surroundings."""
        return self._under(enabled=True)

    @property
    def plate(self) -> float:
        """Temperature of the plate, °C."""
        return self._celsius("plate")

    @property
    def seen(self) -> float:
        """Temperature that the camera sees, °C: the plate's, with the sensor's lag if it has one."""
        return read(self.parameters, self.states)

    @property
    def sink(self) -> float:
        """Temperature of the heat sink, °C."""
        return self._celsius("sink")

    @property
    def room(self) -> float:
        """Temperature of the room, °C."""
        return self.parameters["ambient"] - Peltier.output.absolute

    def advance(self, drive: PinDrive, seconds: float) -> None:
        """Advance under a drive. If the driver is off or the wire broken, the circuit is open."""
        parameters = self._under(enabled=drive.enabled and not self.wire_broken)
        self.states = advance(parameters, self.states, drive.pwm, seconds)

    def feedback(self, drive: PinDrive) -> float:
        """Mean current at the driver's feedback pin, A.

        The driver measures on its supply side, so the pin shows the current while the PWM is high and zero
        while it is low.
        """
        if self.wire_broken or not drive.enabled:
            return 0.0
        current = quantities(self.parameters, self.states, drive.pwm)["current"]
        return math.fabs(current * drive.pwm) / Peltier.drive.limits[1]

    def _celsius(self, name: str) -> float:
        """A state, °C; a sink without mass is at room temperature."""
        by_name = dict(
            zip(self._parameters.model.states, self.states.tolist(), strict=True)
        )
        return (
            float(by_name.get(name, self.parameters["ambient"]))
            - Peltier.output.absolute
        )

    def _under(self, *, enabled: bool) -> Parameters:
        """Parameters under the active faults, with a closed or an open circuit; cached."""
        case = (self.fan_failed, self.warm_room, enabled)
        if case not in self._parameters_by_case:
            parameters = self._parameters
            if self.fan_failed and "sink_convection" in parameters:
                still_air = self._STILL_AIR * parameters["sink_convection"]
                parameters = parameters.replace(sink_convection=still_air)
            if self.warm_room:
                parameters = parameters.replace(
                    ambient=parameters["ambient"] + self._AMBIENT_STEP
                )
            if not enabled:
                parameters = parameters.replace(current_limit=self._OPEN)
            self._parameters_by_case[case] = parameters
        return self._parameters_by_case[case]


class SerialNoise:
    """Another program on the port that ignores the lock: it writes damaged frames and takes replies away."""

    _WRITING: Final = 0.05
    """Probability per burst that the other program writes to the serial line."""
    _TAKEN: Final = 20
    """Most bytes it takes from the line; a reply has about 25."""

    def __init__(self, port: str, seed: int = 0) -> None:
        self._port = port
        self._random = np.random.default_rng(seed)

    def burst(self) -> None:
        """Interfere once."""
        try:
            line = os.open(self._port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError:
            return  # the cable is pulled
        try:
            if self._random.random() < self._WRITING:
                os.write(line, b":" + self._random.bytes(12) + b"\n")
            os.read(line, int(self._random.integers(1, self._TAKEN)))
        except OSError:
            return  # nothing to take
        finally:
            os.close(line)


class VirtualRig(VirtualPlantTime):
    """A Peltier rig whose time stands still until `step` or `run`; a context manager, since it has children.

    Raises:
        TwinmatchError: the board or the camera cannot be created.
    """

    KINDS: ClassVar = frozenset(VirtualPlant.FAULTS).union(
        OF_READINGS,
        ("sensor-frozen", "camera-gone", "garbage-camera"),
        ("driver-fault", "board-hung", "cable-pulled", "garbage-serial"),
    )
    _FEEDBACK_EVERY: Final = 100
    """Interval at which the board's current feedback is updated, ms of plant time."""

    def make(self, stack: ExitStack) -> dict[str, str]:
        """Create board, camera and plate."""
        self.plant = VirtualPlant()
        self._board, self.board_kind, self.board_remark = make_board(
            self.settings.board, self.folder / "ttyACM0"
        )
        stack.callback(self._board.close)
        self._camera = VirtualCamera(
            ambient=self.plant.plate, seed=1000 * self.settings.seed
        )
        stack.callback(self._camera.close)
        self._noise = SerialNoise(self._board.port, self.settings.seed)
        self.drive = self._board.drive()
        """State of the driver's pins."""
        return {
            "camera": "{}:{}".format(*self._camera.address),
            "serial": self._board.port,
        }

    def advance(self) -> None:
        """Advance by one slice of plant time."""
        seconds = self.slice / 1000
        self._advance_board()
        self.plant.advance(self.drive, seconds)
        before = self.ms
        self.ms = self.ms + self.slice
        if self.ms // self._FEEDBACK_EVERY != before // self._FEEDBACK_EVERY:
            self._board.set_current(self.plant.feedback(self.drive))
        temperature = self.schedule.told(self.plant.seen, self.plant.room, self.elapsed)
        self._camera.see(self.elapsed, temperature, self.stamp)

    def _advance_board(self) -> None:
        if "garbage-serial" not in self.schedule.active:
            self.drive = self._board.advance(self.slice / 1000)
            return
        for _ in range(self.slice):
            # the other program may interfere at every millisecond
            self.drive = self._board.advance(0.001)
            self._noise.burst()

    def settled(self, clock: ClockServer) -> bool:
        """Whether all readers that take images have the newest one."""
        if not (self._camera.serves and clock.lacks(self._camera.stamp)):
            return True
        self._camera.repeat()
        return False

    def state(self) -> dict[str, object]:
        """Time, temperatures, drive, speed and active faults."""
        return {
            "time": self.elapsed,
            "plate": self.plant.plate,
            "sink": self.plant.sink,
            "pwm": self.drive.pwm,
            "enabled": self.drive.enabled,
            "current": self.plant.feedback(self.drive),
            "speed": self.pace.achieved(),
            "faults": list(self.schedule.active),
        }

    def turn(self, kind: str, *, on: bool) -> None:
        """Start or end a fault."""
        if kind in VirtualPlant.FAULTS:
            setattr(self.plant, VirtualPlant.FAULTS[kind], on)
        elif kind == "sensor-frozen":
            self._camera.frozen = on
        elif kind == "driver-fault":
            self._board.set_fault(on)
        elif kind == "cable-pulled":
            (self._board.unplug if on else self._board.plug)()
        elif kind == "board-hung" and on:
            self._board.hang()
        elif kind in {"camera-gone", "garbage-camera"}:
            self._camera.serve(self._answering())

    def _answering(self) -> Serving:
        if "camera-gone" in self.schedule.active:
            return Serving.NOBODY
        return (
            Serving.GARBAGE
            if "garbage-camera" in self.schedule.active
            else Serving.CAMERA
        )
