"""A simulated session that several tests judge."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from bags.make_four_setpoints import four_setpoints
from tests.support.watched import copied
from twinmatch.sessions import samples_of
from twinmatch.signals import Sample
from twinmatch.twin import Outcome, Twin


@pytest.fixture(scope="session")
def simulated_session() -> list[Sample]:
    """The samples of the shipped session, made again by its generator."""
    return samples_of(four_setpoints())


@dataclass(frozen=True)
class JudgedSession:
    """A twin with default settings after that session, and what it made of each sample."""

    twin: Twin
    """Which a test copies, if it pushes more."""
    outcomes: list[Outcome]


@pytest.fixture(scope="session")
def judged_session(simulated_session: list[Sample]) -> JudgedSession:
    twin = Twin()
    return JudgedSession(twin, [twin.push(sample) for sample in simulated_session])


@pytest.fixture(scope="session")
def simulated_outcomes(judged_session: JudgedSession) -> list[Outcome]:
    """What a twin with default settings makes of that session, sample by sample."""
    return judged_session.outcomes


@pytest.fixture
def judged_twin(judged_session: JudgedSession) -> Twin:
    """A copy of the twin after that session."""
    copy: Twin = copied(judged_session.twin)
    return copy
