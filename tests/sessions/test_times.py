"""Dates with the year last: which number is the day."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.sessions import RecordingError
from twinmatch.sessions.tables import read_table
from twinmatch.sessions.times import DAY_FIRST, MONTH_FIRST, in_order, order_of, read_times

FORMS = {DAY_FIRST: "%d/%m/%Y %H:%M:%S", MONTH_FIRST: "%m/%d/%Y %I:%M:%S %p"}


@given(
    st.datetimes(datetime(1971, 1, 1), datetime(2099, 12, 28)),
    st.integers(1, 3600),
    st.sampled_from([*FORMS]),
)
def test_a_night_decides_which_number_is_the_day(begin: datetime, step: int, order: str) -> None:
    """Two days of rows: in the wrong order a row is not a date, or midnight is a step of a month."""
    size = 2 * 86400 // step + 2
    times = [
        begin.replace(microsecond=0) + timedelta(seconds=k * step) for k in (0, *range(size)[-50:], size)
    ]
    times = sorted({*times, *(begin.replace(microsecond=0) + timedelta(hours=h) for h in range(49))})
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
def test_forms(text: str, seconds: float | None) -> None:
    assert in_order(text, DAY_FIRST) == seconds


def test_a_cell_with_other_text_is_named(tmp_path: Path) -> None:
    path = tmp_path / "oven.csv"
    path.write_text("when,T\n05/03/2026 23:59:30,1\n06/03/2026 00:00:00,2\nlate,3\n")
    with pytest.raises(RecordingError, match=r"line 4: 'when' is 'late', .* such as 22/01/2021"):
        read_times(read_table(path), "when")
    path.write_text("when,T\n05/03/2026 23:59:30,1\n06/03/2026 00:00:00,2\n")
    found = read_times(read_table(path), "when")
    assert found.seconds.tolist() == [0.0, 30.0]
    assert found.order == DAY_FIRST
