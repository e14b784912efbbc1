"""Somebody else's rig: an oven under PI control that uses rclpy and standard messages, and nothing from here.

    python foreign_rig.py [--period 0.05] [--hold 240] [--stamped] [--kelvin] [--no-set-point]

It says each tick it took as a line of JSON: set-point, reading, command.
"""

import argparse
import json
import random
import time

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Temperature
from std_msgs.msg import Float64

GAIN = 0.5  # W/%
LOSS = 1.0  # W/K
CAPACITY = 4.0  # J/K
ROOM = 20.0  # °C
PROPORTIONAL = 4.0  # %/K
INTEGRAL = 2.0  # %/(K s)
LEVELS = (30.0, 40.0)  # °C, by turns
TOPICS = ("/oven/set_point", "/oven/temperature", "/oven/heater")


class Oven:
    """The oven and its controller, one tick after the other."""

    def __init__(self, period: float, hold: int) -> None:
        self._period = period
        self._hold = hold
        self._noise = random.Random(7)
        self._oven = ROOM
        self._integral = 0.0
        self._tick = 0

    def step(self) -> tuple[float, float, float]:
        """Set-point and reading, °C, and command, %; then the oven moves on to the next tick."""
        wanted = LEVELS[self._tick // self._hold % 2]
        reading = self._oven + self._noise.gauss(0.0, 0.02)
        heater = min(
            max(PROPORTIONAL * (wanted - reading) + self._integral, 0.0), 100.0
        )
        self._integral += INTEGRAL * self._period * (wanted - reading)
        for _ in range(10):
            rate = (GAIN * heater - LOSS * (self._oven - ROOM)) / CAPACITY
            self._oven += 0.1 * self._period * rate
        self._tick += 1
        return wanted, reading, heater


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--period", type=float, default=0.05)
    parser.add_argument(
        "--hold", type=int, default=240, help="ticks from one set-point to the next"
    )
    parser.add_argument(
        "--stamped", action="store_true", help="sensor_msgs/Temperature, best effort"
    )
    parser.add_argument("--kelvin", action="store_true")
    parser.add_argument("--no-set-point", action="store_true")
    parser.add_argument(
        "--topics", nargs=3, default=TOPICS, help="of set-point, reading and command"
    )
    parser.add_argument(
        "--behind",
        type=float,
        default=0.0,
        help="s that the clock of the stamps is behind",
    )
    options = parser.parse_args()
    rclpy.init()
    node = rclpy.create_node("oven_rig")
    kind = Temperature if options.stamped else Float64
    sensor = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    set_point, temperature, command = options.topics
    readings = node.create_publisher(
        kind, temperature, sensor if options.stamped else 10
    )
    commands = node.create_publisher(Float64, command, 10)
    set_points = node.create_publisher(Float64, set_point, 10)
    oven = Oven(options.period, options.hold)
    due = time.monotonic()
    try:
        while rclpy.ok():
            wanted, reading, heater = oven.step()
            reading += 273.15 * options.kelvin
            message = kind()
            if options.stamped:
                message.temperature = reading
                message.header.stamp = node.get_clock().now().to_msg()
                message.header.stamp.sec -= round(options.behind)
            else:
                message.data = reading
            readings.publish(message)
            if not options.no_set_point:
                set_points.publish(Float64(data=wanted))
            commands.publish(Float64(data=heater))
            print(json.dumps([wanted, reading, heater]), flush=True)
            due = max(due + options.period, time.monotonic() - options.period)
            time.sleep(max(due - time.monotonic(), 0.0))
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == "__main__":
    main()
