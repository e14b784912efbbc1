"""Where else the state of the page can be read: Prometheus and MQTT, each with a package of the extra
`outlets`."""

from __future__ import annotations

import time
from importlib.util import find_spec
from typing import TYPE_CHECKING

from twinmatch.showing.page.state import DashboardState
from twinmatch.showing.serving import ServingError

if TYPE_CHECKING:
    from twinmatch.showing.page.mqtt_outlet import MqttOutlet


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
        raise ServingError(f"{use} needs {package}, which is not installed; pip install 'twinmatch[outlets]'")
