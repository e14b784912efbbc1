"""Whatever shows a plant calls it by its own names and units, and by nobody else's."""

from __future__ import annotations

import base64
import html
import io
import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip(
    "bokeh", reason="bokeh is not installed; it is in the extra 'dashboard'"
)

from bokeh.core.json_encoder import serialize_json
from bokeh.document import Document
from rich.console import Console

from tests.showing.page.test_page import Nothing
from tests.words.conftest import FOREIGN, Shown
from twinmatch.cli import main
from twinmatch.plants.records import description_of
from twinmatch.sessions import read_session, write_session
from twinmatch.showing.forecasts import backtest_tables, backtest_words
from twinmatch.showing.foxglove.layout import layout
from twinmatch.showing.page.state import DashboardState, TwinRow, update_sentence
from twinmatch.showing.page.tab import Tab
from twinmatch.showing.report.report import (
    JudgedSession,
    build_report,
    judge_for_report,
)
from twinmatch.twin import Mirror

Capture = pytest.CaptureFixture[str]
FIRST_MATCH = 500
"""Samples after which the first twin is matched: the first set-point step is that of sample 240."""


def printed_by(capsys: Capture, *words: object) -> str:
    capsys.readouterr()
    assert main([str(word) for word in words]) == 0
    printed = capsys.readouterr()
    return printed.out + printed.err


def test_a_replay_uses_the_plants_words(
    shown: Shown, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out.json"
    picture = tmp_path / "out.svg"
    text = printed_by(
        capsys,
        "replay",
        shown.folder,
        "--config",
        shown.config,
        "--json",
        out,
        "--figure",
        picture,
    )
    shown.speaks_of_itself(text)
    shown.speaks_of_itself(
        json.dumps(json.loads(out.read_text("utf-8")), ensure_ascii=False)
    )
    assert re.search("drive-lost|sensor-frozen", text)


def test_a_forecast_uses_the_plants_words(
    shown: Shown, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out.json"
    asked = ("--at", 700, "--horizon", 10, "--json", out)
    text = printed_by(
        capsys, "forecast", shown.folder, "--config", shown.config, *asked
    )
    shown.speaks_of_itself(text)
    shown.speaks_of_itself(out.read_text("utf-8"), '"y"')


@pytest.fixture(scope="session")
def judged(shown: Shown) -> JudgedSession:
    """The plant's session, judged once for the report, the scores and the page."""
    return judge_for_report(shown.folder, shown.config)


def test_a_backtest_uses_the_plants_words(shown: Shown, judged: JudgedSession) -> None:
    """What `twinmatch backtest` prints of the forecasts that a report scores, too."""
    printed = io.StringIO()
    console = Console(file=printed, width=140)
    for table in backtest_tables(judged.tested):
        console.print(table)
    for line in backtest_words(judged.tested):
        console.print(line)
    shown.speaks_of_itself(printed.getvalue())


def test_a_report_uses_the_plants_words(shown: Shown, judged: JudgedSession) -> None:
    report = build_report(judged, shown.folder)
    document = report.html()
    shown.speaks_of_itself(report.sentence, shown.plant.output.unit)
    page = re.sub(r"data:[^\"]*", "", document)
    page = re.sub(r"<style>.*?</style>", "", page, flags=re.DOTALL)
    shown.speaks_of_itself(html.unescape(re.sub(r"<[^>]*>", " ", page)))
    shown.speaks_of_itself(html.unescape(" ".join(re.findall(r'alt="([^"]*)"', page))))
    drawn = re.findall(r"data:image/svg\+xml;base64,([^\"]*)", document)
    lettering = re.findall(
        r"<!-- (.*?) -->", "".join(base64.b64decode(p).decode("utf-8") for p in drawn)
    )
    shown.speaks_of_itself(" ".join(lettering), *shown.words)


def lettering(document: Document) -> str:
    """Every text that a page's document shows."""

    def texts(node: object) -> Iterator[str]:
        if isinstance(node, dict) and node.get("visible", True):
            for name, value in node.items():
                if name not in {"stylesheets", "name", "type", "id"}:
                    yield from texts(value)
        elif isinstance(node, list):
            for value in node:
                yield from texts(value)
        elif isinstance(node, str):
            yield node

    return html.unescape(
        re.sub(
            r"<[^>]*>",
            " ",
            "\n".join(texts(json.loads(serialize_json(document.to_json())))),
        )
    )


def test_a_page_that_knows_no_plant_yet_uses_nobodys_words() -> None:
    document = Document()
    Tab(DashboardState(), Nothing(), clock=lambda: 0.0).build(document)
    text = lettering(document)
    assert "set-point" in text
    assert not FOREIGN.findall(text)


def test_a_page_uses_the_plants_words(shown: Shown, judged: JudgedSession) -> None:
    judgement = judged.judgement
    state = DashboardState()
    state.describe(description_of(shown.plant))
    page = Tab(state, Nothing(), clock=lambda: 0.0)
    document = Document()
    page.build(document)
    mirror = Mirror(judgement.settings.start, judgement.settings.law)
    for sample in judgement.samples:
        state.push_sample(sample, 0.0)
        twin = mirror.push(sample)
        state.push_twin(
            sample.index,
            TwinRow(**{name: getattr(twin, name)[0] for name in TwinRow._fields}),
        )
    for verdict in judgement.verdicts:
        state.push_verdict(verdict)
    update_sentence(state, judgement.settings)
    page.update()
    text = lettering(document) + document.title
    shown.speaks_of_itself(
        text, shown.plant.title, *shown.words, f"plant − twin / {shown.words[1]}"
    )


def test_a_viewer_is_given_axes_with_the_plants_words(shown: Shown) -> None:
    viewer_layout = layout(description_of(shown.plant), rig="/rig_a")
    shown.speaks_of_itself(
        json.dumps(viewer_layout, ensure_ascii=False).replace("/rig_a/", "")
    )
    y = shown.plant.output
    u = shown.plant.drive
    axes = [
        p["yAxisLabel"]
        for name, p in viewer_layout["configById"].items()
        if name.startswith("Plot!")
    ]
    assert axes == [f"{q.name} / {q.unit}" for q in (y, u, y, u, y, u)]
    topics = set(re.findall(r'"(/[a-z_/]+)', json.dumps(viewer_layout)))
    assert {topic for topic in topics if not topic.startswith("/rig_a/")} == {
        "/diagnostics",
        "/rosout",
    }


def test_an_archive_uses_the_plants_words(
    shown: Shown, tmp_path: Path, capsys: Capture
) -> None:
    samples = read_session(shown.folder).samples[:FIRST_MATCH]
    session = write_session(tmp_path / "half", samples)
    text = printed_by(
        capsys,
        "replay",
        session,
        "--config",
        shown.config,
        "--out",
        tmp_path / "archive",
    )
    shown.speaks_of_itself(text, shown.plant.output.unit)
