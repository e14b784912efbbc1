"""What belongs together ends in order, whatever happens to a part."""

from __future__ import annotations

import pytest

from twinmatch.ending import end_in_order


def test_parts_end_in_order() -> None:
    ended: list[int] = []
    assert end_in_order(
        lambda: ended.append(1), lambda: ended.append(2), lambda: ended.append(3)
    )
    assert ended == [1, 2, 3]


def test_a_part_that_has_not_ended_is_reported_and_the_others_end() -> None:
    ended: list[int] = []
    assert not end_in_order(lambda: True, lambda: False, lambda: ended.append(3))
    assert ended == [3]


def test_what_follows_a_part_that_fails_ends_and_no_failure_is_lost() -> None:
    ended: list[int] = []

    def fail(text: str) -> None:
        raise ValueError(text)

    with pytest.raises(ValueError, match="the second") as raised:
        end_in_order(
            lambda: fail("the first"),
            lambda: fail("the second"),
            lambda: ended.append(3),
        )
    assert str(raised.value.__context__) == "the first"
    assert ended == [3]
