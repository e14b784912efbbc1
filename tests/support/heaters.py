"""The other side of a node that drives a heater."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from std_srvs.srv import Trigger

from tests.support.ros import Listener

UNWATCHED = [
    "-p",
    "observer.band:=150.0",
    "-p",
    "observer.margin:=150.0",
    "-p",
    "budget.least:=1000000.0",
]
"""For benches whose sensor shows what the test says, whatever is driven."""


class HeaterRig:
    """Controller and sensor as a bridge sees them, and what it says; a subclass publishes in `feed`."""

    def __init__(self, listener: Listener, place: str) -> None:
        """Feed the bridge from now on; its services are at `place`."""
        self.listener = listener
        self.applied: list[Any] = []
        names = ("clear_fault", "stop")
        self._services = {
            n: listener.node.create_client(Trigger, f"{place}/{n}") for n in names
        }
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def feed(self) -> None:
        """Publish what is to be seen; called twenty times a second."""
        raise NotImplementedError

    def begin(self) -> None:
        self._thread.start()

    def until(self, condition: Callable[[], Any], what: str) -> None:
        self.listener.spin_until(condition, what)

    @property
    def fault(self) -> str:
        return str(self.applied[-1].fault) if self.applied else ""

    def call(self, name: str) -> Any:
        """The answer of a service."""
        client = self._services[name]
        self.until(client.service_is_ready, name)
        future = client.call_async(Trigger.Request())
        self.until(future.done, name)
        return future.result()

    def close(self) -> None:
        self._ending.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ending.wait(0.05):
            self.feed()
