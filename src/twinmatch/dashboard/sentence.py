"""The whole session in one sentence, as the terminal says it at the end, said while it lasts."""

from __future__ import annotations

import math
from dataclasses import replace

from twinmatch.dashboard.state import DashboardState
from twinmatch.dynamics import PidGains
from twinmatch.signals import FloatArray, Sample
from twinmatch.views import sentence, summarise

__all__ = ["say"]


def say(state: DashboardState, gains: PidGains | None) -> None:
    """Sum up the samples that are kept, with the newest verdict, into `state.sentence`.

    Takes a few milliseconds; call it when there is a new verdict, not for every sample. `gains` are those of
    the running controller, if it is known.
    """
    with state.lock:
        verdict, period = state.verdict, state.period
        columns, _ = state.plant.since(0)
    said = ""
    if verdict is not None and (verdict.leader or verdict.nominal):
        samples = _samples(columns)
        if samples:
            said = sentence(
                summarise(samples, [verdict], gains and replace(gains, period=period), period=period)
            )
    with state.lock:
        if state.verdict is verdict:
            state.sentence = said


def _samples(columns: dict[str, FloatArray]) -> list[Sample]:
    rows = zip(*(columns[n].tolist() for n in ("index", "reference", "output", "input")), strict=True)
    return [Sample(int(k), 0, r, y, u) for k, r, y, u in rows if not math.isnan(r)]  # else a gap
