"""Twins that beat nobody, and plants whose twin is exact: whether they are trusted."""

from __future__ import annotations

from collections.abc import Iterator
from math import exp

import numpy as np

from tests.support.plants import Motor
from tests.support.rig import rig
from twinmatch.comparing import ForecastScore
from twinmatch.dynamics import begin, simulate_driven
from twinmatch.forecasting import Ledger
from twinmatch.sessions import samples_of
from twinmatch.signals import FloatArray, Window
from twinmatch.twin import Twin, TwinSettings

PARAMETERS = rig()
HORIZONS = (10, 60, 300)
EVERY = 30
MEMORY = 1800.0


def _walks(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    return np.cumsum(rng.normal(size=shape), axis=-1)


def ever_trusted(seed: int, seconds: int = 3600, better: float = 1.0) -> Iterator[bool]:
    """Twenty twins beside the same baseline for an hour: whether each was trusted at any verdict, one in two
    minutes.

    The plant is a random walk, which nobody can forecast; to it each twin, and the baseline, adds a random
    walk of its own, of the same size. So all are exchangeable. `better`: factor on the errors of the twins.
    """
    rng = np.random.default_rng(seed)
    twins = [f"twin {k}" for k in range(20)]
    plant = _walks(rng, (seconds,))
    walk_of_baseline = _walks(rng, (seconds,))
    walks_of_twins = _walks(rng, (len(twins), seconds))
    new = np.minimum(EVERY / np.array(HORIZONS), 1.0)
    ledger = Ledger(new, np.ones(1), exp(-EVERY / MEMORY))
    trusted: dict[str, tuple[float, ...]] = dict.fromkeys(twins, ())
    ever = dict.fromkeys(twins, False)
    for second in range(0, seconds, EVERY):
        before = 0
        for place, ahead in enumerate(HORIZONS):
            forecast_from = second - ahead
            path = slice(second - ahead + 1 + before, second + 1)
            before = ahead
            if forecast_from < 0:
                continue
            moved = plant[path] - plant[forecast_from]
            guessed = walk_of_baseline[path] - walk_of_baseline[forecast_from]
            errors = better * (
                moved + walks_of_twins[:, path] - walks_of_twins[:, [forecast_from]]
            )
            baselines = np.stack([moved + guessed] * 2)[:, None]
            ledger.add(twins, errors[:, None], baselines, place)
        for name in twins if second % 120 == 0 else ():
            skills = [
                tuple(skill.tolist())
                for [of_twin] in ledger.skills([name])
                for skill in of_twin
            ]
            score = ForecastScore(name, PARAMETERS, 0, 0, 0.0, (), 0.0, *skills)
            doubts = score.doubts(HORIZONS, trusted[name])
            trusted[name] = tuple(float(h) for h in HORIZONS if h not in doubts)
            ever[name] |= bool(trusted[name])
    yield from ever.values()


def levels(seed: int, samples: int) -> list[str]:
    """Those of all verdicts on a motor, driven by steps, whose equations are those of its plant file."""
    rng = np.random.default_rng(seed)
    model = Motor.model("with friction")
    defaults = model.parameters()
    truth = model.parameters(
        **{n: defaults[n] * rng.uniform(0.75, 1.25) for n in ("k", "j", "b", "dry")}
    )
    u = np.repeat(rng.uniform(-15.0, 15.0, samples), rng.integers(40, 160, samples))[
        :samples
    ]
    driven = simulate_driven(truth, u, states=begin(truth, 0.0), period=0.05)
    speed = driven.output + rng.normal(0.0, Motor.speed.noise, samples)
    twin = Twin(TwinSettings.of(Motor, period=0.05, law=None))
    window = Window(np.zeros(samples), speed, u, period=0.05)
    return [
        v.level.value
        for sample in samples_of(window)
        for v in twin.push(sample).verdicts
    ]
