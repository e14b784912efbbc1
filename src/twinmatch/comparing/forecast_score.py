"""How well candidates have forecast, and the test by which their forecasts are trusted at a horizon."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Final, NamedTuple

from twinmatch.comparing.doubts import (
    BANDS_HOLD_TOO_FEW,
    BEATEN_SOONER,
    FEW,
    NOT_BETTER_THAN_PERSISTENCE,
    WORSE_THAN_ARX,
    Shortfall,
)
from twinmatch.comparing.uncertainty import CONFIDENCE
from twinmatch.dynamics import Parameters
from twinmatch.requirements import SHARE, Sized, Within

_SHOWN: Final = 2.5
"""Standard errors from which something is more than chance: 0.6 % in one look, less than 5 % in an hour of
them (`python -m benchmarks.trust`)."""
ONE_SIDED: Final = 1.6448536269514722
"""Quantile of the normal distribution at 95 %: that of `persistence_skill_high` and `arx_skill_high`."""
_TINY: Final = 1e-12
_TENTH: Final = 1.1
"""Up to so many times the errors of ARX, a twin is hardly worse: it alone can answer what-if."""


class _TestLimits(NamedTuple):
    """Standard errors by which a twin passes or fails the test at a horizon."""

    better_than_persistence: float
    """It has to be better than saying that nothing changes by more than this."""
    worse_than_arx: float
    """It may be worse than ARX by no more than this."""
    bands_too_narrow: float
    """Its bands may hold too few readings by no more than this."""


_TO_GAIN_TRUST: Final = _TestLimits(_SHOWN, _SHOWN / 2.0, _SHOWN / 2.0)
_TO_KEEP_TRUST: Final = _TestLimits(0.0, ONE_SIDED, _SHOWN)


class _ErrorRatio(NamedTuple):
    """A twin's errors beside those of a baseline at a horizon; NaN where not enough were compared."""

    value: float
    """(Mean |error|) / (that of the baseline)."""
    low: float
    """Lower end of its one-sided 95 % interval."""

    def standard_errors_above(self, ratio: float) -> float:
        """By how many standard errors it is larger than another ratio, in logarithms."""
        log_value = math.log(self.value)
        log_low = math.log(self.low)
        above = ONE_SIDED * (log_value - math.log(ratio))
        return above / max(log_value - log_low, _TINY)


_BY_HORIZON: Final = Sized("horizons", "its horizons", may_be_empty=True, by_owner=True)
_BY_HORIZON_OF_SIGNAL: Final = Sized(
    "horizons", "the horizons", may_be_empty=True, by_owner=True
)


@dataclass(frozen=True)
class ForecastScore:
    """How well one candidate has forecast."""

    name: str
    parameters: Parameters
    first: int
    """First sample of the data it was fitted to; `last` + 1 if it was given."""
    last: int
    gain: float
    """Characters that its forecasts of output and input have saved compared with a forecast of no change: the
    mean over forecasts, older ones weighted less, summed over the horizons. NaN before one could be compared
    with the samples."""
    gains: Annotated[tuple[float, ...], _BY_HORIZON]
    """The gain at each horizon."""
    forecasts: Annotated[float, Within(0.0, math.inf)]
    """Effective number of forecasts in that mean."""
    persistence_skill: Annotated[tuple[float, ...], _BY_HORIZON] = ()
    """At each horizon, 1 − (mean |error|) / (that of a forecast of no change); NaN if too few were compared,
    empty in recordings from before it was computed."""
    arx_skill: Annotated[tuple[float, ...], _BY_HORIZON] = ()
    """The same beside an ARX model, which is fitted to the samples so far."""
    persistence_skill_high: Annotated[tuple[float, ...], _BY_HORIZON] = ()
    """Upper end of the one-sided 95 % interval of `persistence_skill`: below 0, the forecast of no change is
    better, and not by chance. NaN and empty as above."""
    arx_skill_high: Annotated[tuple[float, ...], _BY_HORIZON] = ()
    """The same of `arx_skill`."""

    coverage: Annotated[tuple[float, ...], _BY_HORIZON] = ()
    """At each horizon, the share of the readings since the horizon before that its bands have held, of
    several signals the least; 0.9 is expected. NaN and empty as above."""
    independent: Annotated[tuple[float, ...], _BY_HORIZON] = ()
    """Effective number of forecasts in that share which do not overlap."""

    def doubts(
        self, horizons: Sequence[float], trusted: Sequence[float] = ()
    ) -> dict[float, Shortfall]:
        """Where its forecasts do not pass the test, and why, by horizon, s; at the others they are trusted.

        They pass if they are better than saying that nothing changes, if ARX is not better, and if their bands
        do not hold less than they promise, each by more than chance. At horizons that were `trusted` before,
        the contrary has to be shown. Where both baselines are better, the better one is named. Nor do they
        pass where ARX is surely much better at a shorter horizon: of long forecasts only few do not overlap.
        """
        doubts = {}
        beaten_sooner = None
        for k, horizon in enumerate(horizons):
            limits = _TO_KEEP_TRUST if horizon in trusted else _TO_GAIN_TRUST
            doubt = self._doubt(k, limits) or beaten_sooner
            if doubt is not None:
                doubts[horizon] = doubt
            if self._is_far_behind_arx(k):
                beaten_sooner = BEATEN_SOONER
        return doubts

    def _doubt(self, k: int, limits: _TestLimits) -> Shortfall | None:
        """Why its forecasts at the k-th horizon do not pass the test by themselves; None if they do."""
        if not self.persistence_skill or math.isnan(self.persistence_skill[k]):
            return FEW
        behind = [
            self._behind_persistence(k, limits.better_than_persistence),
            self._behind_arx(k, limits.worse_than_arx),
        ]
        shortfalls = [shortfall for shortfall in behind if shortfall is not None]
        if shortfalls:
            return max(shortfalls, key=lambda shortfall: float(shortfall.figure))
        return self._with_narrow_bands(k, limits.bands_too_narrow)

    def _behind_persistence(self, k: int, least: float) -> Shortfall | None:
        """That it is not better than persistence by more than `least` standard errors; None if it is."""
        ratio = self._beside_persistence(k)
        worse = ratio.standard_errors_above(1.0)
        if worse < -least:
            return None
        return Shortfall(
            NOT_BETTER_THAN_PERSISTENCE, f"{ratio.value:.2f}", certain=worse > _SHOWN
        )

    def _behind_arx(self, k: int, most: float) -> Shortfall | None:
        """That it is worse than ARX by more than `most` standard errors; None if it is not."""
        ratio = self._beside_arx(k)
        worse = ratio.standard_errors_above(1.0)
        if not worse > most:
            return None
        is_certain = ratio.value > _TENTH and worse > _SHOWN
        return Shortfall(WORSE_THAN_ARX, f"{ratio.value:.2f}", certain=is_certain)

    def _with_narrow_bands(self, k: int, most: float) -> Shortfall | None:
        """That its bands hold too few readings by more than `most` standard errors; None if they do not."""
        share = self.coverage[k] if self.coverage else math.nan
        number = self.independent[k] if self.independent else math.nan
        variance = CONFIDENCE * (1.0 - CONFIDENCE) / number
        missing = (CONFIDENCE - share) / math.sqrt(variance)
        if not missing > most:
            return None
        return Shortfall(
            BANDS_HOLD_TOO_FEW, f"{100 * share:.0f}", certain=missing > _SHOWN
        )

    def _is_far_behind_arx(self, k: int) -> bool:
        """Whether ARX is better by more than a tenth, by the end of the one-sided 95 % interval."""
        return self._beside_arx(k).standard_errors_above(_TENTH) > ONE_SIDED

    def _beside_persistence(self, k: int) -> _ErrorRatio:
        return _error_ratio(self.persistence_skill, self.persistence_skill_high, k)

    def _beside_arx(self, k: int) -> _ErrorRatio:
        return _error_ratio(self.arx_skill, self.arx_skill_high, k)


def _error_ratio(
    skills: tuple[float, ...], highs: tuple[float, ...], k: int
) -> _ErrorRatio:
    """The errors that a skill at the k-th horizon and the upper end of its interval stand for."""
    if not skills or not highs:
        return _ErrorRatio(math.nan, math.nan)
    return _ErrorRatio(1.0 - skills[k], 1.0 - highs[k])


@dataclass(frozen=True)
class SignalScore:
    """How well the leader has forecast one signal; figures at horizons as in `ForecastScore`."""

    signal: str
    """Name in the plant file."""
    miss: float
    """RMS over the newest samples of reading minus forecast, in half widths of the band."""
    inside: Annotated[float, SHARE]
    """Share of these samples in the band; 0.9 is expected."""
    coverage: Annotated[tuple[float, ...], _BY_HORIZON_OF_SIGNAL, SHARE]
    """At each horizon, the share of the readings that the bands have held."""
    persistence_skill: Annotated[tuple[float, ...], _BY_HORIZON_OF_SIGNAL]
    arx_skill: Annotated[tuple[float, ...], _BY_HORIZON_OF_SIGNAL]
    trusted: tuple[float, ...]
    """The horizons, s, at which the forecasts of this signal pass the test."""
