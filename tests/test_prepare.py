"""What `twinmatch prepare` compiles is what a first replay would wait for."""

from __future__ import annotations

import os
import re
import signal
import sys
from pathlib import Path

import pytest

from tests.support.places import SHIPPED
from tests.support.processes import Process
from tests.support.waiting import wait_for
from twinmatch.offline.processes import cores
from twinmatch.sessions import read_session, write_session

USE = """
import gc, sys
from numba.core.dispatcher import Dispatcher
from twinmatch.cli import main, prepare
from twinmatch.plants import PLANTS

gc.unfreeze()  # what was imported before this process was forked is frozen

def used():
    kernels = [kernel for kernel in gc.get_objects() if isinstance(kernel, Dispatcher)]
    return {kernel.py_func.__qualname__: kernel.signatures for kernel in kernels if kernel.signatures}

prepare.derive_plants([PLANTS["peltier"]])
prepare.compare_models()
prepare.judge_a_loop()
prepare.judge_channels()
prepare.search_once()
prepared = used()
assert len(prepared["update_search"]) == 1
assert main(["replay", sys.argv[1]]) == 0
replayed = used()
assert len(replayed) > 20
assert replayed == prepared, replayed.keys() - prepared.keys()
print("the same")
"""


COMPILE_BESIDE = """
import signal
from twinmatch.cli.prepare import compile_beside

if __name__ == "__main__":
    print(compile_beside(signal.pause).pid, flush=True)
    signal.pause()
"""


COPIED = """
import sys, threading
from twinmatch.cli.prepare import compile_beside
from twinmatch.compiled import before_kernels, told
from twinmatch.errors import TwinmatchError

is_known = False

def say():
    print("a copy" if is_known else "a new one", len(told), len(before_kernels), flush=True)

def fail():
    raise TwinmatchError("these equations cannot be used")

if __name__ == "__main__":
    is_known = True
    told.append(print)
    before_kernels.append(print)
    if sys.argv[1] == "threads":
        threading.Thread(target=threading.Event().wait, daemon=True).start()
    process = compile_beside(say, fail)
    process.join()
    print(process.exitcode, len(told), len(before_kernels))
"""


SECOND_COMPILER = """
import multiprocessing, signal
from twinmatch.cli.prepare import second_compiler
from twinmatch.compiled import compiled
from twinmatch.dynamics.store import kernels_of
from twinmatch.plants import PLANTS

@compiled
def doubled(x):
    return 2.0 * x

def say_processes():
    print(len(multiprocessing.active_children()), flush=True)

if __name__ == "__main__":
    with second_compiler(signal.pause):
        kernels_of(PLANTS["peltier"], frozenset(), frozenset())
        say_processes()
        doubled(1.0)
        say_processes()
        doubled(1)
        say_processes()
    say_processes()
    with second_compiler(signal.pause):
        doubled(2.0)
        say_processes()
"""


@pytest.mark.skipif(cores() == 1, reason="a second process is for a second core")
def test_a_second_process_compiles_from_the_first_kernel_to_the_end_of_the_work(
    tmp_path: Path,
) -> None:
    # equations alone, a kernel, another kernel, after the work, and with a kernel that is on disk
    assert processes_said_by("__main__.py", tmp_path) == ["0", "1", "1", "0", "0"]
    assert list((tmp_path / "equations").glob("equations_*.code"))


def test_a_script_that_calls_a_command_is_not_run_by_a_second_process(
    tmp_path: Path,
) -> None:
    assert processes_said_by("calls.py", tmp_path) == ["0"] * 5


def processes_said_by(name: str, folder: Path) -> list[str]:
    """Numbers of second processes that a program of this name says."""
    script = folder / name
    script.write_text(SECOND_COMPILER)
    folders = {
        "TWINMATCH_CACHE": str(folder / "equations"),
        "NUMBA_CACHE_DIR": str(folder / "kernels"),
    }
    process = Process(
        sys.executable,
        script,
        output=folder / "said.txt",
        environment=os.environ | folders,
    )
    assert process.wait() == 0, process.text
    return process.lines


@pytest.mark.skipif(sys.platform != "linux", reason="processes are copied on Linux")
@pytest.mark.parametrize(
    ("threads", "kind"), [("alone", "a copy"), ("threads", "a new one")]
)
def test_what_compiles_beside_is_a_copy_unless_a_thread_may_hold_a_lock(
    threads: str, kind: str, tmp_path: Path
) -> None:
    """It tells nothing, starts no other process, and leaves errors to the process that needs what it compiles."""
    script = tmp_path / "prepare.py"
    script.write_text(COPIED)
    words = (sys.executable, script, threads)
    process = Process(*words, output=tmp_path / "said.txt")
    assert process.wait() == 0, process.text
    assert process.lines == [f"{kind} 0 0", "0 1 1"]


def test_ctrl_c_does_not_reach_what_compiles_beside(tmp_path: Path) -> None:
    script = tmp_path / "prepare.py"
    script.write_text(COMPILE_BESIDE)
    process = Process(sys.executable, script, output=tmp_path / "said.txt")
    second = int(process.said(r"^\d+$").group())
    status = Path(f"/proc/{second}/status").read_text()
    blocked = int(re.findall(r"^SigBlk:\s*(\w+)$", status, re.MULTILINE)[0], 16)
    process.kill()
    assert blocked & 1 << (signal.SIGINT - 1)


def test_what_compiles_beside_ends_when_prepare_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "prepare.py"
    script.write_text(COMPILE_BESIDE)
    process = Process(sys.executable, script, output=tmp_path / "said.txt")
    second = int(process.said(r"^\d+$").group())
    assert Path(f"/proc/{second}").exists()
    process.kill()
    wait_for(lambda: not Path(f"/proc/{second}").exists(), "its end")


def test_a_replay_uses_no_kernel_that_was_not_prepared(tmp_path: Path) -> None:
    script = tmp_path / "use.py"
    script.write_text(USE)
    # four matches
    session = write_session(tmp_path / "half", read_session(SHIPPED).samples[:1010])
    words = (sys.executable, script, session)
    process = Process(*words, output=tmp_path / "said.txt", forked=True)
    assert process.wait() == 0, process.text
    assert process.lines[-1] == "the same"
