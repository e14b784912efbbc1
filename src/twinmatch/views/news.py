"""Which verdicts are worth a line."""

from __future__ import annotations

from collections.abc import Iterable

from twinmatch.discrimination import TrustLevel, Verdict

__all__ = ["News", "news"]


class News:
    """Tells verdicts that say something new from those that only repeat the last one."""

    def __init__(self) -> None:
        """Begin with nothing told."""
        self._told: tuple[TrustLevel, str, str | None, str | None, bool] | None = None

    def worth_telling(self, verdict: Verdict) -> bool:
        """True if something was identified, or level, fault, leader, nominal or its certainty changed."""
        says = (verdict.level, verdict.fault, verdict.leader, verdict.nominal, verdict.decided)
        changed = says != self._told
        self._told = says
        return changed or not verdict.stands


def news(verdicts: Iterable[Verdict]) -> list[Verdict]:
    """The verdicts worth telling."""
    teller = News()
    return [v for v in verdicts if teller.worth_telling(v)]
