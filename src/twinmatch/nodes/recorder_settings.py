"""Asks the nodes of a rig for their parameters, so that a session documents them."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python

from twinmatch.sessions.documents import read_text
from twinmatch.sessions.errors import DocumentError
from twinmatch.sessions.settings import CANDIDATES, parameters_record

__all__ = ["Settings"]

PATIENCE = 3.0
"""Wall seconds after which a node that has not answered is asked again."""

Tell = Callable[[str, Mapping[str, str]], None]


class Settings:
    """Asks every node until it has answered, and again after a restart of the node.

    A killed node stays known for some seconds. If another node of its name starts meanwhile, only the missing
    answer shows it.
    """

    def __init__(self, node: Node, tell: Tell) -> None:
        """`tell` is called with the name and the values of each record, in the executor's thread."""
        self._node = node
        self._tell = tell
        self._own = node.get_fully_qualified_name()
        self._namespace = node.get_namespace().rstrip("/") + "/"
        self._clients: dict[str, list[Any]] = {}
        self._asked: dict[str, float] = {}  # when, s; without those that have answered
        self._known: set[str] = set()
        self._answered: set[str] = set()  # since the last look

    def look(self) -> None:
        """Ask new nodes; call it periodically."""
        found = {
            f"{namespace.rstrip('/')}/{name}"
            for name, namespace in self._node.get_node_names_and_namespaces()
        }
        mine = {n for n in found if n.startswith(self._namespace) and n != self._own and "/_" not in n}
        for done in self._answered | (self._clients.keys() - mine):
            self._forget(done)
        self._answered.clear()
        self._known &= mine
        now = time.monotonic()
        for name in mine - self._known:
            if name in self._asked and now - self._asked[name] > PATIENCE:
                self._forget(name)
            if name not in self._asked:
                self._ask(name, now)

    def _ask(self, name: str, now: float) -> None:
        if name not in self._clients:
            self._clients[name] = [
                self._node.create_client(ListParameters, f"{name}/list_parameters"),
                self._node.create_client(GetParameters, f"{name}/get_parameters"),
            ]
        clients = self._clients[name]
        if not all(client.service_is_ready() for client in clients):
            return
        self._asked[name] = now
        listing, getting = clients

        def get(future: Any) -> None:
            names = list(future.result().result.names) if future.result() is not None else []
            answer = getting.call_async(GetParameters.Request(names=names))
            answer.add_done_callback(lambda done: self._take(name, names, done))

        listing.call_async(ListParameters.Request()).add_done_callback(get)

    def _take(self, name: str, names: list[str], future: Any) -> None:
        answer = future.result()
        values = [parameter_value_to_python(value) for value in answer.values] if answer is not None else []
        values = [list(v) if hasattr(v, "tolist") or isinstance(v, tuple) else v for v in values]
        parameters = dict(zip(names, values, strict=False))
        self._tell(parameters_record(name), {n: json.dumps(v) for n, v in parameters.items()})
        path = parameters.get("candidates")
        if isinstance(path, str) and path:
            self._tell(CANDIDATES, {"text": _read(path)})
        self._answered.add(name)
        self._known.add(name)

    def _forget(self, name: str) -> None:
        self._asked.pop(name, None)
        for client in self._clients.pop(name, []):
            self._node.destroy_client(client)


def _read(path: str) -> str:
    try:
        return read_text(Path(path))
    except DocumentError:
        return ""  # unknown: then the session records no candidates
