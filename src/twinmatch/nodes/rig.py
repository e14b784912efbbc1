"""Bridges, controller and keeper in one process, as the launch scripts start them.

If one of them fails, all end, and the board's own deadline switches the output off.
"""

from __future__ import annotations

from twinmatch.nodes.camera_bridge import CameraBridge
from twinmatch.nodes.controller import ControllerNode
from twinmatch.nodes.keeper import Keeper
from twinmatch.nodes.pwm_bridge import PwmBridge
from twinmatch.nodes.runner import program

main = program(CameraBridge, PwmBridge, ControllerNode, Keeper)


if __name__ == "__main__":
    main()
