"""FMUs of the held sink's equations, built once, and structures that go when a test ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.support.fmus import (
    ForkedWorker,
    build_c_fmu,
    build_c_fmu_3,
    build_python_fmu,
    write_map,
)
from twinmatch.dynamics import Model
from twinmatch.fmu import adopt_fmus, is_fmu, process
from twinmatch.plants import Peltier

STARTED = process.started


@pytest.fixture(autouse=True, scope="package")
def forked_workers() -> Iterator[None]:
    """Processes of FMUs are forked, unless a test undoes this because their start is what it tests."""
    with pytest.MonkeyPatch.context() as changed:
        changed.setattr(process, "started", ForkedWorker)
        yield


@pytest.fixture
def own_programs() -> Iterator[None]:
    """Processes of FMUs are started as users start them."""
    with pytest.MonkeyPatch.context() as changed:
        changed.setattr(process, "started", STARTED)
        yield


@pytest.fixture(scope="session")
def exchange_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_c_fmu(tmp_path_factory.mktemp("exchange"))


@pytest.fixture(scope="session")
def third_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of FMI 3, for model exchange and co-simulation."""
    return build_c_fmu_3(tmp_path_factory.mktemp("third"))


@pytest.fixture(scope="session")
def switching_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_c_fmu(tmp_path_factory.mktemp("switching"), events=True)


@pytest.fixture(scope="session")
def wrong_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Whose author forgot Joule's heat."""
    return build_c_fmu(tmp_path_factory.mktemp("wrong"), joule=False)


@pytest.fixture(scope="session")
def python_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_python_fmu(tmp_path_factory.mktemp("python"), steps=12)


@pytest.fixture
def adopted(tmp_path: Path) -> Iterator[Callable[..., Model]]:
    """Takes an FMU in as a structure; lets all go at the end."""

    def adopt(fmu: Path, name: str = "the shop's", **changes: object) -> Model:
        file = write_map(tmp_path, fmu, name, **changes)
        return adopt_fmus(file)[0]

    yield adopt
    for name in [name for name in Peltier.structures if is_fmu(name)]:
        source = Peltier.structures[name].external
        if hasattr(source, "close"):
            source.close()
        Peltier.disown(name)
