"""The live page: the state of the running graph, in a browser on this machine.

One node subscribes to the graph and fills a `DashboardState`, which is bounded and depends on neither ROS nor
Bokeh. A Bokeh server shows it in every open tab; each tab draws what is new since its last update.

Names are imported on first use, so that `twinmatch dashboard --help` does not wait for numpy.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twinmatch.showing.page.errors import DashboardError
    from twinmatch.showing.page.events import Event, EventLog, Lane, Mark
    from twinmatch.showing.page.history import History
    from twinmatch.showing.page.state import DashboardState, Drive, TwinRow

__all__ = [
    "DashboardError",
    "DashboardState",
    "Drive",
    "Event",
    "EventLog",
    "History",
    "Lane",
    "Mark",
    "TwinRow",
]

_MODULES = {
    "DashboardError": "errors",
    "Event": "events",
    "EventLog": "events",
    "Lane": "events",
    "Mark": "events",
    "History": "history",
    "DashboardState": "state",
    "Drive": "state",
    "TwinRow": "state",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        msg = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(msg)
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
