"""An emulated Lepton in front of a plate that is simulated elsewhere, or stays at one temperature."""

from __future__ import annotations

import logging
import math
import time
from pathlib import Path

from twinmatch.links.thermal_frame import Exposure
from twinmatch_camera.emulation import (
    EmulatedLepton,
    LeptonError,
    LeptonSettings,
    PlateReceiver,
)
from twinmatch_camera.errors import SourceError

_log = logging.getLogger(__name__)

_PATIENCE = 3.0
"""Seconds of silence on the feed after which there are no images."""


class EmulatedSource:
    """Images at the camera's own pace, of the temperature last fed.

    With a feed, there is no image before the first temperature, and none once the feed has been silent
    for some seconds: a dead simulation must not look like a plate that holds its temperature.
    """

    def __init__(
        self,
        *,
        plate: float | None = None,
        feed: str | Path | None = None,
        settings: LeptonSettings | None = None,
        seed: int = 0,
    ) -> None:
        self._settings = settings or LeptonSettings()
        self._camera = EmulatedLepton(self._settings, seed)
        self._plate = plate
        self._feed = feed
        self._receiver: PlateReceiver | None = None
        self._start = 0.0
        self._fed = -math.inf
        self._tick = 0
        self._silent = False

    @property
    def name(self) -> str:
        """What it is, for the log."""
        return "emulated Lepton, " + (
            f"fed from {self._feed}" if self._feed else f"plate at {self._plate} °C"
        )

    def open(self) -> None:
        """Power on, and bind the feed's socket."""
        if self._feed is not None:
            try:
                self._receiver = PlateReceiver(self._feed)
            except LeptonError as error:
                raise SourceError(str(error)) from error
        self._start = time.monotonic()

    def read(self, timeout: float) -> Exposure | None:
        """The image of the next tick of the camera's clock."""
        due = self._start + self._tick / self._settings.rate
        wait = due - time.monotonic()
        if wait > timeout:
            time.sleep(timeout)
            return None
        if wait > 0:
            time.sleep(wait)
        now = time.monotonic()
        # After a pause of the computer the ticks missed are not made up for.
        self._tick = math.floor((now - self._start) * self._settings.rate) + 1
        plate = self._temperature(now)
        if plate is None:
            return None
        return self._camera.expose(plate, now - self._start, time.monotonic_ns())

    def close(self) -> None:
        """Remove the feed's socket."""
        if self._receiver is not None:
            self._receiver.close()
            self._receiver = None

    def _temperature(self, now: float) -> float | None:
        if self._receiver is None:
            return self._plate
        try:
            fed = self._receiver.newest()
        except LeptonError as error:
            _log.warning("%s", error)
            fed = None
        if fed is not None:
            self._plate = fed
            self._fed = now
        silent = now - self._fed > _PATIENCE
        if silent and not self._silent:
            _log.warning(
                "no plate temperature on %s; no frames until one comes", self._feed
            )
        elif self._silent and not silent:
            _log.info(
                "plate temperature %.2f °C on %s; frames again", self._plate, self._feed
            )
        self._silent = silent
        return None if silent else self._plate
