"""What was received on topics of MQTT, as a list of places for a map."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from twinmatch.sampling.channels import Channel, SamplingError, UnreadableError
from twinmatch.sampling.document_paths import quoted
from twinmatch.sampling.payloads import (
    SPARKPLUG,
    document_of,
    is_sparkplug,
    numbers_in,
    place_text,
    texts_in,
)
from twinmatch.sampling.written_numbers import written_number

_QUOTED: Final = 40
"""Most characters of a text that are shown."""
USUAL_MARKS: Final = (
    -32768.0,
    32768.0,
    32767.0,
    65535.0,
    -127.0,
    127.94,
    85.0,
    -999.0,
    -9999.0,
    -8000.0,
)
"""Numbers with which many devices say that there is no sensor, or no value yet."""


class Heard:
    """The newest value at each place; messages may have only a part of the places of their topic."""

    def __init__(self) -> None:
        """Start without messages."""
        self._values: dict[str, dict[str, float | str]] = {}
        self._refused: dict[str, str] = {}

    def take(self, topic: str, payload: bytes) -> None:
        """Take a message."""
        values = self._values.setdefault(topic, {})
        if is_sparkplug(topic):
            self._refused[topic] = SPARKPLUG
            return
        try:
            document = document_of(payload)
        except SamplingError as error:
            self._refused[topic] = str(error)
            return
        values.update(numbers_in(document))
        values.update(texts_in(document))

    def lines(self) -> Iterator[str]:
        """A line for each place, and a reason for each topic without one; a place can be pasted into a map.

        Texts that are not numbers are shown only for topics that have nothing else.
        """
        for topic, values in sorted(self._values.items()):
            shown = [
                _line(topic, path, value)
                for path, value in values.items()
                if _is_number(value)
            ]
            if not shown:
                shown = [_line(topic, path, value) for path, value in values.items()]
            yield from shown
            if topic in self._refused:
                yield f"{_printable(topic)}  ({self._refused[topic]})"
            elif not shown:
                yield f"{_printable(topic)}  (no numbers)"


def mark_hint(value: float) -> str:
    """What to write if a number stands for no value; empty if it is not one that often does."""
    return (
        f"  (no sensor? then write '; missing={value:g}')"
        if value in USUAL_MARKS
        else ""
    )


def _is_number(value: float | str) -> bool:
    if not isinstance(value, str):
        return True
    try:
        written_number(value)
    except UnreadableError:
        return False
    return True


def _line(topic: str, path: str, value: float | str) -> str:
    """A place with what it says."""
    place = place_text(Channel(topic, path))
    if not isinstance(value, str):
        return f"{place}  {value:g}{mark_hint(value)}"
    text = f"{place}  {value[:_QUOTED]!r}"
    if not _is_number(value):
        return text
    written = written_number(value)
    return f"{text} = {written.value:g} {written.unit}".rstrip()


def _printable(topic: str) -> str:
    """A topic, in quotation marks if a terminal should not get it as it is."""
    return topic if topic.isprintable() else quoted(topic)
