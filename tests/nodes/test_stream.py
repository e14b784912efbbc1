"""Samples come out in their order, each once, whichever of them arrived live."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from twinmatch.nodes.past import Missing, Stream
from twinmatch.signals import Sample


def sample(index: int) -> Sample:
    return Sample(index, index * 10**9, 0.0, 0.0, 0.0)


class Keeper:
    """Knows all samples that were made; answers when the test lets it, some at a time."""

    def __init__(self, most: int) -> None:
        self.made: list[int] = []
        self.most = most

    def answer(self, stream: Stream) -> bool:
        assert stream.missing is not None
        first, last = stream.missing
        found = [k for k in self.made if first <= k <= last][: self.most]
        return stream.fetched([sample(k) for k in found], self.made[-1] + 1 if self.made else 0)


@given(
    st.lists(st.tuples(st.integers(1, 4), st.booleans(), st.integers(0, 3)), min_size=1, max_size=60),
    st.integers(1, 7),
)
def test_every_sample_comes_once_and_in_order(ticks: list[tuple[int, bool, int]], most: int) -> None:
    """Ticks may be missed by the rig (steps > 1), samples lost on the way, answers come late."""
    out: list[int] = []
    stream, keeper = Stream(lambda s: out.append(s.index)), Keeper(most)
    index = -1
    for step, arrives, answers in ticks:
        index += step
        keeper.made.append(index)
        if arrives:
            stream.push(sample(index))
        for _ in range(answers):
            if stream.missing is not None:
                keeper.answer(stream)
    index += 1
    keeper.made.append(index)
    stream.push(sample(index))
    while stream.missing is not None:
        assert keeper.answer(stream)
    assert out == keeper.made


def test_a_keeper_that_lags_is_asked_again() -> None:
    out: list[int] = []
    stream, keeper = Stream(lambda s: out.append(s.index)), Keeper(10)
    stream.push(sample(2))
    assert stream.missing == Missing(0, 1)
    assert not keeper.answer(stream)  # it has received nothing yet
    keeper.made = [0]
    assert keeper.answer(stream)
    assert stream.missing == Missing(1, 1)
    assert not keeper.answer(stream)
    keeper.made = [0, 1, 2]
    assert keeper.answer(stream)
    assert out == [0, 1, 2]


def test_without_a_keeper_it_continues_behind_the_gap() -> None:
    out: list[int] = []
    stream = Stream(lambda s: out.append(s.index))
    for k in (5, 6, 9):
        stream.push(sample(k))
    stream.skip()
    assert out == [5, 6]
    assert stream.missing == Missing(7, 8)
    stream.skip()
    assert out == [5, 6, 9]


def test_another_session_begins_where_it_begins() -> None:
    out: list[int] = []
    stream = Stream(lambda s: out.append(s.index))
    for k in (0, 1, 2, 0, 1):
        stream.push(sample(k))
    assert out == [0, 1, 2, 0, 1]
