"""Joins a source and a broadcast: a thread reads the camera, the main thread serves the clients."""

from __future__ import annotations

import logging
import secrets
import signal
import threading

from twinmatch.links.thermal_frame import BOOT_ID_LENGTH, encode_frame
from twinmatch_camera.broadcast import Broadcast
from twinmatch_camera.errors import CameraError
from twinmatch_camera.sources.base import EndOfRecording, Source

_log = logging.getLogger(__name__)

_STOPS = (signal.SIGTERM, signal.SIGINT)
_READ_TIMEOUT = 0.5
_JOIN_TIMEOUT = 3.0


class CameraThread(threading.Thread):
    """Reads exposures, numbers them, and publishes them until stopped or the source fails."""

    def __init__(self, source: Source, broadcast: Broadcast) -> None:
        super().__init__(name="camera", daemon=True)
        self.boot_id = secrets.token_bytes(BOOT_ID_LENGTH)
        self.failure: BaseException | None = None
        self._source = source
        self._broadcast = broadcast
        self._stopping = threading.Event()

    def run(self) -> None:
        """The thread's work; what ends it is kept in `failure`, None for a stop or a recording's end."""
        sequence = 0
        try:
            while not self._stopping.is_set():
                exposure = self._source.read(_READ_TIMEOUT)
                if exposure is not None:
                    self._broadcast.publish(
                        encode_frame(exposure.numbered(sequence, self.boot_id))
                    )
                    sequence += 1
        except EndOfRecording as end:
            _log.info("%s", end)
        except BaseException as error:  # carried to the main thread, which raises it
            self.failure = error
        finally:
            self._broadcast.stop()

    def stop(self) -> None:
        """Let the reading in hand be the last, and wait for it."""
        self._stopping.set()
        self.join(_JOIN_TIMEOUT)


def run(source: Source, broadcast: Broadcast) -> None:
    """Serve the source until SIGTERM, SIGINT, the end of a recording or a failure.

    Raises:
        CameraError: the source could not be opened or has failed.
    """
    before = {
        number: signal.signal(number, lambda *_: broadcast.stop()) for number in _STOPS
    }
    try:
        _serve(source, broadcast)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _serve(source: Source, broadcast: Broadcast) -> None:
    try:
        source.open()
    except CameraError:
        source.close()
        broadcast.close()
        raise
    _log.info("serving %s on %s:%d", source.name, *broadcast.address)
    camera = CameraThread(source, broadcast)
    camera.start()
    try:
        broadcast.serve()
    finally:
        camera.stop()
        source.close()
    if camera.failure is not None:
        raise camera.failure
    _log.info("stopped")
