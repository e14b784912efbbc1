"""The record of what tests take."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.durations import Cost, Costs, files_that_grew, processor_seconds


def test_processes_that_still_run_and_their_children_count() -> None:
    """A program computes, starts another that does, and both wait: their time is this process's."""
    computes = "import time\nwhile time.process_time() < 0.3: pass\n"
    program = (
        f"{computes}import subprocess, sys\n"
        f"child = subprocess.Popen([sys.executable, '-c', {computes!r} + 'print(1, flush=True); input()'])\n"
        "child.wait()\n"
    )
    before = processor_seconds()
    running = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    try:
        assert running.stdout is not None
        assert running.stdout.readline() == b"1\n"
        # 0.3 s each, less the kernel's ticks
        assert processor_seconds() - before >= 0.55
    finally:
        running.communicate(b"\n")
    assert processor_seconds() - before >= 0.55


def test_what_a_test_took_is_kept(tmp_path: Path) -> None:
    costs = Costs()
    costs.add("a.py::first", Cost(1.0, 0.5))
    costs.add("a.py::first", Cost(0.5, 0.25))
    costs.add("b.py::other", Cost(4.0, 0.1))
    costs.write(tmp_path / "folder" / "took.json")
    read_back = Costs.read(tmp_path / "folder" / "took.json")
    assert read_back.by_test == costs.by_test
    assert list(read_back.by_file().items()) == [
        ("b.py", Cost(4.0, 0.1)),
        ("a.py", Cost(1.5, 0.75)),
    ]
    assert Costs.read(tmp_path / "none.json").by_test == {}
    part = Costs()
    part.add("b.py::other", Cost(3.0, 0.2))
    part.write(tmp_path / "folder" / "took.json")
    both = Costs.read(tmp_path / "folder" / "took.json")
    assert both.by_test == costs.by_test | part.by_test


@pytest.mark.parametrize("machine", [1.0, 3.0])
def test_growth_is_seen_on_a_machine_of_any_speed(machine: float) -> None:
    stored = {f"{name}.py": Cost(computed=10.0) for name in "abcdefgh"}
    measured = {name: Cost(computed=10.0 * machine) for name in stored}
    assert files_that_grew(stored, measured) == []
    assert files_that_grew({}, measured) == []
    measured["c.py"] = Cost(computed=20.0 * machine)
    measured["new.py"] = Cost(computed=5.0)
    measured["new_and_quick.py"] = Cost(computed=0.5)
    assert files_that_grew(stored, measured) == [
        f"c.py: {20 * machine:.1f} s of the processors ({10 * machine:.1f} s)",
        "new.py: 5.0 s of the processors (new)",
    ]
