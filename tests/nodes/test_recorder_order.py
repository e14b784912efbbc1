"""However the answers of the keeper are cut, a recorder may be killed after any message it writes."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message

from twinmatch.nodes.past import Copies, Fetched, InOrder, values_of
from twinmatch_msgs.msg import ModelScore

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
    order = InOrder(lambda name, message: written.append((name, message)), SAMPLE, KINDS)
    taken = 0
    for count, *counts in sizes:
        order.add_samples(samples[taken : taken + count])
        taken += count
        for name, most in zip(KINDS, counts, strict=True):
            known = order.counts[name]
            order.add_messages(name, messages[name][known : known + most], len(messages[name]))
        order.write()
    assert order.waiting == 0
    order.finish()
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
    live = [m for m in stream[begin:] if not (copies.expected("verdicts") and copies.found("verdicts", m))]
    assert stream[:fetched] + live == stream
    assert not copies.expected("verdicts") or fetched == messages
    assert not copies.found("matches", "0")


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
