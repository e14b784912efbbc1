"""Replay: recordings against real time, growth with their length, a full verdict, and one sample live.

One core, in a process that has already loaded everything; `start_up` measures the time before that. The
recording is simulated; `python -m benchmarks.replay --recording FILE` uses your own instead.
"""

from __future__ import annotations

import argparse
import copy
import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from benchmarks.common import Row, Timing, measure_side_by_side, print_rows, rows_of
from benchmarks.rig import recorded
from twinmatch.comparing import Candidate, Verdict
from twinmatch.dynamics import Parameters
from twinmatch.importing import open_any
from twinmatch.offline.judging import Judgement, judge_samples
from twinmatch.plants import Peltier
from twinmatch.signals import Sample
from twinmatch.twin import Discriminator, MatchReport, TwinSettings, carry_out

HOUR = 3600
HOUR_TARGET = 1.2
"""Target for an hour, s; with 0.8 s for import and start-up, the total is two."""
VERDICT_TARGET = 0.5
"""Target for a verdict, s."""
SAMPLE_TARGET = 0.0002
"""Target for a sample without a verdict, s, after which all candidates can forecast."""
POINTS = (30, 40, 50, 60, 70, 80, 90, 100)
"""Operating points of eight candidates, °C."""


def _rig(at: int) -> Parameters:
    return Peltier.model().parameters(
        seebeck=0.055 + at / 6000, conductance=0.5, heat_capacity=25.0 + at / 10
    )


def run(quick: bool) -> list[Row]:
    judged = run_on(recorded(320 if quick else HOUR), quick)
    before_a_verdict = _before_a_verdict()
    judged += _growth(quick)
    judged += _full_verdict(*before_a_verdict, quick)
    return judged + _one_sample(*before_a_verdict, quick)


def run_on(samples: Sequence[Sample], quick: bool) -> list[Row]:
    """Time to judge one recording, compared with its duration."""
    settings = TwinSettings()
    calls = {"twinmatch": lambda: judge_samples("hour", samples, settings)}
    timings = measure_side_by_side(calls, 1 if quick else 5, patience=120.0)
    took = len(samples) * settings.period
    timings["real time"] = Timing((took,) * len(timings["twinmatch"].seconds))
    found: Judgement = timings["twinmatch"].result
    note = f"{len(found.verdicts)} verdicts, {len(found.matches)} matches"
    target = {"twinmatch": HOUR_TARGET * took / HOUR}
    return rows_of(
        "replay",
        f"{took / 60:.0f} minutes",
        timings,
        targets=target,
        notes={"twinmatch": note},
    )


def _growth(quick: bool) -> list[Row]:
    """Time to judge an hour of a recording, for short and long recordings."""
    lengths = (300, 320) if quick else (600, HOUR, 10 * HOUR)
    settings = TwinSettings()
    calls = {}
    for length in lengths:
        samples = recorded(length)
        calls[length] = lambda samples=samples: judge_samples("run", samples, settings)
    timings = measure_side_by_side(
        {str(n): c for n, c in calls.items()}, 1 if quick else 3, patience=240.0
    )
    return [
        Row(
            "replay",
            f"{name} samples",
            "twinmatch",
            timing.median,
            None,
            len(timing.seconds),
            None,
            note,
        )
        for name, timing in timings.items()
        for note in [f"{timing.median / int(name) * HOUR:.2f} s per hour"]
    ]


def _full_verdict(
    ready: Discriminator, sample: Sample, report: MatchReport, quick: bool
) -> list[Row]:
    """A full verdict: eight candidates' models of four orders and two outputs, all scores and ν-gaps."""

    def judge() -> tuple[Verdict, ...]:
        discriminator = copy.deepcopy(ready)
        discriminator.push_sample(sample)
        return discriminator.push_match(report).verdicts

    timings = measure_side_by_side(
        {"twinmatch": judge}, 1 if quick else 5, patience=120.0
    )
    verdict = timings["twinmatch"].result[-1]
    case = f"{len(verdict.modelled)} candidates × {len(verdict.modelled[0].orders)} orders × 2 outputs"
    note = f"on {verdict.last - verdict.first + 1} samples"
    return rows_of(
        "replay",
        case,
        timings,
        targets={"twinmatch": VERDICT_TARGET},
        notes={"twinmatch": note},
    )


def _one_sample(
    ready: Discriminator, sample: Sample, report: MatchReport, quick: bool
) -> list[Row]:
    """A sample between two triggers, until the outlooks of all candidates are there; `ready` moves on."""
    ready.push_sample(sample)
    ready.push_match(report)
    count = len(ready.forecaster.names)
    following = itertools.count(sample.index + 1)

    def push() -> int:
        ready.forecaster.push(replace(sample, index=next(following)))
        return len(ready.forecaster.snapshot().outlooks)

    timings = measure_side_by_side(
        {"twinmatch": push}, 20 if quick else 300, keeping=True
    )
    case = f"one sample live, {count} candidates forecast"
    return rows_of("replay", case, timings, targets={"twinmatch": SAMPLE_TARGET})


def _before_a_verdict() -> tuple[Discriminator, Sample, MatchReport]:
    """A discriminator with eight candidates before a window's last sample, that sample, and the match."""
    settings = TwinSettings()
    given = [Candidate(f"given {at} °C", float(at), _rig(at), None) for at in POINTS]
    samples = recorded(HOUR)
    probe = Discriminator(settings, given)
    ready = Discriminator(settings, given)
    for sample in samples:
        request = probe.push_sample(sample).request
        if request is not None:
            return ready, sample, carry_out(request, settings)
        ready.push_sample(sample)
    raise RuntimeError("the recording triggers no match")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="small cases and few rounds: does it run?"
    )
    parser.add_argument(
        "--recording",
        type=Path,
        metavar="FILE",
        help="judge this session or recording only",
    )
    options = parser.parse_args()
    if options.recording is None:
        rows = run(options.quick)
    else:
        rows = run_on(open_any(options.recording).samples, options.quick)
    print_rows(__doc__.splitlines()[0], rows)


if __name__ == "__main__":
    main()
