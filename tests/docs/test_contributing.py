"""CONTRIBUTING names files that are there."""

from __future__ import annotations

import re

import pytest

from tests.support.places import PROJECT

NAMED = sorted(
    set(
        re.findall(
            r"`?\b([\w./-]+/[\w.-]+\.(?:py|md|msg))\b",
            (PROJECT / "CONTRIBUTING.md").read_text("utf-8"),
        )
    )
)
PLACES = (PROJECT, PROJECT / "src" / "twinmatch")


def test_it_names_files() -> None:
    assert len(NAMED) > 20


@pytest.mark.parametrize("name", NAMED)
def test_a_file_it_names_is_there(name: str) -> None:
    assert any((place / name).is_file() for place in PLACES)
