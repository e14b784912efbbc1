"""A program that publishes whole numbers, ten a second, on `count`; it waits after a standstill."""

from __future__ import annotations

import time

import rclpy
from std_msgs.msg import Int64

from twinmatch.nodes.samples import Standstill
from twinmatch.nodes.topics import RELIABLE


def main() -> None:
    """Count until killed."""
    rclpy.init()
    publisher = rclpy.create_node("counting").create_publisher(Int64, "count", RELIABLE)
    standstill = Standstill()
    standstill.start()
    number = 0
    while True:
        standstill.wait()
        publisher.publish(Int64(data=number))
        number += 1
        time.sleep(0.1)


if __name__ == "__main__":
    main()
