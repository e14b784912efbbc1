"""Start-up: from the shell to the first sample judged, and a whole hour from the shell.

Everything runs in new processes, so the start of Python counts, too; `python -c pass` is measured for
comparison. Kernels are compiled beforehand, as by `make setup`, and modules are byte-compiled, as Python does
at the first use unless that is disabled.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median

from benchmarks.common import Row, main, measure_side_by_side
from benchmarks.rig import recorded
from twinmatch.sessions import write_session

START_TARGET = 0.8
"""Target for import and start-up, s."""
HOUR_TARGET = 2.0
"""Target for an hour including start-up, s."""


def run(quick: bool) -> list[Row]:
    with tempfile.TemporaryDirectory() as folder:
        quiet = write_session(Path(folder) / "quiet", recorded(250))
        short = write_session(Path(folder) / "short", recorded(700))
        hour = write_session(Path(folder) / "hour", recorded(700 if quick else 3600))
        cases: dict[str, Callable[[], object]] = {
            "python -c pass": _python("-c", "pass"),
            "import twinmatch.offline.judging": _python(
                "-c", "import twinmatch.offline.judging"
            ),
            "replay, no match": _python("-m", "twinmatch.cli", "replay", quiet),
            "replay, two matches": _python("-m", "twinmatch.cli", "replay", short),
            f"replay, {12 if quick else 60} min": _python(
                "-m", "twinmatch.cli", "replay", hour
            ),
        }
        timings = measure_side_by_side(cases, 1 if quick else 7, patience=120.0)
        loading = _loading(short, 1 if quick else 7)
    targets = {"replay, no match": START_TARGET, "replay, 60 min": HOUR_TARGET}
    rows = [
        Row(
            "start_up",
            case,
            "twinmatch",
            t.median,
            None,
            len(t.seconds),
            targets.get(case),
            t.error,
        )
        for case, t in timings.items()
    ]
    return [*rows, loading]


def _python(*arguments: object) -> Callable[[], object]:
    command = [sys.executable, *map(str, arguments)]
    return partial(
        subprocess.run, command, check=True, capture_output=True, env=_environment()
    )


def _environment() -> dict[str, str]:
    return {
        name: value
        for name, value in os.environ.items()
        if name != "PYTHONDONTWRITEBYTECODE"
    }


def _loading(session: Path, repeats: int) -> Row:
    """CPU time of a new process before it judges: that of a first replay minus that of a second one."""
    code = (
        "import sys, time; from pathlib import Path; from twinmatch.importing import open_any\n"
        "from twinmatch.offline.judging import judge, terms_from_files\n"
        "def run(): session = open_any(Path(sys.argv[1])); judge(session, terms_from_files(session))\n"
        "run(); first = time.process_time(); run(); print(2 * first - time.process_time())"
    )
    command = [sys.executable, "-c", code, str(session)]
    took = [
        float(
            subprocess.run(
                command, check=True, capture_output=True, text=True, env=_environment()
            ).stdout
        )
        for _ in range(repeats)
    ]
    note = "CPU time of Python, imports and loading all kernels"
    return Row(
        "start_up",
        "before judging",
        "twinmatch",
        median(took),
        None,
        repeats,
        START_TARGET,
        note,
    )


if __name__ == "__main__":
    main(run, __doc__)
