"""A signal of a plant as a sum over numbers of topics, in the plant's unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from twinmatch.errors import TwinmatchError
from twinmatch.sampling.errors import SamplingError
from twinmatch.sampling.fields import Channel, parse_channel
from twinmatch.sampling.usual_units import usual_unit
from twinmatch.units import Conversion, conversion, measure

__all__ = ["Wire"]

_SAME: Final = Conversion()


@dataclass(frozen=True)
class Wire:
    """Where a signal comes from: the mean of its channels, scaled, then brought to the plant's unit."""

    signal: str
    channels: tuple[Channel, ...]
    unit: str = ""
    """Of scale·mean + offset; empty: as the type of the messages says, or the plant's."""
    scale: float = 1.0
    offset: float = 0.0
    change: Conversion = _SAME
    """To the plant's unit."""

    @classmethod
    def of(cls, signal: str, columns: Sequence[str], unit: str, scale: float, offset: float) -> Wire:
        """A wire from what a map says of a signal; a text may name several channels, with commas between.

        Raises:
            SamplingError: one of them names no topic.
        """
        parts = [part for column in columns for part in column.split(",") if part.strip()]
        try:
            return cls(signal, tuple(map(parse_channel, parts)), unit, scale, offset)
        except SamplingError as error:
            raise SamplingError(f"{signal}: {error}") from None

    def to(self, wanted: str, kinds: Sequence[str], paths: Sequence[str]) -> Wire:
        """The wire with the paths that were found and its change to the plant's unit.

        Args:
            wanted: unit of the plant's signal.
            kinds: type of the messages of each channel.
            paths: to the number in them.

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
            msg = (
                f"{self.signal}: its channels are in different units, {' and '.join(usual)}; name one of them"
            )
            raise SamplingError(msg)
        unit, kind = next(iter(usual.items()))
        return replace(found, change=found._change(unit, wanted, f" (as {kind} says)")) if unit else found

    def _change(self, unit: str, wanted: str, why: str) -> Conversion:
        try:
            return conversion(unit, wanted)
        except TwinmatchError:
            strange = "" if measure(unit).known else f" {unit!r} is no unit that is known;"
            msg = (
                f"{self.signal}: {self.channels[0].text} is in {unit}{why}, the plant's {self.signal} in "
                f"{wanted or 'plain numbers'};{strange} name another field, or write behind it "
                f"'; unit={wanted or 1}; scale=…'"
            )
            raise SamplingError(msg) from None

    def value(self, numbers: Sequence[float]) -> float:
        """The signal, from one number for each channel."""
        mean = sum(numbers) / len(numbers)
        return (self.scale * mean + self.offset) * self.change.scale + self.change.offset
