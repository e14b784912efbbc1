"""Outlooks of all candidates at one sample, as a value that can be shared."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from twinmatch.forecasting import ForecastError, Outlook

__all__ = ["Snapshot", "candidate_called"]


class Snapshot(NamedTuple):
    """Outlooks of all candidates at one sample; immutable, so it can be used from any thread."""

    leader: str | None = None
    """The candidate whose forecasts have saved the most characters; None without candidates."""
    outlooks: Mapping[str, Outlook] = MappingProxyType({})
    """Outlooks by name of the candidate."""

    def outlook(self, name: str | None = None) -> Outlook:
        """The outlook of a candidate, by default the leader.

        Raises:
            ForecastError: there is no candidate yet, or none of that name.
        """
        return self.outlooks[candidate_called(self.leader if name is None else name, self.outlooks)]


def candidate_called(name: str | None, candidates: Mapping[str, object]) -> str:
    """Check that there is a candidate of this name, and return the name.

    Raises:
        ForecastError: there is no candidate yet, or none of that name.
    """
    if name is None or not candidates:
        msg = "forecast: there is no candidate yet; the first comes with the first match that is accepted"
        raise ForecastError(msg)
    if name not in candidates:
        names = ", ".join(candidates)
        raise ForecastError(f"forecast: no candidate {name!r}; at this sample there are: {names}")
    return name
