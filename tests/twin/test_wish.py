"""What may be asked of an experiment."""

from __future__ import annotations

import math

import pytest

from twinmatch.twin.experiment import ExperimentError, Wish


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (
            {"goal": "x"},
            "goal: 'x' is not known; give one of structure, parameters, fault",
        ),
        ({"minutes": math.nan}, "minutes is nan; give a time"),
        ({"minutes": math.inf}, "minutes is inf; give a time"),
        ({"minutes": -1.0}, "minutes is -1; give a time"),
        (
            {"within": (1.0,)},
            "within has 1 values; give the lowest and the highest, or none",
        ),
        ({"within": (1.0, 2.0, 3.0)}, "within has 3 values"),
        (
            {"within": (2.0, 1.0)},
            "within is 2 to 1; give finite values, the lower one first",
        ),
        ({"within": (math.nan, 1.0)}, "within is nan to 1"),
        ({"within": (-math.inf, 1.0)}, "within is -inf to 1"),
    ],
)
def test_what_nobody_can_mean_is_refused_in_a_sentence(
    asked: dict[str, object], words: str
) -> None:
    with pytest.raises(ExperimentError, match="^" + words.replace("(", r"\(")):
        Wish(**asked)  # type: ignore[arg-type]
