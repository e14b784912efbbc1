"""The report as a user asks for it, and as a browser prints it."""

from __future__ import annotations

import base64
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from pypdf import PdfReader

from tests.support.places import CHROMIUM
from tests.support.processes import run_twinmatch
from tests.support.steps import quarter_of_an_hour
from twinmatch.sessions import write_session


def test_report_and_figures_are_written_and_named(tmp_path: Path) -> None:
    """Of a session too short for a twin, whose report is soon made."""
    session = write_session(tmp_path / "minute", quarter_of_an_hour()[:60])
    completed = run_twinmatch(
        "report", session, "--figures", "figures", "--format", "pdf", folder=tmp_path
    )
    assert completed.returncode == 0, completed.stderr
    assert completed.stdout.startswith("No twin to trust yet")
    assert "report: minute.html" in completed.stdout
    assert "figures: 2 PDF files in figures" in completed.stdout
    assert "twinmatch report" in (tmp_path / "minute.html").read_text(encoding="utf-8")
    figures = {path.name: PdfReader(path) for path in (tmp_path / "figures").iterdir()}
    assert figures.keys() == {"session.pdf", "health.pdf"}
    assert all(len(figure.pages) == 1 for figure in figures.values())


def without_most_drawings(document: str) -> str:
    """All drawings but the last empty, of the same size: a PDF with all their lines is read slowly."""
    pictures = re.findall(r"data:image/svg\+xml;base64,([^\"]+)", document)
    for coded in pictures[:-1]:
        empty = re.sub(
            rb"(<svg[^>]*>).*(</svg>)",
            rb"\1\2",
            base64.b64decode(coded),
            flags=re.DOTALL,
        )
        document = document.replace(coded, base64.b64encode(empty).decode())
    return document


def test_it_prints_on_numbered_a4_pages(shipped_page: str, tmp_path: Path) -> None:
    chromium = (
        shutil.which("chromium")
        or shutil.which("chromium-browser")
        or shutil.which("google-chrome")
    )
    if chromium is None:
        pytest.skip("chromium is not installed: apt-get install chromium")
    places = (
        f"--user-data-dir={tmp_path / 'profile'}",
        f"--print-to-pdf={tmp_path / 'report.pdf'}",
    )
    printed = tmp_path / "report.html"
    printed.write_text(without_most_drawings(shipped_page), encoding="utf-8")
    command = [
        chromium,
        "--headless=new",
        *CHROMIUM,
        "--no-pdf-header-footer",
        *places,
        printed.as_uri(),
    ]
    subprocess.run(command, check=True, capture_output=True, timeout=360)
    pages = PdfReader(tmp_path / "report.pdf").pages
    assert 5 <= len(pages) <= 15
    texts = [page.extract_text() for page in pages]
    for number, (page, text) in enumerate(zip(pages, texts, strict=True), 1):
        width, height = (
            float(v) / 72 * 25.4 for v in (page.mediabox.width, page.mediabox.height)
        )
        assert (width, height) == pytest.approx((210, 297), abs=1)
        assert f"{number} / {len(pages)}" in text
    whole = " ".join(" ".join(texts).split())
    for title in (
        "Summary",
        "2. Health over time",
        "3. What comes next",
        "6. Which model order",
    ):
        assert title in whole
    pixels = sum(len(page.images) for page in pages)
    assert pixels <= 2, (
        "but for the heat map and its colour bar pictures stay drawings, sharp at any size"
    )
