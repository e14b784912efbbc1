"""One thread that does a node's heavy work, so that its callbacks never wait."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Generic, TypeVar

from twinmatch.errors import TwinmatchError
from twinmatch.nodes.diagnostics import Health, Level

__all__ = ["Worker"]

Item = TypeVar("Item")
PATIENCE = 0.2
"""Interval at which an idle worker checks whether it should end, s."""


class Worker(Generic[Item]):
    """Handles items in the order in which they were queued.

    Nothing is ever dropped: the items are small, and a lost sample would cost a whole window. After a
    `TwinmatchError` of the handler, which is reported, the next item is handled; any other exception is a
    defect, ends the worker and is kept in `failure`.
    """

    def __init__(self, handle: Callable[[Item], None], health: Health, backlog: int = 100) -> None:
        """Start the thread; more than `backlog` queued items are reported as a warning."""
        self.failure: Exception | None = None
        self._handle = handle
        self._health = health
        self._backlog = backlog
        self._items: SimpleQueue[Item] = SimpleQueue()
        self._ending = threading.Event()
        self._taken_on = itertools.count(1)
        self._last_put = 0
        self._done = 0
        self._thread = threading.Thread(target=self._run, name="worker", daemon=True)
        self._thread.start()

    @property
    def depth(self) -> int:
        """Number of queued items."""
        return self._items.qsize()

    @property
    def alive(self) -> bool:
        """Whether the thread is still running."""
        return self._thread.is_alive()

    @property
    def idle(self) -> bool:
        """Whether every queued item has been handled."""
        return self._done >= self._last_put

    def put(self, item: Item) -> None:
        """Queue an item."""
        self._last_put = next(self._taken_on)
        self._items.put(item)

    def watch(self) -> None:
        """Report the queue's depth."""
        depth = self.depth
        self._health.set("queue depth", depth)
        if depth > self._backlog:
            message = f"{depth} messages are queued; they arrive faster than they are processed"
            self._health.flag("queue", Level.WARN, message)
        else:
            self._health.withdraw("queue")

    def close(self, timeout: float = 2.0) -> bool:
        """End the worker after its current item; returns whether it ended within the timeout (s)."""
        self._ending.set()
        self._thread.join(timeout)
        return not self.alive

    def _run(self) -> None:
        while not self._ending.is_set():
            try:
                item = self._items.get(timeout=PATIENCE)
            except Empty:
                continue
            try:
                self._handle(item)
            except TwinmatchError as error:
                self._health.set("last error", error)
                self._health.count("errors")
                self._health.flag("error", Level.ERROR, str(error))
            except Exception as error:  # handed to the main thread, which ends the process with it
                self.failure = error
                return
            else:
                self._health.withdraw("error")
            self._done += 1
