"""Which verdicts say something new."""

from __future__ import annotations

from collections.abc import Iterable

from twinmatch.comparing import TrustLevel, Verdict

__all__ = ["News", "news"]


class News:
    """Distinguishes verdicts that say something new from those that repeat the last one."""

    def __init__(self) -> None:
        """Start before the first verdict."""
        self._last: tuple[TrustLevel, str, str | None, str | None, bool] | None = None

    def is_new(self, verdict: Verdict) -> bool:
        """True if models were identified, a match was refused, or level, fault, leader, nominal or `decided`
        changed."""
        content = (verdict.level, verdict.fault, verdict.leader, verdict.nominal, verdict.decided)
        changed = content != self._last
        self._last = content
        return changed or not verdict.stands or bool(verdict.match)


def news(verdicts: Iterable[Verdict]) -> list[Verdict]:
    """The verdicts that say something new."""
    so_far = News()
    return [v for v in verdicts if so_far.is_new(v)]
