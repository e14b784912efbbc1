"""A flood: messages at some kHz from beside a live graph, and what becomes of it.

    python -m benchmarks.flood [--rate 2000] [--seconds 20] [--speed 4]

`live` runs a virtual rig with twin, recorder and page. Another program on its domain publishes one kind of
message after the other, each well formed and each in line with the one before. Printed for each: the rate
that the middleware took, the memory that processes gained and gave back, the output, the hottest plate.
Exit code: 0 every process lives and has grown by less than `ALLOWED`, 1 otherwise.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Temperature

from benchmarks.soak import Soak, _family, _resident
from twinmatch.emulation.faults import tell
from twinmatch.nodes import network
from twinmatch.nodes.messages import message_of, sample_message
from twinmatch.plants import Peltier
from twinmatch.signals import Sample, Window
from twinmatch.twin import MatchRequest
from twinmatch_msgs.msg import LoopSample, ModelScore, PwmCommand
from twinmatch_msgs.msg import MatchRequest as RequestMessage

ALLOWED = 150.0
"""MB by which a process may grow in one flood: its bounded queues, full."""
QUIET = 5.0
"""Wall seconds before and after a flood."""
FLOOD = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)


TOPICS = {
    "samples": ("plant/sample", LoopSample),
    "requests": ("twin/match_request", RequestMessage),
    "scores": ("twin/model_score", ModelScore),
    "temperatures": ("plant/temperature", Temperature),
    "commands": ("plant/pwm_command", PwmCommand),
}
"""The last two decide about heat: the output must go to zero, and latch."""


def forged(kind: str, begun: int) -> Iterator[Any]:
    """Messages of a kind, without end, each in line with the one before; `begun`: plant time, ns."""
    steady = np.full(300, 30.0)
    window = Window(steady, steady, steady)
    asked = MatchRequest(299, 30.0, window, Peltier.model().parameters(), None)
    request = message_of(asked, begun)
    score = ModelScore(level=ModelScore.UNKNOWN, level_name="unknown", decimals=2)
    for k in range(sys.maxsize):
        if kind == "samples":
            yield sample_message(
                Sample(10_000 + k, begun + k * 1_000_000_000, 40.0, 20.0, 255.0)
            )
        elif kind == "requests":
            request.sample = 299 + k
            yield request
        elif kind == "temperatures":
            yield Temperature(temperature=20.0)
        elif kind == "commands":
            yield PwmCommand(pwm=255.0, index=k)
        else:
            score.sample = score.last = 10_000 + k
            yield score


class Flood:
    """What a graph does in and after a flood."""

    def __init__(self, soak: Soak, control: str) -> None:
        self._soak = soak
        self._control = control
        self.memory: dict[str, list[float]] = defaultdict(list)
        self.pwm: list[float] = []
        self.plate: list[float] = []

    def look(self) -> None:
        """Take memory, MB by process, and the state of the rig."""
        for process, name in _family(self._soak.process.pid).items():
            self._soak._ids[name].add(process)
            if (held := _resident(process)) is not None:
                self.memory[name].append(held[1])
        state = json.loads(tell(self._control, "state"))
        self.pwm.append(state["pwm"])
        self.plate.append(state["plate"])

    def run(self, node: Node, kind: str, rate: float, seconds: float) -> float:
        """Flood for some wall seconds; returns the rate that the middleware took, 1/s."""
        topic, message = TOPICS[kind]
        publisher = node.create_publisher(message, topic, FLOOD)
        end = time.monotonic() + QUIET
        while time.monotonic() < end:
            self.look()
            time.sleep(1.0)
        began = looked = time.monotonic()
        sent = 0
        for one in forged(kind, time.time_ns()):
            publisher.publish(serialize_message(one))
            sent += 1
            now = time.monotonic()
            if now - looked > 1.0:
                looked = now
                self.look()
            if now - began > seconds:
                break
            if (early := began + sent / rate - now) > 0.002:
                time.sleep(early)
        took = sent / (time.monotonic() - began)
        node.destroy_publisher(publisher)
        end = time.monotonic() + QUIET
        while time.monotonic() < end:
            self.look()
            time.sleep(1.0)
        return took


def main() -> int:
    title = (__doc__ or "").splitlines()[0]
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.flood", description=title
    )
    parser.add_argument(
        "kinds", nargs="*", choices=(*TOPICS, []), help="what to publish (all)"
    )
    parser.add_argument(
        "--rate", type=float, default=2000.0, help="messages per second (2000)"
    )
    parser.add_argument(
        "--seconds", type=float, default=20.0, help="wall time of each flood (20)"
    )
    parser.add_argument(
        "--speed", type=float, default=4.0, help="plant time per wall time (4)"
    )
    options = parser.parse_args()
    options.plant = "peltier"
    options.session = None
    failed = []
    with tempfile.TemporaryDirectory(prefix="twinmatch-flood-") as folder:
        soak = Soak(options, Path(folder))
        try:
            control = soak.found(r"control: (\S+)")
            while json.loads(tell(control, "state"))["pwm"] == 0:
                time.sleep(0.5)
            network.prepare()
            rclpy.init()
            node = Node("flood")
            for kind in options.kinds or TOPICS:
                flood = Flood(soak, control)
                took = flood.run(node, kind, options.rate, options.seconds)
                print(f"{kind}: {took:.0f} per second for {options.seconds:g} s")
                for name, held in sorted(flood.memory.items()):
                    print(
                        f"  {name:14} {held[0]:6.0f} MB, at most {max(held):6.0f}, then {held[-1]:6.0f}"
                    )
                    failed += (
                        [f"{kind}: {name} grew"]
                        if max(held) - held[0] > ALLOWED
                        else []
                    )
                drives = sum(pwm != 0 for pwm in flood.pwm)
                print(
                    f"  driven at {drives} of {len(flood.pwm)} looks, plate at most {max(flood.plate):.1f} °C"
                )
        finally:
            soak.stop()
    failed += [f"{name} was started more than once" for name in soak.restarted]
    named = [
        line
        for line in soak.lines
        if "end all but one" in line and "refused" not in line
    ]
    print(
        "\n".join(
            [*dict.fromkeys(named), *(line for line in soak.lines if "ended" in line)]
        )
    )
    print("\n".join(f"flood: {why}" for why in failed))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
