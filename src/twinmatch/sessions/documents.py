"""Bounded reading of YAML and JSON from outside; no other module reads either.

A few hundred bytes of YAML can expand to gigabytes (aliases of aliases), nest deeper than Python's recursion
limit, contain numbers that fit neither a float nor a message, or construct objects. A document is therefore
limited in bytes, depth, number of values after expansion of aliases, and size of numbers, and may contain
only lists, mappings and plain scalars. This module builds the values from the events of the parser (libyaml
if available) and counts each value before creating it.
"""

from __future__ import annotations

import json
import math
import reprlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from twinmatch.errors import TwinmatchError
from twinmatch.sessions.files import read_bounded

MAX_BYTES = 1 << 20
"""Longest document: a thousand candidates, or the metadata of a session of a thousand files."""
MAX_VALUES = 20_000
"""Most lists, mappings and scalars, with aliases expanded."""
MAX_DEPTH = 32
MAX_TEXT = 10_000
"""Longest text among the values, characters."""
MAX_DIGITS = 400
"""Longest text of a number; the smallest float in decimals has 325 places before its digits."""
WHOLE = 2**63
"""Limit of whole numbers, as in messages and parameters of ROS."""

_PREFIX = "tag:yaml.org,2002:"
_KINDS = {f"{_PREFIX}{kind}" for kind in ("null", "bool", "int", "float", "str")}


class DocumentError(TwinmatchError):
    """A YAML or JSON text cannot be used; the message names the file and the line in it."""


def read_yaml(path: Path) -> Any:
    """Read a YAML file: lists, mappings with text keys, and scalars.

    Raises:
        DocumentError: the file cannot be read, is not YAML, or exceeds a limit.
    """
    return parse_yaml(read_text(path), str(path))


def read_text(path: Path) -> str:
    """Read a UTF-8 text file of at most `MAX_BYTES`.

    Raises:
        DocumentError: the file cannot be read, is too long, or is not UTF-8 text.
    """
    try:
        return read_bounded(path, MAX_BYTES).decode("utf-8-sig")
    except OSError as error:
        raise DocumentError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise DocumentError(f"{path}: is not UTF-8 text (byte {error.start})") from None


def parse_yaml(text: str, place: str) -> Any:
    """Parse a YAML text; keys stay text as written. Error messages start with `place`.

    Raises:
        DocumentError: the text is not YAML, or exceeds a limit.
    """
    import yaml  # noqa: PLC0415 - reading a session's samples needs no YAML

    if len(text) > MAX_BYTES:
        raise DocumentError(f"{place}: has more than {MAX_BYTES} characters")
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        return _Builder(yaml, place).built(yaml.parse(text, Loader=loader))
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f" in line {mark.line + 1}"
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise DocumentError(f"{place}: is not valid YAML{where}: {problem}") from None


def parse_json(text: str, place: str) -> Any:
    """Parse a JSON text. Error messages start with `place`.

    Raises:
        DocumentError: the text is not JSON, or exceeds a limit.
    """
    try:
        return json.loads(text, parse_int=lambda digits: _whole(digits, place))
    except RecursionError:
        raise DocumentError(f"{place}: is nested too deeply") from None
    except json.JSONDecodeError as error:
        raise DocumentError(f"{place}: is not valid JSON: {error}") from None


def shown(value: object) -> str:
    """A value for one line of a message, shortened."""
    return reprlib.repr(value)


class _Builder:
    """Builds values from the events of a parser, counting them."""

    def __init__(self, yaml: Any, place: str) -> None:
        self._yaml = yaml
        self._place = place
        self._resolver = yaml.resolver.Resolver()
        self._constructor = yaml.constructor.SafeConstructor()
        self._depth = 0
        self._values = 0
        self._anchored: dict[str, tuple[Any, int]] = {}

    def built(self, events: Iterator[Any]) -> Any:
        """The only document of a stream; None for an empty stream."""
        documents: list[Any] = []
        for event in events:
            if isinstance(event, self._yaml.DocumentStartEvent):
                if documents:
                    raise self._error(event, "a second document begins; give only one")
                documents.append(self._value(next(events), events))
        return documents[0] if documents else None

    def _value(self, event: Any, events: Iterator[Any]) -> Any:
        if isinstance(event, self._yaml.AliasEvent):
            return self._alias(event)
        before = self._values
        self._count(event, 1)
        if isinstance(event, self._yaml.ScalarEvent):
            value = self._scalar(event)
        else:
            self._depth += 1
            if self._depth > MAX_DEPTH:
                raise self._error(event, f"is nested deeper than {MAX_DEPTH} levels")
            if event.tag not in (None, f"{_PREFIX}seq", f"{_PREFIX}map"):
                raise self._error(event, f"has a {event.tag[:60]}, which is not supported")
            a_list = isinstance(event, self._yaml.SequenceStartEvent)
            value = self._list(events) if a_list else self._mapping(events)
            self._depth -= 1
        if event.anchor is not None:
            self._anchored[event.anchor] = value, self._values - before
        return value

    def _list(self, events: Iterator[Any]) -> list[Any]:
        items = []
        while not isinstance(event := next(events), self._yaml.SequenceEndEvent):
            items.append(self._value(event, events))
        return items

    def _mapping(self, events: Iterator[Any]) -> dict[str, Any]:
        values: dict[str, Any] = {}
        merged: dict[str, Any] = {}
        while not isinstance(event := next(events), self._yaml.MappingEndEvent):
            if not isinstance(event, self._yaml.ScalarEvent):
                raise self._error(event, "has a key that is not text")
            self._count(event, 1)
            name, value = event.value[:MAX_TEXT], self._value(next(events), events)
            if name == "<<" and event.implicit[0]:
                merged |= self._merged(event, value)
            elif name in values:
                raise self._error(event, f"gives {shown(name)} twice")
            else:
                values[name] = value
        return {**merged, **values}

    def _merged(self, event: Any, value: Any) -> dict[str, Any]:
        """The entries merged by `<<: *name`; of several mappings the first has priority."""
        given = value if isinstance(value, list) else [value]
        if not all(isinstance(one, dict) for one in given):
            raise self._error(event, "merges a value that is not a mapping")
        return {name: one[name] for one in reversed(given) for name in one}

    def _alias(self, event: Any) -> Any:
        if event.anchor not in self._anchored:
            raise self._error(event, f"*{event.anchor[:40]} has no complete anchor before it")
        value, size = self._anchored[event.anchor]
        self._count(event, size)
        return value

    def _scalar(self, event: Any) -> Any:
        text: str = event.value
        if len(text) > MAX_TEXT:
            raise self._error(event, f"has a text of more than {MAX_TEXT} characters")
        tag = event.tag
        if tag in (None, "!"):
            tag = self._resolver.resolve(self._yaml.ScalarNode, text, event.implicit)
            if tag not in _KINDS:  # dates stay text
                tag = f"{_PREFIX}str"
        if tag not in _KINDS:
            raise self._error(event, f"has a {tag[:60]}, which is not supported")
        kind = tag.removeprefix(_PREFIX)
        if kind == "str":
            return text
        if len(text) > MAX_DIGITS:
            raise self._error(event, f"{text[:20]}… is too long for a number; write it with an exponent")
        try:
            value = getattr(self._constructor, f"construct_yaml_{kind}")(self._yaml.ScalarNode(tag, text))
        except (ValueError, LookupError, OverflowError):
            raise self._error(event, f"{shown(text)} is not a valid {kind}") from None
        return self._checked(event, value, text)

    def _checked(self, event: Any, value: Any, text: str) -> Any:
        if isinstance(value, float) and math.isnan(value):
            raise self._error(event, f"{text} is not a number")
        if isinstance(value, float) and math.isinf(value) and "inf" not in text.lower():
            raise self._error(event, f"{shown(text)} is too large for a number")
        if type(value) is int and abs(value) >= WHOLE:
            raise self._error(
                event, f"{shown(text)} is too large for a whole number; write it with an exponent"
            )
        return value

    def _count(self, event: Any, values: int) -> None:
        self._values += values
        if self._values > MAX_VALUES:
            raise self._error(event, f"the document has more than {MAX_VALUES} values")

    def _error(self, event: Any, problem: str) -> DocumentError:
        return DocumentError(f"{self._place}: line {event.start_mark.line + 1}: {problem}")


def _whole(digits: str, place: str) -> int:
    value = int(digits) if len(digits) < MAX_DIGITS else WHOLE
    if abs(value) >= WHOLE:
        raise DocumentError(f"{place}: {shown(digits)} is too large for a whole number")
    return value
