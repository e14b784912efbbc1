"""Lessons made up for tests of the memory."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twinmatch.controllers import LawComparison
from twinmatch.memory import Lesson, report_on
from twinmatch.plants import Peltier

HOUR = 3_600_000_000_000


def lesson(
    number: int = 1, structure: str = "paper", *, rig: str = "", **changed: object
) -> Lesson:
    """That of the session `number`, a day after the one before; its covariance is of no particular size."""
    values = {"seebeck": 0.05 + 1e-3 * number, "conductance": 0.5, "resistance": 3.3}
    spread = np.array([[1e-6, 2e-6], [2e-6, 1e-4]])
    usual: dict[str, object] = {
        "session": f"digest-{number}",
        "name": f"run_{number}",
        "plant": "peltier",
        "equations": "e1",
        "rig": rig,
        "structure": structure,
        "began": number * 24 * HOUR,
        "duration": 3600.0,
        "samples": 3600,
        "parameters": values,
        "free": ("seebeck", "conductance"),
        "covariance": tuple(map(tuple, spread.tolist())),
        "outputs": ((20.0, 70.0),),
        "inputs": ((-255.0, 255.0),),
        "led": True,
        "chosen": False,
        "level": "trusted",
        "horizons": (10.0, 60.0),
        "persistence_skill": (0.5, 0.7),
        "arx_skill": (0.1, 0.2),
    }
    return Lesson(**(usual | changed))  # type: ignore[arg-type]


def comparison(number: int = 1, **changed: object) -> LawComparison:
    """A predicted cost of 5 (3 to 6), measured as it was predicted."""
    usual: dict[str, object] = {
        "session": f"digest-{number}",
        "name": f"run_{number}",
        "plant": "peltier",
        "rig": "",
        "law": "law.json",
        "learned": "run_0",
        "signal": "temperature",
        "unit": "°C²",
        "low": 3.0,
        "median": 5.0,
        "high": 6.0,
        "measured": 5.0,
        "share": 0.91,
        "decision": "safe",
        "stable": True,
        "error": 6.2,
        "predicted_error": 6.0,
    }
    return LawComparison(**(usual | changed))  # type: ignore[arg-type]


KINDS = ("steady", "step", "drift")
_PLANT = Peltier.model("sink with mass, free ambient, switched drive")
_TRUE = {"seebeck": 0.055, "conductance": 0.75, "heat_capacity": 30.0, "ambient": 293.0,
         "sink_heat_capacity": 350.0, "sink_convection": 3.0}  # fmt: skip
_KNOWN = np.array([0.025, 0.004, 0.026, 0.0003, 0.035, 0.017])
"""Relative standard deviations after an hour of the simulated rig."""
_ALIKE = (
    ("seebeck", "heat_capacity", 0.99),
    ("seebeck", "conductance", 0.6),
    ("heat_capacity", "conductance", 0.6),
    ("ambient", "sink_convection", 0.7),
)
"""Correlations of the estimates."""
_CHANGING = ("seebeck", "conductance", "heat_capacity", "sink_convection")


class LivedRig(NamedTuple):
    """A rig over its sessions, one a day."""

    kind: str
    changed: str
    """The parameter that has changed; meaningless if the rig is steady."""
    since: int
    """First session after its step, from 0."""
    lessons: list[Lesson]


def lived_rig(seed: int, kind: str, sessions: int = 12) -> LivedRig:
    """A rig whose lessons have the covariances that they say, one in 25 of them five times the errors; the
    room is another one every day."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    free = _PLANT.structure.free
    names = list(free)
    correlations = np.eye(6)
    for first, second, r in _ALIKE:
        i = names.index(first)
        j = names.index(second)
        correlations[i, j] = correlations[j, i] = r
    true = np.array([_TRUE[name] for name in free])
    changed = str(rng.choice(_CHANGING))
    since = int(rng.integers(3, 9))
    sign = float(rng.choice([-1.0, 1.0]))
    lessons = []
    for number in range(sessions):
        true_today = true.copy()
        true_today[names.index("ambient")] += rng.normal(0.0, 1.5)
        if kind == "step" and number >= since:
            true_today[names.index(changed)] *= 1.0 + 0.1 * sign
        if kind == "drift":
            true_today[names.index(changed)] *= (1.0 + 0.01 * sign) ** number
        spread = _KNOWN * true * rng.uniform(0.6, 1.6)
        covariance = correlations * np.outer(spread, spread)
        errors = rng.multivariate_normal(np.zeros(6), covariance) * (
            5.0 if rng.random() < 0.04 else 1.0
        )
        learned = {
            **_PLANT.parameters(),
            **dict(zip(free, (true_today + errors).tolist(), strict=True)),
        }
        spreads = tuple(map(tuple, covariance.tolist()))
        lessons.append(
            lesson(number, _PLANT.structure_name, parameters=learned, free=free, covariance=spreads)
        )  # fmt: skip
    return LivedRig(kind, changed, since, lessons)


class Told(NamedTuple):
    """What was reported on a rig, looking after every session."""

    first: int | None
    """Number of sessions after which its change was first named, alone or in a combination; None: never."""
    kind: str
    """What it was called at last; empty: nothing."""
    size: float
    """Size at last."""
    false: int
    """Sessions after which something was named that has not changed."""
    looks: int


def told_of(rig: LivedRig) -> Told:
    """Look after every session, from the fourth on."""
    first = None
    kind = ""
    size = math.nan
    false = 0
    for count in range(4, len(rig.lessons) + 1):
        changes = report_on(rig.lessons[:count], _PLANT).changes
        right = [
            c
            for c in changes
            if rig.kind != "steady" and rig.changed in c.name.split(" ")
        ]
        false += len(right) < len(changes)
        if right and (rig.kind == "drift" or count > rig.since):
            first = first or count
            kind = right[-1].kind
            size = right[-1].size
    return Told(first, kind, size, false, len(rig.lessons) - 3)
