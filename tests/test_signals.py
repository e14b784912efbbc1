"""Samples and windows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.signals import Sample, SignalError, Window, unbroken


def samples(*indices: int) -> list[Sample]:
    return [Sample(i, i * 10**9, 30.0, 25.0 + i, -float(i)) for i in indices]


def disturbed(*rows: tuple[float, ...]) -> list[Sample]:
    return [replace(sample, disturbances=row) for sample, row in zip(samples(4, 5, 6), rows, strict=True)]


def test_a_window_of_samples() -> None:
    window = Window.from_samples(samples(4, 5, 6), period=0.5)
    assert (window.first, window.last, len(window)) == (4, 6, 3)
    np.testing.assert_array_equal(window.output, [29.0, 30.0, 31.0])
    np.testing.assert_array_equal(window.time, [2.0, 2.5, 3.0])
    part = window.part(5, 6)
    assert (part.first, part.last, part.period) == (5, 6, 0.5)
    np.testing.assert_array_equal(part.input, [-5.0, -6.0])
    assert window.disturbances.shape == (3, 0)
    assert part.disturbances.shape == (2, 0)


def test_disturbances_go_with_the_samples() -> None:
    window = Window.from_samples(disturbed((21.0, 0.5), (22.0, 0.6), (23.0, 0.7)))
    np.testing.assert_array_equal(window.disturbances, [[21.0, 0.5], [22.0, 0.6], [23.0, 0.7]])
    np.testing.assert_array_equal(window.part(5, 6).disturbances, [[22.0, 0.6], [23.0, 0.7]])
    with pytest.raises(ValueError, match="read-only"):
        window.disturbances[0, 0] = 1.0


def test_windows_are_read_only_copies() -> None:
    values = np.zeros(3)
    window = Window(values, values, values)
    values[0] = 1.0
    assert window.reference[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        window.input[0] = 1.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Window.from_samples([]), "no sample"),
        (lambda: Window.from_samples(samples(1, 3)), "sample 3 follows sample 1"),
        (lambda: Window(np.zeros(2), np.zeros(3), np.zeros(2)), "lengths"),
        (lambda: Window(np.zeros((2, 2)), np.zeros(2), np.zeros(2)), "reference has shape"),
        (lambda: Window(np.zeros(2), np.array([0.0, np.nan]), np.zeros(2), first=7), "nan at sample 8"),
        (lambda: Window(np.zeros(2), np.zeros(2), np.zeros(2), period=0.0), "period is 0.0 s"),
        (lambda: Window.from_samples(samples(1, 2)).part(0, 2), "samples 0 to 2 requested"),
        (lambda: Window.from_samples(disturbed((1.0,), (1.0,), ())), "sample 6 has 0 disturbances, sample 4"),
        (
            lambda: Window.from_samples(disturbed((1.0,), (np.nan,), (1.0,))),
            "disturbances is nan at sample 5",
        ),
        (lambda: Window(*np.zeros((3, 2)), disturbances=np.zeros(2)), r"disturbances have shape \(2,\)"),
        (lambda: Window(*np.zeros((3, 2)), disturbances=np.zeros((3, 1))), "for each of the 2 samples"),
    ],
)
def test_what_is_not_a_window_is_refused(make: object, message: str) -> None:
    with pytest.raises(SignalError, match=message):
        make()  # type: ignore[operator]


@given(st.lists(st.integers(1, 3), max_size=30))
def test_unbroken_stretches_are_whole_and_all(steps: list[int]) -> None:
    taken = samples(*np.cumsum(steps, dtype=int).tolist())
    stretches = unbroken(taken)
    assert [s for stretch in stretches for s in stretch] == taken
    assert len(stretches) == (1 + sum(k > 1 for k in steps[1:]) if steps else 0)
    for stretch in stretches:
        Window.from_samples(stretch)
