"""The three lines of each device in docs/devices.md, given what such a device sends."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from tests.support.broker import RunningBroker, quickest_kind
from tests.support.places import PROJECT
from tests.support.processes import no_plant_files
from tests.support.waiting import PATIENCE, wait_for
from twinmatch.links.mqtt_client import Broker
from twinmatch.links.mqtt_source import open_source
from twinmatch.parameters.sampler import sampler_values, sources_of
from twinmatch.sampling import payloads, registers
from twinmatch.sampling.channels import Channel, SamplingError
from twinmatch.sampling.listener import Read
from twinmatch.sampling.sources import SignalMap, SignalSource

PAGE = (PROJECT / "docs" / "devices.md").read_text("utf-8")
BLOCKS = dict(re.findall(r"^```yaml (\S+)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL))
[PLANT] = re.findall(
    r"^```python room\.py\n(.*?)^```$",
    (PROJECT / "docs" / "mqtt.md").read_text("utf-8"),
    re.M | re.S,
)
UNITS = {"output": "°C", "input": "1"}
PAYLOADS: dict[str, list[tuple[str, bytes]]] = {
    "home_assistant": [
        ("ha/climate/living_room/current_temperature", b"20.5"),
        ("ha/climate/living_room/hvac_action", b'"heating"'),
    ],
    "zigbee2mqtt": [
        (
            "zigbee2mqtt/bath",
            b'{"local_temperature": 20.5, "pi_heating_demand": null, "running_state": "heat"}',
        ),
        (
            "zigbee2mqtt/bath",
            b'{"local_temperature": 20.5, "pi_heating_demand": 100, "child_lock": "LOCK"}',
        ),
    ],
    "esphome": [
        ("boiler/sensor/water/state", b"20.50"),
        ("boiler/climate/heater/action/state", b"HEATING"),
    ],
    "shelly": [
        (
            "shellyplus-ab/events/rpc",
            b'{"params": {"ts": 1.5, "temperature:100": {"id": 100, "tC": 20.5}}}',
        ),
        (
            "shellyplus-ab/events/rpc",
            b'{"params": {"ts": 1.5, "light:0": {"id": 0, "brightness": 100}}}',
        ),
    ],
    "tasmota": [
        (
            "tele/tank/SENSOR",
            b'{"Time": "2025-01-01T00:00:00", "DS18B20": {"Temperature": 20.5}}',
        ),
        ("stat/tank/POWER", b"ON"),
    ],
}


def sources_in(
    name: str, folder: Path
) -> tuple[dict[str, SignalSource], dict[str, Any]]:
    """The sources of a device's three lines in the page's file, and the parameters."""
    (folder / "room.py").write_text(PLANT.replace("warm_room", f"warm_room_{name}"))
    frame = BLOCKS["rig.yaml"].replace("room.py", str(folder / "room.py"))
    (folder / "rig.yaml").write_text(frame + BLOCKS[name])
    with no_plant_files():
        values, _ = sampler_values(folder / "rig.yaml", SignalMap())
        return sources_of("rig", values), dict(values)


def value_of(
    source: SignalSource, channel: Channel, unit: str, messages: list[tuple[str, bytes]]
) -> float:
    """The newest number that a source has from some messages."""
    numbers = []
    for topic, payload in messages:
        if topic == channel.topic:
            value = payloads.value_at(payloads.document_of(payload), channel.path)
            if value is not None:
                numbers.append(source.number(value, unit))
    return source.follow("signal", unit, [channel], [""]).value(numbers[-1:], 0.0)


@pytest.mark.parametrize("name", PAYLOADS)
def test_three_lines_read_what_such_a_device_publishes(
    name: str, tmp_path: Path
) -> None:
    sources, _ = sources_in(name, tmp_path)
    values = {}
    for signal, source in sources.items():
        [channel] = source.channels(signal, payloads.parse_place)
        values[signal] = value_of(source, channel, UNITS[signal], PAYLOADS[name])
    assert values == {"output": pytest.approx(20.5), "input": pytest.approx(1.0)}


def test_all_devices_of_the_page_are_read_through_one_broker(tmp_path: Path) -> None:
    """One broker, one subscription to what all the maps name, and every device's messages in turn."""
    wanted: dict[tuple[str, str], tuple[SignalSource, Channel]] = {}
    for name in PAYLOADS:
        folder = tmp_path / name
        folder.mkdir()
        sources, _ = sources_in(name, folder)
        for signal, source in sources.items():
            [channel] = source.channels(signal, payloads.parse_place)
            wanted[name, signal] = (source, channel)
    ready = payloads.parse_place("test/ready")
    channels = [ready, *(channel for _, channel in wanted.values())]
    newest: dict[Channel, float | str] = {}
    received: list[str] = []

    def receive(topic: str, read: Read, *_: Any, **__: Any) -> None:
        received.append(topic)
        for channel in channels:
            if channel.topic == topic:
                value = read(channel)
                if value is not None:
                    newest[channel] = value

    broker = RunningBroker(tmp_path / "broker", quickest_kind())
    try:
        device = Broker.parse(broker.url).connected(lambda _: None)
        followed = open_source(broker.url, 1.0, channels, receive)

        def stands() -> bool:
            device.publish(ready.topic, "1", 1).wait_for_publish(PATIENCE)
            followed.poll()
            return ready in newest

        wait_for(stands, "the subscription")
        count = 0
        for messages in PAYLOADS.values():
            for topic, payload in messages:
                device.publish(topic, payload, 1).wait_for_publish(PATIENCE)
                count += 1

        def arrived() -> bool:
            followed.poll()
            return len([topic for topic in received if topic != ready.topic]) == count

        wait_for(arrived, "the messages of all devices")
        followed.close()
        device.disconnect()
    finally:
        broker.close()
    for (name, signal), (source, channel) in wanted.items():
        value = source.number(newest[channel], UNITS[signal])
        as_sample = source.follow(signal, UNITS[signal], [channel], [""])
        right = {"output": 20.5, "input": 1.0}[signal]
        assert as_sample.value([value], 0.0) == pytest.approx(right), name


def test_three_lines_read_the_registers_of_a_heat_pump(tmp_path: Path) -> None:
    sources, _ = sources_in("heat_pump", tmp_path)
    words = {("input", 1): 205, ("holding", 40083): 80, ("holding", 40084): 0xFFFF}
    values = {}
    for signal, unit in (("output", "°C"), ("input", "kW")):
        source = sources[signal]
        channels = source.channels(signal, registers.parse_place)
        numbers = [
            source.number(registers.number_at(words, channel), unit)
            for channel in channels
        ]
        values[signal] = source.follow(
            signal, unit, channels, [""] * len(channels)
        ).value(numbers, 0.0)
    assert values == {"output": pytest.approx(20.5), "input": pytest.approx(0.008)}


def test_a_power_is_refused_where_the_plant_has_a_share(tmp_path: Path) -> None:
    sources, _ = sources_in("heat_pump", tmp_path)
    channels = sources["input"].channels("input", registers.parse_place)
    with pytest.raises(SamplingError, match="is in W, but the plant's input in 1"):
        sources["input"].follow("input", "1", channels, ["", ""])


def test_each_device_of_the_page_is_here() -> None:
    assert {*BLOCKS} == {"rig.yaml", "heat_pump", *PAYLOADS}
    for name in (*PAYLOADS, "heat_pump"):
        assert len(BLOCKS[name].splitlines()) == 3
