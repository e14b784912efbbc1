"""Lessons made up for tests of the memory."""

from __future__ import annotations

import numpy as np

from twinmatch.memory import Lesson

HOUR = 3_600_000_000_000


def lesson(number: int = 1, structure: str = "paper", *, rig: str = "", **changed: object) -> Lesson:
    """That of the session `number`, a day after the one before; its covariance is of no particular size."""
    values = {"seebeck": 0.05 + 1e-3 * number, "conductance": 0.5, "resistance": 3.3}
    spread = np.array([[1e-6, 2e-6], [2e-6, 1e-4]])
    of: dict[str, object] = {
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
    return Lesson(**(of | changed))  # type: ignore[arg-type]
