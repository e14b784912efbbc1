"""Definitions of message types, as schemas of a session's topics: of ours, and of any installed type.

Ours are here, so that no ROS installation is needed. The texts are those of the installed `.msg` files,
including comments, because readers show them; the hashes are the RIHS01 type hashes that ROS 2 computes from
the fields. Tests compare both with an installed ROS 2, and the hashes with an independent implementation.
Header, Time, Temperature and Float64 are definitions of the ROS 2 common interfaces (Apache-2.0).
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from twinmatch.sessions.files import SessionError

_PRIMITIVE = {"bool", "byte", "char", "string", "wstring", "float32", "float64"} | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}


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
        return _joined(self.text, ((part.name, part.text) for part in self.parts))


def _joined(text: str, parts: Iterable[tuple[str, str]]) -> str:
    """A schema: the text of a type, then the names and texts of its nested types."""
    blocks = [text]
    for name, nested in parts:
        package, _, short = name.split("/")
        blocks.append(f"{'=' * 80}\nMSG: {package}/{short}\n{nested}")
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


def schema_of(kind: str, environment: Mapping[str, str] = os.environ) -> str:
    """The `ros2msg` schema of an installed type: its definition, then those of its nested types.

    Args:
        kind: full name, `package/msg/Type`.
        environment: its AMENT_PREFIX_PATH lists where packages are; Python's prefix is searched last.

    Raises:
        SessionError: the type or a nested one is not installed, or `kind` is not such a name.
    """
    texts = {kind: _text(kind, environment)}
    todo = [kind]
    while todo:
        owner = todo.pop(0)
        for part in _parts(owner, texts[owner]):
            if part not in texts:
                texts[part] = _text(part, environment)
                todo.append(part)
    return _joined(texts.pop(kind), texts.items())


def _text(kind: str, environment: Mapping[str, str]) -> str:
    match = re.fullmatch(r"(\w+)/msg/(\w+)", kind)
    if match is None:
        raise SessionError(f"session: {kind!r} is not a message type; give package/msg/Type")
    package, name = match.groups()
    prefixes = [*filter(None, environment.get("AMENT_PREFIX_PATH", "").split(":")), sys.prefix]
    for prefix in prefixes:
        path = Path(prefix) / "share" / package / "msg" / f"{name}.msg"
        if path.is_file():
            return path.read_text("utf-8")
    raise SessionError(f"session: the definition of {kind} is not installed; looked in {', '.join(prefixes)}")


def _parts(owner: str, text: str) -> Iterator[str]:
    """Full names of the types of the nested fields."""
    for line in text.splitlines():
        field = line.split("#", 1)[0].strip()
        if not field or re.match(r"\S+\s+\w+\s*=", field):  # empty, or a constant
            continue
        kind = re.split(r"[\[<\s]", field)[0]
        if kind in _PRIMITIVE:
            continue
        package, *_, name = kind.split("/") if "/" in kind else (owner.split("/", 1)[0], kind)
        yield f"{package}/msg/{name}"
