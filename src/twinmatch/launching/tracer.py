"""The tracer that ROS loads, LTTng, is notified of forks.

It has threads of its own, and a fork takes none of them along. Unaware of the fork, the tracer cancels all
of them when the new process ends. Once the C library has freed their stacks, which depends
on how many other threads have ended before, that is signal 11 after all work was done; before, it may be
another thread that has one of these stacks now. A tracer that is notified starts its threads again.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

__all__ = ["tell_tracer_of_forks"]

Notice = Callable[[Any], Any]
"""A function of the tracer that is given a place for a set of signals."""

_NAME: Final = "liblttng-ust"
"""How the names of the library's files begin, also in wheels, which append a checksum."""
_NOTICES: Final = (
    (
        "lttng_ust_before_fork",
        "lttng_ust_after_fork_parent",
        "lttng_ust_after_fork_child",
    ),
    ("ust_before_fork", "ust_after_fork_parent", "ust_after_fork_child"),
)
"""Functions of LTTng to call before and after a fork: since version 2.13, and before it."""
_SIGNAL_SET: Final = 128
"""Size of a `sigset_t` of the C libraries of Linux, bytes."""


def tell_tracer_of_forks() -> bool:
    """Let each `os.fork` of this process, and of those forked from it, be reported to the tracer.

    To be called once, after ROS was imported.

    Returns:
        Whether a tracer is loaded.
    """
    for path in _loaded_files():
        library = ctypes.CDLL(path)
        for names in _NOTICES:
            if hasattr(library, names[0]):
                _call_at_forks(*(library[name] for name in names))
                return True
    return False


def _call_at_forks(
    before: Notice, after_in_parent: Notice, after_in_child: Notice
) -> None:
    # those blocked before, which the call after restores
    signals = ctypes.create_string_buffer(_SIGNAL_SET)
    os.register_at_fork(
        before=lambda: before(signals),
        after_in_parent=lambda: after_in_parent(signals),
        after_in_child=lambda: after_in_child(signals),
    )


def _loaded_files() -> list[str]:
    """The tracer's files that are loaded into this process."""
    mapped = (
        line.split(maxsplit=5)
        for line in Path("/proc/self/maps").read_text("utf-8").splitlines()
    )
    paths = dict.fromkeys(fields[5] for fields in mapped if len(fields) == 6)
    return [path for path in paths if Path(path).name.startswith(_NAME)]
