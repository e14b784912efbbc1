"""Whose turn it is to move the plant: one experiment or one law on trial at a time, from its request on."""

from __future__ import annotations

import threading
from enum import Enum


class Mover(Enum):
    """What moves the plant by the operator's word; the value says so."""

    EXPERIMENT = "an experiment runs, or is being sought; stop it first, or wait"
    LAW = "a law is being tried, or is on trial, which holds the set-point; wait, or give the law before back"


class Turn:
    """Given to the first that asks, until it is given back; thread-safe.

    free ──take──▶ a mover's ──give_back by the same──▶ free
    """

    def __init__(self) -> None:
        """Nothing moves the plant."""
        self._lock = threading.Lock()
        self._mover: Mover | None = None

    @property
    def mover(self) -> Mover | None:
        """Whose turn it is; None: nobody's."""
        return self._mover

    def take(self, mover: Mover) -> str:
        """Take the turn; returns why it cannot be taken, or an empty text."""
        with self._lock:
            if self._mover is not None:
                return self._mover.value
            self._mover = mover
            return ""

    def observe(self, mover: Mover) -> None:
        """Note that something moves the plant, whether or not it has asked."""
        with self._lock:
            self._mover = mover

    def give_back(self, mover: Mover) -> None:
        """End the turn of a mover, if it is its turn."""
        with self._lock:
            if self._mover is mover:
                self._mover = None
