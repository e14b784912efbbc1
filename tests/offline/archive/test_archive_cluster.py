"""The same sessions on a Dask cluster: two workers on this machine, the same results."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.offline.archive.replayed import Replayed
from tests.support.processes import Process, run_twinmatch
from tests.support.waiting import wait_for
from twinmatch.offline import archive as archives
from twinmatch.offline.archive.files import ClusterError
from twinmatch.showing.summary import document

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None,
    reason="distributed is not installed; it is in the extra 'cluster'",
)


judge_archive = partial(archives.judge_archive, document=document)


def dask(stack: ExitStack, folder: Path, *arguments: str) -> None:
    """Run one of Dask's programs until the stack ends; what it says goes into the folder."""
    quiet = os.environ | {"DASK_DISTRIBUTED__ADMIN__LOW_LEVEL_LOG_LENGTH": "0"}
    command = [
        sys.executable,
        "-m",
        "dask",
        *arguments,
        "--host",
        "127.0.0.1",
        "--no-dashboard",
    ]
    process = Process(
        *command,
        output=folder / f"{arguments[0]}.log",
        environment=quiet,
        folder=folder,
    )
    stack.callback(process.end)


def address_in(file: Path) -> str:
    """The address a scheduler writes into its file once it listens."""
    wait_for(
        lambda: file.exists() and file.read_text().rstrip().endswith("}"),
        f"a scheduler in {file}",
    )
    return str(json.loads(file.read_text())["address"])


@pytest.fixture(scope="module")
def idle(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[tuple[ExitStack, Path, str]]:
    """A scheduler without workers."""
    folder = tmp_path_factory.mktemp("cluster")
    with ExitStack() as stack:
        dask(
            stack,
            folder,
            "scheduler",
            "--port",
            "0",
            "--scheduler-file",
            "scheduler.json",
        )
        yield stack, folder, address_in(folder / "scheduler.json")


def test_a_cluster_without_workers_is_named(
    idle: tuple[ExitStack, Path, str],
    archive_folder: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, _, address = idle
    monkeypatch.setattr("twinmatch.offline.archive.job.PATIENCE", 3.0)
    with pytest.raises(ClusterError, match="no workers") as caught:
        judge_archive([archive_folder], scheduler=address)
    assert address in str(caught.value)


@pytest.fixture(scope="module")
def address(idle: tuple[ExitStack, Path, str]) -> str:
    """A scheduler with two workers of one thread each."""
    stack, folder, address = idle
    for name in "ab":
        dask(
            stack,
            folder,
            "worker",
            address,
            "--nthreads",
            "1",
            "--no-nanny",
            "--name",
            name,
        )
    from distributed import Client

    with Client(address, set_as_default=False, timeout=360) as client:
        client.wait_for_workers(2, timeout=360)
    return address


def test_two_workers_find_what_processes_find(
    address: str, archive_folder: Path, replayed: Replayed, tmp_path: Path
) -> None:
    out = tmp_path / "cluster"
    table = tmp_path / "cluster.json"
    process = run_twinmatch(
        "replay", archive_folder, "--scheduler", address, "--out", out, "--json", table
    )
    assert process.returncode == 3, process.stderr
    assert "bad.csv" in process.stderr
    assert "Traceback" not in process.stderr
    assert len(results_in(out)) == 2
    assert results_in(out) == results_in(replayed.out)
    assert (table.read_text(), process.stdout) == (replayed.table, replayed.done.stdout)


def results_in(folder: Path) -> list[Any]:
    """Of its sessions, in the order of their names."""
    return [json.loads(file.read_text()) for file in sorted(folder.iterdir())]


@pytest.mark.parametrize(
    "bad", ["foo", "127.0.0.1", "http://127.0.0.1:8786", "tcp://127.0.0.1:1"]
)
def test_an_address_that_leads_nowhere_is_one_line(
    bad: str, archive_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twinmatch.offline.archive.job.PATIENCE", 1.0)
    with pytest.raises(ClusterError, match="cannot be reached") as caught:
        judge_archive([archive_folder / "first"], scheduler=bad)
    assert bad in str(caught.value)
    assert "\n" not in str(caught.value)


def test_nothing_of_dask_is_loaded_unasked_and_without_it_the_extra_is_named(
    archive_folder: Path,
) -> None:
    code = (
        "import sys, twinmatch.cli, twinmatch.offline.archive, twinmatch.offline.judging\n"
        "print('distributed' in sys.modules); sys.modules['distributed'] = None\n"
        f"words = ['replay', {str(archive_folder / 'first')!r}, '--scheduler', 'tcp://127.0.0.1:1']\n"
        "sys.exit(twinmatch.cli.main(words))"
    )
    process = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert process.stdout.strip() == "False", process.stderr
    assert process.returncode == 2
    assert "twinmatch[cluster]" in process.stderr
    assert len(process.stderr.splitlines()) == 1
