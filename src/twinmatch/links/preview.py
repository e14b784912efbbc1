"""What the entries of a map give now: each signal's number, and the values of which it is made."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from itertools import chain
from typing import Final

from twinmatch.links.sources import protocol_of
from twinmatch.sampling.channels import Channel, SamplingError
from twinmatch.sampling.listener import Read
from twinmatch.sampling.sources import FollowedSignal, SignalMap

_PERIOD: Final = 0.5
"""Interval at which places are read, s."""
_LONGEST: Final = 3.0
"""Longest wait for the values, s."""
_POLLS: Final = 0.02
"""Interval between two looks at what has come, s."""


class _Preview:
    """A signal of which values come."""

    def __init__(self, signal: str, followed: FollowedSignal) -> None:
        self.value = math.nan
        self._signal = signal
        self._followed = followed
        self._newest: dict[Channel, float | str] = {}
        self._why = ""

    def take(self, topic: str, read: Read) -> None:
        """Take a message; what it lacks stays as it was."""
        try:
            for channel in self._followed.channels:
                value = read(channel) if channel.topic == topic else None
                if value is not None:
                    self._newest[channel] = value
            if len(self._newest) < len(set(self._followed.channels)):
                return
            numbers = [
                self._followed.number(self._newest[channel])
                for channel in self._followed.channels
            ]
            self.value = self._followed.value(numbers, time.monotonic())
            self._why = ""
        except SamplingError as error:
            self._why = str(error)

    @property
    def text(self) -> str:
        """The signal's number and of what it is made, or why there is none."""
        source = self._followed.source
        parts = [
            f"{channel.text} is {self._newest.get(channel, 'silent')}"
            for channel in self._followed.channels
        ]
        made = f"{source.text}; {', '.join(parts)}"
        if not math.isfinite(self.value):
            return f"{self._signal} has no value  ({self._why or made})"
        return f"{self._signal} = {self.value:g} {source.unit}".rstrip() + f"  ({made})"


def previewed(url: str, signal_map: SignalMap) -> Iterator[str]:
    """A line for each entry of a map, with what it gives now.

    Raises:
        TwinmatchError: the source or an entry cannot be used.
    """
    protocol = protocol_of(url)
    previews = []
    channels: list[Channel] = []
    for signal, source in signal_map.sources.items():
        places = source.channels(signal, protocol.parse_place)
        channels.extend(places)
        previews.append(
            _Preview(
                signal, source.follow(signal, source.unit, places, [""] * len(places))
            )
        )

    def receive(
        topic: str,
        read: Read,
        stamp: int = 0,  # noqa: ARG001
        *,
        retained: bool = False,  # noqa: ARG001
    ) -> None:
        for preview in previews:
            preview.take(topic, read)

    opened = protocol.open_source(url, _PERIOD, channels, receive)
    try:
        opened.search(0.0)
        until = time.monotonic() + _LONGEST
        while time.monotonic() < until and not all(
            math.isfinite(preview.value) for preview in previews
        ):
            opened.poll()
            time.sleep(_POLLS)
        news = opened.news()
    finally:
        opened.close()
    yield from chain(news, (preview.text for preview in previews))
