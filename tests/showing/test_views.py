"""What people and programs are shown."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path

import pytest
from rich.console import Console

from tests.support.rig import rig
from twinmatch.comparing import CandidateScore, Criteria, OrderScore, TrustLevel, Verdict
from twinmatch.errors import TwinmatchError
from twinmatch.offline.summary import summarise
from twinmatch.showing.figures.session import draw_verdict
from twinmatch.showing.lines import Lines
from twinmatch.showing.summary import document, sentence
from twinmatch.showing.verdicts import COLUMNS, News, news, row
from twinmatch.signals import Sample
from twinmatch.twin import TwinSettings

CRITERIA = Criteria(1000, 400, 600, 0.6, 1.5, 900.0, 40.0)
CANDIDATE = CandidateScore(
    name="50 °C",
    operating_point=50.0,
    parameters=rig(seebeck=0.06),
    first=0,
    last=299,
    orders=tuple(OrderScore(o, CRITERIA, CRITERIA, CRITERIA + CRITERIA) for o in ("22221", "33331")),
    chosen_order="22221",
    nu_gap_sum=0.0,
    newest=None,
    nu_gap_to_plant=None,
)


def verdict(level: TrustLevel, *, stands: bool, nominal: str | None = "50 °C", sample: int = 300) -> Verdict:
    return Verdict(
        sample=sample,
        first=0,
        last=sample - 1,
        level=level,
        stands=stands,
        nominal=nominal,
        reason="because",
        decimals=2,
        candidates=(CANDIDATE,) if nominal else (),
        order="22221" if nominal else None,
        nu_gap=((0.0,),) if nominal else (),
        driven_rms_y=0.5 if nominal else math.nan,
        closed_rms_u=7.0 if nominal else math.nan,
    )


def samples(count: int = 400) -> list[Sample]:
    return [Sample(k, k * 10**9, 50.0 + (k > 200) * 10, 50.0 + 0.01 * k, 90.0 + k % 3) for k in range(count)]


def test_a_row_has_a_cell_per_column_and_dashes_where_nothing_is_known() -> None:
    known = row(verdict(TrustLevel.TRUSTED, stands=False))
    unknown = row(verdict(TrustLevel.UNKNOWN, stands=True, nominal=None))
    assert len(known) == len(unknown) == len(COLUMNS)
    assert known[1:7] == ("trusted", "–", "50 °C", "22221", "1200", "0.000")
    assert set(unknown[2:10]) == {"–"}


def test_news_are_what_was_identified_or_changed() -> None:
    story = [
        verdict(TrustLevel.UNKNOWN, stands=True, nominal=None),
        verdict(TrustLevel.UNKNOWN, stands=True, nominal=None),
        verdict(TrustLevel.TRUSTED, stands=False),
        verdict(TrustLevel.TRUSTED, stands=True),
        verdict(TrustLevel.TRUSTED, stands=False),
        verdict(TrustLevel.FAULT, stands=True),
        verdict(TrustLevel.FAULT, stands=True),
    ]
    assert [story.index(v) for v in news(story)] == [0, 2, 2, 5]
    assert News().is_new(story[3])


def test_lines_have_no_colour_in_a_pipe() -> None:
    stream = io.StringIO()
    console = Console(file=stream, width=80)
    lines = Lines(1.0, console)
    lines.open()
    lines.take_verdict(verdict(TrustLevel.FAULT, stands=False))
    header, line = stream.getvalue().splitlines()
    assert "\x1b" not in stream.getvalue()
    assert header.index("level") == line.index("fault")
    assert line.endswith("because")


def test_the_summary_is_a_sentence_with_the_parameters_and_the_fit() -> None:
    settings = TwinSettings()
    summary = summarise(samples(), [verdict(TrustLevel.TRUSTED, stands=False)], settings.gains)
    text = sentence(summary)
    assert text.startswith("Nominal: 50 °C set; orders 22221; temperature fit ")
    assert f"{100 * summary.fit_y:.1f} %".replace("-", "−") in text
    none = summarise(samples(), [], settings.gains)
    assert "No nominal twin" in sentence(none)
    assert none.level is TrustLevel.UNKNOWN


def test_the_document_is_strict_json() -> None:
    verdicts = [
        verdict(TrustLevel.UNKNOWN, stands=True, nominal=None),
        verdict(TrustLevel.TRUSTED, stands=False),
    ]
    entry = document("s", verdicts, summarise(samples(), verdicts, TwinSettings().gains))
    back = json.loads(json.dumps(entry, allow_nan=False))
    assert (back["verdicts"][0]["driven_rms_y"], back["verdicts"][0]["closed_rms_u"]) == (None, None)
    assert back["verdicts"][1]["candidates"][0]["parameters"]["seebeck"] == 0.06
    assert back["verdicts"][1]["candidates"][0]["orders"][0]["total"]["gain"] == 1200


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_the_figure_is_drawn(ending: str, tmp_path: Path) -> None:
    verdicts = [verdict(TrustLevel.TRUSTED, stands=False)]
    path = tmp_path / f"verdict.{ending}"
    draw_verdict(samples(), verdicts, TwinSettings(), path)
    assert path.stat().st_size > 5000


def test_a_figure_that_cannot_be_written_is_one_message(tmp_path: Path) -> None:
    with pytest.raises(TwinmatchError, match="cannot be written"):
        draw_verdict(samples(), [], TwinSettings(), tmp_path / "verdict.docx")


def test_a_session_with_gaps_is_summed_up_and_drawn_all_the_same(tmp_path: Path) -> None:
    broken = samples()[:100] + samples()[150:]
    verdicts = [verdict(TrustLevel.TRUSTED, stands=False)]
    summary = summarise(broken, verdicts, TwinSettings().gains)
    assert math.isfinite(summary.fit_y)
    assert "samples 150 to 399, the longest of 2 unbroken stretches" in summary.notes[0]
    draw_verdict(broken, verdicts, TwinSettings(), tmp_path / "verdict.png")
