"""Samples and windows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.signals import Sample, SignalError, Window, unbroken


def samples(*indices: int) -> list[Sample]:
    return [Sample(i, i * 10**9, 30.0, 25.0 + i, -float(i)) for i in indices]


def test_a_window_of_samples() -> None:
    window = Window.from_samples(samples(4, 5, 6), period=0.5)
    assert (window.first, window.last, len(window)) == (4, 6, 3)
    np.testing.assert_array_equal(window.temperature, [29.0, 30.0, 31.0])
    np.testing.assert_array_equal(window.time, [2.0, 2.5, 3.0])
    part = window.part(5, 6)
    assert (part.first, part.last, part.period) == (5, 6, 0.5)
    np.testing.assert_array_equal(part.pwm, [-5.0, -6.0])


def test_windows_are_read_only_copies() -> None:
    values = np.zeros(3)
    window = Window(values, values, values)
    values[0] = 1.0
    assert window.reference[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        window.pwm[0] = 1.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Window.from_samples([]), "no sample"),
        (lambda: Window.from_samples(samples(1, 3)), "sample 3 follows sample 1"),
        (lambda: Window(np.zeros(2), np.zeros(3), np.zeros(2)), "lengths"),
        (lambda: Window(np.zeros((2, 2)), np.zeros(2), np.zeros(2)), "reference has shape"),
        (lambda: Window(np.zeros(2), np.array([0.0, np.nan]), np.zeros(2), first=7), "nan at sample 8"),
        (lambda: Window(np.zeros(2), np.zeros(2), np.zeros(2), period=0.0), "period is 0.0 s"),
        (lambda: Window.from_samples(samples(1, 2)).part(0, 2), "samples 0 to 2 asked"),
    ],
)
def test_what_is_no_window_is_refused(make: object, message: str) -> None:
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
