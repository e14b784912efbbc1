"""When an estimate may stand in for a sensor that a trusted twin does not believe."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final, NamedTuple

from twinmatch.safety.accusations import ACCUSED

PATIENCE: Final = 2.0
"""Time without a usable estimate after which nothing says what the sensor should read, s."""


LASTING: Final = 10.0
"""Time for which a sensor must have been accused before a law takes an estimate in its place, s: an alarm
that is taken back sooner gives the loop nothing."""


class StandInState(NamedTuple):
    """What the law takes now, and what is wrong."""

    value: float
    """What it takes in place of the reading, in its unit; NaN: the reading itself."""
    trouble: str = ""
    """Why nothing may be driven; empty while it may."""


class StandIn:
    """One sensor that an operator has allowed to be read through.

        believed ──accused──▶ doubted ──has lasted──▶ stands in ──given back──▶ believed
                                 └──────no usable estimate──────┴──▶ trouble

    A verdict gives a sensor back, silence never does: a twin that ends must not hand the loop back to a
    sensor that lies. All times are seconds of one clock that does not step back.
    """

    def __init__(self, name: str, highest: float, unit: str) -> None:
        """Begin with a sensor that is believed; `highest` is the guard's limit, which holds for estimates."""
        self._name = name
        self._highest = highest
        self._unit = unit
        self._since = math.nan
        self._newest = (-math.inf, math.nan)
        self._poor = ""

    @property
    def accused(self) -> bool:
        """Whether the sensor is not believed."""
        return not math.isnan(self._since)

    def accuse(self, now: float) -> None:
        """From now on the sensor is not believed."""
        self._since = now

    def give_back(self) -> None:
        """The sensor is believed again."""
        self._since = math.nan

    def take(self, value: float, band: float, wide: float, now: float) -> None:
        """Take an estimate, half of the width of its band, and that up to which it counts as good."""
        self._poor = (
            ""
            if math.isfinite(value) and band <= wide
            else f"± {band:.2g} {self._unit} wide"
        )
        if not self._poor:
            self._newest = now, value

    def look(self, now: float) -> StandInState:
        """What the law takes now. Until the accusation has lasted, that is the reading."""
        if not self.accused:
            return StandInState(math.nan)
        estimated_at, value = self._newest
        if now - estimated_at <= PATIENCE and not self._poor:
            hot = (
                f"{self._name} is estimated at {value:.1f} {self._unit}"
                if value > self._highest
                else ""
            )
            has_lasted = now - self._since >= LASTING
            return StandInState(value if has_lasted and not hot else math.nan, hot)
        if now - self._since <= PATIENCE:
            return StandInState(math.nan)
        why = f"the estimate is {self._poor}" if self._poor else "there is no estimate"
        return StandInState(
            math.nan,
            f"{self._name} is not believed, and {why}; measure it and clear this",
        )


class StandIns:
    """All sensors that an operator has allowed to be read through."""

    def __init__(self, names: Iterable[str], highest: float, unit: str) -> None:
        """Begin with sensors that are believed; `highest` is the guard's limit, in their unit."""
        self._of_names = {name: StandIn(name, highest, unit) for name in names}

    def __bool__(self) -> bool:
        return bool(self._of_names)

    @property
    def accused(self) -> list[str]:
        """Names of the sensors that are not believed."""
        return [name for name, stand_in in self._of_names.items() if stand_in.accused]

    def accuse(self, signal: str, fault: str, now: float) -> bool:
        """Take an accusation of a trusted twin; returns whether it is of a sensor that may be read through,
        which is not believed from now on."""
        stand_in = self._of_names.get(signal)
        if stand_in is None or fault not in ACCUSED["sensor"]:
            return False
        stand_in.accuse(now)
        return True

    def give_back(self) -> None:
        """All sensors are believed again."""
        for stand_in in self._of_names.values():
            stand_in.give_back()

    def take(
        self, signal: str, value: float, band: float, wide: float, now: float
    ) -> None:
        """Take an estimate of a sensor; see `StandIn.take`."""
        stand_in = self._of_names.get(signal)
        if stand_in is not None:
            stand_in.take(value, band, wide, now)

    def look(self, now: float) -> dict[str, StandInState]:
        """What the law takes now, by name."""
        return {name: stand_in.look(now) for name, stand_in in self._of_names.items()}
