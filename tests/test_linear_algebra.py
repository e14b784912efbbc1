"""A command's linear algebra uses one thread, unless the user has chosen another number."""

from __future__ import annotations

import os
import subprocess
import sys

from twinmatch.cli import main
from twinmatch.linear_algebra import ONE_THREAD

PROGRAM = """
import os
import sys
from threadpoolctl import threadpool_info
from twinmatch.cli import main
sys.argv = ["twinmatch", "replay", "missing.mcap"]
main()
assert "numpy" in sys.modules
threads = {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}
print(os.environ.get("OPENBLAS_NUM_THREADS"), max(threads, default=1))
"""


def printed_by_command(**chosen: str) -> list[str]:
    """The environment's number and the libraries' largest one, at the end of a command."""
    environment = {
        name: value for name, value in os.environ.items() if name not in ONE_THREAD
    }
    process = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        capture_output=True,
        check=True,
        env=environment | chosen,
        text=True,
        timeout=300,
    )
    return process.stdout.split()


def test_the_program_starts_one_thread() -> None:
    assert printed_by_command() == ["1", "1"]


def test_a_number_that_the_user_has_chosen_stays() -> None:
    number, _ = printed_by_command(OPENBLAS_NUM_THREADS="2")
    assert number == "2"
    number, _ = printed_by_command(OMP_NUM_THREADS="2")  # for which all libraries look
    assert number == "None"


def test_a_script_that_calls_a_command_keeps_its_environment() -> None:
    before = dict(os.environ)
    assert main(["replay", "missing.mcap"]) == 2
    assert dict(os.environ) == before
