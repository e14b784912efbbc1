"""Kit and controller of a Temperature Control Lab in one process, as the launch scripts start them.

If one of them fails, all end, and the process that holds the kit's port switches the heaters off.
"""

from __future__ import annotations

from twinmatch.nodes.controller import ControllerNode
from twinmatch.nodes.keeper import Keeper
from twinmatch.nodes.runner import program
from twinmatch.nodes.tclab_bridge import TCLabBridge

main = program(TCLabBridge, ControllerNode, Keeper)


if __name__ == "__main__":
    main()
