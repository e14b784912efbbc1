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

MISSING = [name for name in ("sphinx", "myst_nb", "furo") if importlib.util.find_spec(name) is None]
pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"{MISSING} not installed; they are in the extra 'docs'"
)

DOCS = Path(__file__).resolve().parents[2] / "docs"
ROOMS = sorted(page.stem for page in (DOCS / "api").glob("*.md") if page.stem != "index")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All but the objects in the tables of contents, which take a third of the time."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-D", "toc_object_entries=0"]
    places = ["-d", folder / "trees", DOCS, folder / "html"]
    done = subprocess.run([*command, *places], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder / "html"


def is_public(module: ModuleType, name: str, it: object) -> bool:
    """Whether a class or function is listed by its room, or defined in a file that has no list."""
    listed = getattr(module, "__all__", None)
    own = getattr(it, "__module__", "") == module.__name__ and not name.startswith("_")
    return (inspect.isclass(it) or inspect.isfunction(it)) and (own if listed is None else name in listed)


def test_every_page_can_be_found_from_the_first(site: Path) -> None:
    pages = [path.relative_to(DOCS).with_suffix(".html") for path in DOCS.rglob("*.md")]
    pages += [path.relative_to(DOCS).with_suffix(".html") for path in DOCS.rglob("*.ipynb")]
    first = (site / "index.html").read_text("utf-8") + (site / "api" / "index.html").read_text("utf-8")
    for page in pages:
        assert (site / page).is_file()
        if page.parts[0] not in {"index.html", "api"}:
            assert f'href="{page}"' in first, f"no way leads from the index to {page}"


@pytest.mark.parametrize("room", ROOMS)
def test_the_api_has_every_class_and_function_that_a_room_offers(site: Path, room: str) -> None:
    """A page names the modules that it describes: a room, or those files of it that others import from."""
    modules = re.findall(r"automodule:: (\S+)", (DOCS / "api" / f"{room}.md").read_text("utf-8"))
    page = html.unescape((site / "api" / f"{room}.html").read_text("utf-8"))
    described = set(re.findall(r'id="(twinmatch\.[\w.]+)"', page))
    offered = {
        f"{module}.{name}"
        for module in modules
        for name, it in vars(importlib.import_module(module)).items()
        if is_public(importlib.import_module(module), name, it)
    }
    assert offered
    assert offered <= described


def test_the_notebook_shows_what_it_found(site: Path) -> None:
    page = (site / "notebooks" / "recording_to_verdict.html").read_text("utf-8")
    assert "cell_output" in page
    assert "<img" in page
