"""Samples and windows."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import reduce
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.signals import (
    Sample,
    SignalError,
    Window,
    decimals_of_time,
    joined,
    rms,
    stretches,
    unbroken,
)
from twinmatch.units import UnitError, conversion, measure


@pytest.mark.parametrize(
    ("period", "text"),
    [(60.0, "60"), (1.0, "1"), (0.5, "0.5"), (0.02, "0.02"), (2e-5, "0.00002")],
)
def test_times_are_written_so_that_samples_are_told_apart(
    period: float, text: str
) -> None:
    assert f"{period:.{decimals_of_time(period)}f}" == text


def samples(*indices: int) -> list[Sample]:
    return [Sample(i, i * 10**9, 30.0, 25.0 + i, -float(i)) for i in indices]


def disturbed(*rows: tuple[float, ...]) -> list[Sample]:
    return [
        replace(sample, disturbances=row)
        for sample, row in zip(samples(4, 5, 6), rows, strict=True)
    ]


def test_a_window_and_its_parts_know_their_samples_and_times() -> None:
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
    np.testing.assert_array_equal(
        window.disturbances, [[21.0, 0.5], [22.0, 0.6], [23.0, 0.7]]
    )
    np.testing.assert_array_equal(
        window.part(5, 6).disturbances, [[22.0, 0.6], [23.0, 0.7]]
    )
    with pytest.raises(ValueError, match="read-only"):
        window.disturbances[0, 0] = 1.0


def test_several_signals_go_with_the_samples() -> None:
    rows = [Sample(k, k, (1.0, 2.0), (k + 0.5, 4.0), (5.0,)) for k in (3, 4)]
    assert rows[0].shape == (2, 2, 1, 0)
    assert rows[0].input == 5.0
    with pytest.raises(
        SignalError,
        match="output: there are 2 of them; this is for a loop with one of each",
    ):
        _ = rows[0].output
    window = Window.from_samples(rows)
    np.testing.assert_array_equal(window.outputs, [[3.5, 4.0], [4.5, 4.0]])
    np.testing.assert_array_equal(window.input, [5.0, 5.0])
    with pytest.raises(
        SignalError, match="sample 5 has 1 outputs, sample 4 has 2; they must be equal"
    ):
        Window.from_samples([rows[1], replace(rows[1], index=5, outputs=3.0)])


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
        (
            lambda: Window(np.zeros((2, 2, 1)), np.zeros(2), np.zeros(2)),
            "references have shape",
        ),
        (
            lambda: Window(np.zeros(2), np.array([0.0, np.nan]), np.zeros(2), first=7),
            "nan at sample 8",
        ),
        (
            lambda: Window(np.zeros(2), np.zeros(2), np.zeros(2), period=0.0),
            "period is 0.0 s",
        ),
        (
            lambda: Window.from_samples(samples(1, 2)).part(0, 2),
            "samples 0 to 2 requested",
        ),
        (
            lambda: Window.from_samples(disturbed((1.0,), (1.0,), ())),
            "sample 6 has 0 disturbances, sample 4",
        ),
        (
            lambda: Window.from_samples(disturbed((1.0,), (np.nan,), (1.0,))),
            "disturbances is nan at sample 5",
        ),
        (
            lambda: Window.from_samples(samples(1, 2)).joined(
                Window.from_samples(samples(4))
            ),
            "sample 4 follows sample 2",
        ),
        (
            lambda: Window.from_samples(samples(1)).joined(
                Window.from_samples(samples(2), 0.5)
            ),
            r"periods of 1.0 s and 0.5 s",
        ),
        (
            lambda: Window.from_samples(samples(4)).joined(
                Window.from_samples(disturbed((1.0,), (1.0,), (1.0,)))
            ),
            "0 and 1 disturbances",
        ),
        (
            lambda: Window(*np.zeros((3, 2)), disturbances=np.zeros(2)),
            r"disturbances have shape \(2,\)",
        ),
        (
            lambda: Window(*np.zeros((3, 2)), disturbances=np.zeros((3, 1))),
            "for each of the 2 samples",
        ),
    ],
)
def test_what_is_not_a_window_is_refused(make: object, message: str) -> None:
    with pytest.raises(SignalError, match=message):
        make()  # type: ignore[operator]


@given(st.lists(st.integers(1, 3), max_size=30))
def test_unbroken_stretches_are_whole_and_all(steps: list[int]) -> None:
    consecutive = samples(*np.cumsum(steps, dtype=int).tolist())
    stretches = unbroken(consecutive)
    assert [s for stretch in stretches for s in stretch] == consecutive
    assert len(stretches) == (1 + sum(k > 1 for k in steps[1:]) if steps else 0)
    for stretch in stretches:
        Window.from_samples(stretch)


VALUES = st.floats(-1e6, 1e6)


@st.composite
def recorded(draw: st.DrawFn) -> tuple[list[Sample], float, int]:
    """Consecutive samples of any plant, some of them stand-ins; their period, s, and stamp of index 0, ns."""
    shape = [draw(st.integers(least, 2)) for least in (1, 1, 1, 0)]
    first = draw(st.integers(0, 10**6))
    period = draw(st.sampled_from([0.005, 0.1, 1.0, 60.0]))
    begin = draw(st.integers(0, 10**18))
    row = st.tuples(*(st.tuples(*[VALUES] * width) for width in shape))
    rows = draw(st.lists(st.tuples(row, st.booleans()), min_size=1, max_size=20))
    run = [
        Sample(index, begin + round(index * period * 1e9), *values, seen=is_seen)
        for index, (values, is_seen) in enumerate(rows, start=first)
    ]
    return run, period, begin


@given(recorded(), st.data())
def test_a_stretch_that_is_taken_apart_and_joined_has_lost_nothing(
    stretch: tuple[list[Sample], float, int], data: st.DataObject
) -> None:
    """Values, marks, period, indices and stamps, wherever it is cut and however the parts overlap."""
    run, period, begin = stretch
    whole = Window.from_samples(run, period)
    parts = []
    first = run[0].index
    assert whole.lost == [s.index for s in run if not s.seen]
    while first <= whole.last:
        last = data.draw(st.integers(first, whole.last))
        parts.append(whole.part(data.draw(st.integers(whole.first, first)), last))
        first = last + 1
    rejoined = reduce(
        Window.joined, (parts[0].part(whole.first, parts[0].last), *parts[1:])
    )
    for field in fields(Window):
        np.testing.assert_array_equal(
            getattr(rejoined, field.name), getattr(whole, field.name)
        )
    assert rejoined.samples(begin) == run
    assert (
        joined(part.samples(begin) for part in parts)
        == run[parts[0].first - whole.first :]
    )


@given(recorded(), st.sets(st.integers(0, 19)))
def test_stretches_between_gaps_hold_every_sample(
    stretch: tuple[list[Sample], float, int], gaps: set[int]
) -> None:
    run, period, begin = stretch
    remaining = [s for k, s in enumerate(run) if k not in gaps]
    windows = stretches(remaining, period)
    assert [s for window in windows for s in window.samples(begin)] == remaining
    assert all(after.first > before.last + 1 for before, after in pairwise(windows))


@given(
    recorded(),
    st.sets(st.integers(0, 19)),
    st.lists(st.tuples(st.integers(0, 20), st.integers(0, 3))),
)
def test_a_run_in_pieces_is_the_run(
    run: tuple[list[Sample], float, int], gaps: set[int], cuts: list[tuple[int, int]]
) -> None:
    """Wherever it is cut, however the pieces overlap, and wherever samples are missing."""
    remaining = [sample for k, sample in enumerate(run[0]) if k not in gaps]
    ends = sorted(cut for cut, _ in cuts)
    begins = [
        max(0, end - overlap) for end, (_, overlap) in zip(ends, cuts, strict=True)
    ]
    pieces = [
        remaining[a:b]
        for a, b in zip([0, *begins], [*ends, len(remaining)], strict=True)
    ]
    assert joined(pieces) == remaining
    of_another_plant = [
        replace(sample, disturbances=(0.0,) * 9) for sample in remaining
    ]
    assert joined([*pieces, of_another_plant]) == remaining


def test_what_continues_and_what_follows_a_sample() -> None:
    before, after, later = samples(4, 5, 7)
    for sample, continues, follows in (
        (after, True, True),
        (later, True, False),
        (replace(after, usable=False), True, False),
        (before, False, False),
        (replace(after, disturbances=(1.0,)), False, False),
    ):
        assert (sample.continues(before), sample.follows(before)) == (
            continues,
            follows,
        )


# Units: against the definitions of the International System, and what people write in brackets.


@pytest.mark.parametrize(
    ("given_unit", "wanted", "value", "is_"),
    [
        ("K", "°C", 300.0, 26.85),
        ("degC", "°C", 20.0, 20.0),
        ("C", "°C", 20.0, 20.0),  # in brackets behind a temperature it is not a coulomb
        ("F", "°C", 212.0, 100.0),
        ("°C", "K", -273.15, 0.0),
        ("ns", "s", 1.5e9, 1.5),
        ("min", "s", 2.0, 120.0),
        ("", "%", 0.25, 25.0),
        ("mV", "V", 1.0, 1e-3),
        ("L/min", "m³/s", 60.0, 1e-3),
        ("PWM", "PWM", 17.0, 17.0),
    ],
)
def test_values_are_brought_to_another_unit(
    given_unit: str, wanted: str, value: float, is_: float
) -> None:
    scale, offset = conversion(given_unit, wanted)
    assert scale * value + offset == pytest.approx(is_, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    ("given_unit", "wanted"), [("V", "°C"), ("PWM", "V"), ("s", ""), ("W/K", "W")]
)
def test_what_measures_something_else_is_refused(given_unit: str, wanted: str) -> None:
    with pytest.raises(UnitError, match="cannot be converted"):
        conversion(given_unit, wanted)


@given(
    st.sampled_from([("K", "°C"), ("°F", "°C"), ("kW", "W"), ("h", "s"), ("%", "")]),
    st.floats(-1e4, 1e4),
)
def test_there_and_back_is_the_same(units: tuple[str, str], value: float) -> None:
    forward = conversion(*units)
    back = conversion(units[1], units[0])
    round_trip = (value * forward.scale + forward.offset) * back.scale + back.offset
    assert round_trip == pytest.approx(value, rel=1e-9, abs=1e-6)


def test_units_are_known_by_all_their_spellings_and_by_what_they_measure() -> None:
    for written, plain in (
        ("deg.C", "°C"),
        ("ºC", "°C"),
        ("Celsius", "°C"),
        ("pct", "%"),
        ("percent", "%"),
        ("LPM", "l/min"),
        ("L/min", "l/min"),
        ("RPM", "rpm"),
        ("U/min", "rpm"),
        ("W/m2K", "W/(m² K)"),
        ("m3/h", "m³/h"),
        ("m/s2", "m/s²"),
        ("Nm", "N m"),
        ("J/kgK", "J/(kg K)"),
        ("kOhm", "kΩ"),
        ("Volt", "V"),
        ("pH", ""),
    ):
        assert measure(written) == measure(plain), written
        assert measure(written).known
    assert (
        measure("V A").dimension == measure("W").dimension == measure("J/s").dimension
    )
    assert measure("kW").factor == pytest.approx(1000 * measure("W").factor)
    assert measure("°C").offset
    assert not measure("K").offset
    assert not measure("PWM").known
    assert not measure("(%").known
    assert (
        measure("PWM").dimension
        == measure("%").dimension
        == measure("").dimension
        == ()
    )


def test_an_error_counts_in_the_unit_of_its_signal() -> None:
    """Two signals, off by 3 and 4 of their units: each alone, then both together."""
    errors = np.array([[3.0, -3.0], [400.0, 400.0]])
    unit = np.array([[1.0], [100.0]])
    assert rms(errors, unit).tolist() == [3.0, 4.0]
    assert rms(rms(errors, unit)) == pytest.approx(np.sqrt(12.5))
    assert rms(errors, axis=0).tolist() == pytest.approx(
        np.sqrt((9.0 + 160000.0) / 2.0).repeat(2).tolist()
    )
