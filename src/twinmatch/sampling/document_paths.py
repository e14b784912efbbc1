"""Paths in JSON documents: `params.[light:0].brightness`, `[n=temp].v`, `["a.b"][2]`.

A path consists of keys, of indices of lists, and of choices: `[n=temp]` is the element of a list whose `n` is
`temp`, wherever it stands. A key that is not a plain name is in brackets, and quoted as in JSON where it has
signs that mean something in a path or a map.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any, Final, NamedTuple

from twinmatch.sampling.channels import SamplingError

_NAME: Final = r"[^\W\d]\w*"
_PLAIN: Final = r"[^\[\]=\",;\\]+"
"""What may stand in brackets without quotation marks."""
_QUOTED: Final = r'"(?:[^"\\]|\\.)*"'
_STEP: Final = re.compile(
    rf"\.?(?P<name>{_NAME})|\.?\[(?P<index>\d+)\]|\.?\[(?P<key>{_PLAIN}|{_QUOTED})\]"
    rf"|\.?\[(?P<naming>{_PLAIN}|{_QUOTED})=(?P<label>{_PLAIN}|{_QUOTED})\]"
)
_WITH_COLON: Final = re.compile(rf"\.?(?P<name>{_NAME}(?::\w+)+)")
"""A key such as `light:0`, which people write without brackets."""
_NAMING: Final = (
    "n",
    "name",
    "id",
    "key",
    "label",
    "sensor",
    "channel",
    "address",
    "tag",
)
"""Keys whose values name the elements of a list, in the order of preference."""
_FORM: Final = 'write keys and indices, such as a.b[2], [n=temp].v or ["any key"]'


class Choice(NamedTuple):
    """The element of a list that has this label under this key."""

    naming: str
    label: str


Step = str | int | Choice
"""A key, an index or a choice; an index of an object is its key."""


class Absent(Exception):  # noqa: N818
    """A document has nothing at a path."""


@lru_cache(maxsize=1024)
def steps_of(path: str) -> tuple[Step, ...]:
    """The steps of a path.

    Raises:
        SamplingError: it is not a path.
    """
    parsed: list[Step] = []
    position = 0
    while position < len(path):
        match = _WITH_COLON.match(path, position) or _STEP.match(path, position)
        if match is None or not _may_follow(match, is_first=position == 0):
            raise SamplingError(f"{path!r} is not a path; {_FORM}")
        parsed.append(_step(match.groupdict()))
        position = match.end()
    return tuple(parsed)


def _may_follow(match: re.Match[str], *, is_first: bool) -> bool:
    """Whether a step has a point before it where it needs one: the first has none, later names have one."""
    has_point = match[0].startswith(".")
    if is_first:
        return not has_point
    return has_point or match["name"] is None


def is_strict(path: str) -> bool:
    """Whether it is a path, each key with a colon in brackets."""
    try:
        steps_of(path)
    except SamplingError:
        return False
    outside = re.sub(rf"{_QUOTED}|\[[^\]]*\]", "", path)
    return ":" not in outside


def is_path(path: str) -> bool:
    """Whether it is a path."""
    try:
        steps_of(path)
    except SamplingError:
        return False
    return True


def _step(groups: dict[str, str | None]) -> Step:
    """The step that a match stands for."""
    if (name := groups["name"]) is not None:
        return name
    if (index := groups.get("index")) is not None:
        return int(index)
    if (naming := groups.get("naming")) is not None:
        return Choice(_text(naming), _text(groups["label"] or ""))
    return _text(groups["key"] or "")


def _text(written: str) -> str:
    """A key or a label from how it is written."""
    if not written.startswith('"'):
        return written.strip()
    try:
        return str(json.loads(written))
    except ValueError:
        raise SamplingError(
            f"{written} is not a text in quotation marks; {_FORM}"
        ) from None


def found_at(document: Any, path: str) -> Any:
    """What a document has at a path.

    Raises:
        Absent: it has nothing there.
        SamplingError: it is not a path.
    """
    value = document
    for step in steps_of(path):
        value = _below(value, step)
    return value


def _below(value: Any, step: Step) -> Any:
    """What is one step below a value."""
    if isinstance(value, list) and isinstance(step, Choice):
        return value[_position(value, step)]
    if isinstance(value, list) and isinstance(step, int) and step < len(value):
        return value[step]
    if isinstance(value, dict) and not isinstance(step, Choice) and str(step) in value:
        return value[str(step)]
    raise Absent


def _position(elements: Sequence[Any], choice: Choice) -> int:
    """Where the chosen element stands in a list.

    Raises:
        Absent: no element has the label.
        SamplingError: several have it.
    """
    positions = []
    for position, element in enumerate(elements):
        if (
            isinstance(element, dict)
            and _label(element.get(choice.naming)) == choice.label
        ):
            positions.append(position)
    if not positions:
        raise Absent
    if len(positions) > 1:
        raise SamplingError(
            f"{len(positions)} elements of a list have {choice.naming}={choice.label}"
        )
    return positions[0]


def _label(value: Any) -> str | None:
    """What a label reads, which may be a text or a whole number; None for anything else."""
    if isinstance(value, str) or (
        isinstance(value, int) and not isinstance(value, bool)
    ):
        return str(value)
    return None


def element_steps(elements: Sequence[Any]) -> list[Step]:
    """The step to each element of a list: by its name, if they have names, otherwise by its index."""
    for naming in _NAMING:
        labels = [
            _label(element.get(naming)) if isinstance(element, dict) else None
            for element in elements
        ]
        if len(elements) > 1 and None not in labels and len(set(labels)) == len(labels):
            return [Choice(naming, str(label)) for label in labels]
    return list(range(len(elements)))


def with_step(path: str, step: Step) -> str:
    """A path that goes one step further."""
    if isinstance(step, Choice):
        return f"{path}[{_written(step.naming)}={_written(step.label)}]"
    if isinstance(step, int):
        return f"{path}[{step}]"
    if re.fullmatch(_NAME, step) and step.isprintable():
        return f"{path}.{step}" if path else step
    is_index = re.fullmatch(r"[0-9]+", step) and str(int(step)) == step
    return f"{path}[{step if is_index else _written(step)}]"


def _written(text: str) -> str:
    """A key or label in brackets, quoted if it has signs that mean something there."""
    is_plain = re.fullmatch(_PLAIN, text) and not re.fullmatch(r"\s*\d+\s*", text)
    if is_plain and text == text.strip() and text.isprintable():
        return text
    return quoted(text)


def quoted(text: str) -> str:
    """A text in quotation marks, as in JSON; all that no terminal should get is escaped."""
    return json.dumps(text, ensure_ascii=not text.isprintable())


def by_name(document: Any, path: str) -> str:
    """The path that chooses by name whatever `path` chooses by an index, where the elements have names.

    Raises:
        Absent: the document has nothing there.
        SamplingError: it is not a path.
    """
    value = document
    named = ""
    for step in steps_of(path):
        is_element = (
            isinstance(value, list) and isinstance(step, int) and step < len(value)
        )
        chosen = element_steps(value)[int(str(step))] if is_element else step
        named = with_step(
            named, chosen if is_element or not isinstance(step, int) else str(step)
        )
        value = _below(value, step)
    return named


def leaves(document: Any, deepest: int, path: str = "") -> Iterator[tuple[str, Any]]:
    """Paths and values of all that is neither an object nor a list, down to a depth."""
    if isinstance(document, dict) and deepest:
        for key, below in document.items():
            yield from leaves(below, deepest - 1, with_step(path, key))
    elif isinstance(document, list) and deepest:
        for step, below in zip(element_steps(document), document, strict=True):
            yield from leaves(below, deepest - 1, with_step(path, step))
    elif not isinstance(document, dict | list):
        yield path, document
