"""The programs of this room: `python -m twinmatch.nodes NAME`, or a console script of that name.

The nodes of a program share its process. If one of them fails, all end: with those of a rig its board's own
deadline switches the output off, with those of a kit the process that holds its port.
"""

from __future__ import annotations

import signal
import sys
from importlib import import_module
from pathlib import Path
from typing import Any, Final

from twinmatch.errors import EXIT_USER_ERROR, TwinmatchError
from twinmatch.nodes import require_ros

PROGRAMS: Final = {
    "camera_bridge": "camera_bridge:CameraBridge",
    "controller": "controller:ControllerNode",
    "discriminator": "discriminator:DiscriminatorNode",
    "matcher": "twin:MatcherNode",
    "plant_clock": "plant_clock:PlantClock",
    "player": "player:Player keeper:Keeper",
    "pwm_bridge": "pwm_bridge:PwmBridge",
    "recorder": "recorder:RecorderNode",
    "rig": "camera_bridge:CameraBridge pwm_bridge:PwmBridge controller:ControllerNode keeper:Keeper",
    "sampler": "sampler:SamplerNode keeper:Keeper",
    "tclab_bridge": "tclab_bridge:TCLabBridge",
    "tclab_rig": "tclab_bridge:TCLabBridge controller:ControllerNode keeper:Keeper",
    "twin": "twin:TwinSimulatorNode twin:MatcherNode discriminator:DiscriminatorNode",
    "twin_simulator": "twin:TwinSimulatorNode",
}
"""Module and class of each node, by program; a program imports only its own."""


def nodes_of(program: str) -> list[type[Any]]:
    """The nodes of a program."""
    places = (place.split(":") for place in PROGRAMS[program].split())
    return [
        getattr(import_module(f"twinmatch.nodes.{module}"), name)
        for module, name in places
    ]


def main() -> None:
    """Run the program that is called so. Until its runner takes signals over, they end it at once."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    arguments = sys.argv if Path(sys.argv[0]).stem in PROGRAMS else sys.argv[1:]
    if not arguments or (name := Path(arguments[0]).stem) not in PROGRAMS:
        print(
            f"usage: python -m twinmatch.nodes {{{','.join(PROGRAMS)}}} [--help]",
            file=sys.stderr,
        )
        sys.exit(EXIT_USER_ERROR)
    try:
        require_ros(name)
        from twinmatch.nodes.runner import run  # noqa: PLC0415

        nodes = nodes_of(name)
    except TwinmatchError as error:
        print(f"twinmatch: {error}", file=sys.stderr)
        sys.exit(EXIT_USER_ERROR)
    sys.exit(run(nodes, arguments))


if __name__ == "__main__":
    main()
