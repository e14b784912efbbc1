"""May a controller be run on a plant that is known only as well as its recordings show?

`WholeLoop` is a linearised plant with the law around it: its largest eigenvalue, and how far it is from
instability. `pid_law` makes a linear law of PIDs with filters and set-point weights.
"""

from twinmatch.controllers.pids import FilteredPid, as_linear, pid_law
from twinmatch.controllers.whole_loop import UNSTABLE, ChannelMargins, WholeLoop

__all__ = ["UNSTABLE", "ChannelMargins", "FilteredPid", "WholeLoop", "as_linear", "pid_law"]
