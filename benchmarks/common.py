"""Shared parts of the benchmarks: side-by-side timing, rows of results, their table, the machine."""

from __future__ import annotations

import argparse
import functools
import gc
import importlib
import importlib.metadata
import math
import os
import platform
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from types import ModuleType
from typing import Any

from rich.console import Console
from rich.table import Table

__all__ = [
    "Row",
    "Timing",
    "document",
    "duration",
    "environment",
    "forget_results",
    "main",
    "measure_side_by_side",
    "peer",
    "print_rows",
    "rows_of",
]

_Cached = functools._lru_cache_wrapper

PACKAGES = (
    "twinmatch",
    "numpy",
    "scipy",
    "numba",
    "control",
    "nugap",
    "casadi",
    "statsmodels",
    "sippy_unipi",
    "pysid",
    "timeseries-toolbox",
    "otwin",
)


@dataclass(frozen=True)
class Row:
    """One line of a benchmark's table.

    Attributes:
        benchmark: name of the module, for example "nu_gap".
        case: what was measured, for example "a pair of order 5".
        program: "twinmatch", or the peer's name.
        seconds: median time of one call, s; NaN if it could not be measured.
        ratio: median over rounds of this program's time divided by twinmatch's in the same round;
            above 1, the peer is that many times slower. None if there is nothing to compare.
        repeats: number of calls in the median.
        target: largest `seconds` (or, for a peer, least `ratio`) aimed at; None without a target.
        note: remarks on the figure, for example the accuracy that was reached.
    """

    benchmark: str
    case: str
    program: str
    seconds: float
    ratio: float | None = None
    repeats: int = 0
    target: float | None = None
    note: str = ""

    @property
    def met(self) -> bool | None:
        """Whether the target was met; None without one."""
        if self.target is None:
            return None
        return (
            self.seconds <= self.target
            if self.ratio is None
            else self.ratio >= self.target
        )


@dataclass(frozen=True)
class Timing:
    """Times of one case, s, one per round; `result` is the return value of its first call."""

    seconds: tuple[float, ...]
    result: Any = None
    error: str = ""

    @property
    def median(self) -> float:
        """Median time of one call, s; NaN if the case failed."""
        return median(self.seconds) if self.seconds else math.nan

    def ratio_to(self, other: Timing) -> float | None:
        """How many times longer this case takes than the other: median over the rounds of both."""
        pairs = zip(self.seconds, other.seconds, strict=False)
        ratios = [mine / its for mine, its in pairs]
        return median(ratios) if ratios else None


def measure_side_by_side(
    cases: Mapping[str, Callable[[], object]],
    repeats: int = 7,
    *,
    patience: float = 20.0,
    least: float = 2e-3,
    keeping: bool = False,
) -> dict[str, Timing]:
    """Time several programs in turns (A B C, A B C, …), so that changes of the load affect all alike.

    Each case is called once unmeasured, which compiles and reads files, unless that call alone exhausts the
    patience: then its time counts as the only one. A case faster than `least` is called many times a round.
    Every call computes: what twinmatch has kept of earlier ones, such as ν-gaps, is forgotten before it. A
    case that raises is left out and carries the error.

    Args:
        cases: program → a call without arguments.
        repeats: number of rounds.
        patience: largest total time of one case, s; after that it is left out of further rounds.
        least: least time of one measurement, s.
        keeping: nothing is forgotten, for calls that continue a run.
    """
    forget = None if keeping else forget_results
    first = {name: _attempt(call, 1, forget) for name, call in cases.items()}
    times: dict[str, list[float]] = {name: [] for name in cases}
    spent: dict[str, float] = {}
    loops: dict[str, int] = {}
    for name, timing in first.items():
        if timing.error:
            continue
        spent[name] = timing.median
        if spent[name] >= patience / 2:
            times[name] += timing.seconds  # there is no time for a second call
        else:
            again = _attempt(cases[name], 1, forget)  # the first call may have compiled
            spent[name] += sum(again.seconds)
            loops[name] = max(1, math.ceil(least / max(sum(again.seconds), 1e-9)))
            if loops[name] == 1:
                times[name] += again.seconds  # it was the first round
    for turn in range(repeats):
        for name, number in loops.items():
            if spent[name] < patience and len(times[name]) == turn:
                took = _attempt(cases[name], number, forget).median
                times[name].append(took)
                spent[name] += took * number
    return {
        name: Timing(tuple(times[name]), first[name].result, first[name].error)
        for name in cases
    }


def _attempt(
    call: Callable[[], object], loops: int, forget: Callable[[], None] | None
) -> Timing:
    gc.collect()
    gc.disable()
    took = 0.0
    rounds, together = (1, loops) if forget is None else (loops, 1)
    try:
        for _ in range(rounds):
            if forget is not None:
                forget()
            begin = time.perf_counter()
            for _ in range(together):
                result = call()
            took += time.perf_counter() - begin
        return Timing((took / loops,), result)
    except Exception as error:
        return Timing(
            (), error=f"{type(error).__name__}: {error}".splitlines()[0][:120]
        )
    finally:
        gc.enable()


def forget_results() -> None:
    """Empty the bounded caches of twinmatch: results that it keeps while a run continues."""
    for name in [name for name in sys.modules if name.startswith("twinmatch.")]:
        for value in list(vars(sys.modules[name]).values()):
            if (
                isinstance(value, _Cached)
                and value.cache_parameters()["maxsize"] is not None
            ):
                value.cache_clear()


def peer(module: str) -> ModuleType | None:
    """A peer's module, or None if it is not installed; `make bench` installs them all."""
    try:
        return importlib.import_module(module)
    except ImportError:
        return None


def rows_of(
    benchmark: str,
    case: str,
    timings: Mapping[str, Timing],
    *,
    own: str = "twinmatch",
    targets: Mapping[str, float] | None = None,
    notes: Mapping[str, str] | None = None,
) -> list[Row]:
    """One row per program; ratios are to the program named `own`."""
    targets = targets or {}
    notes = notes or {}
    return [
        Row(
            benchmark,
            case,
            name,
            timing.median,
            None if name == own else timing.ratio_to(timings[own]),
            len(timing.seconds),
            targets.get(name),
            timing.error or notes.get(name, ""),
        )
        for name, timing in timings.items()
    ]


def environment() -> dict[str, str]:
    """The environment of the measurement: machine, load, versions of all packages involved."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = (line.partition(":") for line in info.read_text().splitlines())
        model = next(
            (value.strip() for key, _, value in lines if key.strip() == "model name"),
            model,
        )
    found = {
        "processor": f"{model}, {os.cpu_count()} cores, one BLAS thread",
        "load": " ".join(f"{load:.1f}" for load in os.getloadavg()),
        "python": f"{platform.python_version()} on {platform.system()} {platform.release()}",
    }
    for package in PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found


def print_rows(title: str, rows: Sequence[Row]) -> None:
    """Print a benchmark's rows as a table."""
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for column, side in (
        ("case", "left"),
        ("program", "left"),
        ("median", "right"),
        ("ratio", "right"),
    ):
        table.add_column(
            column, justify="right" if side == "right" else "left", no_wrap=True
        )
    table.add_column("runs", justify="right")
    table.add_column("target", no_wrap=True)
    table.add_column("note", overflow="fold")
    shown = ""
    for row in rows:
        case = "" if row.case == shown else row.case
        shown = row.case
        ratio = "" if row.ratio is None else f"{row.ratio:.3g} ×"
        table.add_row(
            case,
            row.program,
            duration(row.seconds),
            ratio,
            str(row.repeats),
            _target(row),
            row.note,
        )
    Console(width=160, highlight=False, markup=False).print(table)


def duration(seconds: float) -> str:
    """Format a time in a suitable unit."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return "–" if math.isnan(seconds) else f"{seconds / 1e-9:.3g} ns"


def _target(row: Row) -> str:
    if row.target is None:
        return ""
    aim = f"≤ {duration(row.target)}" if row.ratio is None else f"≥ {row.target:g} ×"
    return f"{aim} {'met' if row.met else 'MISSED'}"


def document(rows: Sequence[Row]) -> dict[str, object]:
    """Environment and rows for JSON; values that could not be measured are null."""
    entries = [asdict(row) | {"met": row.met} for row in rows]
    for entry in entries:
        if math.isnan(entry["seconds"]):
            entry["seconds"] = None
    return {"environment": environment(), "rows": entries}


def main(run: Callable[[bool], list[Row]], title: str | None) -> None:
    """The command line of a single benchmark: `python -m benchmarks.nu_gap [--quick]`."""
    heading = (title or "").strip().splitlines()[0]
    parser = argparse.ArgumentParser(description=heading)
    parser.add_argument(
        "--quick", action="store_true", help="small cases and few rounds: does it run?"
    )
    options = parser.parse_args()
    print(", ".join(f"{name} {value}" for name, value in environment().items()))
    print_rows(heading, run(options.quick))
