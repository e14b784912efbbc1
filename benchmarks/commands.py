"""Commands: processor time of the long ones by samples, in references.

Each command runs in a process of its own, as from the shell, once a round, and its time is that of all its
processes. The reference is a fixed piece of Python and NumPy, timed in every round, by whose median the times are
divided: machines, and what else they do, differ. A command whose cost grows faster than its samples shows in the last
part of a note.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np

from benchmarks.common import Row, main
from benchmarks.rig import recorded
from twinmatch.dynamics import begin, simulate_driven
from twinmatch.plants import TCLab
from twinmatch.sessions import write_session

SAMPLES = (1800, 3600, 7200)
LAW = {
    "kind": "pid",
    "proportional": 77,
    "integral": 2.9,
    "derivative": 13,
    "back_calculation": 1.0,
}
"""The law that `try-controller` tries on the rig."""
LEVELS = 17
"""Levels of the heater in the table."""
HOLD = 212
"""Samples for which each of them is held."""
ROOM = 23.0
"""Temperature of the room, °C."""
ANSWERS = (0, 1, 3)
"""Exit codes of a command that has answered; 3: that there is no answer yet."""


@dataclass(frozen=True)
class Recording:
    """What the commands are given: a rig's session, a table of a kit in open loop, and a law."""

    count: int
    """Samples of the session, and rows of the table."""
    folder: Path

    @property
    def session(self) -> Path:
        """The session of a rig."""
        return self.folder / "rig"

    @property
    def table(self) -> Path:
        """The table of a kit."""
        return self.folder / "kit.csv"

    @property
    def law(self) -> Path:
        """The law to be tried on the rig."""
        return self.folder / "law.json"


COMMANDS: dict[str, Callable[[Recording], list[object]]] = {
    "replay": lambda given: [given.session],
    "backtest": lambda given: [given.session],
    "try-controller": lambda given: [given.session, "--loop", given.law],
    "experiment": lambda given: [given.session],
    "check-plant": lambda given: ["tclab", "--data", given.table],
    "new-plant": lambda given: [
        f"kit_{time.perf_counter_ns()}",
        *("--from", given.table, "--output", given.folder),
    ],
}
"""The arguments of each command."""


def run(quick: bool) -> list[Row]:
    counts = (900,) if quick else SAMPLES
    with tempfile.TemporaryDirectory() as folder:
        recordings = [recording(Path(folder) / str(count), count) for count in counts]
        return _measured(recordings, 1 if quick else 3)


def reference() -> float:
    """What costs the same in every version: a recursion in Python, and factors of matrices."""
    state = 0.5
    for _ in range(8_000_000):
        state = 3.7 * state * (1.0 - state)
    matrix = np.random.default_rng(0).normal(size=(200, 200))
    for _ in range(240):
        matrix = np.linalg.qr(matrix)[0]
    return state + float(matrix[0, 0])


def recording(folder: Path, count: int) -> Recording:
    """So many samples of a rig in its loop, and of a kit whose heater goes through many levels."""
    folder.mkdir()
    made = Recording(count, folder)
    write_session(made.session, recorded(count))
    made.law.write_text(json.dumps(LAW))
    random = np.random.default_rng(5)
    levels = random.choice(np.linspace(0.0, 80.0, LEVELS), -(-count // HOLD))
    power = np.repeat(levels, HOLD)[:count]
    kit = TCLab.model(TCLab.followed).typical()
    response = simulate_driven(kit, power, states=begin(kit, ROOM), period=1.0)
    readings = response.output + random.normal(0.0, TCLab.output.noise, count)
    rows = [
        f"{second},{reading:.2f},{level:g},0"
        for second, (reading, level) in enumerate(zip(readings, power, strict=True))
    ]
    made.table.write_text("\n".join(["time,temperature,power,second", *rows]))
    return made


def _measured(recordings: list[Recording], rounds: int) -> list[Row]:
    """The rows of all commands; a first round compiles, and does not count."""
    calls: dict[tuple[str, int], Callable[[], float]] = {
        (name, given.count): partial(cost, name, given)
        for name in COMMANDS
        for given in recordings
    }
    times: dict[tuple[str, int], list[float]] = {case: [] for case in calls}
    references: list[float] = []
    for turn in range(rounds + 1):
        began = time.process_time()
        reference()
        references.append(time.process_time() - began)
        for case, call in calls.items():
            seconds = call()
            if turn > 0:
                times[case].append(seconds)
    return costs_in_references(times, references)


def costs_in_references(
    times: Mapping[tuple[str, int], Sequence[float]], references: Sequence[float]
) -> list[Row]:
    """The rows of times, s, by command and number of samples, of which those of a command rise."""
    one = median(references)
    rows = [Row("commands", "reference", "reference", one, repeats=len(references))]
    command_before = ""
    count_before = 0
    typical_before = math.nan
    for (command, count), seconds in times.items():
        typical = median(seconds)
        note = f"{typical / one:.2f} references"
        if command == command_before:
            grown = typical / typical_before
            note += f"; × {grown:.2f} for × {count / count_before:g} samples"
        case = f"{command}, {count} samples"
        rows.append(
            Row("commands", case, "twinmatch", typical, repeats=len(seconds), note=note)
        )
        command_before = command
        count_before = count
        typical_before = typical
    return rows


def cost(name: str, given: Recording) -> float:
    """Processor time of a command with all its processes, s.

    Raises:
        RuntimeError: it did not answer.
    """
    arguments = map(str, COMMANDS[name](given))
    command = [sys.executable, "-m", "twinmatch.cli", name, *arguments]
    environment = {
        n: v for n, v in os.environ.items() if n != "PYTHONDONTWRITEBYTECODE"
    }
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=errors, env=environment
        )
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode not in ANSWERS:
            errors.seek(0)
            last = errors.read().decode().strip().splitlines()[-1:]
            raise RuntimeError(f"{name}: exit code {process.returncode}: {last}")
    return usage.ru_utime + usage.ru_stime


if __name__ == "__main__":
    main(run, __doc__)
