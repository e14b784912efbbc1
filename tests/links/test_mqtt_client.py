"""Leaving a broker has a limit, whatever the client's thread is doing."""

from __future__ import annotations

from pathlib import Path
from threading import Event

import pytest
from paho.mqtt.client import MQTTMessage

from tests.support.broker import RunningBroker, require
from tests.support.waiting import PATIENCE
from twinmatch.links import mqtt_client
from twinmatch.links.mqtt_client import Broker, BrokerTimes, leave


def test_a_thread_that_does_not_end_is_waited_for_no_longer_than_its_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mqtt_client, "TIMES", BrokerTimes(leave=0.05))
    came = Event()
    released = Event()

    def hold(_: MQTTMessage) -> None:
        came.set()
        released.wait(PATIENCE)

    broker = RunningBroker(tmp_path, require("amqtt"))
    try:
        client = Broker.parse(broker.url).connected(
            lambda joined: joined.subscribe("a"), hold
        )
        client.publish("a", "b", retain=True)
        assert came.wait(PATIENCE)
        assert not leave(client)
        released.set()
        monkeypatch.setattr(mqtt_client, "TIMES", BrokerTimes(leave=PATIENCE))
        assert leave(client)
    finally:
        released.set()
        broker.close()
