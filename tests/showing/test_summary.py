"""The one line that a session comes down to."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.support.rig import rig
from twinmatch.comparing import TrustLevel
from twinmatch.offline.summary import SessionSummary, TrustRange
from twinmatch.plants import Peltier
from twinmatch.showing.summary import sentence

SINK = Peltier.model("sink with mass").parameters()
SUMMARY = SessionSummary(
    nominal="70 °C",
    level=TrustLevel.TRUSTED,
    parameters=rig(),
    fit_y=0.9881,
    fit_u=0.9,
    verdicts=5,
    identified=2,
    matches={},
    order="22221",
    range=TrustRange(24.3, 92.7, "°C"),
)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            {},
            "Nominal: 70 °C set; orders 22221; temperature fit 98.8 %; trust it between 25 and 92 °C.",
        ),
        (
            {"leader": "70 °C"},
            "Leader and nominal: 70 °C set; orders 22221; temperature fit 98.8 %; trust it between 25 and "
            "92 °C.",
        ),
        (
            {"leader": "50 °C"},
            "Leader: 50 °C set; temperature fit 98.8 %; trust it between 25 and 92 °C. Nominal: 70 °C set, "
            "orders 22221.",
        ),
        (
            {"leader": SINK.model.structure_name, "parameters": SINK, "nominal": None, "order": None},
            "Leader: sink with mass; temperature fit 98.8 %; trust it between 25 and 92 °C. Nominal: none, "
            "no valid match.",
        ),
        (
            {"leader": "50 °C", "nominal": "sink with mass", "order": ""},
            "Leader: 50 °C set; temperature fit 98.8 %; trust it between 25 and 92 °C. Nominal: sink with "
            "mass.",
        ),
        (
            {"leader": "50 °C", "closed": False},
            "Leader: match near 50 °C; temperature fit 98.8 %; trust it between 25 and 92 °C. Nominal: match "
            "near 70 °C, orders 22221.",
        ),
        (
            {"level": TrustLevel.DOUBTFUL},
            "Nominal: 70 °C set; orders 22221; temperature fit 98.8 %; doubtful now: measurements lie "
            "outside the bands (it held between 25 and 92 °C).",
        ),
        (
            {"level": TrustLevel.FAULT, "fault": "drive-lost"},
            "Nominal: 70 °C set; orders 22221; temperature fit 98.8 %; do not trust it now: the plant shows "
            "drive-lost (it held between 25 and 92 °C).",
        ),
        (
            {"level": TrustLevel.FAULT, "fault": "unexplained", "range": None, "fit_y": math.nan},
            "Nominal: 70 °C set; orders 22221; do not trust it now: no twin explains the plant's behaviour.",
        ),
        (
            {"range": None},
            "Nominal: 70 °C set; orders 22221; temperature fit 98.8 %; how far to trust it is not known yet.",
        ),
        (
            {"nominal": None, "level": TrustLevel.UNKNOWN},
            "No nominal twin: 5 verdicts, but no valid match. The loop needs set-point steps far "
            "above the noise, some minutes apart.",
        ),
        (
            {"nominal": None, "level": TrustLevel.UNKNOWN, "refusal": "match refused: C ended on 5 J/K"},
            "No nominal twin: 5 verdicts, but no valid match. Match refused: C ended on 5 J/K.",
        ),
        (
            {"nominal": None, "level": TrustLevel.FAULT, "fault": "drive-lost"},
            "No nominal twin: the plant shows drive-lost. Look at the plant first.",
        ),
    ],
)
def test_the_sentence(changes: dict[str, object], text: str) -> None:
    assert sentence(replace(SUMMARY, **changes)) == text  # type: ignore[arg-type]
