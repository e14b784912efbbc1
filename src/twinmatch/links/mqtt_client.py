"""MQTT: where a broker is, and a client that comes back to it."""

from __future__ import annotations

import ssl
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from typing import Any, Final
from urllib.parse import parse_qsl, unquote, urlsplit

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion

from twinmatch.errors import TwinmatchError
from twinmatch.links import Background


@dataclass(frozen=True)
class BrokerTimes:
    """How long a client waits for a broker, s."""

    keepalive: int = 10
    """After one and a half times so many seconds of silence, broker and client take the other as gone."""
    first_connection: float = 10.0
    leave: float = 2.0
    """Longest wait for the end of a client's thread: it may be looking a host up, or connecting."""


TIMES: Final = BrokerTimes()
_PORTS: Final = {"mqtt": 1883, "mqtts": 8883}
_KEYS: Final = ("password_file", "ca")


def leave(client: Client) -> bool:
    """Disconnect a client for good; returns whether its thread has ended within `BrokerTimes.leave`."""

    def stop() -> None:
        client.loop_stop()  # which waits without a limit

    client.disconnect()
    stopping = Background("leaving the broker", stop, TIMES.leave)
    stopping.start()
    return stopping.close()


def topic_of(message: MQTTMessage) -> str | None:
    """The topic of a message; None if it is not UTF-8, as MQTT demands."""
    try:
        return message.topic
    except UnicodeDecodeError:
        return None


class BrokerError(TwinmatchError):
    """A broker cannot be reached, or lets nobody in with what is given."""


@dataclass(frozen=True)
class Broker:
    """Where a broker is, and how it is entered."""

    host: str
    port: int
    secure: bool = False
    user: str = ""
    password: str = field(default="", repr=False)
    ca: str = ""
    """File with the certificate that signed the broker's; empty: those of this system."""
    more: Mapping[str, str] = field(default_factory=dict)
    """The other keys of the URL."""

    @classmethod
    def parse(cls, url: str, other_keys: Collection[str] = ()) -> Broker:
        """From `mqtt://USER@HOST:PORT?password_file=FILE`, or `mqtts://…?ca=FILE`.

        `other_keys` are allowed too.

        Raises:
            BrokerError: it is not such a URL, or a file cannot be read.
        """
        shown = url.partition("?")[0]
        try:
            parts = urlsplit(url)
            port = parts.port or _PORTS.get(parts.scheme, 0)
        except ValueError as error:
            raise BrokerError(f"{shown}: {error}; write mqtt://HOST:PORT") from None
        if parts.scheme not in _PORTS or not parts.hostname or parts.path.strip("/"):
            raise BrokerError(
                f"{shown}: write mqtt://HOST, mqtts://HOST or mqtt://USER@HOST:PORT"
            )
        if parts.password is not None:
            why = "a command line is visible to all; write the password into a file of its own"
            raise BrokerError(
                f"mqtt://{parts.hostname}: {why} and give ?password_file=FILE"
            )
        keys = dict(parse_qsl(parts.query, keep_blank_values=True))
        for key in keys:
            if key not in (*_KEYS, *other_keys):
                raise BrokerError(
                    f"{shown}: unknown key {key!r}; known are {', '.join((*_KEYS, *other_keys))}"
                )
        named = keys.pop("password_file", "")
        user = unquote(parts.username or "")
        if named and not user:
            raise BrokerError(
                f"{shown}: a password without a user; write mqtt://USER@HOST"
            )
        try:
            password = Path(named).read_text("utf-8").strip() if named else ""
        except (OSError, ValueError) as error:
            raise BrokerError(f"{shown}: {named} cannot be read ({error})") from None
        secure = parts.scheme == "mqtts"
        ca = keys.pop("ca", "")
        if ca and not secure:
            raise BrokerError(f"{shown}: ca is for mqtts:// only")
        return cls(parts.hostname, port, secure, user, password, ca, keys)

    @property
    def text(self) -> str:
        """Host and port."""
        return f"{self.host}:{self.port}"

    def connected(
        self,
        on_connect: Callable[[Client], None],
        on_message: Callable[[MQTTMessage], None] = lambda _: None,
        will: tuple[str, bytes] | None = None,
    ) -> Client:
        """A client that is connected, and connects again whenever the connection is lost.

        Args:
            on_connect: called after each connection, in the client's own thread.
            on_message: called with each message, in the same thread.
            will: topic and payload that the broker publishes, retained, once this client is lost.

        Raises:
            BrokerError: the first connection fails.
        """
        client = Client(CallbackAPIVersion.VERSION2)
        if self.secure:
            try:
                client.tls_set_context(
                    ssl.create_default_context(cafile=self.ca or None)
                )
            except (OSError, ssl.SSLError) as error:
                raise BrokerError(
                    f"mqtts://{self.text}: {self.ca} is not a certificate ({error})"
                ) from None
        if self.user:
            client.username_pw_set(self.user, self.password or None)
        if will is not None:
            client.will_set(*will, qos=1, retain=True)
        client.reconnect_delay_set(1, 5)
        first = ""
        answered = Event()

        def connect(_c: Client, _u: Any, _f: Any, reason: Any, _p: Any) -> None:
            nonlocal first
            if reason.is_failure:
                first = str(reason)
            else:
                on_connect(client)
            answered.set()

        client.on_connect = connect
        client.on_message = lambda _c, _u, message: on_message(message)
        try:
            client.connect(self.host, self.port, TIMES.keepalive)
        except (OSError, ValueError) as error:
            raise BrokerError(
                f"no MQTT broker at {self.text} ({error}); check that it runs"
            ) from None
        client.loop_start()
        if not answered.wait(TIMES.first_connection) or first:
            leave(client)
            why = first or f"it does not answer within {TIMES.first_connection:g} s"
            raise BrokerError(
                f"the MQTT broker at {self.text} does not let us in: {why}"
            )
        return client
