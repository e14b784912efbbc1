"""Control of a running virtual rig: lines on a socket in its private folder, with one answer each.

KIND[+SECONDS]   start a fault now             end KIND   end it
state            report the rig's state        stop       end the rig
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable
from pathlib import Path

from twinmatch.errors import TwinmatchError

__all__ = ["ControlServer", "RigControlError", "tell"]

_LONGEST = 256
_PATIENCE = 5.0


class RigControlError(TwinmatchError):
    """A virtual rig cannot be reached, or refused a command."""


class ControlServer:
    """The rig's side, without a thread: the rig's loop calls `attend`."""

    def __init__(self, path: Path, obey: Callable[[str], str]) -> None:
        self.path = path
        self._obey = obey
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(str(path))
        self._listener.listen(8)
        self._listener.setblocking(False)
        self._clients: dict[socket.socket, bytes] = {}

    def attend(self) -> None:
        """Answer pending commands."""
        with contextlib.suppress(BlockingIOError):
            client, _ = self._listener.accept()
            client.setblocking(False)
            self._clients[client] = b""
        for client in list(self._clients):
            try:
                piece = client.recv(_LONGEST)
                if not piece or len(self._clients[client]) > _LONGEST:
                    raise ConnectionError
                self._answer(client, self._clients[client] + piece)
            except BlockingIOError:
                continue
            except OSError:
                del self._clients[client]
                client.close()

    def _answer(self, client: socket.socket, said: bytes) -> None:
        *lines, self._clients[client] = said.split(b"\n")
        for line in lines:
            try:
                answer = f"ok {self._obey(line.decode(errors='replace').strip())}"
            except TwinmatchError as error:
                answer = f"error {error}"
            client.send(answer.strip().encode() + b"\n")

    def close(self) -> None:
        """Close everything and remove the socket."""
        for ours in (*self._clients, self._listener):
            ours.close()
        self.path.unlink(missing_ok=True)


def tell(path: str | Path, line: str) -> str:
    """Send a line to the rig with its control socket at `path`; returns its answer without `ok`.

    Raises:
        ControlError: there is no such rig, or it refused the command.
    """
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connection.settimeout(_PATIENCE)
            connection.connect(str(path))
            connection.sendall(line.encode() + b"\n")
            answer = connection.makefile("r", encoding="utf-8").readline().strip()
    except OSError as error:
        msg = f"virtual rig at {path}: {error}; give the address it prints as `control:`"
        raise RigControlError(msg) from error
    verdict, _, rest = answer.partition(" ")
    if verdict != "ok":
        raise RigControlError(f"virtual rig: {rest or 'no answer'}")
    return rest
