"""Thin ROS 2 nodes: parameters, topics and diagnostics around the rooms below; no mathematics here.

`network` binds everything to this machine before ROS starts, `runner` starts nodes and ends them, and
`node` is what all of them are. A node's subscriptions only put messages into the queue of its `worker`,
one thread that calls the synchronous object of the core and publishes what comes out. `parameters` (and
the tables of the nodes) need no ROS, so that an offline replay reads the same files; so nothing of it is
imported here, and `middleware` only waits for somebody who does.
"""

import sys

from twinmatch.nodes.middleware import BeforeRos

sys.meta_path.insert(0, BeforeRos())
