"""Sessions of plants that have nothing in common with the Peltier rig."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from tests.support.plants import Motor, Tank
from twinmatch.dynamics import Controller, Parameters, Plant, advance, begin, read
from twinmatch.plants import PLANTS
from twinmatch.sessions import write_session
from twinmatch.sessions.recording import EPOCH
from twinmatch.signals import Sample

FOREIGN = re.compile(
    r"°|\b(celsius|degrees|kelvin|pwm|cameras?|plates?|counts²?|heat\w*|thermal|temperatures?|peltier|"
    r"sinks?|rooms?|fans?|lids?|draughts?|warm\w*|cool\w*|boards?|rig|seebeck|arduino|lepton)\b|[α]",
    re.IGNORECASE,
)
"""What a plant without heat, camera and PWM has nothing of."""


class Shown(NamedTuple):
    """A plant with a recorded session and what has to be read of it."""

    plant: type[Plant]
    folder: Path
    config: Path
    words: tuple[str, ...]
    """Names and units of its own."""

    def speaks_of_itself(self, text: str, *words: str) -> None:
        """Assert that a text has its words, or those given, and none of others' plants."""
        foreign_words = [
            text[max(0, m.start() - 60) : m.end() + 40] for m in FOREIGN.finditer(text)
        ]
        assert not foreign_words, foreign_words[:5]
        for word in words or self.words:
            assert word in text, word


def _levels_held(
    truth: Parameters, levels: list[float], broken: str, last: int, seed: int
) -> list[Sample]:
    """Levels held by the plant's own controller, 240 samples each; then drive or sensor are `broken`."""
    plant = truth.model.plant
    assert plant.loop is not None
    period = plant.loop.period
    begins = 240 * len(levels) - last
    pid = Controller(plant.loop)
    random = np.random.default_rng(seed)
    states = begin(truth, levels[0])
    samples = []
    y = 0.0
    for k, reference in enumerate(np.repeat(levels, 240).tolist()):
        if broken != "frozen" or k < begins:
            y = read(truth, states) + random.normal(0.0, plant.output.noise)
        u = pid.step(reference, y)[0]
        samples.append(Sample(k, EPOCH + round(k * period * 1e9), reference, y, u))
        lost = broken == "lost" and k >= begins
        states = advance(truth, states, plant.drive.rest if lost else u, period)
    return samples


@pytest.fixture(scope="session")
def registered() -> Iterator[None]:
    """The plants can be found by name for as long as the tests run."""
    with pytest.MonkeyPatch.context() as patch:
        for plant in (Motor, Tank):
            patch.setitem(PLANTS, plant.name, plant)
        yield


def _shown(
    folder: Path, plant: type[Plant], samples: list[Sample], *words: str
) -> Shown:
    assert plant.loop is not None
    config = folder / f"{plant.name}.yaml"
    config.write_text(
        f"/**:\n  ros__parameters:\n    plant: {plant.name}\n    period: {plant.loop.period}\n"
    )
    return Shown(plant, write_session(folder / plant.name, samples), config, words)


@pytest.fixture(scope="session", params=["motor", "tank"])
def shown(
    request: pytest.FixtureRequest,
    registered: None,  # noqa: ARG001
    tmp_path_factory: pytest.TempPathFactory,
) -> Shown:
    """A plant whose drive or sensor fails at the end of its session."""
    folder = tmp_path_factory.mktemp("own_words")
    if request.param == "motor":
        truth = Motor.model("without friction").parameters(k=0.06, j=5e-4, b=2e-4)
        samples = _levels_held(truth, [50.0, 150.0, -60.0, 120.0], "lost", 180, seed=3)
        return _shown(folder, Motor, samples, "speed", "rad/s")
    truth = Tank.model().parameters(area=5.0, hole=0.9)
    samples = _levels_held(truth, [0.8, 1.6, 1.1, 2.0], "frozen", 100, seed=4)
    return _shown(folder, Tank, samples, "outflow", "l/s")
