"""What each test took: kept in a file, and compared with the stored run.

Seconds of the clock are how long somebody waits; they depend on what else the machine does. Seconds of the
processors, of the test's process and of all that it started, hardly do, so growth is judged by them.
"""

from __future__ import annotations

import json
import os
import resource
import statistics
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Cost", "Costs", "files_that_grew", "processor_seconds"]

TICK = os.sysconf("SC_CLK_TCK")
GROWN = 1.5
"""From how many times the stored seconds on a file has grown: twice the spread of two runs of one machine."""
NOTICED = 2.0
"""Below so many seconds of the processors more, nobody waits longer."""


def processor_seconds() -> float:
    """Time of the processors, s, that this process and all it has started have used until now."""
    own_usage = resource.getrusage(resource.RUSAGE_SELF)
    ended_children = resource.getrusage(resource.RUSAGE_CHILDREN)
    total = (
        own_usage.ru_utime
        + own_usage.ru_stime
        + ended_children.ru_utime
        + ended_children.ru_stime
    )
    for process in _descendants(os.getpid()):
        total += _seconds_of(process)
    return total


def _descendants(process: int) -> Iterator[int]:
    """Running processes below this one, at any depth.

    Reading the kernel's lists takes a tenth of a millisecond; a search of all processes would take longer
    than most tests.
    """
    for children_of_a_thread in Path(f"/proc/{process}/task").glob("*/children"):
        try:
            children = children_of_a_thread.read_text().split()
        except OSError:  # the thread has ended
            continue
        for child in children:
            yield int(child)
            yield from _descendants(int(child))


def _seconds_of(process: int) -> float:
    """Time of the processors, s, of a process and its ended children; 0 if it has ended itself."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    # user and system: its own, and its children's
    ticks = sum(int(field) for field in fields[11:15])
    return ticks / TICK


@dataclass
class Cost:
    """What a test or a file took."""

    waited: float = 0.0
    """Seconds of the clock."""
    computed: float = 0.0
    """Seconds of the processors."""

    def add(self, other: Cost) -> None:
        self.waited += other.waited
        self.computed += other.computed


class Costs:
    """What the tests of a run took, by their names."""

    def __init__(self) -> None:
        self.by_test: dict[str, Cost] = {}

    def add(self, test: str, cost: Cost) -> None:
        """Add a phase of a test: its set-up, the test itself, what follows it."""
        self.by_test.setdefault(test, Cost()).add(cost)

    def by_file(self) -> dict[str, Cost]:
        """The same by files, the slowest first."""
        files: dict[str, Cost] = {}
        for test, cost in self.by_test.items():
            files.setdefault(test.split("::")[0], Cost()).add(cost)
        return dict(
            sorted(files.items(), key=lambda item: item[1].waited, reverse=True)
        )

    def write(self, path: Path) -> None:
        """Keep what each test took; those that this run has left out stay as they were."""
        path.parent.mkdir(parents=True, exist_ok=True)
        rows = json.loads(path.read_text()) if path.exists() else {}
        rows |= {
            test: [round(cost.waited, 2), round(cost.computed, 2)]
            for test, cost in self.by_test.items()
        }
        path.write_text(json.dumps(rows, indent=0, sort_keys=True) + "\n")

    @classmethod
    def read(cls, path: Path) -> Costs:
        """What `write` has kept; nothing if there is no such file."""
        costs = cls()
        if path.exists():
            for test, (waited, computed) in json.loads(path.read_text()).items():
                costs.add(test, Cost(waited, computed))
        return costs


def files_that_grew(
    stored: Mapping[str, Cost], measured: Mapping[str, Cost]
) -> list[str]:
    """Lines on the files that compute longer than in the stored run, and on those that are new and slow.

    None without a stored run. Machines differ: what all files have in common, the median ratio, is the
    machine's.
    """
    if not stored:
        return []
    ratios = [
        measured[name].computed / cost.computed
        for name, cost in stored.items()
        if name in measured and cost.computed > NOTICED
    ]
    machine = statistics.median(ratios) if ratios else 1.0
    lines = []
    for name, cost in measured.items():
        before = stored[name].computed * machine if name in stored else 0.0
        if cost.computed > GROWN * before and cost.computed - before > NOTICED:
            was = f"{before:.1f} s" if name in stored else "new"
            lines.append(f"{name}: {cost.computed:.1f} s of the processors ({was})")
    return lines
