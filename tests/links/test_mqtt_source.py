"""The topics of a real broker as a source: in step, with what brokers keep, through losses and nonsense."""

from __future__ import annotations

import itertools
import json
import random
import threading
import time
from collections.abc import Callable, Iterator
from copy import copy
from pathlib import Path
from typing import Any

import pytest
from paho.mqtt.client import Client

from tests.support.broker import KINDS, LooseBroker, RunningBroker, require
from tests.support.foreign_rig import Oven
from tests.support.oven import HOLD, PERIOD, oven_file
from tests.support.processes import no_plant_files
from tests.support.waiting import PATIENCE, wait_for
from twinmatch.cli import main
from twinmatch.links.mqtt_client import Broker, BrokerError
from twinmatch.links.mqtt_source import listing, open_source, parse_place
from twinmatch.links.sources import protocol_of
from twinmatch.parameters.declared import check
from twinmatch.parameters.sampler import listener_of, source_of, understood
from twinmatch.plants import find_plant
from twinmatch.sampling.channels import Channel, SamplingError
from twinmatch.sampling.listener import Receive, SignalListener, Source
from twinmatch.signals import NANOSECONDS, Sample
from twinmatch.twin import Twin, TwinSettings

PLACES = {
    "reference": "oven/set_point",
    "output": "oven/room:t.now",
    "input": "oven/heater:[duty cycle]",
}
BEGIN = 1_000 * NANOSECONDS


@pytest.fixture(params=KINDS)
def broker(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[RunningBroker]:
    running = RunningBroker(tmp_path / "broker", require(request.param))
    yield running
    running.close()


@pytest.fixture(scope="module", params=KINDS)
def lasting_broker(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[RunningBroker]:
    """For tests that neither end it nor leave a message with it."""
    running = RunningBroker(
        tmp_path_factory.mktemp("lasting") / "broker", require(request.param)
    )
    yield running
    running.close()


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with no_plant_files():
        yield oven_file(tmp_path_factory.mktemp("plant"))


class InStep:
    """A rig that publishes, and a listener by plant time, which passes once everything has arrived."""

    def __init__(
        self,
        broker: RunningBroker,
        plant: str,
        period: float,
        places: dict[str, str],
        *,
        mark: Callable[[float], str] | None = repr,
    ) -> None:
        """Wait for the subscription by marks, payloads of the set-point; without any, kept messages do."""
        parameters: dict[str, Any] = {
            f"map.{name}": place for name, place in places.items()
        }
        parameters |= {"plant": plant, "period": period, "source": broker.url}
        values = check("sampler", *understood("sampler", parameters))
        self.now = BEGIN
        self._step = round(period * NANOSECONDS)
        self.listener: SignalListener = listener_of("sampler", values, lambda: self.now)
        rig = Broker.parse(broker.url.partition("?")[0])
        self.rig = rig.connected(lambda _: None)
        self._marked_topic = places["reference"].partition(":")[0]
        self._mark = mark
        self._acknowledged: set[int] = set()
        self._more_acknowledged = threading.Condition()
        self.rig.on_publish = lambda _client, _data, mid, *_: self._acknowledge(mid)
        # amqtt loses a client that is still joining when another one subscribes.
        self.publish("oven/ping", "1")
        opened = source_of(values)
        self.received = 0
        assert opened is not None

        def open_counting(channels: list[Channel], receive: Receive) -> Source:
            def count(*arguments: Any, **more: Any) -> None:
                receive(*arguments, **more)
                self.received += 1

            self.source = opened(channels, count)
            return self.source

        self.listener.open(open_counting)
        self.listener.search()
        if mark is not None:
            self.subscribed()

    def subscribed(self) -> None:
        """Wait until what is sent arrives: what is sent before the subscription stands is lost."""
        payload_of = self._mark or repr
        mark = 1000.0
        newest = self.listener.sampler.newest
        before = self.received

        def arrives() -> bool:
            nonlocal mark
            mark += 1.0
            self.publish(self._marked_topic, payload_of(mark))
            self.source.poll()
            return self.received > before

        wait_for(self.rig.is_connected, "the rig")
        wait_for(arrives, "the subscription")
        wait_for(
            lambda: self.source.poll() or newest("reference") == mark, "the last mark"
        )

    def publish(
        self, topic: str, payload: str | bytes, *, retain: bool = False
    ) -> None:
        """Send, and wait until the broker has it; a client that has lost its connection sends it later."""
        sent = self.rig.publish(topic, payload, 1, retain)
        with self._more_acknowledged:
            answered = self._more_acknowledged.wait_for(
                lambda: sent.mid in self._acknowledged, PATIENCE
            )
        assert answered, "the broker does not answer"

    def _acknowledge(self, message: int) -> None:
        """The broker has a message; called by the client's thread."""
        with self._more_acknowledged:
            self._acknowledged.add(message)
            self._more_acknowledged.notify()

    def tick(
        self, number: int, messages: dict[str, str | bytes], *, more: int = 0
    ) -> list[Sample]:
        """The samples of a tick at which these are sent, and `more` messages that were sent before."""
        self.now = BEGIN + number * self._step
        wanted = self.received + len(messages) + more
        for topic, payload in messages.items():
            self.publish(topic, payload)

        def arrived() -> bool:
            self.source.poll()
            return self.received >= wanted

        wait_for(
            arrived,
            lambda: f"{wanted - self.received} messages",
            meanwhile=lambda: time.sleep(0.001),
        )
        self.now += self._step // 5
        return self.listener.samples()

    def close(self) -> None:
        self.listener.close()
        self.rig.disconnect()
        self.rig.loop_stop()


@pytest.fixture
def stepped(lasting_broker: RunningBroker, plant: Path) -> Iterator[InStep]:
    opened = InStep(lasting_broker, str(plant), PERIOD, PLACES)
    yield opened
    opened.close()


def payloads_of(wanted: float, reading: float, duty: float) -> dict[str, str | bytes]:
    return {
        "oven/set_point": repr(wanted),
        "oven/room": json.dumps({"t": {"now": reading, "unit": "C"}}),
        "oven/heater": json.dumps({"duty cycle": duty}),
    }


def test_samples_through_a_broker_are_those_of_the_rig_and_lead_to_its_numbers(
    stepped: InStep, plant: Path
) -> None:
    """Bit for bit: JSON has all digits of a number."""
    oven = Oven(PERIOD, HOLD)
    samples = []
    rows_of_oven = []
    for number in range(3 * HOLD):
        rows_of_oven.append(oven.step())
        samples += stepped.tick(number, payloads_of(*rows_of_oven[-1]))
    assert [(s.reference, s.output, s.input) for s in samples] == rows_of_oven
    assert [s.index for s in samples] == list(range(3 * HOLD))
    twin = Twin(TwinSettings.of(find_plant(str(plant)), period=PERIOD))
    matches = [
        outcome.match.match
        for outcome in map(twin.push, samples)
        if outcome.match is not None
    ]
    assert matches[-1].parameters["gain"] == pytest.approx(0.5, rel=0.02)


def test_what_a_broker_has_kept_may_be_a_set_point_but_never_a_reading(
    broker: RunningBroker, plant: Path
) -> None:
    client = Broker.parse(broker.url).connected(lambda _: None)
    for topic, payload in payloads_of(30.0, 99.0, 77.0).items():
        client.publish(topic, payload, 1, retain=True).wait_for_publish(30.0)
    stepped = InStep(broker, str(plant), PERIOD, PLACES, mark=None)
    assert stepped.tick(0, {}, more=3) == []
    newest = stepped.listener.sampler.newest
    assert (newest("reference"), newest("output"), newest("input")) == (
        30.0,
        None,
        None,
    )
    tick = payloads_of(0.0, 21.0, 50.0)
    del tick["oven/set_point"]
    [sample] = stepped.tick(1, tick)
    assert (sample.reference, sample.output, sample.input) == (30.0, 21.0, 50.0)
    stepped.close()
    client.disconnect()


def test_a_broker_that_is_killed_and_comes_back_leaves_a_gap_and_a_word(
    broker: RunningBroker, plant: Path
) -> None:
    stepped = InStep(broker, str(plant), PERIOD, PLACES)
    [first] = stepped.tick(0, payloads_of(30.0, 20.0, 10.0))
    broker.kill()
    wait_for(
        lambda: "the connection to the broker at" in stepped.listener.trouble("output"),
        "the loss",
    )
    assert stepped.listener.samples() == []
    newest = stepped.listener.sampler.newest
    # the room may have changed meanwhile
    assert (newest("output"), newest("reference")) == (None, 30.0)
    broker.start()
    stepped.subscribed()
    [behind] = stepped.tick(50, payloads_of(30.0, 25.0, 10.0))
    assert (first.index, behind.index) == (0, 50)
    assert behind.output == 25.0
    stepped.close()


def test_hundreds_of_malformed_messages_end_nothing(stepped: InStep) -> None:
    assert len(stepped.tick(0, payloads_of(30.0, 20.0, 10.0))) == 1
    nonsense = random.Random(5)
    before = stepped.received
    for k in range(500):
        payload = (
            nonsense.randbytes(nonsense.randint(0, 40))
            if k % 3
            else b'{"t": {"now": "unavailable"}}'
        )
        stepped.rig.publish("oven/room", payload, 0)
    wait_for(
        lambda: stepped.source.poll() or stepped.received - before >= 500,
        "the nonsense",
    )
    assert stepped.listener.failed is None
    assert stepped.listener.refusals["output"].count == 500
    assert "no samples until there is a number" in stepped.listener.trouble("output")
    assert stepped.listener.samples() == []
    [sample] = stepped.tick(5, payloads_of(30.0, 21.0, 10.0))
    assert (sample.index, sample.output) == (5, 21.0)
    assert not stepped.listener.refusals["output"].now


NOT_NUMBERS: tuple[Callable[[], str], ...] = (
    lambda: json.dumps({"t": {"now": float("nan")}}),
    lambda: json.dumps({"t": {"now": 1e999}}),
    lambda: json.dumps({"t": {"now": None}}),
    lambda: json.dumps({"t": {"now": [1]}}),
    lambda: json.dumps({"t": 20.0}),
)


def test_what_lacks_a_number_makes_no_sample_once_the_reading_is_stale(
    stepped: InStep,
) -> None:
    numbers = itertools.count()
    for payload in NOT_NUMBERS:
        assert len(stepped.tick(next(numbers), payloads_of(30.0, 20.0, 10.0))) == 1, (
            payload()
        )
        for _ in range(6):
            samples = stepped.tick(
                next(numbers), payloads_of(30.0, 0.0, 10.0) | {"oven/room": payload()}
            )
        assert samples == [], payload()
        number = next(numbers)
        [sample] = stepped.tick(number, payloads_of(30.0, 22.0, 10.0))
        assert (sample.index, sample.output) == (number, 22.0), payload()


def test_a_clock_that_is_set_back_and_forth_leaves_gaps(stepped: InStep) -> None:
    indices = []
    for number in (0, 1, 2, 600, 601, 602, 3, 4, 5):
        indices += [
            s.index
            for s in stepped.tick(number, payloads_of(30.0, 20.0 + number % 3, 10.0))
        ]
    assert indices[:3] == [0, 1, 2]
    assert indices == sorted(set(indices))
    assert max(b - a for a, b in itertools.pairwise(indices)) >= 598
    assert indices[-1] > 602


def test_times_in_payloads_count(lasting_broker: RunningBroker, plant: Path) -> None:
    broker = copy(lasting_broker)
    broker.url += "?time=at"
    places = {**PLACES, "reference": "oven/set_point:wanted", "output": "oven/room:t"}
    reading_time = BEGIN / NANOSECONDS

    def wanted(value: float) -> str:
        return json.dumps({"wanted": value, "at": reading_time})

    stepped = InStep(broker, str(plant), PERIOD, places, mark=wanted)

    def timed_payloads(at: float) -> dict[str, str | bytes]:
        return {
            "oven/set_point": wanted(30.0),
            "oven/room": json.dumps({"t": 20.0, "at": at}),
            "oven/heater": json.dumps({"duty cycle": 5.0, "at": at}),
        }

    [sample] = stepped.tick(0, timed_payloads(reading_time))
    assert sample.stamp == BEGIN
    # a second later, the same readings
    assert stepped.tick(10, timed_payloads(reading_time)) == []
    stepped.close()


def test_a_listing_shows_topics_with_their_numbers(broker: RunningBroker) -> None:
    client = Broker.parse(broker.url).connected(lambda _: None)
    for topic, payload in (
        ("home/room/t", "21.5"),
        ("home/boiler", '{"a": {"b": 1}, "c": 2, "d": "x"}'),
        ("home/door", "open"),
        ("garden/t", "3"),
    ):
        client.publish(topic, payload, 1, retain=True).wait_for_publish(30.0)
    lines = [
        "home/boiler:a.b  1",
        "home/boiler:c  2",
        "home/door  'open' = 1",
        "home/room/t  21.5",
    ]
    assert list(listing(broker.url, "home")) == lines
    assert list(listing(broker.url, "")) == ["garden/t  3", *lines]
    assert list(listing(broker.url, "#")) == ["garden/t  3", *lines]
    assert list(listing(broker.url, "+/t")) == ["garden/t  3"]
    assert list(listing(broker.url, "home/+/t")) == ["home/room/t  21.5"]
    client.disconnect()


@pytest.mark.parametrize("broker", KINDS[:1], indirect=True)
def test_a_listing_shows_what_a_map_gives(
    broker: RunningBroker, capsys: pytest.CaptureFixture[str]
) -> None:
    client = Broker.parse(broker.url).connected(lambda _: None)
    payload = '{"params": {"light:0": {"brightness": 60, "mode": "C"}}}'
    client.publish("shelly/rpc", payload, 1, retain=True).wait_for_publish(30.0)
    entries = [
        "input=u * m; u=shelly/rpc:params.light:0.brightness; m=shelly/rpc:params.light:0.mode; "
        "H=1; C=-1; unit=%",
        "output=shelly/rpc:params.light:0.mode",
    ]
    assert (
        main(["attach", "--source", broker.url, "--list", "shelly", "--map", *entries])
        == 0
    )
    lines = capsys.readouterr().out.splitlines()
    client.disconnect()
    assert lines[0] == "shelly/rpc:params[light:0].brightness  60"
    assert lines[1].startswith(
        "input = -60 %  (u * m; u=shelly/rpc:params.light:0.brightness"
    )
    assert lines[1].endswith(
        "params.light:0.brightness is 60.0, shelly/rpc:params.light:0.mode is C)"
    )
    assert lines[2].startswith("output has no value  ('C' is not a number")


@pytest.mark.parametrize(
    "where", ["a/#/b", "a#", "+b/c", "a\0", "\udcff", "a" * 70_000]
)
def test_what_is_not_a_filter_is_one_message(where: str) -> None:
    with pytest.raises(SamplingError, match="is not a filter of MQTT"):
        list(listing("mqtt://127.0.0.1:1", where))


@pytest.mark.parametrize("place", ["home/#", "home/+/t", "home/+/t:value"])
def test_a_signal_from_a_filter_is_refused_in_words(place: str) -> None:
    with pytest.raises(
        SamplingError, match=r"is a filter for many topics, and a signal comes from one"
    ):
        parse_place(place)


@pytest.mark.parametrize("lasting_broker", KINDS[:1], indirect=True)
def test_an_index_into_elements_with_names_is_warned_of_and_never_changes_its_meaning(
    lasting_broker: RunningBroker, plant: Path
) -> None:
    places = {**PLACES, "output": "oven/tank:[0].v"}
    stepped = InStep(lasting_broker, str(plant), PERIOD, places)
    elements = [{"bn": "tank/", "n": "temp", "v": 20.0}, {"n": "duty", "v": 60.0}]
    tick = {
        "oven/set_point": "30",
        "oven/heater": '{"duty cycle": 10}',
        "oven/tank": json.dumps(elements),
    }
    [sample] = stepped.tick(0, dict(tick))
    assert sample.output == 20.0
    [warning] = stepped.listener.news()
    assert warning.endswith("safer by name: oven/tank:[n=temp].v")
    tick["oven/tank"] = json.dumps(elements[::-1])
    assert stepped.tick(1, dict(tick)) == []
    [reason] = stepped.listener.news()
    assert "its place in the list has [n=duty].v now" in reason
    stepped.close()


@pytest.mark.parametrize("lasting_broker", KINDS[:1], indirect=True)
def test_null_is_nothing_new_once_and_no_value_when_it_stays(
    lasting_broker: RunningBroker, plant: Path
) -> None:
    stepped = InStep(lasting_broker, str(plant), PERIOD, PLACES)
    assert len(stepped.tick(0, payloads_of(30.0, 20.0, 10.0))) == 1
    ticks = []
    for number in range(1, 4):
        tick = payloads_of(30.0, 20.0, 10.0) | {"oven/room": '{"t": {"now": null}}'}
        ticks.append(len(stepped.tick(number, tick)))
    assert ticks == [1, 1, 0]
    assert "null in 3 messages in a row" in stepped.listener.trouble("output")
    stepped.close()


@pytest.fixture
def loose() -> Iterator[LooseBroker]:
    running = LooseBroker(
        [
            (b"room/\xff", b"1"),
            (b"other", b"2"),
            (b"\xc3\x28", b"3"),
            (b"room/t", b"21.5"),
        ]
    )
    yield running
    running.close()


def test_topics_that_are_not_utf_8_are_counted_and_end_nothing(
    loose: LooseBroker,
) -> None:
    received: list[tuple[str, float | None]] = []

    def receive(topic: str, read: Any, *_: Any, **__: Any) -> None:
        received.append((topic, read(Channel(topic, ""))))

    source = open_source(loose.url, 1.0, [Channel("room/t", "")], receive)
    wait_for(lambda: source.poll() or received, "the message with a topic")
    assert received == [("room/t", 21.5)]
    assert source.trouble("room/t") == "2 messages left out, whose topics are not UTF-8"
    assert not source.lost
    source.close()


def test_a_listing_counts_topics_that_are_not_utf_8(loose: LooseBroker) -> None:
    counted = "2 messages left out, whose topics are not UTF-8"
    assert list(listing(loose.url, "#")) == [counted, "other  2", "room/t  21.5"]


def test_passwords_are_read_from_a_file_and_wrong_ones_are_refused(
    tmp_path: Path,
) -> None:
    broker = RunningBroker(
        tmp_path / "broker", require("amqtt"), users={"twin": "secret"}
    )
    (tmp_path / "right").write_text("secret\n")
    (tmp_path / "wrong").write_text("guess\n")
    url = broker.url.replace("://", "://twin@")
    client: Client = Broker.parse(
        f"{url}?password_file={tmp_path / 'right'}"
    ).connected(lambda _: None)
    assert client.is_connected()
    client.disconnect()
    for entry in (f"{url}?password_file={tmp_path / 'wrong'}", broker.url):
        with pytest.raises(BrokerError, match="does not let us in"):
            Broker.parse(entry).connected(lambda _: None)
    broker.close()


@pytest.mark.filterwarnings(
    "ignore:Exception ignored:pytest.PytestUnraisableExceptionWarning"
)
@pytest.mark.parametrize("kind", KINDS)
def test_certificates_are_checked(kind: str, tmp_path: Path) -> None:
    """paho leaves the socket of a failed handshake to the garbage collector, which warns."""
    broker = RunningBroker(tmp_path / "broker", require(kind), tls=True)
    client = Broker.parse(f"{broker.url}?ca={broker.certificate}").connected(
        lambda _: None
    )
    assert client.is_connected()
    client.disconnect()
    with pytest.raises(BrokerError, match=r"certificate verify failed"):
        Broker.parse(broker.url).connected(lambda _: None)
    broker.close()


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("mqtt://", "write mqtt://HOST"),
        ("mqtt://host:port", "write mqtt://HOST:PORT"),
        ("mqtt://host/topic", "write mqtt://HOST"),
        ("mqtt://me:secret@host", "a command line is visible to all"),
        ("mqtt://host?password_file=x", "a password without a user"),
        ("mqtt://me@host?password_file=nowhere", "nowhere cannot be read"),
        ("mqtt://host?qos=2", "unknown key 'qos'; known are password_file, ca, time"),
        ("mqtt://host?ca=x", "ca is for mqtts:// only"),
        ("mqtt://127.0.0.1:1", "no MQTT broker at 127.0.0.1:1"),
        ("mqtts://127.0.0.1:1?ca=/dev/null", "is not a certificate"),
    ],
)
def test_a_url_that_cannot_be_used_is_one_message(url: str, words: str) -> None:
    with pytest.raises(BrokerError) as caught:
        list(listing(url, ""))
    assert words in str(caught.value)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize("url", ["opcua://host", "host", "", "mqtt"])
def test_an_unknown_protocol_is_refused_with_those_there_are(url: str) -> None:
    with pytest.raises(SamplingError, match=r"write .*mqtt://…"):
        protocol_of(url)
