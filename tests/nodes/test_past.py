"""Samples come out in order, each once, whichever arrived live; a recorder may be killed at any message."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

from twinmatch.nodes import keeper
from twinmatch.nodes.expected import check
from twinmatch.nodes.fields import MessageError
from twinmatch.nodes.keeper import RunStore
from twinmatch.nodes.past import (
    Copies,
    RecorderPast,
    Stream,
    samples_of_answer,
    values_of,
)
from twinmatch.sessions.cdr import encode_sample
from twinmatch.signals import Sample
from twinmatch_msgs.msg import Match, ModelScore
from twinmatch_msgs.srv import Past


def sample(index: int) -> Sample:
    return Sample(index, index * 10**9, 0.0, 0.0, 0.0)


@contextmanager
def limited_store(samples: int = 2000, messages: int = 20) -> Iterator[RunStore]:
    """A store that gives so many at a time."""
    with pytest.MonkeyPatch.context() as patch, closing(RunStore()) as store:
        patch.setattr(keeper.RunStore, "MAX_SAMPLES", samples)
        patch.setattr(keeper.RunStore, "MAX_MESSAGES", messages)
        yield store


def answered(stream: Stream, store: RunStore) -> bool:
    wanted = stream.wanted()
    return wanted is not None and stream.answered(store.answer(wanted))


def test_an_answer_holds_any_number_of_signals() -> None:
    answer = Past.Response(
        index=[4, 5],
        stamp=[1, 2],
        reference=[1.0, 2.0],
        output=[3.0, 4.0, 5.0, 6.0],
        input=[7.0, 8.0],
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


@given(
    st.lists(
        st.tuples(st.integers(1, 4), st.booleans(), st.integers(0, 3)),
        min_size=1,
        max_size=60,
    ),
    st.integers(1, 7),
)
def test_every_sample_comes_once_and_in_order(
    ticks: list[tuple[int, bool, int]], most: int
) -> None:
    """Ticks may be missed by the rig (steps > 1), samples lost on the way, answers come late."""
    out: list[int] = []
    produced: list[int] = []
    stream = Stream(lambda s: out.append(s.index))
    with limited_store(most) as store:
        for step, arrives, answers in [*ticks, (1, True, 0)]:
            produced.append(produced[-1] + step if produced else step - 1)
            store.samples.push(sample(produced[-1]))
            if arrives:
                stream.push(sample(produced[-1]))
            for _ in range(answers):
                answered(stream, store)
        while stream.missing is not None:
            assert answered(stream, store)
    assert out == produced


def test_a_keeper_that_lags_is_asked_again() -> None:
    out: list[int] = []
    stream = Stream(lambda s: out.append(s.index))
    stream.push(sample(2))
    assert stream.missing == range(2)
    with limited_store() as store:
        assert not answered(stream, store)  # it has received nothing yet
        store.samples.push(sample(0))
        assert answered(stream, store)
        assert stream.missing == range(1, 2)
        assert not answered(stream, store)
        store.samples.push(sample(1))
        assert answered(stream, store)
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


KINDS = Match, ModelScore
NAMES = "sample", "match", "score"


@given(
    produced=st.sets(st.integers(0, 29)).map(lambda found: found | {30}),
    about=st.tuples(*[st.lists(st.integers(0, 29), max_size=20)] * 2),
    begin=st.integers(1, 30),
    live=st.tuples(*[st.integers(0, 20)] * 2),
    most=st.tuples(*[st.integers(1, 12)] * 2),
)
def test_a_session_holds_everything_once_and_may_be_cut_off_anywhere(
    produced: set[int],
    about: tuple[list[int], ...],
    begin: int,
    live: tuple[int, int],
    most: tuple[int, int],
) -> None:
    """It never lacks a message about a sample before its last, whatever arrived live, and how late."""
    written: list[tuple[str, bytes]] = []
    past = RecorderPast(NAMES, lambda name, data, _: written.append((name, data)))
    samples = [sample(index) for index in sorted(produced)]
    serialised = []
    for kind, indices_of_kind in zip(KINDS, about, strict=True):
        sampled = sorted(set(indices_of_kind) & produced)
        messages = [
            kind(sample=index, reason=str(number))
            for number, index in enumerate(sampled)
        ]
        serialised.append(list(map(serialize_message, messages)))
    with limited_store(*most) as store:
        for live_sample in samples:
            store.samples.push(live_sample)
        for kind, of_kind in zip(KINDS, serialised, strict=True):
            for data in of_kind:
                assert store.push(kind, data)
        for name, of_kind, first in zip(NAMES[1:], serialised, live, strict=True):
            for data in of_kind[first:]:
                past.take(name, data, 0)
        for live_sample in samples:
            if live_sample.index >= begin:
                past.take("sample", encode_sample(live_sample), live_sample.stamp)
        while past.stream.missing is not None:
            assert answered(past.stream, store)
    expected = dict(
        zip(
            NAMES,
            ([encode_sample(live_sample) for live_sample in samples], *serialised),
            strict=True,
        )
    )
    indices = {
        data: live_sample.index
        for data, live_sample in zip(expected["sample"], samples, strict=True)
    }
    # rclpy leaves what lies between the fields of a message as it was: equal ones may differ in their bytes.
    read = {
        name: partial(deserialize_message, message_type=kind)
        for kind, name in zip(KINDS, NAMES[1:], strict=True)
    }
    decoded = [
        (topic, read[topic](data) if topic in read else data) for topic, data in written
    ]
    for name in NAMES:
        wanted = (
            [read[name](data) for data in expected[name]]
            if name in read
            else expected[name]
        )
        assert [content for topic, content in decoded if topic == name] == wanted
    order = [
        (content.sample if topic in read else indices[content], topic != "sample")
        for topic, content in decoded
    ]
    assert order == sorted(order)


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
    live = [
        message
        for message in stream[begin:]
        if not copies.found("verdicts", lambda m=message: m)
    ]
    assert stream[:fetched] + live == stream
    if fetched < messages:  # after the first new one, nothing is compared
        assert not copies.found(
            "verdicts", lambda: pytest.fail("its values are not wanted")
        )
    assert not copies.found("matches", lambda: "0")


def test_padding_of_a_serialised_verdict_makes_no_difference() -> None:
    """A process that receives a verdict and serialises it again leaves other bytes between its fields."""
    verdict = ModelScore(sample=540, nu_gap_to_plant=float("nan"), reason="it follows")
    data = bytearray(serialize_message(verdict))
    values = repr(verdict)
    assert values_of(bytes(data), ModelScore) == values
    # Four bytes of encapsulation, eight of the stamp, four of a length and the end of an empty frame_id.
    for place in (17, 18, 19):
        data[place] ^= 0x55
    assert values_of(bytes(data), ModelScore) == values
    assert values_of(serialize_message(ModelScore(sample=541)), ModelScore) != values
