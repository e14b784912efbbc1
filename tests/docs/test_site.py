"""The pages of docs/ build into a site without a warning, and all of them are in it."""

from __future__ import annotations

import html
import importlib.util
import inspect
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

MISSING = [
    name
    for name in ("sphinx", "myst_nb", "furo")
    if importlib.util.find_spec(name) is None
]
pytestmark = [
    pytest.mark.skipif(
        bool(MISSING), reason=f"{MISSING} not installed; they are in the extra 'docs'"
    ),
    pytest.mark.long("builds the whole site, and runs its notebook"),
]

DOCS = Path(__file__).resolve().parents[2] / "docs"
BUILD = """
import gc, sys
from sphinx.builders.html import StandaloneHTMLBuilder
from sphinx.cmd.build import main
gc.set_threshold(100_000, 50, 100)
StandaloneHTMLBuilder.search = False
sys.exit(main())
"""
"""As `python -m sphinx`, but without an index of all words, and looking less often for circles among millions
of nodes."""
ROOMS = sorted(
    page.stem for page in (DOCS / "api").glob("*.md") if page.stem != "index"
)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Without a theme, sources and the objects in the tables of contents, which take half of the time."""
    folder = tmp_path_factory.mktemp("site")
    plain = (
        "toc_object_entries=0",
        "html_theme=basic",
        "html_copy_source=0",
        "html_use_index=0",
    )
    options = [word for setting in plain for word in ("-D", setting)]
    places = ["-d", folder / "trees", DOCS, folder / "html"]
    command = [
        sys.executable,
        "-c",
        BUILD,
        "-q",
        "-W",
        "--keep-going",
        *options,
        *places,
    ]
    completed = subprocess.run(command, capture_output=True, text=True, check=False)
    assert completed.returncode == 0, completed.stderr
    return folder / "html"


def is_public(module: ModuleType, name: str, member: object) -> bool:
    """Whether a class or function is listed by its room, or defined in a file that has no list."""
    listed = getattr(module, "__all__", None)
    is_defined_here = getattr(
        member, "__module__", ""
    ) == module.__name__ and not name.startswith("_")
    return (inspect.isclass(member) or inspect.isfunction(member)) and (
        is_defined_here if listed is None else name in listed
    )


def test_every_page_is_there(site: Path) -> None:
    """And can be found from the first: Sphinx warns of one that is in no table of contents."""
    pages = [*DOCS.rglob("*.md"), *DOCS.rglob("*.ipynb")]
    assert all(
        (site / page.relative_to(DOCS).with_suffix(".html")).is_file() for page in pages
    )
    assert "orphan" not in "".join(page.read_text("utf-8")[:200] for page in pages)


def described_and_offered(site: Path, room: str) -> tuple[set[str], set[str]]:
    """Classes and functions on a room's page, and those of the modules that the page names: a room, or those
    files of it that others import from."""
    modules = re.findall(
        r"automodule:: (\S+)", (DOCS / "api" / f"{room}.md").read_text("utf-8")
    )
    page = html.unescape((site / "api" / f"{room}.html").read_text("utf-8"))
    described = set(re.findall(r'id="(twinmatch\.[\w.]+)"', page))
    offered = {
        f"{module}.{name}"
        for module in modules
        for name, member in vars(importlib.import_module(module)).items()
        if is_public(importlib.import_module(module), name, member)
    }
    return described, offered


def test_the_api_has_every_class_and_function_that_a_room_offers(site: Path) -> None:
    for room in ROOMS:
        described, offered = described_and_offered(site, room)
        assert offered, room
        assert offered <= described, room


def test_the_notebook_shows_what_it_found(site: Path) -> None:
    page = (site / "notebooks" / "recording_to_verdict.html").read_text("utf-8")
    assert "cell_output" in page
    assert "<img" in page
