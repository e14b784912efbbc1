"""The live page: what the graph says, as it says it, in a browser on this machine.

One node hears the graph and fills a `DashboardState`, which is bounded and knows neither ROS nor a browser.
A Bokeh server shows it in as many tabs as are open; each draws what is new since it last looked.
"""

from __future__ import annotations

from twinmatch.dashboard.errors import DashboardError
from twinmatch.dashboard.events import Event, EventLog, Lane, Mark
from twinmatch.dashboard.history import History
from twinmatch.dashboard.state import DashboardState, TwinRow

__all__ = ["DashboardError", "DashboardState", "Event", "EventLog", "History", "Lane", "Mark", "TwinRow"]
