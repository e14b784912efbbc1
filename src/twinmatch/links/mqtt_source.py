"""Topics of MQTT as a source. It subscribes to what is mapped, and publishes nothing."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from paho.mqtt.client import Client, MQTTMessage, topic_matches_sub

from twinmatch.links.mqtt_client import Broker, leave, topic_of
from twinmatch.sampling.channels import Channel, SamplingError, UnreadableError
from twinmatch.sampling.document_paths import by_name, steps_of
from twinmatch.sampling.heard import Heard
from twinmatch.sampling.listener import Receive
from twinmatch.sampling.payloads import (
    absence,
    document_of,
    has_null,
    parse_filter,
    parse_place,
    place_text,
    stamp_at,
    value_at,
)

__all__ = ["MqttSource", "listing", "open_source", "parse_place"]

_TIME: Final = "time"
"""Key of the URL with the path of the time in each payload."""
_LISTENS: Final = 2.0
"""Time for which a listing listens, s; what brokers keep comes at once."""


class MqttSource:
    """Subscribes to the topics of some channels, again after each loss of the connection."""

    _NULLS: Final = 3
    """Messages in a row with null after which a value has ended; before, they have nothing new."""
    _WAITING: Final = 100_000
    """Most messages that wait; the oldest are dropped."""

    def __init__(
        self, broker: Broker, channels: list[Channel], receive: Receive
    ) -> None:
        """Connect and subscribe.

        Raises:
            BrokerError: there is no connection.
        """
        self.kinds: Mapping[str, str] = {channel.topic: "" for channel in channels}
        self._broker = broker
        self._receive = receive
        self._arrived: deque[MQTTMessage] = deque(maxlen=self._WAITING)
        self._amiss: dict[str, tuple[int, str]] = {}
        """Messages in a row of a topic without a number, and why the last had none."""
        self._unreadable = 0
        """Messages whose topic is not UTF-8."""
        self._nulls: dict[Channel, int] = {}
        """Messages in a row with null at a channel."""
        self._named: dict[Channel, str] = {}
        """The path of each channel by names, as the first message had them."""
        self._news: list[str] = []
        self._client = broker.connected(self._subscribe, self._arrived.append)

    def search(self, waited: float) -> None:
        """A topic of MQTT exists once something is sent on it, so nothing is looked for."""

    def path(self, channel: Channel) -> str:
        """The path as it is: each payload may look different."""
        return channel.path

    def poll(self) -> None:
        """Hand on the messages that have arrived."""
        while self._arrived:
            message = self._arrived.popleft()
            topic = topic_of(message)
            if topic is None:
                self._unreadable += 1
                continue
            if topic not in self.kinds:
                continue
            try:
                document = document_of(bytes(message.payload))
            except UnreadableError as error:
                self._receive(
                    topic, self._unreadable_reader(error), retained=message.retain
                )
                continue
            try:
                place = self._broker.more.get(_TIME)
                stamp = stamp_at(document, place) if place else 0
            except SamplingError as error:
                self._miss(topic, str(error))
                continue
            self._receive(
                topic, self._reader(topic, document), stamp, retained=message.retain
            )

    @property
    def lost(self) -> str:
        """That there is no connection."""
        text = f"the connection to the broker at {self._broker.text} is lost"
        return "" if self._client.is_connected() else text

    def trouble(self, topic: str) -> str:
        """That the newest messages have no number, or topics that cannot be read."""
        count, why = self._amiss.get(topic, (0, ""))
        without = (
            f"{count} messages on {topic} without a number, the last: {why}"
            if count
            else ""
        )
        return without or unreadable_words(self._unreadable)

    def news(self) -> list[str]:
        """Places that choose by an index what has a name."""
        lines = self._news.copy()
        self._news.clear()
        return lines

    def close(self) -> bool:
        """Disconnect."""
        return leave(self._client)

    def _subscribe(self, client: Client) -> None:
        for topic in self.kinds:
            client.subscribe(topic, 1)

    def _reader(
        self, topic: str, document: Any
    ) -> Callable[[Channel], float | str | None]:
        def read(channel: Channel) -> float | str | None:
            value = value_at(document, channel.path)
            if value is None:
                self._miss(topic, absence(document, channel.path))
                self._count_null(channel, document)
                return None
            self._check_name(channel, document)
            self._amiss.pop(topic, None)
            self._nulls.pop(channel, None)
            return value

        return read

    def _unreadable_reader(
        self, error: UnreadableError
    ) -> Callable[[Channel], float | str | None]:
        def read(channel: Channel) -> float | str | None:  # noqa: ARG001
            raise UnreadableError(str(error))

        return read

    def _count_null(self, channel: Channel, document: Any) -> None:
        """Count messages in a row that have null at a channel.

        Raises:
            UnreadableError: they are so many that null cannot mean "nothing new".
        """
        if not has_null(document, channel.path):
            return
        self._nulls[channel] = self._nulls.get(channel, 0) + 1
        if self._nulls[channel] >= self._NULLS:
            raise UnreadableError(f"null in {self._NULLS} messages in a row")

    def _check_name(self, channel: Channel, document: Any) -> None:
        """Notice that a channel chooses an element by its index although it has a name.

        Raises:
            UnreadableError: the element at the index has another name than before.
        """
        named = by_name(document, channel.path)
        if channel not in self._named:
            self._named[channel] = named
            if steps_of(named) != steps_of(channel.path):
                place = place_text(channel._replace(path=named))
                self._news.append(
                    f"{channel.text} is chosen by its place in a list; safer by name: {place}"
                )
        elif named != self._named[channel]:
            place = place_text(channel._replace(path=self._named[channel]))
            raise UnreadableError(
                f"its place in the list has {named} now; choose it by name: {place}"
            )

    def _miss(self, topic: str, why: str) -> None:
        self._amiss[topic] = self._amiss.get(topic, (0, ""))[0] + 1, why


def unreadable_words(count: int) -> str:
    """That so many messages were left out for their topics; empty for none."""
    return f"{count} messages left out, whose topics are not UTF-8" if count else ""


def open_source(
    url: str,
    period: float,  # noqa: ARG001
    channels: list[Channel],
    receive: Receive,
) -> MqttSource:
    """The topics of the broker at a URL; see `Broker.parse`.

    `?time=PATH` names where each payload says when its values were measured.

    Raises:
        BrokerError: the URL cannot be used, or there is no connection.
    """
    return MqttSource(Broker.parse(url, (_TIME,)), channels, receive)


def listing(url: str, where: str) -> Iterator[str]:
    """The topics on which something is sent within two seconds, with their numbers.

    `where` is a filter of MQTT, such as `home/+/t` or `#`, or the topic above those that are listed.

    Raises:
        BrokerError: as for `open_source`.
        SamplingError: `where` is not a filter.
    """
    chosen = parse_filter(where)
    heard = Heard()
    unreadable = 0

    def subscribe(client: Client) -> None:
        client.subscribe(chosen)

    def hear(message: MQTTMessage) -> None:
        nonlocal unreadable
        topic = topic_of(message)
        if topic is None:
            unreadable += 1
        elif topic_matches_sub(chosen, topic):
            # some brokers send what they have kept, whatever was asked
            heard.take(topic, bytes(message.payload))

    client = Broker.parse(url, (_TIME,)).connected(subscribe, hear)
    time.sleep(_LISTENS)
    leave(client)
    if unreadable:
        yield unreadable_words(unreadable)
    yield from heard.lines()
