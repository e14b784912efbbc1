"""Units of the numbers in common message types."""

from __future__ import annotations

import re
from typing import Final

__all__ = ["usual_unit"]

_UNITS: Final = {
    "sensor_msgs/msg/Temperature": {"temperature": "degC"},
    "sensor_msgs/msg/FluidPressure": {"fluid_pressure": "Pa"},
    "sensor_msgs/msg/RelativeHumidity": {"relative_humidity": "1"},
    "sensor_msgs/msg/Illuminance": {"illuminance": "lx"},
    "sensor_msgs/msg/Range": {"range": "m"},
    "sensor_msgs/msg/BatteryState": {
        "voltage": "V",
        "temperature": "degC",
        "current": "A",
        "percentage": "1",
    },
    "sensor_msgs/msg/Imu": {"angular_velocity": "rad/s", "linear_acceleration": "m/s^2"},
    "sensor_msgs/msg/MagneticField": {"magnetic_field": "T"},
    "geometry_msgs/msg/Twist": {"linear": "m/s", "angular": "rad/s"},
    "geometry_msgs/msg/TwistStamped": {"twist.linear": "m/s", "twist.angular": "rad/s"},
}
"""By type and prefix of the path, from the comments in the message definitions."""


def usual_unit(kind: str, path: str) -> str:
    """The unit of a number according to its message definition; empty if it gives none."""
    known = _UNITS.get(kind, {})
    return next(
        (unit for begin, unit in known.items() if re.match(rf"{re.escape(begin)}(\.|\[|$)", path)), ""
    )
