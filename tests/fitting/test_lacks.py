"""What a plant file lacks is named, and the lines that are shown are what it lacks."""

from __future__ import annotations

import pytest

from tests.support.rooms import judged_room


@pytest.mark.parametrize(("seed", "stores"), [(1, 2), (2, 2), (3, 3)])
def test_a_room_of_several_stores_is_told_that_it_lacks_one(seed: int, stores: int) -> None:
    lack = judged_room(seed, stores).split("; ")[-1]
    assert lack.startswith(f"a second store {'between heating and inner' if seed > 1 else 'beside inner'}")
    assert (", and a third one beside it" in lack) is (stores == 3)
    assert int(lack.split("would explain ")[1].split("%")[0]) >= 90


def test_a_room_of_one_store_lacks_none() -> None:
    assert "store" not in judged_room(1, 1)
