"""A process continues in its child, which has its memory, and looks from outside as if it had not."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")

from tests.support.processes import Process
from tests.support.waiting import PATIENCE, wait_for
from twinmatch.errors import EXIT_INTERRUPTED

BEGIN = """
import json, os, signal, sys, time
from twinmatch.launching.succession import continue_in_child

def say(*words):
    print(json.dumps(words), flush=True)

"""


def started(tmp_path: Path, program: str) -> Process:
    """A program that may continue in a child."""
    script = tmp_path / "program.py"
    script.write_text(BEGIN + textwrap.dedent(program))
    return Process(
        sys.executable, script, output=tmp_path / "output", folder=Path.cwd()
    )


def test_the_child_has_what_was_prepared_and_the_exit_code_is_its_own(
    tmp_path: Path,
) -> None:
    process = started(
        tmp_path,
        """
        prepared = []
        def prepare():
            prepared.append(os.getpid())
        continue_in_child(prepare)
        say(*prepared, os.getpid(), os.getppid(), os.getpgrp() == os.getpgid(os.getppid()))
        sys.exit(7)
        """,
    )
    assert process.wait() == 7, process.text
    ((prepared, child, parent, is_of_one_group),) = process.json
    assert parent == process.id
    assert is_of_one_group
    assert len({prepared, child, parent}) == 3
    assert not Path(f"/proc/{prepared}").exists()


def test_pages_of_files_that_were_read_are_not_the_childs(tmp_path: Path) -> None:
    content = tmp_path / "library"
    content.write_bytes(bytes(1 << 22))
    process = started(
        tmp_path,
        f"""
        import mmap
        def resident():
            sizes, is_ours = 0, False
            for line in open("/proc/self/smaps"):
                words = line.split()
                if "-" in words[0]:
                    is_ours = words[-1] == {str(content)!r}
                elif words[0] == "Rss:" and is_ours:
                    sizes += int(words[1])
            return sizes
        mapped = []
        def prepare():
            descriptor = os.open({str(content)!r}, os.O_RDONLY)
            mapped.append(mmap.mmap(descriptor, 0, prot=mmap.PROT_READ, flags=mmap.MAP_PRIVATE))
            bytes(mapped[0])
            say(resident())
        continue_in_child(prepare)
        say(resident())
        """,
    )
    assert process.wait() == 0, process.text
    (before,), (after,) = process.json
    assert before == 1 << 12
    assert after == 0


COUNTING = """
counts = {}
def count(number, _):
    counts[number] = counts.get(number, 0) + 1
for number in (signal.SIGINT, signal.SIGUSR1, signal.SIGHUP):
    signal.signal(number, count)
def end(*_):
    say(sorted(counts.items()))
    sys.exit(3)
signal.signal(signal.SIGTERM, end)
say("ready", os.getpid())
while True:
    time.sleep(1000)
"""


def is_ready(process: Process) -> int:
    """Wait until the child counts; returns its number."""
    wait_for(
        lambda: any(row[0] == "ready" for row in process.json), lambda: process.text
    )
    (number,) = (row[1] for row in process.json if row[0] == "ready")
    return int(number)


def test_a_signal_that_is_sent_to_the_process_reaches_the_child_once(
    tmp_path: Path,
) -> None:
    process = started(tmp_path, "continue_in_child(lambda: None)\n" + COUNTING)
    is_ready(process)
    for number in (signal.SIGINT, signal.SIGUSR1, signal.SIGTERM):
        os.kill(process.id, number)
    assert process.wait() == 3, process.text
    assert process.json[-1] == [[[signal.SIGINT, 1], [signal.SIGUSR1, 1]]]


def test_a_signal_that_reaches_what_prepares_as_it_ends_is_for_the_child(
    tmp_path: Path,
) -> None:
    """Blocked, it comes to the process that prepares and does nothing there, as it does in one that ends."""
    process = started(
        tmp_path,
        """
        def prepare():
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGUSR1})
            say("preparing")
            while signal.SIGUSR1 not in signal.sigpending():
                time.sleep(0.01)
        continue_in_child(prepare)
        signal.signal(signal.SIGUSR1, lambda *_: say("received"))
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGUSR1})
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(3))
        say("ready", os.getpid())
        while True:
            time.sleep(1000)
        """,
    )
    wait_for(lambda: ["preparing"] in process.json, lambda: process.text)
    os.kill(process.id, signal.SIGUSR1)
    is_ready(process)
    wait_for(lambda: ["received"] in process.json, lambda: process.text)
    os.kill(process.id, signal.SIGTERM)
    assert process.wait() == 3, process.text
    assert process.json.count(["received"]) == 1


def test_ctrl_c_at_a_terminal_reaches_the_child_once(tmp_path: Path) -> None:
    script = tmp_path / "program.py"
    take_terminal = "import fcntl, termios\nfcntl.ioctl(0, termios.TIOCSCTTY, 0)\n"
    script.write_text(
        BEGIN + take_terminal + "continue_in_child(lambda: None)\n" + COUNTING
    )
    ours, theirs = os.openpty()
    output = tmp_path / "output"
    with output.open("w") as stream:
        process = subprocess.Popen(
            [sys.executable, script],
            stdin=theirs,
            stdout=stream,
            stderr=stream,
            start_new_session=True,
        )
    os.close(theirs)
    wait_for(lambda: "ready" in output.read_text(), output.read_text)
    os.write(ours, b"\x03")
    process.send_signal(signal.SIGTERM)
    assert process.wait(PATIENCE) == 3, output.read_text()
    os.close(ours)
    assert json.loads(output.read_text().splitlines()[-1]) == [[[signal.SIGINT, 1]]]


def test_the_process_ends_by_the_signal_that_ends_its_child(tmp_path: Path) -> None:
    process = started(tmp_path, "continue_in_child(lambda: None)\n" + COUNTING)
    os.kill(is_ready(process), signal.SIGKILL)
    process.killed = True
    assert process.wait() == -signal.SIGKILL


def test_the_child_of_a_process_that_is_killed_receives_sigterm(tmp_path: Path) -> None:
    process = started(tmp_path, "continue_in_child(lambda: None)\n" + COUNTING)
    child = is_ready(process)
    process.killed = True
    os.kill(process.id, signal.SIGKILL)
    process.wait()
    wait_for(lambda: not Path(f"/proc/{child}").exists(), lambda: process.text)
    assert process.json[-1] == [[]]


def test_ctrl_c_during_its_imports_is_an_interrupted_command(tmp_path: Path) -> None:
    process = started(
        tmp_path,
        """
        from twinmatch.launching import launcher
        def importing():
            say("ready", os.getpid())
            time.sleep(1000)
        launcher.import_for_programs = importing
        launcher.main()
        """,
    )
    is_ready(process)
    os.kill(process.id, signal.SIGINT)
    assert process.wait() == EXIT_INTERRUPTED
    assert process.lines[-1] == "twinmatch: interrupted"


def test_what_cannot_be_prepared_ends_the_process(tmp_path: Path) -> None:
    process = started(
        tmp_path,
        """
        def prepare():
            sys.exit("there is no library")
        continue_in_child(prepare)
        say("not reached")
        """,
    )
    assert process.wait() == 1
    assert process.lines == ["there is no library"]
