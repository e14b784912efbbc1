"""Programs that are forked are children like any other."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")

from tests.support.processes import Process
from tests.support.waiting import PATIENCE, wait_for
from twinmatch.launching.forking import Forked, ForkServer, fork_server

PROGRAM = """
import json, os, sys, time
comm = open("/proc/self/comm").read().strip()
print(json.dumps([sys.argv[1:], os.getcwd(), dict(os.environ), os.getppid(), os.getsid(0), comm, __name__]))
print("a line with an error", file=sys.stderr)
if sys.argv[1] == "wait":
    time.sleep(1000)
sys.exit(int(sys.argv[1]))
"""


@pytest.fixture
def program(tmp_path: Path) -> str:
    path = tmp_path / "program.py"
    path.write_text(PROGRAM)
    return str(path)


def start(
    server: ForkServer,
    output: Path,
    *words: str,
    folder: Path | None = None,
    environment: Mapping[str, str] = {"A": "b"},
) -> Forked:
    with output.open("w") as stream:
        return server.start(
            *words, output=stream.fileno(), environment=environment, folder=folder
        )


def lines_of(output: Path, number: int = 2) -> list[str]:
    wait_for(lambda: output.read_text().count("\n") >= number, output.read_text)
    return output.read_text().splitlines()


def test_a_program_finds_what_it_would_if_it_were_started(
    tmp_path: Path, program: str
) -> None:
    """Its words, folder, environment, name, a session of its own, and this process as its parent."""
    output = tmp_path / "output"
    forked = start(fork_server(), output, program, "3", "x", folder=tmp_path)
    assert forked.wait(PATIENCE) == 3
    reported, error = lines_of(output)
    expected = [
        ["3", "x"],
        str(tmp_path),
        {"A": "b"},
        os.getpid(),
        forked.pid,
        "program.py",
        "__main__",
    ]
    assert json.loads(reported) == expected
    assert error == "a line with an error"


@pytest.mark.parametrize(
    ("environment", "kept"), [({}, True), ({"PYTHONDONTWRITEBYTECODE": "1"}, False)]
)
def test_what_it_imports_is_kept_compiled_unless_its_environment_forbids(
    tmp_path: Path, environment: dict[str, str], kept: bool
) -> None:
    """A file that is written twice in a second with as many characters is else not read again."""
    (tmp_path / "imported.py").write_text("")
    program = tmp_path / "importing.py"
    program.write_text('import sys; sys.path.insert(0, ""); import imported')
    forked = start(
        fork_server(),
        tmp_path / "output",
        str(program),
        folder=tmp_path,
        environment=environment,
    )
    assert forked.wait(PATIENCE) == 0, (tmp_path / "output").read_text()
    assert any(tmp_path.glob("__pycache__/imported.*")) == kept


def test_a_module_is_run_like_with_m(tmp_path: Path) -> None:
    """With the same words and exit code as started by itself."""
    words = ["-m", "twinmatch.nodes", "nobody"]
    alone = subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, check=False
    )
    forked = start(fork_server(), tmp_path / "output", *words)
    assert forked.wait(PATIENCE) == alone.returncode == 2
    assert (tmp_path / "output").read_text() == alone.stderr


def test_what_every_program_would_do_first_is_done_for_all_of_them(
    tmp_path: Path,
) -> None:
    """Creating a node imports a parser of message types, and the first kernel starts numba and imports more."""
    path = tmp_path / "first.py"
    path.write_text(
        "import sys\nfrom numba.core.runtime import rtsys\n"
        "needed = {'lark', 'service_msgs', 'type_description_interfaces', 'email.parser', 'numpy.ma'}\n"
        "print(rtsys._init, *(needed - set(sys.modules)))\n"
    )
    output = tmp_path / "output"
    assert start(fork_server(), output, str(path)).wait(PATIENCE) == 0, (
        output.read_text()
    )
    assert lines_of(output, 1) == ["True"]


def test_it_is_signalled_and_waited_for(tmp_path: Path, program: str) -> None:
    output = tmp_path / "output"
    forked = start(fork_server(), output, program, "wait")
    lines_of(output)
    assert forked.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        forked.wait(0.0)
    forked.send_signal(signal.SIGTERM)
    assert forked.wait(PATIENCE) == -signal.SIGTERM
    forked.kill()  # which has ended: nothing happens
    assert forked.returncode == -signal.SIGTERM


def test_a_server_that_is_killed_is_replaced_and_its_programs_continue(
    tmp_path: Path, program: str
) -> None:
    children_before = set(Process.children_of(os.getpid()))
    server = ForkServer()
    (server_id,) = set(Process.children_of(os.getpid())) - children_before
    try:
        first = start(server, tmp_path / "first", program, "wait")
        lines_of(tmp_path / "first")
        os.kill(server_id, signal.SIGKILL)
        os.waitid(os.P_PID, server_id, os.WEXITED | os.WNOWAIT)
        assert start(server, tmp_path / "second", program, "0").wait(PATIENCE) == 0
        assert first.poll() is None
    finally:
        server.close()
    assert first.poll() is None
    first.kill()
    assert first.wait(PATIENCE) == -signal.SIGKILL


def test_without_its_parent_it_ends(tmp_path: Path, program: str) -> None:
    """Killed, the parent can do nothing more; neither server nor program outlives it."""
    text = (
        "import sys\nfrom twinmatch.launching.forking import fork_server\n"
        f"words = [{program!r}, 'wait']\n"
        "done = fork_server().start(*words, output=1, environment={})\n"
        "print(done.pid, fork_server().pid, flush=True)\ndone.wait()\n"
    )
    parent = Process(sys.executable, "-c", text, output=tmp_path / "output")
    forked, server = map(int, parent.said(r"^(\d+) (\d+)$").groups())
    parent.said("a line with an error")
    parent.kill()
    for process in (forked, server):
        status = Path(f"/proc/{process}/stat")

        def gone(status: Path = status) -> bool:
            return (
                not status.exists()
                or status.read_text().rsplit(")", 1)[1].split()[0] == "Z"
            )

        wait_for(gone, f"the end of {status}")


def test_an_interrupted_program_shows_no_traceback(
    tmp_path: Path, program: str
) -> None:
    output = tmp_path / "output"
    forked = start(fork_server(), output, program, "wait")
    lines_of(output)
    forked.send_signal(signal.SIGINT)
    assert forked.wait(PATIENCE) == -signal.SIGINT
    assert len(output.read_text().splitlines()) == 2


MANY_THREADS = """
import sys, threading
threading.stack_size(8 << 20)
go = threading.Event()
threads = [threading.Thread(target=go.wait) for _ in range(int(sys.argv[1]))]
for thread in threads:
    thread.start()
go.set()
for thread in threads:
    thread.join()
"""


@pytest.mark.parametrize("threads", [6, 20])
def test_a_program_that_had_many_threads_ends_by_itself(
    tmp_path: Path, threads: int
) -> None:
    """The memory of stacks that are no longer used is given back; the tracer's own threads had some, too."""
    path = tmp_path / "threads.py"
    path.write_text(MANY_THREADS)
    output = tmp_path / "output"
    assert start(fork_server(), output, str(path), str(threads)).wait(PATIENCE) == 0
    assert output.read_text() == ""
