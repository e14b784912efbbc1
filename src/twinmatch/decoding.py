"""Documents from outside become values of declared types, in one way: what does not fit is refused with its
field and the reason. `sessions.documents` makes trees of their texts.
"""

from __future__ import annotations

import re
import reprlib
import sys
from collections.abc import Iterable
from typing import Annotated, Any, Final, TypeVar

import msgspec

from twinmatch.errors import TwinmatchError

Decoded = TypeVar("Decoded")
FiniteNumber = Annotated[
    float, msgspec.Meta(ge=-sys.float_info.max, le=sys.float_info.max)
]
NOT_GIVEN: Final = msgspec.UNSET
"""Value of an optional key that a document leaves out."""
LONGEST: Final = 200
"""Longest reason in a message, characters: it may repeat the document's own keys."""
_WORDS: Final = {
    "float": "a number", "int": "a whole number", "str": "text", "bool": "true or false", "null": "nothing",
    "array": "a list", "object": "names with values", "bytes": "bytes",
}  # fmt: skip
_EXPECTED: Final = re.compile(
    r"Expected `(?P<wanted>[^`]+)`(?P<more>[^,]*)(, got `?(?P<got>.+?)`?)?$"
)
_FIELD: Final = re.compile(
    r"Object (?P<lacks>missing)?.* field `(?P<name>.*)`$", re.DOTALL
)
_PLACE: Final = re.compile(
    r"(?P<why>.*?) - at (`key` in )?`\$\.?(?P<place>.*)`$", re.DOTALL
)


def document_type(
    needed: Iterable[str], others: Iterable[str] = (), kind: Any = float
) -> type[msgspec.Struct]:
    """The type of a document with only these keys, of values of one kind; `others` may be left out."""
    fields: list[Any] = [(name, kind) for name in needed]
    fields += [(name, kind | msgspec.UnsetType, NOT_GIVEN) for name in others]
    return msgspec.defstruct(
        "Document", fields, forbid_unknown_fields=True, kw_only=True
    )


def decoded(
    tree: Any,
    kind: type[Decoded],
    place: str = "",
    refusal: type[TwinmatchError] = TwinmatchError,
) -> Decoded:
    """A tree of lists, mappings and scalars as a declared type.

    Raises:
        TwinmatchError: it does not fit; it is a `refusal`, and its message begins with `place` and the field.
    """
    try:
        return msgspec.convert(tree, kind, from_attributes=False)
    except msgspec.ValidationError as error:
        raise refusal(_words(str(error), place, kind, tree)) from None


def decoded_json(
    text: str | bytes,
    kind: type[Decoded],
    place: str = "",
    refusal: type[TwinmatchError] = TwinmatchError,
) -> Decoded:
    """A JSON text as a declared type; errors as those of `decoded`."""
    try:
        return msgspec.json.decode(text, type=kind)
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        raise refusal(_words(str(error), place, kind)) from None


def given_keys(document: msgspec.Struct) -> dict[str, Any]:
    """The keys of a document that were given, with their values."""
    return {
        name: v
        for name, v in msgspec.structs.asdict(document).items()
        if v is not NOT_GIVEN
    }


def _words(error: str, place: str, kind: Any, tree: Any = None) -> str:
    """The library's message in words, after the place and the field in it."""
    why = error
    path = ""
    with_place = _PLACE.match(error)
    if with_place:
        why = with_place["why"]
        path = with_place["place"]
    if field := _FIELD.match(why):
        path = ".".join(filter(None, (path, field["name"])))
        why = "is missing" if field["lacks"] else "is not a known key"
        keys = sorted(getattr(kind, "__struct_fields__", ()))
        if keys and not with_place:
            why += f"; there are {', '.join(keys)}"
    elif expected := _EXPECTED.match(why):
        kinds = [
            _WORDS.get(word, word)
            for word in expected["wanted"].split(" | ")
            if word != "null"
        ]
        finite = "e+308" in expected["more"]
        wanted = "a finite number" if finite else " or ".join(kinds) + expected["more"]
        why = f"is {_value(tree, path, expected['got'])}; give {wanted}"
    return ": ".join(filter(None, (place, _shortened(path), _shortened(why))))


def _shortened(text: str) -> str:
    """A text in printable characters, not too long for a message."""
    return (text if text.isprintable() else ascii(text))[:LONGEST]


def _value(tree: Any, path: str, kind: str | None) -> str:
    """The value at a place in a tree, shortened; its kind where the place is not exact."""
    if "[...]" in path:
        return _WORDS.get(kind or "", "of another kind")
    try:
        for number, name in re.findall(r"\[(\d+)\]|([^.\[\]]+)", path):
            tree = tree[int(number)] if number else tree[name]
    except (LookupError, TypeError):
        return _WORDS.get(kind or "", kind or "of another kind")
    return "of another kind" if tree is None and kind != "null" else reprlib.repr(tree)
