"""What is required of a record's field in a message, and how it is written there: declared beside the field.

Declarations are a part of the field's type, such as `margin: Annotated[float, SHARE]`. Those with values are
named tuples, since the pages on the interface show a dataclass in a type as if its texts were names.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final, NamedTuple, Protocol

LARGEST: Final = 1e12
"""Largest magnitude of a signal, in any unit."""


class Requirement(Protocol):
    """One thing that is expected of a field's value."""

    def problem(self, name: str, value: Any, message: Any, owner: Any) -> str:
        """Why a value is not what is expected; empty if it is.

        Args:
            name: of the field.
            value: its value: a number or a text, or several.
            message: whose field it is.
            owner: the message that it is a part of; None for a whole one.
        """


class Within(NamedTuple):
    """Numbers are in a range; NaN passes where a number may be absent."""

    low: float
    high: float
    may_be_absent: bool = True

    def problem(self, name: str, value: Any, message: Any, owner: Any) -> str:  # noqa: ARG002
        """As of every `Requirement`."""
        for number in numbers_in(value):
            is_absent = self.may_be_absent and math.isnan(number)
            if not (self.low <= number <= self.high or is_absent):
                return f"{name} is {number:g}; expected {self.low:g} to {self.high:g}"
        return ""


@dataclass(frozen=True)
class Finite:
    """Numbers are finite, and not absurdly large."""

    def problem(self, name: str, value: Any, message: Any, owner: Any) -> str:  # noqa: ARG002
        """As of every `Requirement`."""
        for number in numbers_in(value):
            if not abs(number) <= LARGEST:  # true for NaN too
                return f"{name} is {number}; expected a finite number"
        return ""


@dataclass(frozen=True)
class Rising:
    """Numbers rise from 0 on."""

    def problem(self, name: str, value: Any, message: Any, owner: Any) -> str:  # noqa: ARG002
        """As of every `Requirement`."""
        has_negative = not all(
            math.isfinite(number) and number >= 0 for number in value
        )
        if has_negative or any(before >= after for before, after in pairwise(value)):
            return f"{name} does not rise from 0 on"
        return ""


class Sized(NamedTuple):
    """There are as many values as another field has."""

    by: str
    """Name of that field."""
    of: str
    """What it holds, in words."""
    rows: int = 1
    """Values for each of them."""
    square: bool = False
    """Whether there is a value for each pair of them."""
    may_be_empty: bool = False
    by_owner: bool = False
    """Whether that field is one of the message that this one is a part of."""

    def problem(self, name: str, value: Any, message: Any, owner: Any) -> str:
        """As of every `Requirement`."""
        count = len(getattr(owner if self.by_owner else message, self.by))
        size = count**2 if self.square else self.rows * count
        if len(value) != size and not (self.may_be_empty and len(value) == 0):
            return wrong_size(name, len(value), size, self.of)
        return ""


class Among(NamedTuple):
    """Words are among those of another field, or empty."""

    field: str
    kind: str
    """What such a word is, in an error."""
    attribute: str = ""
    """Of the parts that the field lists, what holds the word; empty: it lists words."""

    def problem(self, name: str, value: Any, message: Any, owner: Any) -> str:  # noqa: ARG002
        """As of every `Requirement`."""
        listed = getattr(message, self.field)
        accepted = {
            getattr(entry, self.attribute) if self.attribute else entry
            for entry in listed
        }
        return unknown_word(
            [value] if isinstance(value, str) else value, accepted, self.kind
        )


class RowsOf(NamedTuple):
    """There are as many values as another field has, or that many of each signal."""

    field: str
    of: str
    """What that field holds, in words."""

    def problem(self, name: str, value: Any, message: Any, owner: Any) -> str:  # noqa: ARG002
        """As of every `Requirement`."""
        rows = len(getattr(message, self.field))
        if not len(value) or len(value) % rows:
            return f"{name} has {len(value)} values for {self.of}; expected {rows}, or that of each"
        return ""


class SentAs(NamedTuple):
    """How a field is written in a message, where it is not as here."""

    name: str = ""
    """Its name there; empty: as here."""
    is_first_bare: bool = False
    """Whether the first of its parts has that name itself, and the others begin with it: `reach`,
    `reach_latest`."""
    is_listed: bool = False
    """Whether a number is written as a list of one: of each output of a loop."""


class OfPlant(NamedTuple):
    """A window of the plant of other parameters: so many outputs has each of its samples."""

    parameters: str
    """Name of the field that holds them."""


def unknown_word(words: Any, accepted: set[str], kind: str) -> str:
    """That one of some words is neither accepted nor empty; empty if all are."""
    for word in words:
        if word not in accepted | {""}:
            return f"{kind} {word[:40]!r} is not among those listed"
    return ""


def wrong_size(name: str, size: int, expected: int, of: str) -> str:
    """That a field has the wrong number of values."""
    return f"{name} has {size} values for {of}; expected {expected}"


def numbers_in(value: Any) -> Iterator[float]:
    """A number alone, or the numbers of a list."""
    if isinstance(value, float | int):
        yield value
    else:
        yield from value


SHARE: Final = Within(0.0, 1.0 + 1e-9)
"""A share, a probability or a ν-gap."""
FINITE: Final = Finite()
RISING: Final = Rising()
