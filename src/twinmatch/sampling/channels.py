"""Channels: numbers in the messages of foreign topics.

A channel is a topic and the path to a number in its messages: `data`, `temperature`, `readings[2].value`.
Where messages name the elements of their lists, as JointState names its joints, a path may choose one by its
name: `position[elbow]`. A function from a type's name to its fields describes the types, so that messages of
ROS and of a bag are handled alike.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache, reduce
from typing import Any, Final, NamedTuple, cast

from twinmatch.errors import TwinmatchError
from twinmatch.settings import Rule
from twinmatch.units import measure

NUMBERS: Final = frozenset(
    {
        "bool",
        "boolean",
        "byte",
        "char",
        "octet",
        "float",
        "float32",
        "float64",
        "double",
        "long double",
    }
    | {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
)
TEXTS: Final = frozenset({"string", "wstring"})
_TIMES: Final = ("Header", "Time", "Duration")
_LABEL: Final = r"[A-Za-z_/][^\[\]]*"
_STEP: Final = re.compile(
    rf"\.?(?P<name>[A-Za-z]\w*)|\[(?P<index>\d+)\]|\[(?P<label>{_LABEL})\]"
)
_NAMES: Final = ("name", "names", "joint_names", "interface_names")
"""Fields whose texts name the elements of the lists beside them."""


class FieldListing(Rule):
    """Which fields of a message a list shows; errors and `--list` show one."""

    depth: int = 4
    """Of nested messages."""
    in_errors: int = 30
    """Most fields in an error."""


_LISTING: Final = FieldListing()


class SamplingError(TwinmatchError):
    """A field is missing, or the settings allow no sampling."""


class UnreadableError(SamplingError):
    """A message has something else where the number should be: the value before it has ended."""


class Label(str):
    """The name of an element of a list."""

    __slots__ = ()


class Field(NamedTuple):
    """Type of one field of a message."""

    kind: str
    """A number's or text's type, or the name of another message."""
    array: bool = False
    length: int | None = None
    """Length of a fixed-length array."""


FieldsOf = Callable[[str], Mapping[str, Field]]
"""The fields of a message type by name, in their order."""


class Channel(NamedTuple):
    """A number in a topic's messages."""

    topic: str
    path: str
    """Empty: the only number in the messages."""

    @property
    def text(self) -> str:
        """The channel as written in a map."""
        return f"{self.topic}:{self.path}" if self.path else self.topic


def parse_channel(text: str) -> Channel:
    """A channel from `/camera/temperature:temperature` or `/cmd`.

    Raises:
        SamplingError: the topic is missing, or the rest is not a field path.
    """
    topic, colon, path = (part.strip() for part in text.strip().partition(":"))
    if not re.fullmatch(r"/?\w+(/\w+)*", topic):
        msg = f"{text.strip()!r} names no topic; write TOPIC:FIELD, such as /camera/temperature:temperature"
        raise SamplingError(msg)
    if colon and not path:
        raise SamplingError(
            f"{text.strip()!r} names no field; write TOPIC:FIELD, or the topic alone"
        )
    if path:
        steps(path)
    return Channel(topic, path)


@lru_cache(maxsize=1024)
def steps(path: str) -> tuple[str | int, ...]:
    """The names of fields, indices and labels of a path.

    Raises:
        SamplingError: it is not a field path.
    """
    path_steps: list[str | int] = []
    position = 0
    while position < len(path):
        match = _STEP.match(path, position)
        if match is None or (not path_steps and path[0] in ".["):
            form = (
                "write names and indices, such as readings[2].value or position[elbow]"
            )
            raise SamplingError(f"{path!r} is not a field path; {form}")
        name, index, label = match.groups()
        path_steps.append(name or (Label(label.strip()) if label else int(index)))
        position = match.end()
    return tuple(path_steps)


def check_path(kind: str, path: str, fields_of: FieldsOf) -> str:
    """The checked path to a number in messages of a type; an empty path stands for their only number.

    Raises:
        SamplingError: there is no such field, it is not a number, or the path is empty and there are several
            numbers. The error lists the numbers.
    """
    if not path:
        return _only(kind, fields_of)
    place = _PlaceInMessage(kind, fields_of)
    for step in steps(path):
        if isinstance(step, int | Label):
            place.enter_element(step)
        else:
            place.enter_field(step)
    place.require_number()
    return path


class _PlaceInMessage:
    """A place in messages of a type, to which a path leads step by step."""

    def __init__(self, kind: str, fields_of: FieldsOf) -> None:
        """Begin at the whole message."""
        self._kind = kind
        self._fields_of = fields_of
        self._field = Field(kind)
        self._path = ""
        self._has_names = False
        """Whether a list of texts that may be names stands at the place, or beside the way to it."""

    def enter_element(self, step: int | Label) -> None:
        """Enter an element of a list.

        Raises:
            SamplingError: there is none.
        """
        field = self._field
        if not field.array:
            raise SamplingError(
                f"{self._kind}: {self._path} is not a list; leave out [{step}]"
            )
        if isinstance(step, Label) and not self._has_names:
            raise SamplingError(
                f"{self._kind}: the elements of {self._path} have no names; choose one by number, such as "
                f"{self._path}[0]"
            )
        if isinstance(step, int) and field.length is not None and step >= field.length:
            raise SamplingError(
                f"{self._kind}: {self._path} has {field.length} values, counted from 0"
            )
        self._field = Field(field.kind)
        self._path = f"{self._path}[{step}]"

    def enter_field(self, name: str) -> None:
        """Enter a field.

        Raises:
            SamplingError: there is none.
        """
        if self._field.array:
            raise SamplingError(
                f"{self._kind}: {self._path} is a list; choose an element, such as {self._path}[0].{name}"
            )
        has_fields = self._field.kind not in NUMBERS | TEXTS
        fields = self._fields_of(self._field.kind) if has_fields else {}
        if name not in fields:
            where = (
                f"{self._kind}: {self._path} has" if self._path else f"{self._kind} has"
            )
            raise SamplingError(
                f"{where} no field {name!r}; its numbers: {self._numbers}"
            )
        self._has_names = self._has_names or _has_list_of_names(fields)
        self._field = fields[name]
        self._path = f"{self._path}.{name}" if self._path else name

    def require_number(self) -> None:
        """Check that a number is there.

        Raises:
            SamplingError: it is a list, a text or another message.
        """
        field = self._field
        if field.array:
            raise SamplingError(
                f"{self._kind}: {self._path} is a list; choose an element, such as {self._path}[0]"
            )
        if field.kind in TEXTS:
            raise SamplingError(
                f"{self._kind}: {self._path} is text; choose a number: {self._numbers}"
            )
        if field.kind not in NUMBERS:
            below = fields_below(field.kind, self._fields_of)
            paths = [f"{self._path}.{name}" for name in below]
            instead = ", ".join(paths[: _LISTING.in_errors]) or self._numbers
            raise SamplingError(
                f"{self._kind}: {self._path} is a message; choose a number in it: {instead}"
            )

    @property
    def _numbers(self) -> str:
        """The numbers in the whole message, for an error."""
        return _field_list(self._kind, self._fields_of)


def _has_list_of_names(fields: Mapping[str, Field]) -> bool:
    """Whether some of these fields are texts that may name the elements of a list beside them."""
    candidates = [fields[name] for name in _NAMES if name in fields]
    return any(field.array and field.kind in TEXTS for field in candidates)


def fields_below(
    kind: str, fields_of: FieldsOf, deep: int = _LISTING.depth
) -> Iterator[str]:
    """Paths of the numbers in messages of a type, without those of headers and times."""
    for name, field in fields_of(kind).items():
        mark = "[0]" if field.array else ""
        if field.kind in NUMBERS:
            yield f"{name}{mark}"
        elif (
            field.kind not in TEXTS
            and deep > 1
            and field.kind.rsplit("/", 1)[-1] not in _TIMES
        ):
            for below in fields_below(field.kind, fields_of, deep - 1):
                yield f"{name}{mark}.{below}"


def by_name(message: Any, path: str) -> list[str]:
    """A path of `fields_below` as often as a message names elements of its lists; as it is without names."""
    head, mark, tail = path.partition("[0]")
    *above, last = head.split(".")
    if not mark:
        return [path]
    holder = reduce(getattr, above, message)
    names = _names_in(holder)
    elements = getattr(holder, last)
    has_labels = bool(names) and all(re.fullmatch(_LABEL, name) for name in names)
    if not has_labels or len(elements) not in (0, len(names)):
        return [path]
    paths = []
    for name, element in zip(names, elements, strict=False):
        for below in by_name(element, tail[1:]) if tail else [""]:
            paths.append(f"{head}[{name}]{tail[:1]}{below}")
    return paths


class Followed:
    """Follows a channel through the messages of its topic.

    A publisher may change the order of a list's elements, and several may publish on one topic: an element
    chosen by its number has to keep the name that the first message gave it.
    """

    def __init__(self, channel: Channel) -> None:
        """Begin before the first message."""
        self._channel = channel
        self._names: tuple[str, ...] = ()

    def number(self, message: Any) -> float | None:
        """The number in a message; None if it has no element of the name, NaN if a list is too short.

        Raises:
            SamplingError: the value is not a number, or an index means another element than before.
        """
        value, names = _walk(message, self._channel.path)
        before = self._names
        self._names = self._names or names
        if before and names and names != before:
            both = f"{'/'.join(before)} in one message and {'/'.join(names)} in another"
            suggested = (
                f"{self._channel.topic}:{_with_names(self._channel.path, before)}"
            )
            raise SamplingError(
                f"{self._channel.text} is {both}; choose it by name: {suggested}"
            )
        if value is None:
            return (
                None
                if any(isinstance(step, Label) for step in steps(self._channel.path))
                else math.nan
            )
        if isinstance(value, bytes):  # how ROS gives the type `byte`
            return float(value[0])
        try:
            return float(value)
        except (TypeError, ValueError):
            text = f"{self._channel.path} is {str(value)[:40]!r}, which is not a number"
            raise SamplingError(text) from None


def _walk(message: Any, path: str) -> tuple[Any, tuple[str, ...]]:
    """What is at a path, None if a list has no such element, and the names of elements chosen by number."""
    value = message
    names = cast("Sequence[str]", ())
    met = list[str]()
    for step in steps(path):
        if not isinstance(step, int | Label):
            names = _names_in(value) or names
            value = getattr(value, step)
            continue
        if isinstance(step, int):
            chosen = step
        elif step in names:
            chosen = names.index(step)
        else:
            return None, tuple(met)
        if chosen >= len(value):
            return None, tuple(met)
        if isinstance(step, int) and chosen < len(names):
            met.append(names[chosen])
        value = value[chosen]
    return value, tuple(met)


def _with_names(path: str, names: Sequence[str]) -> str:
    """A path with its numbers replaced by these names of elements, as far as there are some."""
    names_left = iter(names)
    text = ""
    for step in steps(path):
        if isinstance(step, int):
            text += f"[{next(names_left, step)}]"
        elif isinstance(step, Label):
            text += f"[{step}]"
        else:
            text += f".{step}"
    return text.lstrip(".")


def _names_in(message: Any) -> Sequence[str]:
    for name in _NAMES:
        names = getattr(message, name, None)
        if isinstance(names, list) and names:
            return names
    return ()


def _only(kind: str, fields_of: FieldsOf) -> str:
    paths = list(fields_below(kind, fields_of))
    single = [path for path in paths if "[" not in path]
    if len(paths) == len(single) == 1:
        return paths[0]
    if not paths:
        raise SamplingError(f"{kind} has no numbers; name another topic")
    raise SamplingError(
        f"{kind} has several numbers; choose one: {_field_list(kind, fields_of)}"
    )


def _field_list(kind: str, fields_of: FieldsOf) -> str:
    paths = [] if kind in NUMBERS | TEXTS else list(fields_below(kind, fields_of))
    most = _LISTING.in_errors
    count_of_further = f" and {len(paths) - most} more" if len(paths) > most else ""
    return ", ".join(paths[:most]) + count_of_further if paths else "none"


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
    "sensor_msgs/msg/Imu": {
        "angular_velocity": "rad/s",
        "linear_acceleration": "m/s^2",
    },
    "sensor_msgs/msg/MagneticField": {"magnetic_field": "T"},
    "sensor_msgs/msg/JointState": {
        "position": "rad or m",
        "velocity": "rad/s or m/s",
        "effort": "N m or N",
    },
    "geometry_msgs/msg/Twist": {"linear": "m/s", "angular": "rad/s"},
    "geometry_msgs/msg/TwistStamped": {"twist.linear": "m/s", "twist.angular": "rad/s"},
}
"""By type and prefix of the path, from the comments in the message definitions."""


def usual_unit(kind: str, path: str, wanted: str | None = None) -> str:
    """The unit of a number according to its message definition; empty if it gives none.

    Of several units, as those of revolving and sliding joints, it is the one that measures the same as the
    unit `wanted`; empty if none does. Without one it is the first.
    """
    units_by_path = _UNITS.get(kind, {})
    stated = next(
        (
            unit
            for begin, unit in units_by_path.items()
            if re.match(rf"{re.escape(begin)}(\.|\[|$)", path)
        ),
        "",
    )
    units = stated.split(" or ")
    if wanted is None or len(units) == 1:
        return units[0]
    asked = measure(wanted)
    if not asked.known or "%" in wanted:
        # to which radians, being plain numbers, could be converted
        return ""
    return next(
        (unit for unit in units if measure(unit).dimension == asked.dimension), ""
    )
