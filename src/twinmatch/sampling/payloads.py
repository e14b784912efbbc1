"""Numbers in payloads of MQTT: plain ones, words such as ON, and those at a path in JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from datetime import datetime
from typing import Any, Final

from twinmatch.sampling.channels import Channel, SamplingError, UnreadableError
from twinmatch.sampling.document_paths import (
    Absent,
    found_at,
    is_path,
    is_strict,
    leaves,
    quoted,
    steps_of,
)
from twinmatch.sampling.quoted import split_unquoted, unquoted_places
from twinmatch.settings import Rule
from twinmatch.signals import NANOSECONDS

SPARKPLUG: Final = (
    "a payload of Sparkplug B, which is binary and not read here; have the device or its gateway publish "
    "JSON too"
)
_WILDCARDS: Final = ("#", "+")
_ENDS_LIKE_TOPIC: Final = re.compile(r"(?:[0-9a-f]{2}:){5}[0-9a-f]{2}$", re.IGNORECASE)
"""A hardware address at the end of a place belongs to its topic."""
_LONGEST_TOPIC: Final = 65535
_FIRST_PRINTED: Final = ord(" ")
_MILLISECONDS: Final = 1e11
"""Epochs above are milliseconds: as seconds they would be in the year 5138."""


class PayloadLimits(Rule):
    """How much of a payload is looked at: it may come from anybody who reaches the broker."""

    size: int = 1_000_000
    """Longest payload that is read, bytes."""
    depth: int = 8
    """To which numbers are looked for."""
    listed: int = 30
    """Most numbers that an error lists."""


_LIMITS: Final = PayloadLimits()


def parse_place(text: str) -> Channel:
    """A channel from `home/room/temperature`, `zigbee2mqtt/Living room:temperature` or `"a:b":temperature`.

    Topics and keys may have colons themselves. The path begins behind the last colon behind which there can
    be one; a topic in quotation marks is never cut.

    Raises:
        SamplingError: the topic is missing or a filter, or the rest is not a path.
    """
    text = text.strip()
    topic, path = _topic_and_path(text)
    if any(sign in topic for sign in _WILDCARDS):
        raise SamplingError(
            f"{text!r} is a filter for many topics, and a signal comes from one; write TOPIC or TOPIC:KEY, "
            "such as room/t:value; --list shows the topics of a filter"
        )
    if not topic or not _may_be_sent(topic):
        raise SamplingError(
            f"{text!r} names no topic; write TOPIC or TOPIC:KEY, such as room/t:value"
        )
    if is_sparkplug(topic):
        raise SamplingError(f"{topic}: {SPARKPLUG}")
    steps_of(path)
    return Channel(topic, path)


def place_text(channel: Channel) -> str:
    """A channel as it can be pasted into a map: in the plain form if that means the same."""
    plain = channel.text
    try:
        is_same = split_unquoted(plain, ",") == split_unquoted(plain, ";") == [plain]
        if plain.isprintable() and is_same and parse_place(plain) == channel:
            return plain
    except SamplingError:
        pass
    colon = ":" if channel.path else ""
    return f"{quoted(channel.topic)}{colon}{channel.path}"


def is_sparkplug(topic: str) -> bool:
    """Whether a topic is one of Sparkplug B, whose payloads are binary."""
    return topic.startswith("spBv1.0/")


def _topic_and_path(text: str) -> tuple[str, str]:
    """Topic and path of a place; an empty path without one."""
    colons = unquoted_places(text, ":")
    if text.startswith('"'):
        end = colons[0] if colons else len(text)
        return _unquoted(text[:end].strip()), text[end + 1 :].strip()
    if not colons or _ENDS_LIKE_TOPIC.search(text):
        return text, ""
    behind = {colon: text[colon + 1 :].strip() for colon in colons}
    strict = [colon for colon in colons if behind[colon] and is_strict(behind[colon])]
    lenient = [colon for colon in colons if behind[colon] and is_path(behind[colon])]
    if strict or lenient:
        colon = strict[-1] if strict else lenient[0]
        return text[:colon].strip(), behind[colon]
    last = behind[colons[-1]]
    if "/" in last or last.isdigit():
        return text, ""
    return text[: colons[-1]].strip(), last


def _unquoted(text: str) -> str:
    """The text of a quotation.

    Raises:
        SamplingError: it is not one.
    """
    try:
        return str(json.loads(text))
    except ValueError:
        raise SamplingError(
            f"{text[:40]!r} is not a topic in quotation marks"
        ) from None


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
        raise SamplingError(
            f"{text[:40]!r} is not a filter of MQTT; write room, room/# or room/+/t"
        )
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
        UnreadableError: it is too long, too deep or too binary to be a reading.
    """
    if len(payload) > _LIMITS.size:
        raise UnreadableError(f"a payload of {len(payload)} bytes is not a reading")
    try:
        return json.loads(payload)
    except RecursionError:
        raise UnreadableError("a payload is nested too deeply") from None
    except ValueError:
        pass
    text = payload.decode("utf-8", "replace").strip()
    if any(ord(letter) < _FIRST_PRINTED and letter not in "\t\r\n" for letter in text):
        raise UnreadableError(
            f"{len(payload)} binary bytes, {payload[:12].hex(' ')} …, are not a reading"
        )
    return text


def value_at(document: Any, path: str) -> float | str | None:
    """The number or text at a path, for an empty one the only number; None: the document has nothing there.

    Raises:
        UnreadableError: there is an object or a list, or the document is text and the path leads into it.
    """
    if path and not isinstance(document, dict | list):
        raise UnreadableError(f"no {path!r}; its numbers: {_listed(document)}")
    try:
        value = found_at(document, path)
    except Absent:
        return None
    if isinstance(value, dict | list):
        paths = [below for below, _ in numbers_in(value)]
        if path or len(paths) != 1:
            raise UnreadableError(
                f"several numbers or none; choose one: {_listed(document)}"
            )
        return value_at(document, paths[0])
    if value is None or isinstance(value, str):
        return value
    try:
        return float(value)
    except OverflowError:
        raise UnreadableError(f"{str(value)[:40]!r} is too large a number") from None


def has_null(document: Any, path: str) -> bool:
    """Whether a document has null at a path."""
    try:
        return found_at(document, path) is None
    except Absent:
        return False


def absence(document: Any, path: str) -> str:
    """Why there is no number at a path at which a document has nothing."""
    return f"no {path!r}; its numbers: {_listed(document)}"


def stamp_at(document: Any, path: str) -> int:
    """The time at a path, ns: seconds or milliseconds since 1970, or ISO 8601, without a zone local time.

    Raises:
        SamplingError: there is none.
    """
    try:
        value = found_at(document, path)
    except Absent:
        value = None
    try:
        if isinstance(value, str):
            return round(
                datetime.fromisoformat(value.replace("Z", "+00:00")).timestamp()
                * NANOSECONDS
            )
        seconds = float(value)
        return round(
            (seconds / 1e3 if seconds > _MILLISECONDS else seconds) * NANOSECONDS
        )
    except (TypeError, ValueError, OverflowError):
        raise SamplingError(f"no time at {path!r}, but {str(value)[:40]!r}") from None


def numbers_in(document: Any) -> Iterator[tuple[str, float]]:
    """Paths and values of the numbers in a document, without its texts."""
    for path, value in leaves(document, _LIMITS.depth):
        if isinstance(value, int | float):
            yield path, float(value)


def texts_in(document: Any) -> Iterator[tuple[str, str]]:
    """Paths and values of the texts in a document."""
    for path, value in leaves(document, _LIMITS.depth):
        if isinstance(value, str):
            yield path, value


def _listed(document: Any) -> str:
    if not isinstance(document, dict | list):
        return f"none, it is {str(document)[:40]!r}"
    paths = [path for path, _ in numbers_in(document)]
    return ", ".join(paths[: _LIMITS.listed]) or "none"
