"""A simulated session that several tests judge."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from twinmatch.sessions import samples_of
from twinmatch.signals import Sample
from twinmatch.twin import Outcome, Twin

GENERATOR = Path(__file__).resolve().parents[2] / "bags" / "make_four_setpoints.py"


@pytest.fixture(scope="session")
def simulated_session() -> list[Sample]:
    """The samples of the shipped session, made anew by its generator."""
    spec = importlib.util.spec_from_file_location("make_four_setpoints", GENERATOR)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return samples_of(module.four_setpoints())


@pytest.fixture(scope="session")
def simulated_outcomes(simulated_session: list[Sample]) -> list[Outcome]:
    """What a twin with default settings makes of that session, sample by sample."""
    twin = Twin()
    return [twin.push(sample) for sample in simulated_session]
