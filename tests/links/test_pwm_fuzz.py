from __future__ import annotations

from tests.support import pwm_mutations
from twinmatch.links.pwm_protocol import Damage, FrameReader, Request, parse_request, seal


def test_no_damaged_frame_is_acted_on_with_a_changed_meaning_and_the_next_one_always_arrives() -> None:
    reader = FrameReader()
    found_damage = 0
    for payload, line in pwm_mutations.damaged_lines(100_000, seed=20220):
        # The line end in front stands for what the line before may have lost.
        events = reader.feed(line + b"\n" + seal("Q 9"))
        assert events[-1] == b"Q 9", (payload, line)
        for event in events[:-1]:
            if isinstance(event, Damage):
                found_damage += 1
            else:
                request = parse_request(event)
                assert not isinstance(request, Request) or str(request) == payload, (payload, line)
    assert found_damage > 50_000


def test_a_lost_line_end_costs_one_frame() -> None:
    reader = FrameReader()
    assert reader.feed(seal("P 1 25")[:-1] + seal("P 2 30") + seal("P 3 35")) == [b"P 2 30", b"P 3 35"]
