"""What the recordings leave of twins, for all tests of controllers."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from twinmatch.controllers import TriedTwin
from twinmatch.memory import digest_of
from twinmatch.offline.controllers import Ground, members_from
from twinmatch.offline.judging import Watch

Members = Callable[..., tuple[TriedTwin, ...]]


@pytest.fixture(scope="session")
def members_of() -> Members:
    """The twins of a session, which is judged for the first test or command that asks."""
    members_of_session: dict[tuple[str, str], tuple[TriedTwin, ...]] = {}

    def members(ground: Ground, *, watch: Watch | None = None) -> tuple[TriedTwin, ...]:
        session = ground.plant.name, digest_of(ground.session.samples)
        if session not in members_of_session:
            members_of_session[session] = members_from(ground, watch=watch)
        return members_of_session[session]

    return members
