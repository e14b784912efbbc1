"""The benchmarks run; what they measure is for a reader, not for a test."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.places import PROJECT


@pytest.fixture
def common(monkeypatch: pytest.MonkeyPatch) -> object:
    """`benchmarks.common`, which is not an installed package; it would set the threads of this process."""
    monkeypatch.syspath_prepend(str(PROJECT))
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.setenv(variable, "1")
    # Before each measurement; of what all tests have left, a fifth of a second.
    monkeypatch.setattr("gc.collect", lambda: 0)
    import benchmarks.common

    return benchmarks.common


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "benchmarks", *map(str, arguments)]
    return subprocess.run(
        command, cwd=PROJECT, capture_output=True, text=True, check=False, timeout=280
    )


def test_replay_is_measured_and_written_down(tmp_path: Path) -> None:
    completed = run("--quick", "replay", "--json", tmp_path / "out.json")
    assert completed.returncode == 0, completed.stderr
    report = json.loads((tmp_path / "out.json").read_text())
    assert {"processor", "load", "python", "numpy"} <= set(report["environment"])
    cases = {
        row["case"]: row for row in report["rows"] if row["program"] == "twinmatch"
    }
    assert all(
        row["benchmark"] == "replay" and row["seconds"] > 0 for row in cases.values()
    )
    assert "8 candidates × 4 orders × 2 outputs" in cases
    assert all(case in completed.stdout for case in cases)


def test_every_benchmark_can_be_listed_and_others_are_refused() -> None:
    listed = run("--list").stdout.split()
    assert {"replay", "start_up"} <= set(listed)
    assert "common" not in listed
    refused = run("no_such")
    assert refused.returncode == 2
    assert "no_such" in refused.stderr
    assert "replay" in refused.stderr


def test_programs_take_turns_and_failures_stay_in_the_table(common) -> None:
    order = []

    def fail() -> None:
        raise RuntimeError("does not converge\nat all")

    def succeed() -> str:
        order.append("a")
        return "result"

    cases = {"twinmatch": succeed, "peer": lambda: order.append("b"), "broken": fail}
    timings = common.measure_side_by_side(cases, repeats=4, least=0.0)
    assert order[-8:] == 4 * ["a", "b"]
    assert [len(t.seconds) for t in timings.values()] == [4, 4, 0]
    assert timings["twinmatch"].result == "result"
    rows = {
        row.program: row
        for row in common.rows_of("x", "case", timings, targets={"broken": 2.0})
    }
    assert rows["broken"].note == "RuntimeError: does not converge"
    assert math.isnan(rows["broken"].seconds)
    assert rows["broken"].ratio is None
    assert rows["twinmatch"].ratio is None
    assert rows["peer"].ratio > 0
    assert json.dumps(common.document(list(rows.values())), allow_nan=False)


def test_what_is_measured_is_computed_at_every_call(common) -> None:
    """Candidates stay in a family for many verdicts, so ν-gaps are kept: asked again, they cost a look-up."""
    from twinmatch.comparing import GraphSymbol, nu_gap
    from twinmatch.comparing.nu_gap import gap_between

    symbols = [
        GraphSymbol.of_transfer_functions([([0.1], [1.0, -a])], 1.0) for a in (0.5, 0.9)
    ]

    case = {"twinmatch": lambda: nu_gap(*symbols)}
    (timing,) = common.measure_side_by_side(case, repeats=2).values()
    assert timing.result > 0
    assert gap_between.cache_info()[:2] == (0, 1)
    common.measure_side_by_side(case, repeats=2, keeping=True)
    assert gap_between.cache_info().hits > 2


def test_a_slow_program_is_not_asked_twice(common) -> None:
    calls = []
    timings = common.measure_side_by_side(
        {"slow": lambda: calls.append(1)}, repeats=5, patience=0.0
    )
    assert len(calls) == len(timings["slow"].seconds) == 1


def test_a_ratio_is_that_of_rounds_not_of_medians(common) -> None:
    """A machine that slows down threefold half-way changes no ratio."""
    ours = common.Timing((1.0, 1.0, 3.0, 3.0))
    peers = common.Timing((2.0, 2.0, 6.0, 6.0))
    assert peers.ratio_to(ours) == 2.0
    assert common.Timing(()).ratio_to(ours) is None


@pytest.mark.parametrize(
    ("seconds", "ratio", "target", "met"),
    [
        (1.0, None, 2.0, True),
        (3.0, None, 2.0, False),
        (3.0, 4.0, 5.0, False),
        (3.0, 6.0, 5.0, True),
    ],
)
def test_targets_are_most_seconds_for_us_and_least_ratios_for_peers(
    seconds: float, ratio: float | None, target: float, met: bool, common
) -> None:
    assert common.Row("x", "case", "who", seconds, ratio, 1, target).met is met
