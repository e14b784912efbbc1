"""What a session comes down to: one line, the last lines, where forecasts held, JSON, a picture."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from tests.support.plants import Tank
from tests.support.rig import rig
from tests.support.verdicts import LED, NONE_YET, verdict
from twinmatch.comparing import TrustLevel
from twinmatch.errors import TwinmatchError
from twinmatch.offline.summary import SessionSummary, TrustRange, summarise, trust_range
from twinmatch.plants import Peltier
from twinmatch.showing.figures.session import draw_verdict
from twinmatch.showing.summary import closing_lines, document, sentence
from twinmatch.signals import Sample
from twinmatch.twin import TwinSettings

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
            {"fit_y": -1.003},
            "Nominal: 70 °C set; orders 22221; left without readings it drifts off (temperature fit "
            "−100.3 %), from the newest readings it forecasts well; trust it between 25 and 92 °C.",
        ),
        (
            {"beaten": "10 s ahead its forecasts are worse than an ARX model"},
            "Nominal: 70 °C set; orders 22221; temperature fit 98.8 %; trust it between 25 and 92 °C, but "
            "10 s ahead its forecasts are worse than an ARX model.",
        ),
        (
            {"level": TrustLevel.DOUBTFUL, "beaten": "10 s ahead its forecasts are worse than an ARX model"},
            "Nominal: 70 °C set; orders 22221; temperature fit 98.8 %; doubtful now: 10 s ahead its "
            "forecasts are worse than an ARX model (it held between 25 and 92 °C).",
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


def test_the_end_is_notes_leader_nominal_structure_and_the_sentence() -> None:
    summary = SessionSummary("50 °C", TrustLevel.TRUSTED, None, 0.98, 0.9, 5, 2, {}, notes=("cut short",))
    lines = closing_lines(summary, LED)
    assert lines[:3] == [
        "Note: cut short",
        "The leader is the twin to ask what comes next, the nominal one the centre of the family.",
        "Certainty: 50 °C is the only candidate.",
    ]
    assert lines[3].startswith("Structure: the samples justify sink with mass (α 63.0 mV/K, R 3.30 Ω, ")
    assert lines[3].endswith(", L 5.00 A).")
    assert lines[4] == sentence(summary)
    assert closing_lines(summary, None) == [lines[0], lines[4]]


def test_where_forecasts_held_is_rounded_to_the_inside_and_to_the_plants_places() -> None:
    found = trust_range(replace(LED, held_low=22.3, held_high=89.7), Peltier.output)
    assert found == TrustRange(22.3, 89.7, "°C")
    assert str(found) == "23 and 89 °C"
    # Readings of the tank have a noise of 0.005 l/s; in whole litres there would be no range at all.
    small = trust_range(replace(LED, held_low=0.612, held_high=0.977), Tank.output)
    assert str(small) == "0.62 and 0.97 l/s"
    assert str(TrustRange(0.302, 0.309, "l/s", 2)) == "0.30 and 0.31 l/s"  # nothing is left to round away
    assert math.isnan(LED.held_low)
    assert trust_range(LED, Peltier.output) is None


MATCHED = [verdict(TrustLevel.TRUSTED, stands=False)]
GAINS = TwinSettings().gains


def samples(count: int = 400) -> list[Sample]:
    return [Sample(k, k * 10**9, 50.0 + (k > 200) * 10, 50.0 + 0.01 * k, 90.0 + k % 3) for k in range(count)]


def test_the_summary_is_a_sentence_with_the_parameters_and_the_fit() -> None:
    summary = summarise(samples(), MATCHED, GAINS)
    text = sentence(summary)
    assert text.startswith("Nominal: 50 °C set; orders 22221; temperature fit ")
    assert f"{100 * summary.fit_y:.1f} %".replace("-", "−") in text
    none = summarise(samples(), [], GAINS)
    assert "No nominal twin" in sentence(none)
    assert none.level is TrustLevel.UNKNOWN


def test_the_document_is_strict_json() -> None:
    verdicts = [NONE_YET, *MATCHED]
    entry = document("s", verdicts, summarise(samples(), verdicts, GAINS))
    back = json.loads(json.dumps(entry, allow_nan=False))
    assert (back["verdicts"][0]["driven_rms_y"], back["verdicts"][0]["closed_rms_u"]) == (None, None)
    assert back["verdicts"][1]["candidates"][0]["parameters"]["seebeck"] == 0.06
    assert back["verdicts"][1]["candidates"][0]["orders"][0]["total"]["gain"] == 1200


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_the_figure_is_drawn_of_a_session_with_gaps_too(ending: str, tmp_path: Path) -> None:
    broken, path = samples()[:100] + samples()[150:], tmp_path / f"verdict.{ending}"
    draw_verdict(broken, MATCHED, TwinSettings(), path)
    assert path.stat().st_size > 5000
    summary = summarise(broken, MATCHED, GAINS)
    assert math.isfinite(summary.fit_y)
    assert "samples 150 to 399, the longest of 2 unbroken stretches" in summary.notes[0]


def test_a_figure_that_cannot_be_written_is_one_message(tmp_path: Path) -> None:
    with pytest.raises(TwinmatchError, match="cannot be written"):
        draw_verdict(samples(), [], TwinSettings(), tmp_path / "verdict.docx")
