"""What is required of a record's fields, where it is declared and where a message is checked."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from twinmatch.requirements import (
    FINITE,
    RISING,
    SHARE,
    Among,
    Requirement,
    Sized,
    Within,
)

MESSAGE = SimpleNamespace(
    names=["a", "b"],
    parts=[SimpleNamespace(name="p"), SimpleNamespace(name="q")],
    horizons=[1.0],
)
OWNER = SimpleNamespace(horizons=[1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("requirement", "value", "problem"),
    [
        (SHARE, 0.5, ""),
        (SHARE, math.nan, ""),
        (SHARE, [0.5, 1.5], "x is 1.5; expected 0 to 1"),
        (Within(0.0, 1.0, may_be_absent=False), math.nan, "x is nan; expected 0 to 1"),
        (Within(0, 15), 16, "x is 16; expected 0 to 15"),
        (FINITE, [1.0, -2e11], ""),
        (FINITE, [1.0, math.nan], "x is nan; expected a finite number"),
        (FINITE, 1e13, "x is 10000000000000.0; expected a finite number"),
        (RISING, [0.0, 1.0, 5.0], ""),
        (RISING, [1.0, 1.0], "x does not rise from 0 on"),
        (RISING, [-1.0, 1.0], "x does not rise from 0 on"),
        (RISING, [math.nan], "x does not rise from 0 on"),
        (Sized("names", "its names"), [1.0, 2.0], ""),
        (
            Sized("names", "its names"),
            [1.0],
            "x has 1 values for its names; expected 2",
        ),
        (Sized("names", "its names"), [], "x has 0 values for its names; expected 2"),
        (Sized("names", "its names", may_be_empty=True), [], ""),
        (
            Sized("names", "its names", square=True),
            [1.0] * 3,
            "x has 3 values for its names; expected 4",
        ),
        (Sized("names", "its names", rows=3), [1.0] * 6, ""),
        (Sized("horizons", "its horizons", by_owner=True), [1.0] * 3, ""),
        (Among("names", "name"), ["b", "", "a"], ""),
        (Among("names", "name"), ["c"], "name 'c' is not among those listed"),
        (Among("parts", "leader", "name"), "q", ""),
        (Among("parts", "leader", "name"), "a", "leader 'a' is not among those listed"),
    ],
)
def test_a_problem_names_field_value_and_what_was_expected(
    requirement: Requirement, value: Any, problem: str
) -> None:
    assert requirement.problem("x", value, MESSAGE, OWNER) == problem
