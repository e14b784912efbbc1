"""Why forecasts are not trusted, in words."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Final, NamedTuple

BASELINES: Final = {
    "persistence": "saying that nothing changes",
    "arx": "a linear model without physics (ARX)",
}
"""The baselines, and what each is called in a sentence."""


_WHOSE: Final = re.compile("its (forecasts|bands)")


class Shortfall(NamedTuple):
    """Why forecasts at a horizon are not trusted."""

    words: str
    """A clause, with a place for the figure if it has one."""
    figure: str
    certain: bool
    """Whether it is known that they are not to be trusted; otherwise it is not known that they are."""

    def of(self, signal: str) -> Shortfall:
        """The same, said of one signal."""
        return self._replace(
            words=_WHOSE.sub(rf"\g<0> of {signal}", self.words, count=1)
        )


FEW: Final = Shortfall("too few of its forecasts have been compared", "", certain=False)
"""Nothing is known yet."""
BEATEN_SOONER: Final = Shortfall(
    f"its forecasts are not surely better than {BASELINES['arx']}, which is better sooner",
    "",
    certain=False,
)
"""What a shorter horizon says of a longer one."""
NOT_BETTER_THAN_PERSISTENCE: Final = (
    f"its forecasts are not surely better than {BASELINES['persistence']}, "
    "with {} times the error"
)
WORSE_THAN_ARX: Final = (
    f"its forecasts are worse than {BASELINES['arx']}, with {{}} times the error"
)
BANDS_HOLD_TOO_FEW: Final = "its bands hold {} % of the readings"


def doubt_words(doubts: Mapping[float, Shortfall]) -> str:
    """Where the one test fails, by `ForecastScore.doubts`, in words; empty if nowhere."""
    proven = {horizon: doubt for horizon, doubt in doubts.items() if doubt != FEW}
    clauses = []
    for words in dict.fromkeys(doubt.words for doubt in proven.values()):
        figures = {
            horizon: proven[horizon].figure
            for horizon in sorted(proven)
            if proven[horizon].words == words
        }
        clauses.append(
            f"{horizon_list(figures)} s ahead {words.format(number_list(figures.values()))}"
        )
    return ", and ".join(clauses)


def number_list(listed: Iterable[float | str], digits: str = "g") -> str:
    """Numbers or texts in a sentence, at least one: 10, 60 and 300."""
    *first, last = (
        entry if isinstance(entry, str) else format(entry, digits) for entry in listed
    )
    return f"{', '.join(first)} and {last}" if first else last


def horizon_list(horizons: Iterable[float]) -> str:
    """Horizons in a sentence, s, the shortest first; to three digits, as those of fast plants are odd multiples
    of their period."""
    return number_list(float(f"{horizon:.3g}") for horizon in sorted(horizons))
