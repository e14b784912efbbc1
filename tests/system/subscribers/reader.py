"""A program that is not ours: it knows rclpy and the messages, nothing of twinmatch.

    python reader.py PACKAGE/TYPE TOPIC [latched | everything]

It prints `ready`, then every message as one line of JSON, until SIGTERM or SIGINT; then the modules of
twinmatch it had come to import, of which there should be none.
"""

from __future__ import annotations

import importlib
import json
import signal
import sys
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

QOS = {
    "usual": QoSProfile(depth=10),
    "latched": QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    "everything": QoSProfile(
        history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE
    ),
}

stop_requested = False


def request_stop(*_: object) -> None:
    global stop_requested  # noqa: PLW0603
    stop_requested = True


def plain(value: Any) -> Any:
    """A message as JSON has it."""
    if hasattr(value, "get_fields_and_field_types"):
        return {
            name: plain(getattr(value, name))
            for name in value.get_fields_and_field_types()
        }
    if isinstance(value, str) or not hasattr(value, "__len__"):
        return value
    return [plain(element) for element in value]


def main() -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, request_stop)
    package, kind = sys.argv[1].split("/")
    qos = QOS[sys.argv[3] if len(sys.argv) > 3 else "usual"]
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = Node("stranger")

    def show(message: Any) -> None:
        print(json.dumps(plain(message)), flush=True)

    node.create_subscription(
        getattr(importlib.import_module(f"{package}.msg"), kind), sys.argv[2], show, qos
    )
    print("ready", flush=True)
    while not stop_requested:
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    rclpy.shutdown()
    print(
        "imported",
        [name for name in sys.modules if name.partition(".")[0] == "twinmatch"],
        flush=True,
    )


if __name__ == "__main__":
    main()
