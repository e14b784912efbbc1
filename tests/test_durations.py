"""The record of what tests take."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.durations import Cost, Costs, files_that_grew, processor_seconds
from tests.support.places import PROJECT


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


def test_a_test_that_ends_its_process_is_named(tmp_path: Path) -> None:
    """Its report comes from another process, which knows nothing of what it took."""
    (tmp_path / "conftest.py").write_text(
        "from pathlib import Path\n"
        "import tests.conftest as ours\n"
        "ours.TOOK = Path(__file__).with_name('took.json')\n"
        "pytest_addoption = ours.pytest_addoption\n"
        "def pytest_configure(config):\n"
        "    config.pluginmanager.register(ours.Durations())\n"
    )
    (tmp_path / "test_dies.py").write_text(
        "import os, signal\n"
        "def test_dies():\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    options = ("-n", "1", "--max-worker-restart", "0", "-c", os.devnull, "--rootdir")
    run = subprocess.run(
        [sys.executable, "-m", "pytest", *options, tmp_path, tmp_path],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 1, run.stdout
    assert "crashed while running 'test_dies.py::test_dies'" in run.stdout
    assert "INTERNALERROR" not in run.stdout + run.stderr


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
