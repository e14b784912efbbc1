"""The test of trust as docs/method.md and its decision record describe it, computed from recorded figures."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from twinmatch.comparing import Verdict
from twinmatch.record.trees import documents_of

Document = Mapping[str, Any]
"""A verdict, or a part of it, as it is written into JSON."""
_ONE_SIDED: Final = 1.645
"""Of the ends of intervals that are recorded."""


def documents_of_verdicts(verdicts: Iterable[Verdict]) -> list[Document]:
    """Verdicts as `replay --json` writes them."""
    return [*documents_of(verdicts)]


def check_trust(verdicts: Sequence[Document], outputs: Sequence[str] = ()) -> None:
    """Check the trusted horizons of a session's verdicts.

    A horizon is trusted if the test passes with the figures of that very verdict; where the verdict before
    trusted it, if the contrary is not shown. `outputs` are the names of several outputs, each of which has to
    pass alone, too.
    """
    trusted_before: list[float] = []
    for verdict in verdicts:
        trusted = list(verdict["trusted"])
        expected = _horizons_that_pass(verdict, trusted_before, outputs)
        assert trusted == expected, f"sample {verdict['sample']}"
        trusted_before = trusted


def _horizons_that_pass(
    verdict: Document, trusted_before: Sequence[float], outputs: Sequence[str]
) -> list[float]:
    leading = [
        score for score in verdict["forecasts"] if score["name"] == verdict["leader"]
    ]
    if not leading:
        return []
    [score] = leading
    horizons = [
        horizon
        for k, horizon in enumerate(verdict["horizons"])
        if _passes(score, k, was_trusted=horizon in trusted_before)
    ]
    alone = [signal for signal in verdict["signals"] if signal["signal"] in outputs]
    return [
        horizon
        for horizon in horizons
        if all(horizon in signal["trusted"] for signal in alone)
    ]


def _passes(score: Document, k: int, *, was_trusted: bool) -> bool:
    beats_no_change = _beats_no_change(score, k, was_trusted=was_trusted)
    behind_arx = _is_behind_arx(score, k, was_trusted=was_trusted)
    beaten_sooner = any(_is_far_behind_arx(score, shorter) for shorter in range(k))
    bands_hold = _bands_hold(score, k, was_trusted=was_trusted)
    return beats_no_change and not (behind_arx or beaten_sooner) and bands_hold


def _errors(score: Document, baseline: str, k: int) -> tuple[float, float]:
    """Logarithm of how many times a baseline's error its own is, and the standard error of that; NaN where
    too few forecasts were compared."""
    skills = score[f"{baseline}_skill"]
    highs = score[f"{baseline}_skill_high"]
    if not skills or skills[k] is None or math.isnan(skills[k]):
        return math.nan, math.nan
    log_ratio = math.log(1.0 - skills[k])
    return log_ratio, (log_ratio - math.log(1.0 - highs[k])) / _ONE_SIDED


def _beats_no_change(score: Document, k: int, *, was_trusted: bool) -> bool:
    """Better by 2.5 standard errors; once trusted, until no change is as good."""
    log_ratio, error = _errors(score, "persistence", k)
    return log_ratio < (0.0 if was_trusted else -2.5 * error)


def _is_behind_arx(score: Document, k: int, *, was_trusted: bool) -> bool:
    """Worse by 1.25 standard errors; once trusted, by the upper end of the interval of its skill."""
    log_ratio, error = _errors(score, "arx", k)
    return log_ratio > (_ONE_SIDED if was_trusted else 1.25) * error


def _is_far_behind_arx(score: Document, k: int) -> bool:
    """Worse by more than a tenth, by the upper end of the interval of its skill."""
    log_ratio, error = _errors(score, "arx", k)
    return log_ratio - _ONE_SIDED * error > math.log(1.1)


def _bands_hold(score: Document, k: int, *, was_trusted: bool) -> bool:
    """Not below 90 % by 1.25 standard errors, or 2.5 once trusted, of as many forecasts as do not overlap."""
    coverage = score["coverage"][k]
    number = score["independent"][k]
    if coverage is None or number is None or math.isnan(coverage):
        return True
    errors = (0.9 - coverage) / math.sqrt(0.9 * 0.1 / number)
    return bool(errors <= (2.5 if was_trusted else 1.25))
