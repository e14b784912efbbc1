"""Recordings of real Temperature Control Labs, in the folder of other people's plants."""

from __future__ import annotations

import csv

import pytest

from tests.support.places import OTHERS


def kit_rows(folder: str, name: str) -> list[dict[str, float]]:
    """The rows of a table by their titles; skips the test if it is not here."""
    path = OTHERS / folder / f"{name}.csv"
    if not path.is_file():
        pytest.skip(
            f"no {path}; set TWINMATCH_PLANT_RECORDINGS to the folder of other plants' recordings"
        )
    with path.open(encoding="utf-8") as table:
        rows = list(csv.DictReader(table))
    return [numbers_of(row) for row in rows]


def numbers_of(row: dict[str, str]) -> dict[str, float]:
    return {title: float(text) for title, text in row.items()}
