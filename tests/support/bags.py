"""Other people's bags, written message by message."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
"""The types of messages; a test may register its own."""
START = 1_700_000_000
"""Time from which those of messages count, s since the epoch."""


def stamp(seconds: float) -> Any:
    return STORE.types["builtin_interfaces/msg/Time"](
        sec=START + math.floor(seconds),
        nanosec=round(seconds % 1 * 1e9) % 1_000_000_000,
    )


def header(seconds: float) -> Any:
    return STORE.types["std_msgs/msg/Header"](stamp=stamp(seconds), frame_id="")


def number(value: float) -> Any:
    return STORE.types["std_msgs/msg/Float64"](data=value)


def temperature(seconds: float, value: float) -> Any:
    return STORE.types["sensor_msgs/msg/Temperature"](
        header=header(seconds), temperature=value, variance=0.0
    )


def bag(
    folder: Path,
    storage: StoragePlugin,
    messages: list[tuple[float, str, Any]],
    behind: float = 0.0,
    *,
    surplus: bytes = b"",
    compression: CompressionMode = CompressionMode.NONE,
) -> Path:
    """Write a bag whose messages are written 30 ms after they were sent, and `behind` s more.

    On its topic `/empty` there is no message. `surplus` follows every message.
    """
    writer = Writer(folder, version=9, storage_plugin=storage)
    if compression is not CompressionMode.NONE:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections = {
            "/empty": writer.add_connection(
                "/empty", "std_msgs/msg/Float64", typestore=STORE
            )
        }
        for time, name, message in sorted(messages, key=lambda entry: entry[0]):
            kind = message.__msgtype__
            if name not in connections:
                connections[name] = writer.add_connection(name, kind, typestore=STORE)
            logged = round((START + time + 0.03 + behind) * 1e9)
            writer.write(
                connections[name],
                logged,
                bytes(STORE.serialize_cdr(message, kind)) + surplus,
            )
    return folder
