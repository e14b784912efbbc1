"""A simulated session that several tests judge."""

from __future__ import annotations

import pytest

from bags.make_four_setpoints import four_setpoints
from twinmatch.sessions import samples_of
from twinmatch.signals import Sample
from twinmatch.twin import Outcome, Twin


@pytest.fixture(scope="session")
def simulated_session() -> list[Sample]:
    """The samples of the shipped session, made again by its generator."""
    return samples_of(four_setpoints())


@pytest.fixture(scope="session")
def simulated_outcomes(simulated_session: list[Sample]) -> list[Outcome]:
    """What a twin with default settings makes of that session, sample by sample."""
    twin = Twin()
    return [twin.push(sample) for sample in simulated_session]
