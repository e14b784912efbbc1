"""Irregular rows on one clock: what each kind of column becomes, and what is refused."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.importing import resample
from twinmatch.importing.dates import DAY_FIRST, MONTH_FIRST, in_order, order_of
from twinmatch.importing.tables import read_table
from twinmatch.importing.times import read_times
from twinmatch.sessions.files import RecordingError


def test_rows_on_a_clock_stay_as_they_are_to_the_last_bit():
    rng = np.random.default_rng(0)
    y = rng.normal(size=50)
    u = rng.normal(size=50)
    time = 1608572942.72 + 3.0 * np.arange(50) + rng.uniform(-1e-4, 1e-4, 50)
    resampled = resample(time, {"y": y, "u": u}, {"y": "reading", "u": "held"})
    assert resampled.period == 3.0
    assert not resampled.moved
    assert np.array_equal(resampled.columns["y"], y)
    assert np.array_equal(resampled.columns["u"], u)
    assert resampled.sentence == "50 rows, one every 3 s"


def test_readings_are_interpolated_inputs_averaged_and_set_points_held():
    """Rows at 0, 1.2, 1.8, 3 s; ticks at 0, 1, 2, 3 s."""
    columns = {
        "y": [0.0, 12.0, 18.0, 30.0],
        "u": [1.0, 0.0, 1.0, 5.0],
        "r": [7.0, 8.0, 9.0, 10.0],
    }
    kinds = {"y": "reading", "u": "held", "r": "set"}
    resampled = resample([0.0, 1.2, 1.8, 3.0], columns, kinds, period=1.0)
    assert resampled.time == pytest.approx([0.0, 1.0, 2.0, 3.0])
    assert resampled.columns["y"] == pytest.approx([0.0, 10.0, 20.0, 30.0])
    # 1 until 1.2 s, 0 until 1.8 s
    assert resampled.columns["u"] == pytest.approx([1.0, 0.2 + 0.2, 1.0, 5.0])
    assert resampled.columns["r"].tolist() == [7.0, 8.0, 9.0, 10.0]
    assert resampled.jitter == pytest.approx(0.2 / np.sqrt(2))


def test_the_period_is_the_mean_of_steps_that_lost_no_row():
    time = np.delete(np.cumsum(np.tile([2.96, 3.04], 40)), [11, 30])
    resampled = resample(time, {"y": time}, {"y": "reading"})
    assert resampled.period == 3.0
    assert len(resampled.bridged) == 2
    assert resampled.columns["y"] == pytest.approx(resampled.time)
    assert "rows are missing at 2 places" in resampled.sentence


def test_a_slow_clock_is_kept_and_a_shaky_one_rounded():
    regular = 1.0015 * np.arange(60)
    shaky = 1.0015 * np.arange(60) + np.tile([0.0, 0.01], 30)
    assert resample(regular, {}, {}).period == 1.0015
    assert resample(shaky, {}, {}).period == 1.0


@given(
    steps=st.lists(st.floats(2.4, 3.6), min_size=5, max_size=60),
    values=st.lists(st.floats(-255, 255), min_size=61, max_size=61),
)
def test_a_held_input_gives_the_plant_as_much_as_the_rows_did(steps, values):
    """Until the last tick the integral over the ticks is that over the rows."""
    time = np.concatenate([[0.0], np.cumsum(steps)])
    u = np.array(values[: time.size])
    resampled = resample(time, {"u": u}, {"u": "held"}, period=3.0)
    end = resampled.time[-1]
    lasting = np.clip(
        np.append(time[1:], max(time[-1], end) + 3.0), None, end
    ) - np.clip(time, None, end)
    assert 3.0 * resampled.columns["u"][:-1].sum() == pytest.approx(
        float(u @ lasting), abs=1e-6
    )
    assert (
        u.min()
        <= resampled.columns["u"].min()
        <= resampled.columns["u"].max()
        <= u.max()
    )


@given(
    steps=st.lists(st.floats(0.5, 1.4), min_size=3, max_size=60), slope=st.floats(-5, 5)
)
def test_a_straight_reading_stays_straight_within_the_rows(steps, slope):
    time = 100.0 + np.concatenate([[0.0], np.cumsum(steps)])
    resampled = resample(time, {"y": slope * time}, {"y": "reading"}, period=1.0)
    inside = resampled.time <= time[-1]
    assert resampled.columns["y"][inside] == pytest.approx(
        slope * resampled.time[inside], abs=1e-9
    )
    assert np.diff(resampled.time) == pytest.approx(1.0)
    assert resampled.time[-1] <= time[-1] + 1e-3


@pytest.mark.parametrize(
    ("time", "y", "kinds", "period", "words"),
    [
        ([0, 3, 6, 18, 21], 1.0, {"y": "reading"}, None, "a gap of 12 s after row 3; steps of up to 9 s"),
        ([0, 3, 3, 6], 1.0, {"y": "reading"}, None, "does not advance from 3 s in row 2 to 3 s in row 3"),
        ([0, 3, 6, 9], np.nan, {"y": "reading"}, None, "y in row 1 is nan; give a finite number"),
        ([0], 1.0, {"y": "reading"}, None, "has 1 rows; at least two"),
        ([0, 3, 6], 1.0, {}, None, "the kind of column y is missing; give one of reading, held, set"),
        ([0, 3, 6], 1.0, {"y": "reading"}, 0.5, "a period of 0.5 s does not fit rows 3 s apart"),
        ([0, 3, 6], 1.0, {"y": "reading"}, np.nan, "a period of nan s does not fit"),
    ],
)  # fmt: skip
def test_what_cannot_be_put_on_a_clock_is_refused_in_words(
    time, y, kinds, period, words
):
    with pytest.raises(RecordingError, match=words) as error:
        resample(
            time, {"y": np.full(len(time), y)}, kinds, period, place="recording a.csv"
        )
    assert str(error.value).startswith("recording a.csv: ")
    assert "\n" not in str(error.value)


def test_a_gap_that_its_owner_allows_is_bridged():
    resampled = resample(
        [0, 3, 6, 18, 21], {"y": [0, 3, 6, 18, 21]}, {"y": "reading"}, longest=12.0
    )
    assert resampled.columns["y"] == pytest.approx(np.arange(0, 22, 3))
    assert resampled.bridged == (2,)


def test_columns_of_other_lengths_are_refused():
    with pytest.raises(RecordingError, match=r"y has the shape \(2,\), time \(3,\)"):
        resample([0, 1, 2], {"y": [1, 2]}, {"y": "reading"})


def test_a_gap_splits_where_that_is_asked_for():
    """By hand: the second stretch begins 12.5 s after the last tick of the first, four periods and a bit."""
    time = [0.0, 3.0, 6.0, 18.5, 21.5, 24.5]
    columns = {
        "y": [1.0, 2, 3, 4, 5, 6],
        "u": [1.0, 2, 3, 4, 5, 6],
        "r": [1.0, 2, 3, 4, 5, 6],
    }
    resampled = resample(
        time, columns, {"y": "reading", "u": "held", "r": "set"}, gaps="split"
    )
    assert resampled.time.tolist() == time
    assert resampled.index.tolist() == [0, 1, 2, 6, 7, 8]
    assert resampled.stretches == [slice(0, 3), slice(3, 6)]
    assert resampled.gaps == (12.5,)
    assert resampled.bridged == ()
    assert resampled.steps == (3.0, 3.0, 3.0)
    assert all(
        resampled.columns[name].tolist() == column for name, column in columns.items()
    )
    assert (
        resampled.sentence
        == "6 rows, one every 3 s; split into 2 stretches by gaps of 12.5 s"
    )


@given(
    parts=st.lists(
        st.lists(st.floats(0.7, 1.3), min_size=2, max_size=30), min_size=2, max_size=5
    ),
    gap=st.floats(5.0, 1e5),
    seed=st.integers(0, 9),
)
def test_each_stretch_is_what_it_is_alone(parts, gap, seed):
    """Nothing of the rows beyond a gap enters a stretch, and no index follows another across one."""
    pieces = []
    start = 0.0
    for steps in parts:
        pieces.append(start + np.concatenate([[0.0], np.cumsum(steps)]))
        start = pieces[-1][-1] + gap
    time = np.concatenate(pieces)
    rng = np.random.default_rng(seed)
    columns = {name: rng.normal(size=time.size) for name in ("y", "u", "r")}
    kinds = {"y": "reading", "u": "held", "r": "set"}
    resampled = resample(time, columns, kinds, period=1.0, gaps="split")
    assert len(resampled.stretches) == len(parts)
    first = 0
    for rows, stretch in zip(pieces, resampled.stretches, strict=True):
        mine = {
            name: column[first : first + rows.size] for name, column in columns.items()
        }
        alone = resample(rows, mine, kinds, period=1.0)
        assert np.array_equal(resampled.time[stretch], alone.time)
        assert all(
            np.array_equal(resampled.columns[name][stretch], alone.columns[name])
            for name in columns
        )
        first += rows.size
    skipped = np.diff(resampled.index)
    assert set(skipped[skipped != 1] >= 2) == {True}
    away = resampled.time - resampled.time[0] - resampled.index
    jumps = np.abs(np.diff(away))[
        skipped > 2
    ]  # where a gap is longer than two periods, the number is the time
    assert np.all(jumps <= 0.5 + 1e-6)


def test_without_a_gap_splitting_changes_nothing():
    time = np.cumsum(np.tile([2.96, 3.04], 40))
    refusing, splitting = (
        resample(time, {"y": time}, {"y": "reading"}, gaps=g)
        for g in ("refuse", "split")
    )
    assert np.array_equal(refusing.time, splitting.time)
    assert np.array_equal(refusing.columns["y"], splitting.columns["y"])
    assert splitting.index.tolist() == list(range(splitting.time.size))
    assert refusing.sentence == splitting.sentence


# Dates with the year last: which number is the day.

FORMS = {DAY_FIRST: "%d/%m/%Y %H:%M:%S", MONTH_FIRST: "%m/%d/%Y %I:%M:%S %p"}


@given(
    st.datetimes(datetime(1971, 1, 1), datetime(2099, 12, 28)),
    st.integers(1, 3600),
    st.sampled_from([*FORMS]),
)
def test_a_night_decides_which_number_is_the_day(
    begin: datetime, step: int, order: str
) -> None:
    """Two days of rows: in the wrong order a row is not a date, or midnight is a step of a month."""
    size = 2 * 86400 // step + 2
    times = [
        begin.replace(microsecond=0) + timedelta(seconds=k * step)
        for k in (0, *range(size)[-50:], size)
    ]
    times = sorted(
        {
            *times,
            *(begin.replace(microsecond=0) + timedelta(hours=h) for h in range(49)),
        }
    )
    texts = [time.strftime(FORMS[order]) for time in times]
    assert order_of(texts) == order
    seconds = [in_order(text, order) for text in texts]
    assert seconds == [time.replace(tzinfo=timezone.utc).timestamp() for time in times]


def test_within_a_day_the_clock_tells_the_custom() -> None:
    assert order_of(["05/03/2026 10:00", "", "05/03/2026 10:01"]) == DAY_FIRST
    assert order_of(["05/03/2026 10:00 am", "05/03/2026 12:01 pm"]) == MONTH_FIRST
    assert order_of(["05/03/2026 10:00 AM", "13/03/2026 10:00 AM"]) == DAY_FIRST


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("22.01.2021 14:48:58,25", 1611326938.25),
        ("22-01-21 14:48", 1611326880.0),
        ("22/01/2021 02:48 PM", 1611326880.0),
        ("22/01/2021 12:00 am", 1611273600.0),
        ("22.01.2021 15:48:58+01:00", 1611326938.0),
        ("32/01/2021 14:48", None),
        ("22/01.2021 14:48", None),
        ("22/01/2021 14:48 PM", None),
    ],
)
def test_a_date_is_read_in_any_of_its_forms_or_not_at_all(
    text: str, seconds: float | None
) -> None:
    assert in_order(text, DAY_FIRST) == seconds


def test_a_cell_with_other_text_is_named(tmp_path: Path) -> None:
    path = tmp_path / "oven.csv"
    path.write_text("when,T\n05/03/2026 23:59:30,1\n06/03/2026 00:00:00,2\nlate,3\n")
    with pytest.raises(
        RecordingError, match=r"line 4: 'when' is 'late', .* such as 22/01/2021"
    ):
        read_times(read_table(path), "when")
    path.write_text("when,T\n05/03/2026 23:59:30,1\n06/03/2026 00:00:00,2\n")
    times = read_times(read_table(path), "when")
    assert times.seconds.tolist() == [0.0, 30.0]
    assert times.order == DAY_FIRST
