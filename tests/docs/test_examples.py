"""Every Python example of README and docs runs and prints what its comments say.

Blocks fenced as `python hardware` need a rig and are left out; one fenced as `python NAME.py` is a module
that the examples of all pages may import.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.places import PROJECT

PAGES = {
    page: page.read_text(encoding="utf-8")
    for page in (PROJECT / "README.md", *sorted((PROJECT / "docs").rglob("*.md")))
}
"""Every page with its text."""
NEEDS_ROS = re.compile(r"import rclpy|cyclonedds")


def examples() -> list[tuple[str, str]]:
    runnable = []
    for page, text in PAGES.items():
        blocks = re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
        name = str(page.relative_to(PROJECT))
        runnable += [
            (f"{name} #{k}", block)
            for k, block in enumerate(blocks, 1)
            if not NEEDS_ROS.search(block)
        ]
    return runnable


def modules() -> dict[str, str]:
    """The modules that examples may import, by the names of their files."""
    fenced = re.compile(r"^```python (\w+\.py)\n(.*?)^```", re.DOTALL | re.MULTILINE)
    return {
        name: code for text in PAGES.values() for name, code in fenced.findall(text)
    }


@pytest.fixture(scope="module")
def _modules(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    folder = tmp_path_factory.mktemp("modules")
    for name, code in modules().items():
        (folder / name).write_text(code, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        # what examples leave there goes with the folders of the tests
        patch.setattr(tempfile, "tempdir", str(tmp_path_factory.mktemp("temporary")))
        yield


def test_examples_of_the_readme_are_among_those_that_are_run() -> None:
    assert any(name.startswith("README") for name, _ in examples())


@pytest.mark.usefixtures("_modules")
@pytest.mark.parametrize(
    ("name", "code"), examples(), ids=[name for name, _ in examples()]
)
def test_each_example_runs_and_prints_what_it_says(
    name: str, code: str, capsys: pytest.CaptureFixture[str]
) -> None:
    exec(compile(code, name, "exec"), {"__name__": "example"})
    promised = re.findall(r"# prints: (.*)$", code, re.MULTILINE)
    assert capsys.readouterr().out.splitlines()[: len(promised)] == promised


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_between_pages_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\((?!https?://)([^)#]+)", PAGES[page]):
        assert (page.parent / target).exists(), f"{page.name} links to {target}"
