"""The state over MQTT, for programs and for Home Assistant; nothing is subscribed to, so nothing commands."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, Final

from paho.mqtt.client import Client

from twinmatch import __version__
from twinmatch.comparing import TrustLevel
from twinmatch.links.mqtt_client import Broker, BrokerError, leave
from twinmatch.record import finite
from twinmatch.showing.page.outline import ahead, coverage, faults, level, trusted_ahead
from twinmatch.showing.page.state import DashboardState

_GOODBYE: Final = 1.0
"""Time limit for the last message, s."""
_NOT_PLAIN: Final = re.compile(r"[^A-Za-z0-9_-]+")
"""What the names of topics and of Home Assistant's entities may not have."""
_MEASURED: Final = {"state_class": "measurement"}


class MqttOutlet:
    """Publishes what a state knows below `twinmatch/RIG/`, and how Home Assistant shows it; all is retained.

    Nothing is queued while the connection is lost: on the next one every topic is published as it is then.
    """

    def __init__(self, url: str, rig: str = "") -> None:
        """Connect. `URL?rig=NAME` says which rig it is, by default `rig`, or else the name of the plant.

        Raises:
            BrokerError: the URL cannot be used, or there is no connection.
        """
        self._broker = Broker.parse(url, ("rig",))
        self._name = ""
        self._rig = self._broker.more.get("rig") or rig
        self._enter(_NOT_PLAIN.sub("_", self._rig))

    def tell(self, state: DashboardState) -> str:
        """Publish what has changed, once the plant is known; returns why it cannot, or nothing."""
        with state.lock:
            plant = state.described.plant
            title = state.described.title
            name = _NOT_PLAIN.sub("_", self._rig or plant)
            messages = messages_of(state, name, title if self._rig in {"", plant} else self._rig)
        if not plant:
            return ""
        if name != self._name:
            self.close()
            self._name = ""
            try:
                self._enter(name)
            except BrokerError as error:
                return str(error)
        for topic, said in messages.items():
            if self._said.get(topic) != said:
                self._said[topic] = said
                if self._client.is_connected():
                    self._client.publish(topic, said, retain=True)
        lost = f"the connection to the broker at {self._broker.text} is lost"
        return "" if self._client.is_connected() else lost

    def _enter(self, name: str) -> None:
        """Connect under the name of a rig; without one, to know that the broker can be used."""
        self._said = {_status(name): "online"} if name else {}
        will = (_status(name), b"offline") if name else None
        self._client = self._broker.connected(self._repeat, will=will)
        self._name = name

    def close(self) -> bool:
        """Say that nothing follows, and disconnect; returns whether the client's thread has ended."""
        if self._name and self._client.is_connected():
            with suppress(RuntimeError, ValueError):  # the connection is lost at this moment
                last = self._client.publish(_status(self._name), "offline", retain=True)
                last.wait_for_publish(_GOODBYE)
        return leave(self._client)

    def _repeat(self, client: Client) -> None:
        for topic, said in dict(self._said).items():
            client.publish(topic, said, retain=True)


def _status(name: str) -> str:
    return f"twinmatch/{name}/status"


def messages_of(state: DashboardState, name: str, title: str) -> dict[str, str]:
    """The payload of each topic of a rig: its entities in Home Assistant, under a title, and its state."""
    topic = f"twinmatch/{name}/state"
    device = f"twinmatch_{name}"
    common = {
        "state_topic": topic,
        "availability_topic": _status(name),
        "device": {"identifiers": [device], "name": title, "manufacturer": "twinmatch"},
        "origin": {"name": "twinmatch", "sw_version": __version__},
    }
    documents: dict[str, Any] = {}
    for kind, key, own, value, shown in _entities(state):
        entity = {**common, "unique_id": f"{device}_{key}", "value_template": f"{{{{ {value} }}}}", **own}
        if shown:
            pairs = ", ".join(f"'{of}': {place}" for of, place in shown.items())
            entity["json_attributes_template"] = f"{{{{ {{{pairs}}} | tojson }}}}"
            entity["json_attributes_topic"] = topic
        documents[f"homeassistant/{kind}/{device}_{key}/config"] = entity
    documents[topic] = finite(_document(state))
    return {topic: json.dumps(said, ensure_ascii=False) for topic, said in documents.items()}


def _document(state: DashboardState) -> dict[str, Any]:
    """The state; the forecast is that at the longest trusted horizon, or else at the longest there is."""
    outputs = [point for point in ahead(state) if point.signal in state.described.outputs]
    trusted = trusted_ahead(state)
    shown = trusted or max((point.horizon for point in outputs), default=0.0)
    of = [(point.signal, point) for point in outputs if point.horizon == shown]
    share = coverage(state).get(shown)
    return {
        "level": level(state).value,
        "sentence": state.sentence,
        "leader": state.leader or None,
        "horizon": trusted,
        "ahead": shown or None,
        "forecast": {signal.name: round(point.mean, signal.decimals) for signal, point in of},
        "low": {signal.name: round(point.low, signal.decimals) for signal, point in of},
        "high": {signal.name: round(point.high, signal.decimals) for signal, point in of},
        "coverage": None if share is None else round(100.0 * share, 1),
        "fault": "; ".join(" of ".join(filter(None, fault)) for fault in faults(state)) or None,
        "sample": state.sample,
    }


def _entities(state: DashboardState) -> Iterator[tuple[str, str, dict[str, Any], str, dict[str, str]]]:
    """Kind, key, own fields, value and attributes of each entity; what is not known is rendered as `None`."""
    said = {key: f"value_json.{key}" for key in _document(state)}
    levels = {"name": "Trust", "device_class": "enum", "options": [each.value for each in TrustLevel]}
    yield "sensor", "trust", levels, said["level"], {key: said[key] for key in ("sentence", "leader")}
    seconds = {"name": "Trusted ahead", "device_class": "duration", "unit_of_measurement": "s", **_MEASURED}
    yield "sensor", "horizon", seconds, said["horizon"], {}
    percent = {"name": "Readings within the bands", "unit_of_measurement": "%", **_MEASURED}
    yield "sensor", "coverage", percent, said["coverage"], {}
    for output in state.described.outputs:
        own = {"name": f"Forecast of {output.text or output.name}", **_MEASURED}
        own |= {"unit_of_measurement": output.unit} if output.unit else {}
        own |= {"device_class": "temperature"} if output.unit in {"°C", "°F", "K"} else {}
        of = {key: f"{said[key]}.get('{output.name}')" for key in ("forecast", "low", "high")}
        value = of.pop("forecast")
        yield "sensor", f"forecast_{output.name}", own, value, {**of, "ahead": said["ahead"]}
    problem = {"name": "Fault", "device_class": "problem"}
    yield "binary_sensor", "fault", problem, "'ON' if value_json.fault else 'OFF'", {"fault": said["fault"]}
