"""Definitions of the message types installed on this machine, as schemas of a session's topics."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from twinmatch.sessions.errors import SessionError

__all__ = ["schema_of"]

PRIMITIVE = {"bool", "byte", "char", "string", "wstring", "float32", "float64"} | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}


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
    first, *others = texts.items()
    blocks = [first[1]]
    for name, text in others:
        package, _, short = name.split("/")
        blocks.append(f"{'=' * 80}\nMSG: {package}/{short}\n{text}")
    return "\n".join(blocks)


def _text(kind: str, environment: Mapping[str, str]) -> str:
    match = re.fullmatch(r"(\w+)/msg/(\w+)", kind)
    if match is None:
        msg = f"session: {kind!r} is not a message type; give package/msg/Type"
        raise SessionError(msg)
    package, name = match.groups()
    prefixes = [*filter(None, environment.get("AMENT_PREFIX_PATH", "").split(":")), sys.prefix]
    for prefix in prefixes:
        path = Path(prefix) / "share" / package / "msg" / f"{name}.msg"
        if path.is_file():
            return path.read_text("utf-8")
    msg = f"session: the definition of {kind} is not installed; looked in {', '.join(prefixes)}"
    raise SessionError(msg)


def _parts(owner: str, text: str) -> Iterator[str]:
    """Full names of the types of the nested fields."""
    for line in text.splitlines():
        field = line.split("#", 1)[0].strip()
        if not field or re.match(r"\S+\s+\w+\s*=", field):  # empty, or a constant
            continue
        kind = re.split(r"[\[<\s]", field)[0]
        if kind in PRIMITIVE:
            continue
        package, *_, name = kind.split("/") if "/" in kind else (owner.split("/", 1)[0], kind)
        yield f"{package}/msg/{name}"
