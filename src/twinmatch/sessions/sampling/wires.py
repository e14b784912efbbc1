"""A plant's signal as the mean of numbers in topics, in the plant's unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from twinmatch.errors import TwinmatchError
from twinmatch.sessions.sampling.errors import SamplingError
from twinmatch.sessions.sampling.fields import Channel, parse_channel
from twinmatch.sessions.sampling.usual_units import usual_unit
from twinmatch.units import Conversion, conversion, measure

__all__ = ["Wire"]

_SAME: Final = Conversion()


@dataclass(frozen=True)
class Wire:
    """The source of a signal: the mean of its channels, scaled, then converted to the plant's unit."""

    signal: str
    channels: tuple[Channel, ...]
    unit: str = ""
    """Unit of scale·mean + offset; empty: that of the message type, or else the plant's."""
    scale: float = 1.0
    offset: float = 0.0
    change: Conversion = _SAME
    """Conversion to the plant's unit."""

    @classmethod
    def of(cls, signal: str, columns: Sequence[str], unit: str, scale: float, offset: float) -> Wire:
        """A wire from a signal's map entry; a text may name several channels, separated by commas.

        Raises:
            SamplingError: a channel names no topic.
        """
        parts = [part for column in columns for part in column.split(",") if part.strip()]
        try:
            return cls(signal, tuple(map(parse_channel, parts)), unit, scale, offset)
        except SamplingError as error:
            raise SamplingError(f"{signal}: {error}") from None

    def to(self, wanted: str, kinds: Sequence[str], paths: Sequence[str]) -> Wire:
        """The wire with resolved paths and the conversion to the plant's unit.

        Args:
            wanted: unit of the plant's signal.
            kinds: message type of each channel.
            paths: path to the number in each channel's messages.

        Raises:
            SamplingError: the units measure different things.
        """
        channels = tuple(c._replace(path=path) for c, path in zip(self.channels, paths, strict=True))
        found = replace(self, channels=channels)
        if self.unit:
            return replace(found, change=found._change(self.unit, wanted, ""))
        if (self.scale, self.offset) != (1.0, 0.0):
            return found
        usual = {usual_unit(kind, path): kind for kind, path in zip(kinds, paths, strict=True)}
        if len(usual) > 1:
            msg = f"{self.signal}: its channels have different units, {' and '.join(usual)}; map only one"
            raise SamplingError(msg)
        unit, kind = next(iter(usual.items()))
        return (
            replace(found, change=found._change(unit, wanted, f" (according to {kind})")) if unit else found
        )

    def _change(self, unit: str, wanted: str, why: str) -> Conversion:
        try:
            return conversion(unit, wanted)
        except TwinmatchError:
            strange = "" if measure(unit).known else f" {unit!r} is not a known unit;"
            msg = (
                f"{self.signal}: {self.channels[0].text} is in {unit}{why}, but the plant's {self.signal} in "
                f"{wanted or 'plain numbers'};{strange} map another field, or append "
                f"'; unit={wanted or 1}; scale=…' to its map entry"
            )
            raise SamplingError(msg) from None

    def value(self, numbers: Sequence[float]) -> float:
        """The signal, from one number for each channel."""
        mean = sum(numbers) / len(numbers)
        return (self.scale * mean + self.offset) * self.change.scale + self.change.offset
