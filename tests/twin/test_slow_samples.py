"""A plant of which a sample comes every half minute, and later."""

from __future__ import annotations

import numpy as np

from tests.support.plants import Lag
from twinmatch.comparing import TrustLevel
from twinmatch.offline.judging import judge_samples
from twinmatch.signals import Sample
from twinmatch.twin import TwinSettings

PERIOD = 30.0
LAG = 45.0
GAIN = 2.0


def recording(size: int = 800, shift: float = 0.0) -> list[Sample]:
    """Steps of the input, 100 samples each; from sample 750 on the output is shifted."""
    rng = np.random.default_rng(7)
    levels = (0.0, 6.0, -3.0, 8.0, 2.0, -7.0, 5.0)
    x = 0.0
    decay = np.exp(-PERIOD / LAG)
    samples = []
    for k in range(size):
        u = levels[k // 100 % len(levels)]
        y = x + rng.normal(0.0, Lag.output.noise) + (shift if k >= 750 else 0.0)
        samples.append(Sample(k, round(k * PERIOD * 1e9), 0.0, float(y), u))
        x = decay * x + (1.0 - decay) * GAIN * u  # exact for a constant input
    return samples


def test_forecasts_are_compared_and_a_change_is_noticed() -> None:
    """The longest horizon has to reach over the samples between two verdicts, or none can be compared."""
    settings = TwinSettings.of(Lag, period=PERIOD)
    judged = judge_samples("slow", recording(shift=1.0), settings)
    before = [v for v in judged.verdicts if 550 <= v.sample < 750]
    assert before
    assert all(v.level is TrustLevel.TRUSTED for v in before)
    assert all(v.miss_y < 1.0 for v in before)  # 0.6 is usual
    after = [v for v in judged.verdicts if v.sample > 760]
    assert any(v.level in {TrustLevel.DOUBTFUL, TrustLevel.FAULT} for v in after)
