"""What is kept on the disk comes back as it was, whatever was missing and whatever is asked."""

from __future__ import annotations

import tracemalloc
from contextlib import closing

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.sessions.spool import MessageSpool, SampleSpool
from twinmatch.signals import SIGNALS, Sample

numbers = st.floats(allow_nan=False, allow_infinity=False)


@given(
    st.lists(st.integers(1, 5), max_size=40),
    st.integers(0, 2**40),
    st.tuples(st.integers(0, 200), st.integers(0, 200), st.integers(1, 50)),
    st.tuples(*(st.integers(least, 3) for least in (1, 1, 1, 0))),
    st.data(),
)
def test_rows_are_the_samples_with_these_indices(
    steps: list[int],
    begin: int,
    wish: tuple[int, int, int],
    shape: tuple[int, int, int, int],
    data: st.DataObject,
) -> None:
    first, count, most = wish
    samples = []
    index = begin
    with closing(SampleSpool()) as spool:  # an example may end in the middle
        for step in steps:
            signals = [data.draw(st.tuples(*[numbers] * width)) for width in shape]
            samples.append(
                Sample(index, index * 1000, *signals, seen=data.draw(st.booleans()))
            )
            assert spool.continued_by(samples[-1])
            spool.push(samples[-1])
            assert not spool.continued_by(samples[-1])
            index += step
        assert len(spool) == len(samples)
        assert spool.end == (samples[-1].index + 1 if samples else 0)
        first = max(0, begin - 20) + first
        wanted = [s for s in samples if first <= s.index < first + count][:most]
        rows = spool.rows(first, count, most)
        assert [sample_of(row) for row in rows] == wanted


def sample_of(row: np.void) -> Sample:
    signals = [tuple(row[name].tolist()) for name in SIGNALS]
    return Sample(
        row["index"].item(), row["stamp"].item(), *signals, seen=row["seen"].item()
    )


@given(
    st.lists(st.binary(max_size=30), max_size=20),
    st.integers(0, 25),
    st.integers(0, 25),
)
def test_messages_come_back_by_their_number_and_repeated_ones_count_once(
    messages: list[bytes], number: int, most: int
) -> None:
    texts = MessageSpool()
    for data in messages:
        texts.push(data)
        texts.push(data)
    once = [
        data
        for data, before in zip(messages, [b"", *messages], strict=False)
        if data != before
    ]
    assert len(texts) == len(once)
    assert list(texts.since(number, most)) == once[number : number + most]
    texts.close()


def test_a_sample_takes_no_memory() -> None:
    spool = SampleSpool()
    for k in range(1000):
        spool.push(Sample(k, k, 1.0, 2.0, 3.0))
    tracemalloc.start()
    try:
        for k in range(1000, 9_000):
            spool.push(Sample(k, k, 1.0, 2.0, 3.0))
        memory, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert memory < 8_000  # a byte per sample would be as much
    assert len(spool) == 9_000
    spool.close()
