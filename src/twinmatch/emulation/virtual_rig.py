"""The virtual rig: plate, heat sink, board and camera behind the real serial port and TCP stream.

One process owns plant time. It steps the board in small slices, reads the driver's pins, advances the plate,
passes the driver's current to the board and the plate's temperature to the camera program, and serves the
time. Nothing of the production path is replaced: a host opens the serial port and connects to the camera as
on a real rig; only time may pass faster.
"""

from __future__ import annotations

from contextlib import ExitStack

from twinmatch.emulation.arduino_pins import PinDrive
from twinmatch.emulation.virtual_rig_board import SerialNoise, make_board
from twinmatch.emulation.virtual_rig_camera import Serving, VirtualCamera
from twinmatch.emulation.virtual_rig_clock import ClockServer
from twinmatch.emulation.virtual_rig_plant import VirtualPlant
from twinmatch.emulation.virtual_rig_time import RigSettings, VirtualPlantTime, VirtualRigError

__all__ = ["RigSettings", "VirtualRig", "VirtualRigError"]

_FEEDBACK_EVERY = 100
"""Interval at which the board's current feedback is updated, ms of plant time."""


class VirtualRig(VirtualPlantTime):
    """A Peltier rig whose time stands still until `step` or `run`; a context manager, since it has children.

    Raises:
        TwinmatchError: the board or the camera cannot be created.
    """

    def make(self, stack: ExitStack) -> dict[str, str]:
        """Create board, camera and plate."""
        self.plant = VirtualPlant()
        made = make_board(self.settings.board, self.folder / "ttyACM0")
        self._board, self.board_kind, self.board_remark = made
        stack.callback(self._board.close)
        self._camera = VirtualCamera(ambient=self.plant.plate, seed=1000 * self.settings.seed)
        stack.callback(self._camera.close)
        self._noise = SerialNoise(self._board.port, self.settings.seed)
        self._drive = self._board.drive()
        return {"camera": "{}:{}".format(*self._camera.address), "serial": self._board.port}

    @property
    def drive(self) -> PinDrive:
        """State of the driver's pins."""
        return self._drive

    def advance(self) -> None:
        """Advance by one slice of plant time."""
        seconds = self.slice / 1000
        self._advance_board()
        self.plant.advance(self._drive, seconds)
        before, self.ms = self.ms, self.ms + self.slice
        if self.ms // _FEEDBACK_EVERY != before // _FEEDBACK_EVERY:
            self._board.set_current(self.plant.feedback(self._drive))
        self._camera.see(self.elapsed, self.plant.seen, self.stamp)

    def _advance_board(self) -> None:
        if "garbage-serial" not in self.schedule.active:
            self._drive = self._board.advance(self.slice / 1000)
            return
        for _ in range(self.slice):  # the other program may interfere at every millisecond
            self._drive = self._board.advance(0.001)
            self._noise.burst()

    def lacks_image(self, clock: ClockServer) -> bool:
        """Whether the newest image has not been taken yet by a reader that takes images."""
        return self._camera.serves and clock.lacks(self._camera.stamp)

    def show_again(self) -> None:
        """Repeat the newest image."""
        self._camera.show_again()

    def state(self) -> dict[str, object]:
        """Time, temperatures, drive, speed and active faults."""
        return {
            "time": self.elapsed,
            "plate": self.plant.plate,
            "sink": self.plant.sink,
            "pwm": self._drive.pwm,
            "enabled": self._drive.enabled,
            "current": self.plant.feedback(self._drive),
            "speed": self.pace.achieved(),
            "faults": list(self.schedule.active),
        }

    def turn(self, kind: str, *, on: bool) -> None:
        """Start or end a fault."""
        if kind == "drive-lost":
            self.plant.wire_broken = on
        elif kind == "fan-failed":
            self.plant.fan_failed = on
        elif kind == "ambient-step":
            self.plant.warm_room = on
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
        return Serving.GARBAGE if "garbage-camera" in self.schedule.active else Serving.CAMERA
