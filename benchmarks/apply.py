"""Laws put on trial on simulated rigs and kits although half of them are unsound: which are taken back, when.

    python -m benchmarks.apply 60

Every law is the plant's own with other gains. It drives at once, and is watched by `control.Loop` alone.
"""

from __future__ import annotations

import argparse
import copy
import math
from collections.abc import Sequence
from dataclasses import replace
from statistics import median

import numpy as np

from benchmarks.experiment import Bench, taught
from twinmatch.controllers import (
    ControllerDecision,
    ControllerQuestion,
    TriedTwin,
    try_controller,
    try_now,
)
from twinmatch.dynamics import PidGains, law_of, pids_of
from twinmatch.plants import Peltier, TCLab
from twinmatch.safety import LawTrial, TrialBands, TrialPhase

PATIENCE = {"peltier": 10, "tclab": 10}
"""Samples outside, less those inside since."""
TRUE = {
    "peltier": "sink with mass, free ambient",
    "tclab": "sensor lag, radiation, neighbour",
}
AFTER = 900
"""Samples that a law may drive."""


def gains_of(bench: Bench, rng: np.random.Generator) -> PidGains:
    """The plant's own PID with each gain changed by up to a factor."""
    [own] = pids_of(law_of(bench.plant, 1.0))
    far = math.exp(rng.uniform(-0.7, 6.5))
    names = ("proportional", "integral", "derivative")
    return replace(
        own,
        **{n: getattr(own, n) * far * math.exp(rng.uniform(-0.3, 0.3)) for n in names},
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line for each law, then what they come to."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("number", type=int, nargs="?", default=60)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    back: list[float] = []
    unsound = wrongly = sound = kept = beyond = 0
    bumps = []
    for k in range(options.number):
        if k % 6 < 2:
            lessons = [
                taught(p, TRUE[p.name], options.seed + k) for p in (Peltier, TCLab)
            ]
        bench, members, terms = lessons[k % 2]
        plant = bench.plant
        bench = copy.deepcopy(bench)
        rng = np.random.default_rng(options.seed + k)
        gains = gains_of(bench, rng)
        level = np.tile(terms.before, (240, 1))
        truth = TriedTwin("truth", bench.truth)
        really = try_controller(
            [truth],
            ControllerQuestion(gains, level, terms.before, terms.holding, draws=1),
        )
        found = try_now(members, gains, terms.holding, terms.before)
        trial = LawTrial(TrialBands(found.low, found.high, 0, PATIENCE[plant.name]))
        before = bench.loop.input
        bench.loop.try_law(gains, trial)
        first = bench.sample(float(terms.before[0]))
        if trial.drives:
            bumps.append(abs(first.input - before) / plant.drive.noise)
        at, low, high = math.inf, *plant.output.safe
        for j in range(AFTER):
            sample = bench.sample(float(terms.before[0]))
            beyond += not low <= sample.output <= high
            if trial.phase is TrialPhase.BACK:
                at = min(at, j + 2.0)
        is_unsound = really.decision is not ControllerDecision.SAFE
        unsound = unsound + is_unsound
        sound = sound + (not is_unsound)
        if is_unsound:
            back.append(at)
        else:
            wrongly += trial.phase is TrialPhase.BACK
            kept += trial.phase is TrialPhase.KEPT
        said = found.answer.decision.value
        words = f"really {really.decision.value}, said {said}, {trial.phase.value} {at:g} {trial.reason}"
        print(f"  {plant.name}: {words}", flush=True)
    print(
        f"{unsound} unsound laws: back after {median(back):g} s in the median, {back.count(math.inf)} never; "
        f"{sound} sound ones: {wrongly} taken back, {kept} kept; {beyond} samples beyond the range; "
        f"bump at most {max(bumps):.2g} of the noise"
    )


if __name__ == "__main__":
    main()
