"""The state over MQTT, for programs and for Home Assistant. It subscribes to nothing, so it commands
nothing."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict
from typing import Any, Final, NamedTuple

from paho.mqtt.client import Client

from twinmatch import __version__
from twinmatch.comparing import TrustLevel
from twinmatch.links.mqtt_client import Broker, BrokerError, leave
from twinmatch.record import finite
from twinmatch.showing.page.outline import PointAhead, ahead, coverage
from twinmatch.showing.page.state import DashboardState

_GOODBYE: Final = 1.0
"""Time limit for the last message, s."""
_NOT_PLAIN: Final = re.compile(r"[^A-Za-z0-9_-]+")
"""Characters that names of topics and of Home Assistant's entities may not have."""
_MEASURED: Final = {"state_class": "measurement"}
_TEMPERATURES: Final = {"°C", "°F", "K"}
"""Units that Home Assistant knows as those of temperatures."""


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
        """Publish what has changed, once the plant is known; returns why that is impossible, or an empty
        text."""
        with state.lock:
            plant = state.described.plant
            title = state.described.title
            name = _NOT_PLAIN.sub("_", self._rig or plant)
            messages = messages_of(
                state, name, title if self._rig in {"", plant} else self._rig
            )
        if not plant:
            return ""
        if name != self._name:
            self.close()
            self._name = ""
            try:
                self._enter(name)
            except BrokerError as error:
                return str(error)
        for topic, payload in messages.items():
            if self._newest_payloads.get(topic) != payload:
                self._newest_payloads[topic] = payload
                if self._client.is_connected():
                    self._client.publish(topic, payload, retain=True)
        lost = f"the connection to the broker at {self._broker.text} is lost"
        return "" if self._client.is_connected() else lost

    def _enter(self, name: str) -> None:
        """Connect under the name of a rig. Without a name, the connection shows that the broker can be
        used."""
        self._newest_payloads = {_status(name): "online"} if name else {}
        will = (_status(name), b"offline") if name else None
        self._client = self._broker.connected(self._repeat, will=will)
        self._name = name

    def close(self) -> bool:
        """Say that nothing follows, and disconnect; returns whether the client's thread has ended."""
        if self._name and self._client.is_connected():
            with suppress(RuntimeError, ValueError):
                # the connection is lost at this moment
                last = self._client.publish(_status(self._name), "offline", retain=True)
                last.wait_for_publish(_GOODBYE)
        return leave(self._client)

    def _repeat(self, client: Client) -> None:
        """Publish all topics again on a new connection."""
        for topic, payload in dict(self._newest_payloads).items():
            client.publish(topic, payload, retain=True)


def _status(name: str) -> str:
    """The topic that says whether a rig is online."""
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
    for entity in _entities(state):
        name_of_entity = f"{device}_{entity.key}"
        value = f"{{{{ {entity.value} }}}}"
        config = {
            **common,
            "unique_id": name_of_entity,
            "value_template": value,
            **entity.fields,
        }
        if entity.attributes:
            pairs = ", ".join(
                f"'{name}': {expression}"
                for name, expression in entity.attributes.items()
            )
            config["json_attributes_template"] = f"{{{{ {{{pairs}}} | tojson }}}}"
            config["json_attributes_topic"] = topic
        documents[f"homeassistant/{entity.kind}/{name_of_entity}/config"] = config
    documents[topic] = finite(_document(state))
    return {
        topic: json.dumps(document, ensure_ascii=False)
        for topic, document in documents.items()
    }


def _document(state: DashboardState) -> dict[str, Any]:
    """The state; the forecast is that at the longest trusted horizon, or else at the longest there is."""
    outputs = [
        point for point in ahead(state) if point.signal in state.described.outputs
    ]
    statements = state.statements
    trusted = statements.trust.longest
    shown = trusted or max((point.horizon for point in outputs), default=0.0)
    points_shown = [point for point in outputs if point.horizon == shown]
    share = coverage(state).get(shown)
    return {
        "level": statements.trust.level.value,
        "sentence": state.sentence,
        "leader": state.leader or None,
        "horizon": trusted,
        "ahead": shown or None,
        "forecast": _rounded("mean", points_shown),
        "low": _rounded("low", points_shown),
        "high": _rounded("high", points_shown),
        "coverage": None if share is None else round(100.0 * share, 1),
        "fault": "; ".join(fault.with_signal for fault in statements.faults) or None,
        "sample": state.sample,
        **_goal_document(state),
    }


def _goal_document(state: DashboardState) -> dict[str, Any]:
    """When the level that is asked for is reached, s after the sample; empty if nothing is asked."""
    answer = state.goal
    if answer is None:
        return {}
    return {
        "reach": answer.goal.level,
        "reached": asdict(answer.held),
        "reached_if_moved": asdict(answer.moved),
        "move": answer.move,
        "begin": None if math.isnan(answer.begin) else round(answer.begin),
    }


def _rounded(edge: str, points: Sequence[PointAhead]) -> dict[str, float]:
    """An edge of the forecast, or its mean, by the name of the signal."""
    return {
        point.signal.name: round(getattr(point, edge), point.signal.decimals)
        for point in points
    }


class _Entity(NamedTuple):
    """A sensor in Home Assistant."""

    kind: str
    key: str
    fields: dict[str, Any]
    """Fields of its configuration that no other entity shares."""
    value: str
    """Expression of Home Assistant's templates for its value."""
    attributes: dict[str, str]
    """Expressions of the templates for its attributes, by name."""


def _entities(state: DashboardState) -> Iterator[_Entity]:
    """The entities of a rig; what is not known is rendered as `None`."""
    template = {key: f"value_json.{key}" for key in _document(state)}
    levels = {
        "name": "Trust",
        "device_class": "enum",
        "options": [level.value for level in TrustLevel],
    }
    words = {"sentence": template["sentence"], "leader": template["leader"]}
    yield _Entity("sensor", "trust", levels, template["level"], words)
    seconds = {
        "name": "Trusted ahead",
        "device_class": "duration",
        "unit_of_measurement": "s",
        **_MEASURED,
    }
    yield _Entity("sensor", "horizon", seconds, template["horizon"], {})
    percent = {
        "name": "Readings within the bands",
        "unit_of_measurement": "%",
        **_MEASURED,
    }
    yield _Entity("sensor", "coverage", percent, template["coverage"], {})
    for output in state.described.outputs:
        fields = {"name": f"Forecast of {output.text or output.name}", **_MEASURED}
        if output.unit:
            fields["unit_of_measurement"] = output.unit
        if output.unit in _TEMPERATURES:
            fields["device_class"] = "temperature"
        edges = {
            key: f"{template[key]}.get('{output.name}')" for key in ("low", "high")
        }
        mean = f"{template['forecast']}.get('{output.name}')"
        attributes = {**edges, "ahead": template["ahead"]}
        yield _Entity("sensor", f"forecast_{output.name}", fields, mean, attributes)
    if state.goal is not None:
        yield from _goal_entities(
            template, state.goal.goal.level, state.described.output.unit
        )
    problem = {"name": "Fault", "device_class": "problem"}
    is_faulty = "'ON' if value_json.fault else 'OFF'"
    yield _Entity(
        "binary_sensor", "fault", problem, is_faulty, {"fault": template["fault"]}
    )


def _goal_entities(
    template: dict[str, str], level: float, unit: str
) -> Iterator[_Entity]:
    """When the level that is asked for is reached, and when to begin."""
    seconds = {"device_class": "duration", "unit_of_measurement": "s", **_MEASURED}
    named = f"{level:g} {unit}".rstrip()
    for key, name in (
        ("reached", f"{named} reached in"),
        ("reached_if_moved", f"{named} if begun now in"),
    ):
        edges = {edge: f"{template[key]}.{edge}" for edge in ("earliest", "latest")}
        yield _Entity(
            "sensor", key, {"name": name, **seconds}, f"{template[key]}.expected", edges
        )
    begin = {"name": f"Begin for {named} in", **seconds}
    yield _Entity(
        "sensor", "begin", begin, template["begin"], {"move": template["move"]}
    )
