"""Samples come out in order, each once, whichever arrived live; a recorder may be killed at any message."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message

from twinmatch.nodes.expected import check
from twinmatch.nodes.fields import MessageError
from twinmatch.nodes.past import Copies, Fetched, InOrder, Stream, samples_of_answer, values_of
from twinmatch.signals import Sample
from twinmatch_msgs.msg import ModelScore
from twinmatch_msgs.srv import Past


def sample(index: int) -> Sample:
    return Sample(index, index * 10**9, 0.0, 0.0, 0.0)


def test_an_answer_holds_any_number_of_signals() -> None:
    answer = Past.Response(
        index=[4, 5], stamp=[1, 2], reference=[1.0, 2.0], output=[3.0, 4.0, 5.0, 6.0], input=[7.0, 8.0]
    )
    check(answer)
    assert list(samples_of_answer(answer)) == [
        Sample(4, 1, 1.0, (3.0, 4.0), 7.0),
        Sample(5, 2, 2.0, (5.0, 6.0), 8.0),
    ]
    assert not list(samples_of_answer(Past.Response()))
    answer.output = [3.0, 4.0, 5.0]
    with pytest.raises(MessageError, match="output has 3 values for 2 samples"):
        check(answer)


class Keeper:
    """Knows all samples that were made; answers when the test lets it, some at a time."""

    def __init__(self, most: int) -> None:
        self.made: list[int] = []
        self.most = most

    def answer(self, stream: Stream) -> bool:
        assert stream.missing is not None
        found = [k for k in self.made if k in stream.missing][: self.most]
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
    assert stream.missing == range(2)
    assert not keeper.answer(stream)  # it has received nothing yet
    keeper.made = [0]
    assert keeper.answer(stream)
    assert stream.missing == range(1, 2)
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
    assert stream.missing == range(7, 9)
    stream.skip()
    assert out == [5, 6, 9]


def test_another_session_begins_where_it_begins() -> None:
    out: list[int] = []
    stream = Stream(lambda s: out.append(s.index))
    for k in (0, 1, 2, 0, 1):
        stream.push(sample(k))
    assert out == [0, 1, 2, 0, 1]


SAMPLE, KINDS = "samples", ("matches", "verdicts")


def about(samples: list[int]) -> list[Fetched]:
    return [Fetched(sample, b"", sample) for sample in samples]


@given(
    gone=st.sets(st.integers(0, 29), max_size=20),
    said=st.fixed_dictionaries({name: st.lists(st.integers(0, 29), max_size=20) for name in KINDS}),
    sizes=st.lists(st.tuples(*[st.integers(1, 12)] * 3), min_size=30, max_size=30),
)
def test_what_is_written_never_lacks_a_message_about_a_sample_before_its_last(
    gone: set[int], said: dict[str, list[int]], sizes: list[tuple[int, int, int]]
) -> None:
    samples = about([index for index in range(30) if index not in gone])
    messages = {name: about(sorted(set(found) - gone)) for name, found in said.items()}
    written: list[tuple[str, Fetched]] = []
    order = InOrder(lambda name, message: written.append((name, message)), (SAMPLE, *KINDS))
    taken = 0
    for count, *counts in sizes:
        order.add(SAMPLE, samples[taken : taken + count])
        taken += count
        for name, most in zip(KINDS, counts, strict=True):
            known = order.counts[name]
            order.add(name, messages[name][known : known + most], len(messages[name]))
        order.write()
    assert order.waiting == 0
    order.write(math.inf)
    assert [message for name, message in written if name == SAMPLE] == samples
    for kind in KINDS:
        assert [message for name, message in written if name == kind] == messages[kind]
    for end in range(1, len(written)):
        cut = written[:end]
        last = max((message.sample for name, message in cut if name == SAMPLE), default=-1)
        for kind in KINDS:
            found = [message for name, message in cut if name == kind]
            assert found[: len(messages[kind])] == messages[kind][: len(found)]
            assert len(found) >= sum(message.sample < last for message in messages[kind] if last >= 0)


@given(messages=st.integers(1, 30), data=st.data())
def test_no_message_is_written_twice_or_lost_wherever_fetched_and_live_ones_overlap(
    messages: int, data: st.DataObject
) -> None:
    """The keeper's answers hold the first of a topic's messages, the live ones begin anywhere among them."""
    fetched = data.draw(st.integers(0, messages))
    begin = data.draw(st.integers(0, fetched))
    copies = Copies()
    stream = [str(number) for number in range(messages)]
    for message in stream[:fetched]:
        copies.add("verdicts", message)
    live = [message for message in stream[begin:] if not copies.found("verdicts", lambda m=message: m)]
    assert stream[:fetched] + live == stream
    assert fetched == messages or not copies._fetched
    assert not copies.found("matches", lambda: "0")


def test_padding_of_a_serialised_verdict_makes_no_difference() -> None:
    """A process that receives a verdict and serialises it again leaves other bytes between its fields."""
    verdict = ModelScore(sample=540, nu_gap_to_plant=float("nan"), reason="it follows")
    data, values = bytearray(serialize_message(verdict)), repr(verdict)
    assert values_of(bytes(data), ModelScore) == values
    # Four bytes of encapsulation, eight of the stamp, four of a length and the end of an empty frame_id.
    for at in (17, 18, 19):
        data[at] ^= 0x55
    assert values_of(bytes(data), ModelScore) == values
    assert values_of(serialize_message(ModelScore(sample=541)), ModelScore) != values
