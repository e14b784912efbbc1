"""Texts that a program or a device printed instead of a table: what each is, and how its values can be had."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final, NamedTuple

from twinmatch.importing.heads import Line

__all__ = ["MessageLog", "message_log"]

_OVER_MQTT: Final = (
    "take the values as they come instead: twinmatch attach --source mqtt://HOST --list"
)


class MessageLog(NamedTuple):
    """One kind of such a text."""

    line: re.Pattern[str]
    """What each of its first lines contains, or one of them."""
    is_each: bool
    """Whether all of the first lines have to be like that."""
    text: str
    """What it is, after the file's name and "is"."""
    way_out: str
    """What the user can do, after a semicolon."""


MESSAGE_LOGS: Final = (
    MessageLog(
        line=re.compile(r"^(?:(?:event|data|retry):(?: |$)|id: *\d+$)"),
        is_each=True,
        text="a stream of events, in which nothing says when they came",
        way_out="take the values of the device as they come instead, such as over MQTT with twinmatch attach "
        "--source mqtt://HOST --list",
    ),
    MessageLog(
        line=re.compile(r"\b(?:MQT|RSL): \S+ = "),
        is_each=False,
        text="the console of a device, in which each line is a message",
        way_out=_OVER_MQTT,
    ),
    MessageLog(
        line=re.compile(r"^[A-Za-z$][^\s,;:/]*(?:/[^\s,;:/]+)+ +(?:[^\s,;]+|\{.*\})$"),
        is_each=True,
        text="a list of topics with their payloads, in which nothing says when they came",
        way_out=_OVER_MQTT,
    ),
    MessageLog(
        line=re.compile(r"^(?:-- Polling|\[\d+\]:\s)"),
        is_each=False,
        text="what a Modbus client printed, in which nothing says when",
        way_out="read the registers instead: twinmatch attach --source modbus://HOST/UNIT --list holding/0-20",
    ),
    MessageLog(
        line=re.compile(r"\bT\d?:-?\d+(?:\.\d+)? ?/-?\d"),
        is_each=False,
        text="what the firmware of a printer reports",
        way_out="write a table of it, a line of names and a row for each report: time,nozzle,target,power",
    ),
)
"""In the order in which they are looked for."""


def message_log(first_lines: Sequence[Line]) -> MessageLog | None:
    """The kind of text that these lines begin, if it is one of those that cannot be tables."""
    for kind in MESSAGE_LOGS:
        matching = [line for line in first_lines if kind.line.search(line.text)]
        if matching and (len(matching) == len(first_lines) or not kind.is_each):
            return kind
    return None
