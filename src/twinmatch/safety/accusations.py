"""What a trusted twin says against sensor or drive, and who acts on it."""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

ACCUSED: Final = {
    "drive": frozenset({"drive-lost"}),
    "sensor": frozenset({"sensor-frozen", "sensor-late", "sensor-drift"}),
}
"""What the twin's alarms accuse. Left out: a weak drive and one impossible reading, no danger yet."""

_UNNAMED: Final = "drift"


class Accusations:
    """Acts on the alarms of a twin whose forecasts held until then.

    A twin that was never trusted accuses nobody: it may be the one that is wrong. After each fault it has to
    be trusted again; but a change without a name may still turn out to be the drive's.
    """

    def __init__(self, act_on: Collection[str] = tuple(ACCUSED)) -> None:
        """Act on accusations of these: keys of `ACCUSED`."""
        self._names = frozenset[str]().union(*(ACCUSED[kind] for kind in act_on))
        self._trusted: int | None = None
        self._unnamed = False

    def take(
        self, sample: int, *, trusted: bool, fault: str, reason: str
    ) -> str | None:
        """Take a verdict: its sample, whether the twin is trusted, name and evidence of a fault of the plant;
        returns an error message, or None."""
        since = self._trusted
        if fault != _UNNAMED and (fault or self._unnamed):
            self._trusted = None
        if trusted and not fault:
            self._trusted = sample
        self._unnamed = fault == _UNNAMED
        if since is None or fault not in self._names:
            return None
        return f"the twin, trusted at sample {since}, reports {fault}: {reason}"
