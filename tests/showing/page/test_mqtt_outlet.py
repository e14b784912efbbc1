"""What the page publishes over MQTT, on a real broker, and what Home Assistant makes of it.

Any broker will do: `tests/links` holds that the same client speaks to several.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jinja2 import Environment, StrictUndefined

pytest.importorskip(
    "paho", reason="paho-mqtt is not installed; it is in the extra 'outlets'"
)

from paho.mqtt.client import Client, MQTTMessage

from tests.support.broker import RunningBroker, quickest_kind, require
from tests.support.processes import Process
from tests.support.sockets import ask
from tests.support.verdicts import LED
from tests.support.waiting import wait_for
from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.description import Description
from twinmatch.forecasting import Band, Forecast
from twinmatch.links.mqtt_client import Broker, BrokerError
from twinmatch.plants import Peltier
from twinmatch.plants.records import description_of
from twinmatch.plants.tclab import TCLabBoth
from twinmatch.showing.page.mqtt_outlet import MqttOutlet, messages_of
from twinmatch.showing.page.state import DashboardState, DriveReport

STATE = "twinmatch/peltier/state"
STATUS = "twinmatch/peltier/status"
HORIZONS = (10.0, 60.0, 300.0)


class Subscriber:
    """Keeps the newest message of each topic, and how often it came."""

    def __init__(self, url: str) -> None:
        self.payloads: dict[str, str] = {}
        self.retained: set[str] = set()
        """Topics whose newest message the broker had kept."""
        self.counts: dict[str, int] = {}
        self._client = Broker.parse(url).connected(self._subscribe, self._take)

    def json(self, topic: str) -> Any:
        return json.loads(self.payloads[topic])

    def await_that(self, condition: Callable[[], object], what: str) -> None:
        wait_for(condition, lambda: f"{what}: {self.payloads}")

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()

    def _subscribe(self, client: Client) -> None:
        client.subscribe([("twinmatch/#", 1), ("homeassistant/#", 1)])

    def _take(self, message: MQTTMessage) -> None:
        self.counts[message.topic] = self.counts.get(message.topic, 0) + 1
        (self.retained.add if message.retain else self.retained.discard)(message.topic)
        self.payloads[message.topic] = message.payload.decode()


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[RunningBroker]:
    running = RunningBroker(tmp_path / "broker", require(quickest_kind()))
    yield running
    running.close()


@contextmanager
def subscribed(broker: RunningBroker) -> Iterator[Subscriber]:
    subscriber = Subscriber(broker.url)
    try:
        yield subscriber
    finally:
        subscriber.close()


@contextmanager
def telling(broker: RunningBroker, rig: str = "") -> Iterator[MqttOutlet]:
    outlet = MqttOutlet(broker.url, rig)
    try:
        yield outlet
    finally:
        outlet.close()


def state_with_forecast(
    described: Description | None = None, sample: int = 300
) -> DashboardState:
    """A trusted leader, 60 s ahead: at 10, 60 and 300 s the k-th output is at 45.1, 45.6 and 48.0, plus k."""
    described = described or description_of(Peltier)
    state = DashboardState(described=described)
    references, outputs, inputs = described.shape
    state.plant.push(sample, [0.0] * 3 * len(described.loops))
    state.push_verdict(with_bands())
    time = np.arange(1.0, 301.0)
    course = 45.0 + 0.01 * time
    bands = [
        Band(course + k, course + k - 1.0, course + k + 2.0)
        for k in range(outputs + inputs)
    ]
    asked = np.full((300, references), 50.0)
    state.push_forecast(
        Forecast(
            sample,
            "twin",
            "",
            0.9,
            time,
            asked,
            tuple(bands[:outputs]),
            tuple(bands[outputs:]),
        )
    )
    state.sentence = "Leader: twin; trust it 10 and 60 s ahead."
    return state


def with_bands(**more: Any) -> Verdict:
    score = replace(LED.forecasts[0], coverage=(0.9, 0.875, math.nan))
    return replace(
        LED, horizons=HORIZONS, trusted=(10.0, 60.0), forecasts=(score,), **more
    )


def test_late_subscribers_receive_the_whole_state(broker: RunningBroker) -> None:
    with telling(broker) as outlet:
        assert outlet.tell(state_with_forecast()) == ""
        with subscribed(broker) as early:
            early.await_that(lambda: STATE in early.payloads, "the state")
        with subscribed(broker) as late:
            late.await_that(
                lambda: {STATE, STATUS} <= late.payloads.keys(), "the state"
            )
            assert {STATE, STATUS} <= late.retained
            assert late.payloads[STATUS] == "online"
            assert late.json(STATE) == {
                "level": "trusted",
                "sentence": "Leader: twin; trust it 10 and 60 s ahead.",
                "leader": "twin",
                "horizon": 60.0,
                "ahead": 60.0,
                "forecast": {"temperature": 45.6},
                "low": {"temperature": 44.6},
                "high": {"temperature": 47.6},
                "coverage": 87.5,
                "fault": None,
                "sample": 300,
            }
    with subscribed(broker) as later:
        later.await_that(lambda: later.payloads.get(STATUS) == "offline", "the end")


def test_only_what_has_changed_is_published(broker: RunningBroker) -> None:
    state = state_with_forecast()
    with subscribed(broker) as subscriber, telling(broker) as outlet:
        outlet.tell(state)
        outlet.tell(state)
        state.plant.push(301, [0.0] * 3)
        outlet.tell(state)
        outlet.tell(state)
        subscriber.await_that(
            lambda: (
                STATE in subscriber.payloads and subscriber.json(STATE)["sample"] == 301
            ),
            "the second state",
        )
        assert subscriber.counts.pop(STATE) == 2
        assert set(subscriber.counts.values()) == {1}


def test_without_a_plant_nothing_is_published_and_another_plant_is_another_rig(
    broker: RunningBroker,
) -> None:
    state = DashboardState()
    with subscribed(broker) as subscriber, telling(broker) as outlet:
        assert outlet.tell(state) == ""
        state.describe(description_of(Peltier))
        outlet.tell(state)
        subscriber.await_that(lambda: STATE in subscriber.payloads, "the first plant")
        first = subscriber.json(STATE)
        assert (
            first["level"],
            first["ahead"],
            first["forecast"],
            first["coverage"],
        ) == (
            "unknown",
            None,
            {},
            None,
        )
        state.describe(description_of(TCLabBoth))
        outlet.tell(state)
        subscriber.await_that(
            lambda: "twinmatch/tclab-both/state" in subscriber.payloads,
            "the second plant",
        )
        subscriber.await_that(
            lambda: subscriber.payloads[STATUS] == "offline", "the end of the first"
        )
        assert subscriber.payloads["twinmatch/tclab-both/status"] == "online"


def test_a_plant_that_is_known_before_keeps_its_title(broker: RunningBroker) -> None:
    with subscribed(broker) as subscriber, telling(broker, "peltier") as outlet:
        subscriber.await_that(
            lambda: subscriber.payloads.get(STATUS) == "online", "its status"
        )
        assert outlet.tell(DashboardState()) == ""
        outlet.tell(state_with_forecast())
        topic = "homeassistant/sensor/twinmatch_peltier_trust/config"
        subscriber.await_that(lambda: topic in subscriber.payloads, "its entity")
        assert subscriber.json(topic)["device"]["name"] == "Peltier rig"
        assert subscriber.counts[STATUS] == 1


@pytest.mark.parametrize("way", ["argument", "url"])
def test_a_rig_may_have_a_name_of_its_own(broker: RunningBroker, way: str) -> None:
    named = ("", "north wing/2") if way == "argument" else ("?rig=north%20wing/2", "")
    outlet = MqttOutlet(broker.url + named[0], named[1])
    try:
        with subscribed(broker) as subscriber:
            outlet.tell(state_with_forecast())
            topic = "twinmatch/north_wing_2/state"
            subscriber.await_that(lambda: topic in subscriber.payloads, "the state")
            config = subscriber.json(
                "homeassistant/sensor/twinmatch_north_wing_2_trust/config"
            )
            assert config["device"]["name"] == "north wing/2"
    finally:
        outlet.close()


def test_after_a_restart_of_the_broker_all_is_there_again(
    broker: RunningBroker,
) -> None:
    state = state_with_forecast()
    with telling(broker) as outlet:
        outlet.tell(state)
        broker.kill()
        state.plant.push(301, [0.0] * 3)
        wait_for(lambda: outlet.tell(state), "word of the lost connection")
        assert (
            outlet.tell(state)
            == f"the connection to the broker at 127.0.0.1:{broker.port} is lost"
        )
        broker.start()  # it has forgotten what it kept
        with subscribed(broker) as subscriber:
            entity = "homeassistant/binary_sensor/twinmatch_peltier_fault/config"
            subscriber.await_that(
                lambda: {STATE, STATUS, entity} <= subscriber.payloads.keys(),
                "all of it",
            )
            assert subscriber.payloads[STATUS] == "online"
            assert subscriber.json(STATE)["sample"] == 301
        assert outlet.tell(state) == ""


def test_it_ends_while_the_broker_is_away(broker: RunningBroker) -> None:
    with telling(broker) as outlet:
        outlet.tell(state_with_forecast())
        broker.kill()
        wait_for(
            lambda: outlet.tell(state_with_forecast()), "word of the lost connection"
        )


def test_a_publisher_that_is_killed_leaves_its_will(
    broker: RunningBroker, tmp_path: Path
) -> None:
    script = tmp_path / "publisher.py"
    script.write_text(
        "import sys, time\n"
        "from twinmatch.plants import Peltier\n"
        "from twinmatch.plants.records import description_of\n"
        "from twinmatch.showing.page.mqtt_outlet import MqttOutlet\n"
        "from twinmatch.showing.page.state import DashboardState\n"
        "MqttOutlet(sys.argv[1]).tell(DashboardState(described=description_of(Peltier)))\n"
        "time.sleep(600)\n"
    )
    with subscribed(broker) as subscriber:
        process = Process(
            sys.executable, script, broker.url, output=tmp_path / "output.txt"
        )
        try:
            process.wait_until(
                lambda: subscriber.payloads.get(STATUS) == "online", "its status"
            )
        finally:
            process.kill()
        subscriber.await_that(
            lambda: subscriber.payloads[STATUS] == "offline", "the last will"
        )
    with subscribed(broker) as late:
        late.await_that(
            lambda: late.payloads.get(STATUS) == "offline", "the last will, kept"
        )
        assert STATUS in late.retained


# paho leaves a socket behind
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_users_certificates_and_what_is_refused(tmp_path: Path) -> None:
    secret = tmp_path / "password"
    secret.write_text("s3cret\n")
    running = RunningBroker(
        tmp_path / "broker",
        require(quickest_kind()),
        users={"twin": "s3cret"},
        tls=True,
    )
    right = f"{running.url.replace('//', '//twin@')}?ca={running.certificate}&password_file={secret}"
    try:
        MqttOutlet(right).close()
        with pytest.raises(BrokerError, match="does not let us in"):
            MqttOutlet(f"{running.url}?ca={running.certificate}")
        with pytest.raises(BrokerError, match="certificate verify failed"):
            MqttOutlet(running.url)
    finally:
        running.close()
    with pytest.raises(
        BrokerError, match=f"no MQTT broker at localhost:{running.port}"
    ):
        MqttOutlet(right)


# The page itself.


def test_the_page_tells_a_broker_and_prometheus(
    broker: RunningBroker, page_process: Callable[..., Process], tmp_path: Path
) -> None:
    config = tmp_path / "twin.yaml"
    config.write_text("/**:\n  ros__parameters: {plant: tclab}\n")
    with subscribed(broker) as subscriber:
        page = page_process("--tell", broker.url, "--config", config)
        subscriber.await_that(
            lambda: "twinmatch/tclab/state" in subscriber.payloads, "the state"
        )
        status, text = ask(page.url, "/metrics")
        assert status == 200
        assert 'twinmatch_trust_level{level="unknown"} 1.0' in text
        page.kill()
        subscriber.await_that(
            lambda: subscriber.payloads["twinmatch/tclab/status"] == "offline",
            "its will",
        )


@pytest.mark.parametrize(
    ("url", "why"),
    [
        ("mqtt://127.0.0.1:1", "no MQTT broker at 127.0.0.1:1"),
        ("http://127.0.0.1", "write mqtt://HOST"),
    ],
)
def test_a_page_that_cannot_tell_its_broker_says_so_at_once(
    ros: None,  # noqa: ARG001
    url: str,
    why: str,
) -> None:
    from tests.support.ros import Inside
    from twinmatch.showing.page.node import Dashboard

    page = Inside("dashboard", "-p", "port:=0", "-p", f"tell:={url}", kinds=[Dashboard])
    assert page.wait() == 2
    assert why in page.text
    assert page.text.count("\n") == 1


# What Home Assistant makes of it: the configurations are published as they are, so no broker is needed.

TEMPLATES = Environment(undefined=StrictUndefined, autoescape=False)


class Entities:
    """Entities as Home Assistant makes them from what is published: their states and attributes."""

    def __init__(self, state: DashboardState) -> None:
        self.payloads = {
            topic: json.loads(payload)
            for topic, payload in messages_of(state, "rig", "The rig").items()
        }
        self.configs = {
            t.split("/")[2]: c
            for t, c in self.payloads.items()
            if t.startswith("homeassistant/")
        }

    def state(self, name: str) -> str:
        return self._render(name, "value_template", "state_topic")

    def attributes(self, name: str) -> Any:
        return json.loads(
            self._render(name, "json_attributes_template", "json_attributes_topic")
        )

    def _render(self, name: str, template: str, topic: str) -> str:
        config = self.configs[f"twinmatch_rig_{name}"]
        return TEMPLATES.from_string(config[template]).render(
            value_json=self.payloads[config[topic]]
        )


def test_home_assistant_shows_trust_forecast_and_fault() -> None:
    state = state_with_forecast()
    shown = Entities(state)
    assert {
        name: shown.state(name)
        for name in ("trust", "horizon", "coverage", "forecast_temperature", "fault")
    } == {
        "trust": "trusted",
        "horizon": "60.0",
        "coverage": "87.5",
        "forecast_temperature": "45.6",
        "fault": "OFF",
    }
    assert shown.attributes("trust") == {"sentence": state.sentence, "leader": "twin"}
    assert shown.attributes("forecast_temperature") == {
        "low": 44.6,
        "high": 47.6,
        "ahead": 60.0,
    }
    state.push_verdict(
        with_bands(level=TrustLevel.FAULT, fault="drive-lost", fault_signal="pwm")
    )
    state.push_drive(DriveReport(0.0, math.nan, "too_hot: 121 °C"))
    shown = Entities(state)
    assert (shown.state("trust"), shown.state("horizon"), shown.state("fault")) == (
        "fault",
        "0.0",
        "ON",
    )
    assert shown.attributes("fault") == {
        "fault": "drive-lost of pwm; output held at zero: too hot"
    }
    # the longest there is
    assert shown.attributes("forecast_temperature")["ahead"] == 300.0


def test_home_assistant_takes_what_is_not_known_as_unknown() -> None:
    shown = Entities(DashboardState(described=description_of(Peltier)))
    assert {shown.state(name) for name in ("coverage", "forecast_temperature")} == {
        "None"
    }
    assert shown.attributes("forecast_temperature") == {
        "low": None,
        "high": None,
        "ahead": None,
    }
    assert (shown.state("trust"), shown.state("fault")) == ("unknown", "OFF")


def test_every_output_has_its_entity_and_all_belong_to_one_device() -> None:
    shown = Entities(state_with_forecast(description_of(TCLabBoth)))
    assert shown.state("forecast_temperature") == "45.6"
    assert shown.state("forecast_second_temperature") == "46.6"
    assert (
        len({config["unique_id"] for config in shown.configs.values()})
        == len(shown.configs)
        == 6
    )
    for name, config in shown.configs.items():
        assert config["unique_id"] == name
        assert config["availability_topic"] == "twinmatch/rig/status"
        assert config["device"] == {
            "identifiers": ["twinmatch_rig"],
            "name": "The rig",
            "manufacturer": "twinmatch",
        }
        assert "command_topic" not in config
    assert shown.configs["twinmatch_rig_fault"]["device_class"] == "problem"
    forecast = shown.configs["twinmatch_rig_forecast_second_temperature"]
    assert (forecast["unit_of_measurement"], forecast["device_class"]) == (
        "°C",
        "temperature",
    )
    assert forecast["name"] == "Forecast of temperature T2"
