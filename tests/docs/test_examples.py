"""Every Python example of README and docs runs and prints what its comments say.

Blocks fenced as `python hardware` need a rig and are left out; one fenced as `python NAME.py` is a module
that the examples of all pages may import.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.places import PROJECT

PAGES = [PROJECT / "README.md", *sorted((PROJECT / "docs").rglob("*.md"))]
NEEDS_ROS = re.compile(r"import rclpy|cyclonedds")


def examples() -> list[tuple[str, str]]:
    runnable = []
    for page in PAGES:
        blocks = re.findall(
            r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
        )
        name = str(page.relative_to(PROJECT))
        runnable += [
            (f"{name} #{k}", block) for k, block in enumerate(blocks, 1) if not NEEDS_ROS.search(block)
        ]
    return runnable


@pytest.fixture(autouse=True)
def _modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for page in PAGES:
        blocks = re.findall(
            r"^```python (\w+\.py)\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
        )
        for name, code in blocks:
            (tmp_path / name).write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)


def test_examples_of_the_readme_are_among_those_that_are_run() -> None:
    assert any(name.startswith("README") for name, _ in examples())


@pytest.mark.parametrize(("name", "code"), examples(), ids=[name for name, _ in examples()])
def test_each_example_runs_and_prints_what_it_says(
    name: str, code: str, capsys: pytest.CaptureFixture[str]
) -> None:
    exec(compile(code, name, "exec"), {"__name__": "example"})
    promised = re.findall(r"# prints: (.*)$", code, re.MULTILINE)
    assert capsys.readouterr().out.splitlines()[: len(promised)] == promised


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_between_pages_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\((?!https?://)([^)#]+)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), f"{page.name} links to {target}"
