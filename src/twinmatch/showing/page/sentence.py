"""The session so far in one sentence, as the terminal prints it at the end."""

from __future__ import annotations

import math
from dataclasses import replace

from twinmatch.dynamics import PidGains
from twinmatch.showing import sentence, summarise
from twinmatch.showing.page.state import DashboardState
from twinmatch.signals import FloatArray, Sample

__all__ = ["update_sentence"]


def update_sentence(state: DashboardState, gains: PidGains | None) -> None:
    """Summarise the samples that are kept, with the newest verdict, into `state.sentence`.

    Takes a few milliseconds; call it for a new verdict, not for every sample. `gains` are those of the
    running controller; None where the controller is not known.
    """
    with state.lock:
        verdict, period = state.verdict, state.period
        columns, _ = state.plant.since(0)
    summed_up = ""
    if verdict is not None and (verdict.leader or verdict.nominal):
        samples = _samples(columns)
        if samples:
            summed_up = sentence(
                summarise(samples, [verdict], gains and replace(gains, period=period), period=period)
            )
    with state.lock:
        if state.verdict is verdict:
            state.sentence = summed_up


def _samples(columns: dict[str, FloatArray]) -> list[Sample]:
    rows = zip(*(columns[n].tolist() for n in ("index", "reference", "output", "input")), strict=True)
    return [Sample(int(k), 0, r, y, u) for k, r, y, u in rows if not math.isnan(r)]  # NaN: a gap
