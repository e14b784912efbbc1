"""Whatever shows a plant calls it by its own names and units, and by nobody else's."""

from __future__ import annotations

import base64
import html
import json
import re
from pathlib import Path

import pytest

from tests.words.conftest import Shown
from twinmatch.cli import main

Capture = pytest.CaptureFixture[str]


def said(capsys: Capture, *words: object) -> str:
    capsys.readouterr()
    assert main([str(word) for word in words]) == 0
    printed = capsys.readouterr()
    return printed.out + printed.err


def test_a_replay_speaks_of_the_plant(shown: Shown, tmp_path: Path, capsys: Capture) -> None:
    out, picture = tmp_path / "out.json", tmp_path / "out.svg"
    text = said(capsys, "replay", shown.folder, "--config", shown.config, "--json", out, "--figure", picture)
    shown.speaks_of_itself(text)
    shown.speaks_of_itself(json.dumps(json.loads(out.read_text("utf-8")), ensure_ascii=False))
    assert re.search("drive-lost|sensor-frozen", text)


def test_a_forecast_speaks_of_the_plant(shown: Shown, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "out.json"
    asked = ("--at", 1000, "--horizon", 10, "--json", out)
    text = said(capsys, "forecast", shown.folder, "--config", shown.config, *asked)
    shown.speaks_of_itself(text)
    shown.speaks_of_itself(out.read_text("utf-8"), '"y"')


def test_a_backtest_speaks_of_the_plant(shown: Shown, capsys: Capture) -> None:
    text = said(capsys, "backtest", shown.folder, "--config", shown.config, "--horizon", 5)
    shown.speaks_of_itself(text)


def test_a_report_speaks_of_the_plant(shown: Shown, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "report.html"
    text = said(capsys, "report", shown.folder, "--config", shown.config, "-o", out)
    shown.speaks_of_itself(text, str(out))
    page = re.sub(r"data:[^\"]*", "", out.read_text("utf-8"))
    page = re.sub(r"<style>.*?</style>", "", page, flags=re.DOTALL)
    shown.speaks_of_itself(html.unescape(re.sub(r"<[^>]*>", " ", page)))
    shown.speaks_of_itself(html.unescape(" ".join(re.findall(r'alt="([^"]*)"', page))))
    drawn = re.findall(r"data:image/svg\+xml;base64,([^\"]*)", out.read_text("utf-8"))
    lettering = re.findall(r"<!-- (.*?) -->", "".join(base64.b64decode(p).decode("utf-8") for p in drawn))
    shown.speaks_of_itself(" ".join(lettering), *shown.words)


def test_an_archive_speaks_of_the_plant(shown: Shown, tmp_path: Path, capsys: Capture) -> None:
    text = said(capsys, "replay", shown.folder, "--config", shown.config, "--out", tmp_path / "archive")
    shown.speaks_of_itself(text, shown.plant.output.unit)
