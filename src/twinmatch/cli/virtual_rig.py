"""`twinmatch virtual-rig`: a virtual rig until its duration is over or a signal ends it.

Each line of output is `key: value`; a line `ready` follows once everything can be used.
"""

from __future__ import annotations

import argparse
import math
import select
import signal
import sys
from typing import TYPE_CHECKING, Any

from twinmatch.cli.shared import add_options
from twinmatch.emulation.faults import KINDS, Change, parse_faults, tell
from twinmatch.errors import TwinmatchError

if TYPE_CHECKING:
    from twinmatch.emulation.plant_time import VirtualPlantTime

EXIT_LOST = 1
"""Exit code after a part of the rig has ended unexpectedly."""
KITS = ("tclab", "tclab-both")
"""Plants whose virtual one is the kit; who commands it decides on its heaters."""
_STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    width = max(map(len, KINDS))
    parser.epilog = "faults:\n" + "\n".join(
        f"  {kind:{width}}  {text}" for kind, text in KINDS.items()
    )
    parser.add_argument(
        "--plant",
        default="peltier",
        choices=("peltier", *KITS),
        help="plant to emulate (default: peltier)",
    )
    add_options(parser, "--speed", "--fault", "--board", "--seed")
    parser.add_argument(
        "--in-step",
        action="store_true",
        help="no faster than real time unless the graph that commands the plant keeps step",
    )
    parser.add_argument(
        "--duration",
        type=float,
        default=math.inf,
        metavar="S",
        help="plant time to run for",
    )
    parser.add_argument(
        "--tell",
        nargs=2,
        metavar=("CONTROL", "LINE"),
        help="send a command to a running rig: KIND[+S], 'end KIND', state, stop",
    )


def run(options: argparse.Namespace) -> int:
    """Run a virtual rig until its duration is over or a signal ends it, or send a command to one.

    Returns:
        The exit code: 0 ended as requested, `EXIT_LOST` if the board or the camera ended unexpectedly.

    Raises:
        TwinmatchError: an option cannot be used, or a part of the rig cannot be created.
    """
    if options.tell is not None:
        print(tell(*options.tell))
        return 0
    from twinmatch.emulation.kit import VirtualKit  # noqa: PLC0415
    from twinmatch.emulation.plant_time import RigSettings  # noqa: PLC0415
    from twinmatch.emulation.virtual_rig import VirtualRig  # noqa: PLC0415

    faults = tuple(fault for text in options.fault for fault in parse_faults(text))
    asked = {
        name: getattr(options, name)
        for name in ("speed", "in_step", "board", "seed", "duration")
    }
    settings = RigSettings(faults=faults, **asked)
    stopping: list[int] = []
    before = {
        number: signal.signal(number, lambda n, _: stopping.append(n))
        for number in _STOPS
    }
    try:
        with (VirtualKit if options.plant in KITS else VirtualRig)(settings) as rig:
            for number in _STOPS:
                signal.signal(number, lambda *_: rig.request_stop())
            return 0 if stopping else _run(rig)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _run(rig: VirtualPlantTime) -> int:
    rig.on_change = _say_fault
    _say("board", f"{rig.board_kind} ({rig.board_remark})")
    for name, address in rig.addresses.items():
        _say(name, address)
    print("ready", flush=True)
    try:
        rig.run(lambda: rig.request_stop() if _reader_gone() else None)
    except TwinmatchError as error:
        # a part of the rig was lost: not an error of the user
        print(f"twinmatch: {error}", file=sys.stderr)
        return EXIT_LOST
    wall, speed = rig.achieved()
    if not _reader_gone():
        _say(
            "ended",
            f"{rig.elapsed:.1f} s of plant time in {wall:.1f} s, {speed:.2f} times the wall clock",
        )
    return 0


def _reader_gone() -> bool:
    """Whether the reader of our output is gone: the process that started us was killed."""
    output = select.poll()
    output.register(sys.stdout, 0)  # errors are reported without registration
    return any(event & select.POLLERR for _, event in output.poll(0))


def _say_fault(change: Change) -> None:
    _say(
        "fault",
        f"{change.kind} {'begins' if change.begins else 'ends'} at {change.time:.2f} s",
    )


def _say(key: str, value: Any) -> None:
    print(f"{key}: {value}", flush=True)
