"""Bounded reading of YAML and JSON from outside; no other module reads either.

A few hundred bytes of YAML can expand to gigabytes (aliases of aliases), nest deeper than Python's recursion
limit, contain numbers that fit neither a float nor a message, or construct objects. A document is therefore
limited in bytes, depth, number of values after expansion of aliases, and size of numbers, and may contain
only lists, mappings and plain scalars: PyYAML's safe loader, restricted.
"""

from __future__ import annotations

import json
import math
import re
import reprlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Final

import yaml

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

_PREFIX: Final = "tag:yaml.org,2002:"
_SCALARS: Final = tuple(
    f"{_PREFIX}{kind}" for kind in ("null", "bool", "int", "float", "str")
)
_MERGE: Final = f"{_PREFIX}merge"
_Safe: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_FLOAT: Final = f"{_PREFIX}float"
_WITH_EXPONENT: Final = re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)[eE][-+]?\d+$")
"""A number with an exponent, such as `2e-05`, which is text in YAML 1.1 if it has no point or no sign there."""


class DocumentError(TwinmatchError):
    """A YAML or JSON text cannot be used; the message names the file and the line in it."""


def read_yaml(path: Path) -> Any:
    """Read a YAML file that a person has written: lists, mappings with text keys, and scalars.

    `2e-05` is a number, as in YAML 1.2, JSON and the parameter files of ROS.

    Raises:
        DocumentError: the file cannot be read, is not YAML, or exceeds a limit.
    """
    return _parsed(read_text(path), str(path), _WrittenByHand)


def read_text(path: Path) -> str:
    """Read a UTF-8 text file of at most `MAX_BYTES`.

    Raises:
        DocumentError: the file cannot be read, is too long, or is not UTF-8 text.
    """
    try:
        return read_bounded(path, MAX_BYTES).decode("utf-8-sig")
    except OSError as error:
        raise DocumentError(
            f"{path}: cannot be read: {error.strerror or error}"
        ) from error
    except UnicodeDecodeError as error:
        raise DocumentError(f"{path}: is not UTF-8 text (byte {error.start})") from None


def parse_yaml(text: str, place: str) -> Any:
    """Parse a YAML text; keys stay text as written. Error messages start with `place`.

    `2e-05` is text, as in YAML 1.1: PyYAML writes numbers with a point, and texts that look like this one as they are.

    Raises:
        DocumentError: the text is not YAML, or exceeds a limit.
    """
    return _parsed(text, place, _PlainLoader)


def _parsed(text: str, place: str, loader: type[_PlainLoader]) -> Any:
    if len(text) > MAX_BYTES:
        raise DocumentError(f"{place}: has more than {MAX_BYTES} characters")
    try:
        return loader(text).get_single_data()
    except _RefusedError as error:
        raise DocumentError(f"{place}: {error}") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f" in line {mark.line + 1}"
        parts = getattr(error, "context", None), getattr(error, "problem", None)
        problem = ", ".join(filter(None, parts)) or str(error).splitlines()[0]
        raise DocumentError(f"{place}: is not valid YAML{where}: {problem}") from None
    except RecursionError:  # PyYAML without libyaml
        raise DocumentError(f"{place}: is nested too deeply") from None


def parse_json(text: str, place: str) -> Any:
    """Parse a JSON text. Error messages start with `place`.

    Raises:
        DocumentError: the text is not JSON, or exceeds a limit.
    """
    try:
        return json.loads(
            text,
            parse_int=lambda digits: _whole(digits, place),
            object_pairs_hook=lambda pairs: _without_repetition(pairs, place),
        )
    except RecursionError:
        raise DocumentError(f"{place}: is nested too deeply") from None
    except json.JSONDecodeError as error:
        raise DocumentError(f"{place}: is not valid JSON: {error}") from None


def _without_repetition(pairs: Sequence[tuple[str, Any]], place: str) -> dict[str, Any]:
    """An object in which every key is given once: of two, Python would take the last."""
    document: dict[str, Any] = {}
    for key, value in pairs:
        if key in document:
            raise DocumentError(f"{place}: {shown(key)} is given twice; give it once")
        document[key] = value
    return document


def shown(value: object) -> str:
    """A value for one line of a message, shortened."""
    return reprlib.repr(value)


class _RefusedError(yaml.YAMLError):
    """A text is YAML, but not what we read."""

    def __init__(self, node: yaml.Node, problem: str) -> None:
        super().__init__(f"line {node.start_mark.line + 1}: {problem}")


class _PlainLoader(_Safe):  # type: ignore[misc]  # whichever of the two is installed
    """Reads one document; dates and the like stay text."""

    yaml_implicit_resolvers: ClassVar = {
        first: [pair for pair in pairs if pair[0] in {*_SCALARS, _MERGE}]
        for first, pairs in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._nodes = 0
        self._values = 0

    def descend_resolver(self, parent: yaml.Node | None, index: Any) -> None:
        """Count what is composed: aliases are not expanded yet, but a list may already be too long."""
        super().descend_resolver(parent, index)
        self._nodes += 1
        if parent is not None and self._nodes > MAX_VALUES:
            raise _RefusedError(
                parent, f"the document has more than {MAX_VALUES} values"
            )

    def get_single_data(self) -> Any:
        """The value of the only document; None for an empty stream."""
        node = self.get_single_node()
        return None if node is None else self._value(node, 1)

    def _value(self, node: yaml.Node, depth: int) -> Any:
        """The value of a node; that of an alias is made again, and counts again."""
        self._count(node)
        if isinstance(node, yaml.ScalarNode):
            return self._scalar(node)
        if depth > MAX_DEPTH:
            raise _RefusedError(node, f"is nested deeper than {MAX_DEPTH} levels")
        if node.tag == f"{_PREFIX}seq" and isinstance(node, yaml.SequenceNode):
            return [self._value(item, depth + 1) for item in node.value]
        if node.tag == f"{_PREFIX}map" and isinstance(node, yaml.MappingNode):
            return self._mapping(node, depth)
        raise _RefusedError(node, f"has a {node.tag[:60]}, which is not supported")

    def _mapping(self, node: yaml.MappingNode, depth: int) -> dict[str, Any]:
        values: dict[str, Any] = {}
        merged: dict[str, Any] = {}
        for key, value_node in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _RefusedError(key, "has a key that is not text")
            self._count(key)
            name = key.value[:MAX_TEXT]
            value = self._value(value_node, depth + 1)
            if key.tag == _MERGE:
                sources = value if isinstance(value, list) else [value]
                if not all(isinstance(source, dict) for source in sources):
                    raise _RefusedError(key, "merges a value that is not a mapping")
                for source in reversed(sources):  # the first has priority
                    merged |= source
            elif name in values:
                raise _RefusedError(key, f"gives {shown(name)} twice")
            else:
                values[name] = value
        return merged | values

    def _scalar(self, node: yaml.ScalarNode) -> Any:
        text = node.value
        if len(text) > MAX_TEXT:
            raise _RefusedError(node, f"has a text of more than {MAX_TEXT} characters")
        if node.tag in {_MERGE, f"{_PREFIX}str"}:
            return text
        if node.tag not in _SCALARS:
            raise _RefusedError(node, f"has a {node.tag[:60]}, which is not supported")
        if len(text) > MAX_DIGITS:
            raise _RefusedError(
                node,
                f"{text[:20]}… is too long for a number; write it with an exponent",
            )
        try:
            value = self.construct_object(node)
        except (ValueError, LookupError, OverflowError):
            kind = node.tag.removeprefix(_PREFIX)
            raise _RefusedError(node, f"{shown(text)} is not a valid {kind}") from None
        if isinstance(value, float) and math.isnan(value):
            raise _RefusedError(node, f"{text} is not a number")
        if isinstance(value, float) and math.isinf(value) and "inf" not in text.lower():
            raise _RefusedError(node, f"{shown(text)} is too large for a number")
        if type(value) is int and abs(value) >= WHOLE:
            raise _RefusedError(
                node,
                f"{shown(text)} is too large for a whole number; write it with an exponent",
            )
        return value

    def _count(self, node: yaml.Node) -> None:
        self._values += 1
        if self._values > MAX_VALUES:
            raise _RefusedError(node, f"the document has more than {MAX_VALUES} values")


class _WrittenByHand(_PlainLoader):
    """Reads numbers with exponents in all their forms."""

    yaml_implicit_resolvers: ClassVar = {
        first: [(_FLOAT, _WITH_EXPONENT), *pairs]
        for first, pairs in _PlainLoader.yaml_implicit_resolvers.items()
    }


def _whole(digits: str, place: str) -> int:
    value = int(digits) if len(digits) < MAX_DIGITS else WHOLE
    if abs(value) >= WHOLE:
        raise DocumentError(f"{place}: {shown(digits)} is too large for a whole number")
    return value
