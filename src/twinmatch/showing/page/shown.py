"""A state, the page that shows it and what a broker gets: for a node, and for a run in one process."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib.util import find_spec
from typing import TYPE_CHECKING

from twinmatch.description import Description
from twinmatch.ending import end_in_order
from twinmatch.showing.page.state import DashboardState, update_sentence
from twinmatch.showing.serving import Hosts, ServingError
from twinmatch.twin import TwinSettings

if TYPE_CHECKING:
    from twinmatch.showing.page.mqtt_outlet import MqttOutlet
    from twinmatch.showing.page.requests import Requests
    from twinmatch.showing.page.server import PageServer


class Shown:
    """Shows a state to those who look; the program that receives samples and verdicts puts them into it."""

    def __init__(
        self, described: Description, settings: Callable[[], TwinSettings]
    ) -> None:
        """Begin with an empty state of a plant, shown to nobody; `settings` returns those of the twin."""
        self.state = DashboardState(described=described)
        self._settings = settings
        self._summed_up = 0
        self._server: PageServer | None = None
        self._outlet: MqttOutlet | None = None

    def serve(
        self,
        requests: Requests,
        port: int,
        address: str = "127.0.0.1",
        hosts: Hosts | None = None,
    ) -> None:
        """Serve the page, and print where; `requests` is what can be asked for on it.

        Raises:
            ServingError: address or port cannot be used.
        """
        from twinmatch.showing.page.server import PageServer  # noqa: PLC0415
        from twinmatch.showing.page.tab import Tab  # noqa: PLC0415

        state = self.state
        self._server = PageServer(
            address,
            port,
            lambda document: Tab(state, requests).build(document),
            hosts,
            lambda: metrics_text(state),
        )
        print(f"page: {self._server.url}", flush=True)

    def publish_to(self, broker: str, rig: str = "") -> None:
        """Publish over MQTT what the state comes down to, under the name of a rig, by default the plant's.

        Raises:
            ServingError: the package for MQTT is not installed.
            BrokerError: the broker cannot be reached.
        """
        self._outlet = outlet_to(broker, rig)

    def tell(self) -> str | None:
        """Summarise after a new verdict, and tell the broker what is new; to be called about once a second.

        Returns why nothing reaches the broker, or an empty text; None without a broker.
        """
        if self._summed_up != self.state.verdicts:
            self._summed_up = self.state.verdicts
            update_sentence(self.state, self._settings())
        return None if self._outlet is None else self._outlet.tell(self.state)

    @property
    def url(self) -> str:
        """Address of the page; empty without one."""
        return "" if self._server is None else self._server.url

    @property
    def tabs(self) -> int:
        """Number of open tabs of the page."""
        return 0 if self._server is None else self._server.tabs

    @property
    def failure(self) -> Exception | None:
        """The error that ended the page's server."""
        return None if self._server is None else self._server.failure

    def close(self) -> bool:
        """Leave the broker, and stop the page; returns whether the threads of both have ended."""
        parts = (self._outlet, self._server)
        return end_in_order(*(part.close for part in parts if part is not None))


def metrics_text(state: DashboardState) -> bytes:
    """What Prometheus reads at /metrics.

    Raises:
        ServingError: its package is not installed.
    """
    _require("prometheus_client", "/metrics")
    from twinmatch.showing.page.metrics import exposition  # noqa: PLC0415

    return exposition(state, time.monotonic())


def outlet_to(url: str, rig: str = "") -> MqttOutlet:
    """What publishes a state over MQTT; URL and rig are those of an `MqttOutlet`.

    Raises:
        ServingError: the package for MQTT is not installed.
        BrokerError: the URL cannot be used, or there is no connection.
    """
    _require("paho", "--tell")
    from twinmatch.showing.page.mqtt_outlet import MqttOutlet  # noqa: PLC0415

    return MqttOutlet(url, rig)


def _require(package: str, use: str) -> None:
    if find_spec(package) is None:
        raise ServingError(
            f"{use} needs {package}, which is not installed; pip install 'twinmatch[outlets]'"
        )
