"""Definitions of the messages in sessions, so that no ROS installation is needed.

The texts are those of the installed `.msg` files, including comments, because readers show them; the
hashes are the RIHS01 type hashes that ROS 2 computes from the fields. Tests compare both with an
installed ROS 2, and the hashes with an independent implementation.
Header, Time, Temperature and Float64 are definitions of the ROS 2 common interfaces (Apache-2.0).
"""

from __future__ import annotations

from typing import NamedTuple

__all__ = [
    "FLOAT64",
    "HEADER",
    "LOOP_SAMPLE",
    "SCALAR_SAMPLE",
    "TEMPERATURE",
    "TIME",
    "MessageType",
    "fields_of",
]


class MessageType(NamedTuple):
    """A ROS message type as a session file describes it."""

    name: str
    """Full name, `package/msg/Type`."""
    text: str
    """Text of the `.msg` file."""
    type_hash: str
    """RIHS01 hash of the fields."""
    parts: tuple[MessageType, ...] = ()
    """Types of the nested fields, in breadth-first order."""

    @property
    def schema(self) -> str:
        """The `ros2msg` schema: this text, then those of the nested types, each after its name."""
        blocks = [self.text]
        for part in self.parts:
            package, _, name = part.name.split("/")
            blocks.append(f"{'=' * 80}\nMSG: {package}/{name}\n{part.text}")
        return "\n".join(blocks)


def fields_of(schema: str) -> list[str]:
    """The field lines of a schema's first type, without comments and extra spaces."""
    own = schema.split("=" * 80, maxsplit=1)[0]
    lines = (" ".join(line.split("#", 1)[0].split()) for line in own.splitlines())
    return [line for line in lines if line]


TIME = MessageType(
    "builtin_interfaces/msg/Time",
    """\
# This message communicates ROS Time defined here:
# https://design.ros2.org/articles/clock_and_time.html

# The seconds component, valid over all int32 values.
int32 sec

# The nanoseconds component, valid in the range [0, 1e9).
uint32 nanosec
""",
    "RIHS01_b106235e25a4c5ed35098aa0a61a3ee9c9b18d197f398b0e4206cea9acf9c197",
)

HEADER = MessageType(
    "std_msgs/msg/Header",
    """\
# Standard metadata for higher-level stamped data types.
# This is generally used to communicate timestamped data
# in a particular coordinate frame.

# Two-integer timestamp that is expressed as seconds and nanoseconds.
builtin_interfaces/Time stamp

# Transform frame with which this data is associated.
string frame_id
""",
    "RIHS01_f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01",
    (TIME,),
)

LOOP_SAMPLE = MessageType(
    "twinmatch_msgs/msg/LoopSample",
    """\
# One tick of the control loop: at tick k references, outputs and disturbances are read and the inputs are
# computed from them; the inputs then drive the plant until tick k+1. plant/description has names and units.

std_msgs/Header header   # stamp: when the outputs were read
uint64 index             # ticks since the session started, without gaps
float64[] reference      # set-points r, in the units of the outputs
float64[] output         # measured outputs y
float64[] input          # commands u of this tick
float64[] disturbances   # measured disturbances; the Peltier rig has none
""",
    "RIHS01_29aed8c2ef7b66a60fb7166b3918f2b3b9606a5b297e5fd222d2c049b2df8cb0",
    (HEADER, TIME),
)

SCALAR_SAMPLE = (
    "std_msgs/Header header",
    "uint64 index",
    "float64 reference",
    "float64 temperature",
    "float64 pwm",
)
"""Fields of the first definition of LoopSample; sessions recorded with it are converted when read."""

TEMPERATURE = MessageType(
    "sensor_msgs/msg/Temperature",
    """\
# Single temperature reading.

std_msgs/Header header # timestamp is the time the temperature was measured
                             # frame_id is the location of the temperature reading

float64 temperature          # Measurement of the Temperature in Degrees Celsius.

float64 variance             # 0 is interpreted as variance unknown.
""",
    "RIHS01_72514a14126ab9f8a9abec974c78e5610a367b59db5da355ff1fb982d5bad4b8",
    (HEADER, TIME),
)

FLOAT64 = MessageType(
    "std_msgs/msg/Float64",
    """\
# This was originally provided as an example message.
# It is deprecated as of Foxy
# It is recommended to create your own semantically meaningful message.
# However if you would like to continue using this please use the equivalent in example_msgs.

float64 data
""",
    "RIHS01_705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a",
)
