"""The report as a user asks for it, and as a browser prints it."""

from __future__ import annotations

import base64
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support.places import CHROMIUM
from tests.support.processes import run_twinmatch
from tests.support.steps import quarter_of_an_hour
from twinmatch.sessions import write_session


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Written with its figures beside it."""
    folder = tmp_path_factory.mktemp("report")
    session = write_session(folder / "quarter", quarter_of_an_hour()[:400])
    completed = run_twinmatch("report", session, "--figures", "figures", "--format", "pdf", folder=folder)
    assert completed.returncode == 0, completed.stderr
    assert completed.stdout.startswith("Leader: ")
    assert "report: quarter.html" in completed.stdout
    return folder / "quarter.html"


def test_report_and_figures_are_written_and_named(report: Path) -> None:
    from pypdf import PdfReader

    assert "twinmatch report" in report.read_text(encoding="utf-8")
    figures = {path.name: PdfReader(path) for path in (report.parent / "figures").iterdir()}
    assert figures.keys() >= {"session.pdf", "nu_gap.pdf"}
    assert all(len(figure.pages) == 1 for figure in figures.values())


def without_most_drawings(document: str) -> str:
    """All but the last two pictures empty, of the same size: a PDF with all their lines is read slowly."""
    pictures = re.findall(r"data:image/svg\+xml;base64,([^\"]+)", document)
    for coded in pictures[:-2]:
        empty = re.sub(rb"(<svg[^>]*>).*(</svg>)", rb"\1\2", base64.b64decode(coded), flags=re.DOTALL)
        document = document.replace(coded, base64.b64encode(empty).decode())
    return document


def test_it_prints_on_numbered_a4_pages(report: Path, tmp_path: Path) -> None:
    from pypdf import PdfReader

    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("chromium is not installed: apt-get install chromium")
    places = (f"--user-data-dir={tmp_path / 'profile'}", f"--print-to-pdf={tmp_path / 'report.pdf'}")
    printed = tmp_path / "report.html"
    printed.write_text(without_most_drawings(report.read_text(encoding="utf-8")), encoding="utf-8")
    command = [chromium, "--headless=new", *CHROMIUM, "--no-pdf-header-footer", *places, printed.as_uri()]
    subprocess.run(command, check=True, capture_output=True, timeout=360)
    pages = PdfReader(tmp_path / "report.pdf").pages
    assert 5 <= len(pages) <= 15
    texts = [page.extract_text() for page in pages]
    for number, (page, text) in enumerate(zip(pages, texts, strict=True), 1):
        width, height = (float(v) / 72 * 25.4 for v in (page.mediabox.width, page.mediabox.height))
        assert (width, height) == pytest.approx((210, 297), abs=1)
        assert f"{number} / {len(pages)}" in text
    whole = " ".join(" ".join(texts).split())
    for title in ("Summary", "2. Health over time", "3. What comes next", "6. Which model order"):
        assert title in whole
    pixels = sum(len(page.images) for page in pages)
    assert pixels <= 2, "but for the heat map and its colour bar pictures stay drawings, sharp at any size"
