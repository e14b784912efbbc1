"""Connections to the hardware, without ROS: the camera's thermal stream, serial lines to board and kit."""

from __future__ import annotations

import threading
from collections.abc import Callable


class Background:
    """A thread; an error in it is kept for its owner, who ends the process with it."""

    failure: Exception | None = None
    """The error that ended the thread, if any."""

    def __init__(
        self, name: str, run: Callable[[], None], patience: float = 2.0
    ) -> None:
        """`run` returns soon after `ending` is set; `close` waits for it `patience` s by default."""
        self.ending = threading.Event()
        self._run = run
        self._patience = patience
        self._thread = threading.Thread(target=self._guarded, name=name, daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self, timeout: float | None = None) -> bool:
        """End the thread; returns whether it ended within the timeout (s)."""
        self.ending.set()
        if self._thread.ident is not None:
            self._thread.join(self._patience if timeout is None else timeout)
        return not self._thread.is_alive()

    def _guarded(self) -> None:
        try:
            self._run()
        except Exception as error:
            self.failure = error
