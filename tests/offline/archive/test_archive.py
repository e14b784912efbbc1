"""Many sessions at once: the same results as one by one, bad ones skipped, runs that continue."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.offline.archive.replayed import Replayed
from tests.support.processes import run_twinmatch
from tests.support.waiting import wait_for
from twinmatch.importing import open_any
from twinmatch.offline import archive as archives
from twinmatch.offline.archive import ArchiveError, find_sessions, is_single
from twinmatch.offline.archive.files import Store, content_of, key_of
from twinmatch.offline.archive.job import (
    ArchiveTerms,
    Job,
    judge_in_processes,
    judge_job,
)
from twinmatch.offline.judging import judge, terms_from_files
from twinmatch.offline.processes import Beside, pool
from twinmatch.showing.summary import document
from twinmatch.twin import TwinSettings

Make = Callable[..., Path]

TERMS = ArchiveTerms(TwinSettings(), (), None, document)
judge_archive = partial(archives.judge_archive, document=document)


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sessions are judged here, where it does not matter that others do it."""
    monkeypatch.setattr(
        "twinmatch.offline.archive.archive.judge_in_processes",
        lambda jobs, _: map(judge_job, jobs),
    )


def test_an_archive_is_judged_as_its_sessions_are_one_by_one_and_a_second_run_continues(
    archive_folder: Path, replayed: Replayed, tmp_path: Path
) -> None:
    out = tmp_path / "results"
    shutil.copytree(replayed.out, out)
    result = replayed.done
    assert result.returncode == 3, result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert "skipped" in result.stderr
    assert "bad.csv" in result.stderr
    assert "2 sessions judged" in result.stdout

    archive_table = json.loads(replayed.table)
    kept_entries = {
        entry["result"]["session"]: entry
        for entry in map(json.loads, map(Path.read_text, out.iterdir()))
    }
    paths = {
        "second": archive_folder / "deeper" / "second",
        "first": archive_folder / "first",
    }
    assert (
        [s["session"] for s in archive_table["sessions"]]
        == list(paths)
        == sorted(kept_entries, reverse=True)
    )
    for name, path in paths.items():
        alone = judge(session := open_any(path), terms_from_files(session))
        expected = json.loads(
            json.dumps(document(name, alone.verdicts, alone.summary, alone.matches))
        )
        assert {key: kept_entries[name]["result"][key] for key in expected} == expected
        rows = [row for row in archive_table["candidates"] if row["session"] == name]
        assert [row["name"] for row in rows] == [
            c.name for c in alone.verdicts[-1].modelled
        ]
        for row, candidate in zip(rows, alone.verdicts[-1].modelled, strict=True):
            assert row["parameters"]["seebeck"] == candidate.parameters["seebeck"]
            assert row["nu_gap_sum"] == candidate.nu_gap_sum
            assert row["chosen_order"] == candidate.chosen_order
            chosen = next(
                o for o in candidate.orders if o.order == candidate.chosen_order
            )
            assert row["criteria"]["naic"] == chosen.total.naic
        nominal = [row for row in rows if row["nominal"]]
        assert [row["name"] for row in nominal] == [alone.summary.nominal]
        assert nominal[0]["fit"] == {"y": alone.summary.fit_y, "u": alone.summary.fit_u}
        assert nominal[0]["name"] in result.stdout

    # What was kept is what the next run shows: a mark in it shows too.
    for file in out.iterdir():
        file.write_text(
            file.read_text().replace('"nominal": true', '"nominal": true, "mark": 1')
        )
    continued = judge_archive([archive_folder], out=out)
    assert continued.reused == 2
    assert [row.get("mark") for row in continued.candidates if row["nominal"]] == [1, 1]
    assert [failure.path.name for failure in continued.failed] == ["bad.csv"]


@pytest.mark.usefixtures("in_this_process")
def test_a_result_is_used_again_as_long_as_session_and_parameters_stay_the_same(
    tmp_path: Path,
) -> None:
    session = tmp_path / "quiet.csv"
    config = tmp_path / "config.yaml"
    out = tmp_path / "out"
    lines = [f"{k},30.0,{30 + k % 2},10.0" for k in range(130)]
    session.write_text("\n".join(["time,reference,temperature,pwm", *lines]))
    config.write_text("/**:\n  ros__parameters:\n    decimals: 1\n")

    def reused(**terms: Path) -> int:
        archive = judge_archive([session], out=out, jobs=1, **terms)  # type: ignore[arg-type]
        assert [s["session"] for s in archive.sessions] == ["quiet"]
        return archive.reused

    assert [reused(), reused()] == [0, 1]
    assert [reused(config=config), reused(config=config)] == [0, 1]
    session.write_text(session.read_text().replace("129,30.0,31", "129,30.0,30.5"))
    assert [reused(config=config), reused(config=config)] == [0, 1]


@pytest.mark.usefixtures("in_this_process")
def test_progress_counts_every_session_once(tmp_path: Path) -> None:
    bad = [tmp_path / "absent.mat", tmp_path / "empty.csv"]
    bad[1].touch()
    progress: list[tuple[int, int]] = []
    skipped = []
    archive = judge_archive(
        bad, watch=lambda *at: progress.append(at), on_skip=skipped.append
    )
    assert progress[-1] == (2, 2)
    assert [count for count, _ in progress] == sorted({count for count, _ in progress})
    assert list(archive.failed) == skipped
    assert [failure.path for failure in archive.failed] == bad
    assert not archive.sessions


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["absent.mat", "--jobs", "1"], 2, "does not exist"),
        (["absent.mat", "gone.csv"], 2, "does not exist"),
        (["*.nothing"], 2, "pattern"),
        (["a.csv", "b.csv", "--figure", "x.png"], 2, "--figure"),
        (["a.csv", "--jobs", "0"], 2, "processes"),
        (["a.csv", "b.csv", "--config", "gone.yaml"], 2, "gone.yaml"),
    ],
)
def test_mistakes_of_replay_are_named_without_a_traceback(
    arguments: list[str], code: int, words: str
) -> None:
    result = run_twinmatch("replay", *arguments)
    assert result.returncode == code, result.stderr
    assert words in result.stderr
    assert "Traceback" not in result.stderr


class _Fatal:
    """Terms that end the process that unpickles them, as a lack of memory would."""

    def __reduce__(self) -> tuple[object, tuple[int]]:
        return os._exit, (1,)


def test_a_process_that_dies_takes_only_its_session_along(tmp_path: Path) -> None:
    jobs: list[Any] = []
    for number in range(2):
        # not the content that is expected; that this is said shows who was looked at
        (tmp_path / f"{number}.csv").touch()
        jobs.append(Job(number, tmp_path / f"{number}.csv", "", None))  # type: ignore[arg-type]
    jobs[1] = replace(jobs[1], terms=_Fatal())
    errors = {outcome.number: outcome.error for outcome in judge_in_processes(jobs, 2)}
    assert set(errors) == {0, 1}
    assert "has changed" in errors[0]
    assert "died" in errors[1]


def test_a_session_elsewhere_has_to_be_the_same(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    job = Job(4, path, "0" * 64, TERMS)
    absent = judge_job(job, " on worker tcp://10.0.0.7:41")
    assert (absent.number, absent.record) == (4, None)
    assert "on worker tcp://10.0.0.7:41" in absent.error
    assert "same path" in absent.error
    path.touch()
    assert "differs on worker" in judge_job(job, " on worker tcp://10.0.0.7:41").error
    assert "changed" in judge_job(job).error


def test_control_c_ends_all_processes_and_keeps_what_was_done(
    tmp_path: Path, make_session: Make
) -> None:
    for number in range(4):
        make_session(tmp_path / "runs" / str(number), seed=number, seebeck=0.06)
    out = tmp_path / "out"
    command = [
        sys.executable,
        "-m",
        "twinmatch.cli",
        "replay",
        tmp_path / "runs",
        "--jobs",
        "1",
        "--out",
        out,
    ]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as running:
        wait_for(
            lambda: list(out.glob("*.json")) or running.poll() is not None, "a result"
        )
        # as a terminal does it: to all of the group
        os.killpg(running.pid, signal.SIGINT)
        _, errors = running.communicate(timeout=360)
    assert running.returncode == 130, errors
    assert errors.strip().splitlines() == ["twinmatch: interrupted"]
    wait_for(lambda: _is_gone(running.pid), "the end of all processes")
    judged_count = len(list(out.iterdir()))
    assert 1 <= judged_count < 4
    assert all(
        file.suffix == ".json" and json.loads(file.read_text())
        for file in out.iterdir()
    )
    sessions = sorted((tmp_path / "runs").iterdir())[:judged_count]
    assert judge_archive(sessions, out=out, jobs=1).reused == judged_count


def _is_gone(group: int) -> bool:
    """Whether nobody of a process group is left."""
    with suppress(ProcessLookupError):
        os.killpg(group, 0)
        return False
    return True


def test_work_is_done_even_if_the_second_process_dies() -> None:
    with pool(1) as second:
        work = Beside(second)
        second_pid = second.submit(os.getpid).result()
        results = [work.give(os.getpid) for _ in range(20)]
        assert {result() for result in results} <= {os.getpid(), second_pid}
        with pytest.raises(BrokenProcessPool):
            second.submit(os._exit, 1).result()
        assert work.give(os.getpid)() == os.getpid()


# Which sessions a user means, results kept between runs, and what makes one stale.


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    for name in (
        "b/run_0.mcap",
        "a/deep/metadata.yaml",
        "c/x.MAT",
        "c/y.csv",
        "c/z.txt",
        ".git/v.csv",
        "d[1].csv",
    ):
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    (tmp_path / "empty").mkdir()
    return tmp_path


@pytest.mark.parametrize(
    ("named", "sessions"),
    [
        pytest.param(".", "a/deep b c/x.MAT c/y.csv d[1].csv", id="all in a folder"),
        pytest.param(
            "b a/deep b/run_0.mcap",
            "b a/deep b/run_0.mcap",
            id="sessions and a file of one",
        ),
        pytest.param(
            "c/y.csv c c/../b b", "c/y.csv c/x.MAT c/../b", id="each once, as named"
        ),
        pytest.param(
            "c/*.[cM]* **/deep",
            "c/x.MAT c/y.csv a/deep",
            id="patterns that the shell left",
        ),
        pytest.param(
            "d[1].csv", "d[1].csv", id="a name that only looks like a pattern"
        ),
        pytest.param(
            "absent.mat",
            "absent.mat",
            id="what is not there is named when it is judged",
        ),
    ],
)
def test_what_is_named_stands_for_these_sessions(
    tree: Path, named: str, sessions: str
) -> None:
    paths = find_sessions([tree / name for name in named.split()])
    assert [str(path.relative_to(tree)) for path in paths] == sessions.split()


@pytest.mark.parametrize(
    ("name", "words"),
    [("*.mcap", "matches this pattern"), ("empty", "has neither sessions")],
)
def test_nothing_found_is_said(tree: Path, name: str, words: str) -> None:
    with pytest.raises(ArchiveError, match=words):
        find_sessions([tree / name])


def test_one_session_is_distinguished_from_many(tree: Path) -> None:
    assert all(
        is_single([tree / name]) for name in ("b", "c/y.csv", "absent", "d[1].csv")
    )
    for names in (".", "b a", "*"):
        assert not is_single([tree / name for name in names.split()]), names


RECORD = {"session": "run", "fit": 0.25, "note": "°C"}


def test_what_is_kept_is_found_under_its_session_and_key_only_and_a_failed_write_leaves_it(
    tmp_path: Path,
) -> None:
    session = tmp_path / "monday" / "run"
    namesake = tmp_path / "tuesday" / "run"
    store = Store(tmp_path / "new" / "results")
    assert store.find(session, "k") is None
    store.keep(session, "k", RECORD)
    with pytest.raises(ValueError, match="JSON compliant"):
        store.keep(session, "k", {"fit": float("nan")})
    assert Store(store.folder).find(session, "k") == RECORD
    assert store.find(session, "other") is None
    assert store.find(namesake, "k") is None
    assert [file.suffix for file in store.folder.iterdir()] == [".json"]


@pytest.mark.parametrize(
    "text",
    ["", '{"key": "k", "resu', "[]", '{"key": "k"}', '{"key": "k", "result": 1}'],
)
def test_a_file_that_is_torn_or_not_ours_counts_as_none(
    text: str, tmp_path: Path
) -> None:
    store = Store(tmp_path)
    store.file_of(tmp_path / "run").write_text(text)
    assert store.find(tmp_path / "run", "k") is None


def test_a_folder_that_cannot_be_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ArchiveError, match="the folder for results cannot be created"):
        Store(tmp_path / "file")


def test_any_byte_of_a_session_changes_its_hash(tmp_path: Path) -> None:
    def hashed(**files: bytes) -> str:
        session = tmp_path / "run"
        shutil.rmtree(session, ignore_errors=True)
        session.mkdir()
        for name, content in files.items():
            (session / name.replace("_", ".")).write_bytes(content)
        return content_of(session)

    whole = hashed(a_mcap=b"abc", b_mcap=b"def")
    assert hashed(a_mcap=b"abc", b_mcap=b"def", notes_txt=b"does not matter") == whole
    changed = [
        hashed(a_mcap=b"abd", b_mcap=b"def"),
        hashed(a_mcap=b"abc", b_mcap=b"de"),
        hashed(a_mcap=b"ab", b_mcap=b"cdef"),  # the same bytes, moved between files
        hashed(a_mcap=b"abc", c_mcap=b"def"),
        hashed(a_mcap=b"abc", b_mcap=b"def", metadata_yaml=b"x"),
    ]
    assert len({whole, *changed}) == 6
    assert (
        len({key_of(content, terms) for content in changed[:2] for terms in ("", "b")})
        == 4
    )
