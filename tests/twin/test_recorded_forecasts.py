"""What the whole twin forecasts on recorded healthy hours, against the measurements.

The limits are promises, not records: bands that promise 90 % hold 87 to 94 % over all hours and 78 % in each;
the leader is worse than the best in hindsight by 4 % at most in the mean; the ν-gap of two candidates goes
with how differently they behave.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import spearmanr

from twinmatch.dynamics import Parameters, begin, simulate_closed_loop
from twinmatch.forecasting import Outlook
from twinmatch.sessions import open_any
from twinmatch.signals import FloatArray, Sample
from twinmatch.twin import Twin, TwinSettings

HEALTHY = (1, 2, 5, 9, 14, 20)
AHEAD, EVERY = 300, 20
AT = (10, 60, 300)
SETTINGS = TwinSettings()
NOISE = np.array([[SETTINGS.noise.output], [SETTINGS.noise.input]])


@dataclass
class Hour:
    """One recording, judged once."""

    leading: list[float] = field(default_factory=list)
    """Error of the leader over the next 300 s, after every verdict on a window that moved."""
    best: list[float] = field(default_factory=list)
    """Of the best candidate in hindsight."""
    decided: list[bool] = field(default_factory=list)
    inside: list[list[bool]] = field(default_factory=list)
    """Whether output and input lay in the band at 10, 60 and 300 s."""
    gaps: list[float] = field(default_factory=list)
    apart: list[float] = field(default_factory=list)
    """ν-gaps between candidates, and RMS differences of their answers to the hour's set-points."""


def judged(samples: list[Sample]) -> Hour:
    hour, twin = Hour(), Twin()
    signals = np.array([[s.output for s in samples], [s.input for s in samples]])
    reference = np.array([s.reference for s in samples])
    for k, sample in enumerate(samples):
        verdicts = [v for v in twin.push(sample).verdicts if not v.stands]
        if k + AHEAD >= len(samples):
            continue
        coming, forecaster = slice(k + 1, k + 1 + AHEAD), twin.discriminator.forecaster
        for verdict in verdicts:
            errors = {
                name: error(forecaster.outlook(name), reference[coming], signals[:, coming])
                for name in forecaster.names
            }
            hour.leading.append(errors[str(verdict.leader)])
            hour.best.append(min(errors.values()))
            hour.decided.append(verdict.decided)
            answers = [answer(c.parameters, reference, samples[0].output) for c in verdict.candidates]
            for i, j in zip(*np.tril_indices(len(answers), -1), strict=True):
                hour.gaps.append(verdict.nu_gap[i][j])
                hour.apart.append(rms(answers[i] - answers[j]))
        if k % EVERY == 0 and forecaster.leader is not None:
            told = forecaster.outlook().forecast(reference[coming])
            bands = ((told.output, 0), (told.input, 1))
            hour.inside.append(
                [b.low[h - 1] <= signals[row, k + h] <= b.high[h - 1] for h in AT for b, row in bands]
            )
    return hour


def rms(difference: FloatArray) -> float:
    """Of output and input together, in units of their noise."""
    return float(np.sqrt(np.mean(np.square(difference / NOISE))))


def error(outlook: Outlook, reference: FloatArray, came: FloatArray) -> float:
    return rms(np.array(outlook.predicted(reference, banded=False)[:2]) - came)


def answer(parameters: Parameters, reference: FloatArray, start: float) -> FloatArray:
    run = simulate_closed_loop(parameters, reference, states=begin(parameters, start), gains=SETTINGS.gains)
    return np.stack([run.output, run.input])


@pytest.fixture(scope="module")
def hours(recordings: dict[int, Path]) -> list[Hour]:
    if not set(HEALTHY) <= recordings.keys():
        pytest.skip("the recorded hours are not here; TWINMATCH_RECORDINGS names their folder")
    return [judged(list(open_any(recordings[n]).samples)) for n in HEALTHY]


def test_the_leader_is_hardly_worse_than_the_best_in_hindsight(hours: list[Hour]) -> None:
    leading, best = (np.concatenate([getattr(h, n) for h in hours]) for n in ("leading", "best"))
    assert np.mean(leading / best) <= 1.04
    assert np.median(leading) <= 1.35  # 1.29 was measured; the nominal twin has 1.66


def test_when_it_is_decided_it_is_right(hours: list[Hour]) -> None:
    leading, best = (np.concatenate([getattr(h, n) for h in hours]) for n in ("leading", "best"))
    decided = np.concatenate([h.decided for h in hours])
    assert decided.mean() > 0.2, "a twin that never decides is right by silence"
    assert np.mean((leading <= 1.03 * best)[decided]) >= 0.9


def test_bands_hold_what_they_promise(hours: list[Hour]) -> None:
    shares = np.array([np.mean(h.inside, axis=0) for h in hours])
    together = np.mean(np.concatenate([np.array(h.inside) for h in hours]), axis=0)
    assert np.all((together >= 0.87) & (together <= 0.94)), together
    assert shares.min() >= 0.78, shares


def test_the_gap_goes_with_how_differently_two_candidates_behave(hours: list[Hour]) -> None:
    gaps, apart = (np.concatenate([getattr(h, n) for h in hours]) for n in ("gaps", "apart"))
    assert spearmanr(gaps, apart).statistic >= 0.6
    assert gaps.max() < 0.9
