"""A backtest as a plain dictionary, for JSON."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from twinmatch.offline.backtest.result import Backtest

__all__ = ["document"]


def document(backtest: Backtest, *, forecasts: bool = True) -> dict[str, Any]:
    """Report cards and, optionally, the marks of every forecast; NaN becomes None.

    Errors, ends, widths and scores are in units of the noise in the same document.
    """
    plant = backtest.plant
    found: dict[str, Any] = {
        "name": backtest.name,
        "plant": plant.name,
        "confidence": backtest.confidence,
        "horizons": list(backtest.horizons),
        "noise": {"output": plant.output.noise, "input": plant.drive.noise},
        "origins": backtest.origins,
        "cards": [_finite(asdict(card)) for card in backtest.cards],
        "absent": [absent._asdict() for absent in backtest.absent],
        "notes": list(backtest.notes),
    }
    if forecasts:
        found["forecasts"] = [
            {
                "session": one.session,
                "sample": one.sample,
                "horizon": one.horizon,
                "who": one.who,
                "candidate": one.candidate,
                "error": one.marks.error,
                **_finite(asdict(one.marks)),
            }
            for one in backtest.marked
        ]
    return found


def _finite(values: dict[str, Any]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}
