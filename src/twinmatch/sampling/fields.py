"""The number that is meant in a message: `data`, `temperature`, `readings[2].value`.

A type is known by a function from its name to its fields, so that messages of ROS and of a bag are looked
into in the same way.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, NamedTuple

from twinmatch.sampling.errors import SamplingError

__all__ = ["Channel", "Field", "FieldsOf", "check_path", "fields_below", "follow", "parse_channel"]

NUMBERS: Final = frozenset(
    {"bool", "boolean", "byte", "char", "octet", "float", "float32", "float64", "double", "long double"}
    | {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
)
TEXTS: Final = frozenset({"string", "wstring"})
_STEP: Final = re.compile(r"\.?(?P<name>[A-Za-z]\w*)|\[(?P<index>\d+)\]")
_DEEP: Final = 4
"""Messages within messages that are looked into for a list of fields."""
_MANY: Final = 30
"""Fields that an error lists."""


class Field(NamedTuple):
    """What a type says of one of its fields."""

    kind: str
    """A number's or text's type, or the name of another message."""
    array: bool = False
    length: int | None = None
    """Of an array whose length is fixed."""


FieldsOf = Callable[[str], Mapping[str, Field]]
"""The fields of a message type by name, in their order."""


class Channel(NamedTuple):
    """A number of a topic."""

    topic: str
    path: str
    """Empty: the only one that its messages have."""

    @property
    def text(self) -> str:
        """As it is written."""
        return f"{self.topic}:{self.path}" if self.path else self.topic


def parse_channel(text: str) -> Channel:
    """A channel from `/camera/temperature:temperature` or `/cmd`.

    Raises:
        SamplingError: there is no topic, or what follows is no path of fields.
    """
    topic, colon, path = (part.strip() for part in text.strip().partition(":"))
    if not re.fullmatch(r"/?\w+(/\w+)*", topic):
        msg = f"{text.strip()!r} names no topic; write TOPIC:FIELD, such as /camera/temperature:temperature"
        raise SamplingError(msg)
    if colon and not path:
        raise SamplingError(f"{text.strip()!r} names no field; write TOPIC:FIELD, or the topic alone")
    if path:
        steps(path)
    return Channel(topic, path)


def steps(path: str) -> tuple[str | int, ...]:
    """The names and indices of a path.

    Raises:
        SamplingError: it is none.
    """
    found: list[str | int] = []
    at = 0
    while at < len(path):
        match = _STEP.match(path, at)
        if match is None or (not found and path[0] in ".["):
            msg = f"{path!r} is no path of fields; write names and indices, such as readings[2].value"
            raise SamplingError(msg)
        found.append(match["name"] if match["name"] else int(match["index"]))
        at = match.end()
    return tuple(found)


def check_path(kind: str, path: str, fields_of: FieldsOf) -> str:
    """The path to a number in messages of a type; an empty one is that to the only number they have.

    Args:
        kind: name of the type.
        path: as it was written.
        fields_of: knows the types.

    Raises:
        SamplingError: there is no such field, it is no number, or there are several and none is named. The
            message says which there are.
    """
    if not path:
        return _only(kind, fields_of)
    field = Field(kind)
    done = ""
    for step in steps(path):
        if isinstance(step, int):
            if not field.array:
                raise SamplingError(f"{kind}: {done} is no list; leave out [{step}]")
            if field.length is not None and step >= field.length:
                raise SamplingError(f"{kind}: {done} has {field.length} values, counted from 0")
            field, done = Field(field.kind), f"{done}[{step}]"
            continue
        if field.array:
            raise SamplingError(f"{kind}: {done} is a list; write which is meant, such as {done}[0].{step}")
        known = {} if field.kind in NUMBERS | TEXTS else fields_of(field.kind)
        if step not in known:
            where = f"{kind}: {done} has" if done else f"{kind} has"
            raise SamplingError(f"{where} no field {step!r}; numbers there are {_listed(kind, fields_of)}")
        field, done = known[step], f"{done}.{step}" if done else step
    if field.array:
        raise SamplingError(f"{kind}: {done} is a list; write which is meant, such as {done}[0]")
    if field.kind in TEXTS:
        raise SamplingError(f"{kind}: {done} is a text; numbers there are {_listed(kind, fields_of)}")
    if field.kind not in NUMBERS:
        whole = [f"{done}.{below}" for below in fields_below(field.kind, fields_of)]
        instead = ", ".join(whole[:_MANY]) if whole else _listed(kind, fields_of)
        raise SamplingError(f"{kind}: {done} is a message; name a number: {instead}")
    return path


def fields_below(kind: str, fields_of: FieldsOf, deep: int = _DEEP) -> Iterator[str]:
    """Paths of the numbers in messages of a type, those of headers and times left out."""
    for name, field in fields_of(kind).items():
        mark = "[0]" if field.array else ""
        if field.kind in NUMBERS:
            yield f"{name}{mark}"
        elif field.kind not in TEXTS and deep > 1 and not _is_time(field.kind):
            for below in fields_below(field.kind, fields_of, deep - 1):
                yield f"{name}{mark}.{below}"


def follow(message: Any, path: str) -> float:
    """The number at a path in a message; nan if a list is too short for it.

    Raises:
        SamplingError: what is there is no number.
    """
    found = message
    for step in steps(path):
        if isinstance(step, int):
            if step >= len(found):
                return float("nan")
            found = found[step]
        else:
            found = getattr(found, step)
    if isinstance(found, bytes):  # how ROS gives the type `byte`
        return float(found[0])
    try:
        return float(found)
    except (TypeError, ValueError):
        raise SamplingError(f"{path} is {str(found)[:40]!r}, which is no number") from None


def _only(kind: str, fields_of: FieldsOf) -> str:
    found = list(fields_below(kind, fields_of))
    single = [path for path in found if "[" not in path]
    if len(found) == len(single) == 1:
        return found[0]
    if not found:
        raise SamplingError(f"{kind} has no numbers; name another topic")
    raise SamplingError(f"{kind} has several numbers; write which: {_listed(kind, fields_of)}")


def _listed(kind: str, fields_of: FieldsOf) -> str:
    found = [] if kind in NUMBERS | TEXTS else list(fields_below(kind, fields_of))
    more = f" and {len(found) - _MANY} more" if len(found) > _MANY else ""
    return ", ".join(found[:_MANY]) + more if found else "none"


def _is_time(kind: str) -> bool:
    return kind.rsplit("/", 1)[-1] in ("Header", "Time", "Duration")
