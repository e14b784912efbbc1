"""Thin ROS 2 nodes: parameters, topics and diagnostics around the packages below; no mathematics here.

`network` binds everything to this machine before ROS starts, `runner` starts and ends nodes, and `node` is
their base class. A node's subscriptions only put messages into the queue of its `worker`, a thread that
calls the synchronous object of the core and publishes the results. `parameters` and the nodes' tables need
no ROS, so that an offline replay reads the same files. For that reason ROS is not imported here, and
`middleware` only hooks into a later import.
"""

import sys

from twinmatch.nodes.middleware import BeforeRos

sys.meta_path.insert(0, BeforeRos())
