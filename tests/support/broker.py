"""MQTT brokers in processes of their own: amqtt, and Debian's mosquitto where it is installed."""

from __future__ import annotations

import json
import shutil
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final

import pytest

from tests.support.processes import Process

KINDS: Final = ("amqtt", "mosquitto")
"""The programs; see `require`."""


def require(kind: str) -> str:
    """The kind of broker, if it is installed; otherwise the test is skipped, with the reason."""
    if kind == "amqtt":
        pytest.importorskip(
            "amqtt", reason="amqtt is not installed; it is in the extra 'test'"
        )
    elif shutil.which(kind, path=_PATH) is None:
        pytest.skip("mosquitto is not installed: apt-get install mosquitto")
    return kind


def quickest_kind() -> str:
    """The kind that starts sooner, of those installed: for tests that ask nothing of the broker itself."""
    return "amqtt" if shutil.which("mosquitto", path=_PATH) is None else "mosquitto"


class RunningBroker:
    """A broker on a port of loopback that it keeps when it is started again; it forgets what it retained.

    Without `users` (names and passwords) everyone is let in. With `tls` it is reached as `localhost`, and
    `certificate` is the file that says so.
    """

    def __init__(
        self,
        folder: Path,
        kind: str = "amqtt",
        *,
        users: Mapping[str, str] | None = None,
        tls: bool = False,
    ) -> None:
        """Start it, with its files in this folder, which is made, and wait until it answers."""
        self.kind = kind
        self._folder = folder
        self._starts = 0
        folder.mkdir(parents=True, exist_ok=True)
        self.certificate = folder / "certificate.pem"
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port: int = free.getsockname()[1]
        write = _write_mosquitto if kind == "mosquitto" else _write_amqtt
        key = _certify(self.certificate) if tls else None
        self._command = write(
            folder, self.port, users or {}, (self.certificate, key) if key else None
        )
        self.url = (
            f"mqtts://localhost:{self.port}" if tls else f"mqtt://127.0.0.1:{self.port}"
        )
        self.start()

    def start(self) -> None:
        """Start it on its port, and wait until that answers."""
        self._starts += 1
        output = self._folder / f"broker_{self._starts}.txt"
        self.process = Process(*self._command, output=output, folder=self._folder)
        try:
            self.process.wait_until(self._answers, "the broker's port")
        except BaseException:
            self.process.kill()
            raise

    def kill(self) -> None:
        """End it as kill -9 does."""
        self.process.kill()

    def restart(self) -> None:
        """Kill it, and start it again on the same port."""
        self.kill()
        self.start()

    def close(self) -> None:
        """End it, if it still runs; how it ends is its own affair."""
        self.process.send(signal.SIGTERM)
        self.process.kill()

    def _answers(self) -> bool:
        try:
            socket.create_connection(("127.0.0.1", self.port), 1.0).close()
        except OSError:
            return False
        return True


class LooseBroker:
    """A broker that checks nothing: it lets everybody in, and sends each subscriber these messages.

    Others refuse topics that are not UTF-8; devices with a small stack of their own do not.
    """

    def __init__(self, messages: Iterable[tuple[bytes, bytes]]) -> None:
        """Listen on a port of loopback; messages are topics with payloads."""
        self._messages = [_published(topic, payload) for topic, payload in messages]
        self._server = socket.create_server(("127.0.0.1", 0))
        self.url = f"mqtt://127.0.0.1:{self._server.getsockname()[1]}"
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def close(self) -> None:
        """End it."""
        self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        self._thread.join()

    def _serve(self) -> None:
        with suppress(OSError):  # it has been closed
            while True:
                connection, _ = self._server.accept()
                with connection, suppress(OSError):
                    self._answer(connection)

    def _answer(self, connection: socket.socket) -> None:
        stream = connection.makefile("rb")
        while len(head := stream.read(2)) == 2:
            # what clients send here is short: its length is one byte
            body = stream.read(head[1])
            kind = head[0] >> 4
            if kind == _CONNECT:
                connection.sendall(b"\x20\x02\x00\x00")
            elif kind == _SUBSCRIBE:
                connection.sendall(b"\x90\x03" + body[:2] + b"\x01")
                connection.sendall(b"".join(self._messages))
            elif kind == _PING:
                connection.sendall(b"\xd0\x00")


_CONNECT: Final = 1
_SUBSCRIBE: Final = 8
_PING: Final = 12
"""Kinds of packets of MQTT 3.1.1."""


def _published(topic: bytes, payload: bytes) -> bytes:
    """The packet that brings a short message."""
    content = len(topic).to_bytes(2, "big") + topic + payload
    assert len(content) < 128
    return bytes((0x30, len(content))) + content


_PATH: Final = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin"
"""Debian has mosquitto among the programs of root."""
_Tls = tuple[Path, Path] | None


def _write_amqtt(
    folder: Path, port: int, users: Mapping[str, str], tls: _Tls
) -> list[object]:
    """Its configuration, and the command that starts it."""
    listener: dict[str, object] = {"type": "tcp", "bind": f"127.0.0.1:{port}"}
    if tls is not None:
        listener |= {"ssl": True, "certfile": str(tls[0]), "keyfile": str(tls[1])}
    plugins: dict[str, object] = {
        "amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True},
    }
    if users:
        from pwdlib import PasswordHash
        from pwdlib.hashers.argon2 import Argon2Hasher

        hashed = PasswordHash((Argon2Hasher(),))
        users_file = folder / "users"
        users_file.write_text(
            "".join(f"{name}:{hashed.hash(word)}\n" for name, word in users.items())
        )
        plugins = {
            "amqtt.plugins.authentication.FileAuthPlugin": {
                "password_file": str(users_file)
            }
        }
    config = folder / "amqtt.yaml"
    config.write_text(
        json.dumps({"listeners": {"default": listener}, "plugins": plugins})
    )
    return [Path(sys.executable).with_name("amqtt"), "-c", config]


def _write_mosquitto(
    folder: Path, port: int, users: Mapping[str, str], tls: _Tls
) -> list[object]:
    """The same of mosquitto."""
    lines = [
        f"listener {port} 127.0.0.1",
        f"allow_anonymous {str(not users).lower()}",
        "persistence false",
    ]
    if users:
        users_file = folder / "users"
        users_file.touch(mode=0o600)
        for name, word in users.items():
            subprocess.run(
                ["mosquitto_passwd", "-b", users_file, name, word],
                check=True,
                env={"PATH": _PATH},
            )
        lines.append(f"password_file {users_file}")
    if tls is not None:
        lines += [f"certfile {tls[0]}", f"keyfile {tls[1]}"]
    config = folder / "mosquitto.conf"
    # it gives root's files up otherwise
    config.write_text("\n".join((*lines, "user root", "")))
    return [str(shutil.which("mosquitto", path=_PATH)), "-c", config]


def _certify(certificate: Path) -> Path:
    """Write a certificate of `localhost`, signed by itself; returns its key."""
    key = certificate.with_name("key.pem")
    named = (
        "subjectAltName=DNS:localhost",
        "keyUsage=critical,digitalSignature,keyCertSign",
    )
    words = [
        "openssl",
        "req",
        "-x509",
        "-newkey",
        "rsa:2048",
        "-nodes",
        "-subj",
        "/CN=localhost",
    ]
    words += [word for extension in named for word in ("-addext", extension)]
    try:
        subprocess.run(
            [*words, "-keyout", key, "-out", certificate],
            check=True,
            capture_output=True,
        )
    except FileNotFoundError:
        pytest.skip("openssl is not installed, which makes the broker's certificate")
    return key
