"""Numbers in payloads of MQTT: plain ones, words such as ON, and those at a path in JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final

from twinmatch.sampling.channels import Channel, SamplingError, steps
from twinmatch.signals import NANOSECONDS

_WORDS: Final = {"on": 1.0, "true": 1.0, "open": 1.0, "heating": 1.0} | dict.fromkeys(
    ("off", "false", "closed", "idle"), 0.0
)
_WILDCARDS: Final = ("#", "+")
_LONGEST_TOPIC: Final = 65535
_MILLISECONDS: Final = 1e11
"""Epochs above are milliseconds: as seconds they would be in the year 5138."""


@dataclass(frozen=True)
class PayloadLimits:
    """How much of a payload is looked at: it may come from anybody who reaches the broker."""

    size: int = 1_000_000
    """Longest payload that is read, bytes."""
    depth: int = 8
    """To which numbers are looked for."""
    listed: int = 30
    """Most numbers that an error lists."""


_LIMITS: Final = PayloadLimits()


def parse_place(text: str) -> Channel:
    """A channel from `home/room/temperature` or `zigbee2mqtt/Living room:temperature`.

    Raises:
        SamplingError: the topic is missing or a filter, or the rest is not a path.
    """
    text = text.strip()
    topic, _, path = (part.strip() for part in text.rpartition(":")) if ":" in text else (text, "", "")
    if any(sign in topic for sign in _WILDCARDS):
        raise SamplingError(
            f"{text!r} is a filter for many topics, and a signal comes from one; write TOPIC or TOPIC:KEY, "
            "such as room/t:value; --list shows the topics of a filter"
        )
    if not topic or not _may_be_sent(topic):
        raise SamplingError(f"{text!r} names no topic; write TOPIC or TOPIC:KEY, such as room/t:value")
    _steps(path)
    return Channel(topic, path)


def parse_filter(text: str) -> str:
    """A filter of topics: as it is written, if it has a wildcard; otherwise the topics below `text`.

    Raises:
        SamplingError: MQTT has no such filter.
    """
    has_wildcard = any(sign in text for sign in _WILDCARDS)
    chosen = text if has_wildcard else _all_below(text.rstrip("/"))
    levels = chosen.split("/")
    for number, level in enumerate(levels, 1):
        alone = level in _WILDCARDS or not any(sign in level for sign in _WILDCARDS)
        if not alone or (level == "#" and number < len(levels)):
            raise SamplingError(
                f"{text!r} is not a filter of MQTT: + stands for a whole level between slashes, and # for "
                "all that follow, at the end; write room, room/# or room/+/t"
            )
    if not _may_be_sent(chosen):
        raise SamplingError(f"{text[:40]!r} is not a filter of MQTT; write room, room/# or room/+/t")
    return chosen


def _all_below(topic: str) -> str:
    """The filter of all topics below one; of all topics, if it is empty."""
    return f"{topic}/#" if topic else "#"


def _may_be_sent(topic: str) -> bool:
    """Whether MQTT can send this topic or filter: UTF-8 of at most 65535 bytes, without NUL."""
    try:
        return len(topic.encode()) <= _LONGEST_TOPIC and "\0" not in topic
    except UnicodeEncodeError:
        return False


def document_of(payload: bytes) -> Any:
    """The JSON in a payload; its text where it is not JSON.

    Raises:
        SamplingError: it is too long or too deep to be a reading.
    """
    if len(payload) > _LIMITS.size:
        raise SamplingError(f"a payload of {len(payload)} bytes is not a reading")
    try:
        return json.loads(payload)
    except RecursionError:
        raise SamplingError("a payload is nested too deeply") from None
    except ValueError:
        return payload.decode("utf-8", "replace").strip()


def number_at(document: Any, path: str) -> float:
    """The number at a path; with an empty path, the document itself or its only number.

    Raises:
        SamplingError: there is none; the error lists those there are.
    """
    value = document
    for step in _steps(path):
        try:
            value = value[step if isinstance(value, list) else str(step)]
        except (LookupError, TypeError):
            raise SamplingError(f"no {path!r}; its numbers: {_listed(document)}") from None
    if isinstance(value, dict | list):
        paths = [below for below, _ in numbers_in(value)]
        if path or len(paths) != 1:
            raise SamplingError(f"several numbers or none; choose one: {_listed(document)}")
        return number_at(document, paths[0])
    try:
        return _WORDS[value.lower()] if isinstance(value, str) and value.lower() in _WORDS else float(value)
    except (TypeError, ValueError, OverflowError):
        raise SamplingError(f"{str(value)[:40]!r} is not a number") from None


def stamp_at(document: Any, path: str) -> int:
    """The time at a path, ns: seconds or milliseconds since 1970, or ISO 8601, without a zone local time.

    Raises:
        SamplingError: there is none.
    """
    value = document
    for step in _steps(path):
        value = value.get(step) if isinstance(value, dict) else None
    try:
        if isinstance(value, str):
            return round(datetime.fromisoformat(value.replace("Z", "+00:00")).timestamp() * NANOSECONDS)
        seconds = float(value)
        return round((seconds / 1e3 if seconds > _MILLISECONDS else seconds) * NANOSECONDS)
    except (TypeError, ValueError, OverflowError):
        raise SamplingError(f"no time at {path!r}, but {str(value)[:40]!r}") from None


def numbers_in(document: Any, path: str = "", deep: int = _LIMITS.depth) -> Iterator[tuple[str, float]]:
    """Paths and values of the numbers in a document; words are none."""
    if isinstance(document, dict) and deep:
        for key, below in document.items():
            if key.isprintable():
                name = key if key.isidentifier() else f"[{key}]"
                whole = f"{path}.{name}" if path and name == key else f"{path}{name}"
                yield from numbers_in(below, whole, deep - 1)
    elif isinstance(document, list) and deep:
        for index, below in enumerate(document):
            yield from numbers_in(below, f"{path}[{index}]", deep - 1)
    elif isinstance(document, int | float):
        yield path, float(document)


def _steps(path: str) -> tuple[str | int, ...]:
    """The steps of a path, which may begin with an element of a list, as no path in a message of ROS does."""
    return steps(f"document{path}")[1:] if path.startswith("[") else steps(path)


def _listed(document: Any) -> str:
    if not isinstance(document, dict | list):
        return f"none, it is {str(document)[:40]!r}"
    paths = [path for path, _ in numbers_in(document)]
    return ", ".join(paths[: _LIMITS.listed]) or "none"
