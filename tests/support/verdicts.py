"""Verdicts as tests need them: one candidate matched at 50 °C, and nothing else said."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from tests.support.rig import rig
from twinmatch.comparing import (
    CandidateScore,
    ForecastScore,
    OrderScore,
    TrustLevel,
    Verdict,
)
from twinmatch.comparing.criteria import Criteria

CRITERIA = Criteria(1000, 400, 600, 0.6, 1.5, 900.0, 40.0)
CANDIDATE = CandidateScore(
    name="50 °C",
    operating_point=50.0,
    parameters=rig(seebeck=0.06),
    first=0,
    last=299,
    orders=tuple(
        OrderScore(o, CRITERIA, CRITERIA, CRITERIA + CRITERIA)
        for o in ("22221", "33331")
    ),
    chosen_order="22221",
    nu_gap_sum=0.25,
    newest=None,
    nu_gap_to_plant=0.125,
)


def verdict(
    level: TrustLevel, sample: int = 300, *, nominal: str | None = "50 °C", **more: Any
) -> Verdict:
    """A verdict that repeats the one before, unless more is said of it."""
    has_nominal = nominal is not None
    usual: dict[str, Any] = {
        **{
            "sample": sample,
            "first": 0,
            "last": sample - 1,
            "level": level,
            "stands": True,
        },
        **{
            "nominal": nominal,
            "order": "22221" if has_nominal else None,
            "reason": "because",
            "decimals": 2,
        },
        "level_reason": f"it is {level.value}",
        "candidates": (replace(CANDIDATE, name=nominal),)
        if nominal is not None
        else (),
        "nu_gap": ((0.0,),) if has_nominal else (),
        "driven_rms_y": 0.5 if has_nominal else math.nan,
        "closed_rms_u": 7.0 if has_nominal else math.nan,
    }
    return Verdict(**usual | more)


NONE_YET = verdict(TrustLevel.UNKNOWN, nominal=None)
LED = verdict(
    TrustLevel.TRUSTED,
    stands=False,
    reason="candidate 50 °C matched on samples 0 to 299",
    decided=True,
    certainty="50 °C is the only candidate",
    structure="sink with mass",
    structure_parameters=rig(seebeck=0.063),
    leader="sink with mass",
    leader_confidence=0.84,
    forecasts=(ForecastScore("sink with mass", rig(), 0, 299, 9.25, (9.25,), 7.0),),
    miss_y=0.5,
    miss_u=0.7,
)
"""With a leader, a structure, and forecasts that have come true."""
