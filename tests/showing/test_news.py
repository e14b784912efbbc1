"""Which verdicts say something new."""

from __future__ import annotations

from dataclasses import replace

from twinmatch.comparing import ADMITTED, REFUSED, TrustLevel, Verdict
from twinmatch.offline.summary import Tally
from twinmatch.showing.verdicts import news

STANDS = Verdict(
    sample=0,
    first=0,
    last=0,
    level=TrustLevel.FAULT,
    stands=True,
    nominal="50 °C",
    reason="",
    decimals=2,
    candidates=(),
    order=None,
    nu_gap=(),
    driven_rms_y=0.5,
    closed_rms_u=7.0,
    decided=True,
    fault="unexplained",
)


def test_another_fault_at_the_same_level_and_a_choice_no_longer_sure_are_news() -> None:
    story = [
        STANDS,
        STANDS,
        replace(STANDS, fault="drive-lost"),
        replace(STANDS, fault="drive-lost"),
        replace(STANDS, fault="drive-lost", decided=False),
        replace(STANDS, fault="", decided=False),
        replace(STANDS, fault="", decided=False, nominal="70 °C"),
        replace(STANDS, fault="", decided=False, nominal="70 °C", level=TrustLevel.TRUSTED),
        replace(STANDS, fault="", decided=False, nominal="70 °C", level=TrustLevel.TRUSTED, stands=False),
    ]
    told = [replace(v, sample=place) for place, v in enumerate(story)]
    assert [v.sample for v in news(told)] == [0, 2, 4, 5, 6, 7, 8]


def test_a_refused_match_is_news_though_nothing_else_changes() -> None:
    """Otherwise a first match that is refused would leave no trace in the lines."""
    story = [
        STANDS,
        replace(STANDS, sample=1),
        replace(STANDS, sample=2, match=REFUSED, reason="match refused"),
    ]
    assert [v.sample for v in news([*story, replace(STANDS, sample=3)])] == [0, 2]


def test_the_summary_tells_the_last_refusal() -> None:
    told = [replace(STANDS, match=REFUSED, reason=f"match refused: {k}") for k in range(2)]
    tally = Tally([*told, replace(STANDS, match=ADMITTED, reason="admitted"), STANDS])
    assert tally.refusal == "match refused: 1"
    assert Tally([STANDS]).refusal == ""
