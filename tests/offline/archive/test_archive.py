"""Many sessions at once: the same results as one by one, bad ones skipped, runs that continue."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from twinmatch.offline import archive as archives
from twinmatch.offline.archive import ArchiveError, find_sessions, is_single
from twinmatch.offline.archive.files import Store, content_of, key_of
from twinmatch.offline.archive.job import ArchiveTerms, Job, judge_in_processes, judge_job
from twinmatch.offline.judging import judge, terms_from_files
from twinmatch.offline.processes import Beside, pool
from twinmatch.sessions import open_any
from twinmatch.showing.summary import document
from twinmatch.twin import TwinSettings

Run = Callable[..., subprocess.CompletedProcess[str]]
Make = Callable[..., Path]

TERMS = ArchiveTerms(TwinSettings(), (), None, document)
judge_archive = partial(archives.judge_archive, document=document)


def test_an_archive_is_judged_as_its_sessions_are_one_by_one_and_a_second_run_continues(
    archive_folder: Path, tmp_path: Path, run_twinmatch: Run
) -> None:
    out, table = tmp_path / "results", tmp_path / "all.json"
    result = run_twinmatch("replay", archive_folder, "--jobs", 2, "--out", out, "--json", table)
    assert result.returncode == 3, result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert "skipped" in result.stderr
    assert "bad.csv" in result.stderr
    assert "2 sessions judged" in result.stdout

    found = json.loads(table.read_text())
    kept = {
        entry["result"]["session"]: entry for entry in map(json.loads, map(Path.read_text, out.iterdir()))
    }
    paths = {"second": archive_folder / "deeper" / "second", "first": archive_folder / "first"}
    assert [s["session"] for s in found["sessions"]] == list(paths) == sorted(kept, reverse=True)
    for name, path in paths.items():
        alone = judge(session := open_any(path), terms_from_files(session))
        expected = json.loads(json.dumps(document(name, alone.verdicts, alone.summary, alone.matches)))
        assert {key: kept[name]["result"][key] for key in expected} == expected
        rows = [row for row in found["candidates"] if row["session"] == name]
        assert [row["name"] for row in rows] == [c.name for c in alone.verdicts[-1].modelled]
        for row, candidate in zip(rows, alone.verdicts[-1].modelled, strict=True):
            assert row["parameters"]["seebeck"] == candidate.parameters["seebeck"]
            assert row["nu_gap_sum"] == candidate.nu_gap_sum
            assert row["chosen_order"] == candidate.chosen_order
            chosen = next(o for o in candidate.orders if o.order == candidate.chosen_order)
            assert row["criteria"]["naic"] == chosen.total.naic
        nominal = [row for row in rows if row["nominal"]]
        assert [row["name"] for row in nominal] == [alone.summary.nominal]
        assert nominal[0]["fit"] == {"y": alone.summary.fit_y, "u": alone.summary.fit_u}
        assert nominal[0]["name"] in result.stdout

    # What was kept is what the next run shows: a mark in it shows too.
    for file in out.iterdir():
        file.write_text(file.read_text().replace('"nominal": true', '"nominal": true, "mark": 1'))
    again = judge_archive([archive_folder], out=out)
    assert again.reused == 2
    assert [row.get("mark") for row in again.candidates if row["nominal"]] == [1, 1]
    assert [failure.path.name for failure in again.failed] == ["bad.csv"]


def test_a_result_is_used_again_as_long_as_session_and_parameters_stay_the_same(tmp_path: Path) -> None:
    session, config, out = tmp_path / "quiet.csv", tmp_path / "config.yaml", tmp_path / "out"
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


def test_progress_counts_every_session_once(tmp_path: Path) -> None:
    bad = [tmp_path / "absent.mat", tmp_path / "empty.csv"]
    bad[1].touch()
    seen: list[tuple[int, int]] = []
    passed = []
    archive = judge_archive(bad, watch=lambda *at: seen.append(at), on_skip=passed.append)
    assert seen[-1] == (2, 2)
    assert [done for done, _ in seen] == sorted({done for done, _ in seen})
    assert list(archive.failed) == passed
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
def test_mistakes_are_named(arguments: list[str], code: int, words: str, run_twinmatch: Run) -> None:
    result = run_twinmatch("replay", *arguments)
    assert result.returncode == code, result.stderr
    assert words in result.stderr
    assert "Traceback" not in result.stderr


class _Fatal(TwinSettings):
    """Settings that end the process that unpickles them, as a lack of memory would."""

    def __reduce__(self) -> tuple[object, tuple[int]]:
        return os._exit, (1,)


def test_a_process_that_dies_takes_only_its_session_along(tmp_path: Path) -> None:
    jobs = []
    for number in range(3):
        path = tmp_path / f"{number}.csv"
        path.write_text("time,reference\n")  # no recording; what is wrong with it says that it was looked at
        jobs.append(Job(number, path, content_of(path), TERMS))
    jobs[1] = replace(jobs[1], terms=ArchiveTerms(_Fatal(), (), None, document))
    errors = {outcome.number: outcome.error for outcome in judge_in_processes(jobs, 2)}
    assert set(errors) == {0, 1, 2}
    assert "died" in errors[1]
    assert "died" not in errors[0] + errors[2]


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


def test_control_c_ends_all_processes_and_keeps_what_was_done(tmp_path: Path, make_session: Make) -> None:
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
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as running:
        while not list(out.glob("*.json")) and running.poll() is None:
            time.sleep(0.05)
        os.killpg(running.pid, signal.SIGINT)  # as a terminal does it: to all of the group
        _, errors = running.communicate(timeout=360)
    assert running.returncode == 130, errors
    assert errors.strip().splitlines() == ["twinmatch: interrupted"]
    assert _is_gone(running.pid)
    done = len(list(out.iterdir()))
    assert 1 <= done < 4
    assert all(file.suffix == ".json" and json.loads(file.read_text()) for file in out.iterdir())
    sessions = sorted((tmp_path / "runs").iterdir())[:done]
    assert judge_archive(sessions, out=out, jobs=1).reused == done


def _is_gone(group: int) -> bool:
    """Whether nobody of a process group is left, or not for long."""
    for _ in range(100):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


def end_but_in(process: int) -> int:
    """End this process, unless it is that one."""
    if os.getpid() != process:
        os._exit(1)
    return process


def test_work_is_done_even_if_the_second_process_dies() -> None:
    with pool(1) as second:
        work, other = Beside(second), second.submit(os.getpid).result()
        assert {result() for result in [work.give(os.getpid) for _ in range(20)]} <= {os.getpid(), other}
        with pytest.raises(BrokenProcessPool):
            second.submit(end_but_in, os.getpid()).result()
        assert work.give(os.getpid)() == os.getpid()


# Which sessions a user means, results kept between runs, and what makes one stale.


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    for name in ("b/run_0.mcap", "a/deep/metadata.yaml", "c/x.MAT", "c/y.csv", "c/z.txt", ".git/v.csv"):
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    return tmp_path


def relative(tree: Path, *named: str) -> list[str]:
    return [str(path.relative_to(tree)) for path in find_sessions([tree / name for name in named])]


def test_a_folder_stands_for_all_sessions_and_recordings_in_it(tree: Path) -> None:
    assert relative(tree, ".") == ["a/deep", "b", "c/x.MAT", "c/y.csv"]


def test_a_session_folder_and_its_file_are_taken_as_they_are(tree: Path) -> None:
    assert relative(tree, "b", "a/deep", "b/run_0.mcap") == ["b", "a/deep", "b/run_0.mcap"]


def test_each_is_judged_once_in_the_order_named(tree: Path) -> None:
    assert relative(tree, "c/y.csv", "c", "c/../b", "b") == ["c/y.csv", "c/x.MAT", "c/../b"]


def test_patterns_that_the_shell_left_are_resolved(tree: Path) -> None:
    assert relative(tree, "c/*.[cM]*") == ["c/x.MAT", "c/y.csv"]
    assert relative(tree, "**/deep") == ["a/deep"]


def test_a_name_with_brackets_that_exists_is_not_a_pattern(tmp_path: Path) -> None:
    odd = tmp_path / "run[1].csv"
    odd.touch()
    assert find_sessions([odd]) == [odd]
    assert is_single([odd])


def test_what_is_not_there_is_left_for_the_judging_to_name(tmp_path: Path) -> None:
    assert find_sessions([tmp_path / "absent.mat"]) == [tmp_path / "absent.mat"]


@pytest.mark.parametrize("name", ["*.mcap", "empty"])
def test_nothing_found_is_said(name: str, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(ArchiveError, match=r"matches this pattern|has neither sessions"):
        find_sessions([tmp_path / name])


def test_one_session_is_distinguished_from_many(tree: Path) -> None:
    assert is_single([tree / "b"])
    assert is_single([tree / "c" / "y.csv"])
    assert is_single([tree / "absent"])
    assert not is_single([tree])
    assert not is_single([tree / "b", tree / "a"])
    assert not is_single([tree / "*"])


RECORD = {"session": "run", "fit": 0.25, "note": "°C"}


def test_what_is_kept_is_found_under_its_key_only(tmp_path: Path) -> None:
    session = tmp_path / "run"
    store = Store(tmp_path / "new" / "results")
    assert store.find(session, "k") is None
    store.keep(session, "k", RECORD)
    assert Store(store.folder).find(session, "k") == RECORD
    assert store.find(session, "other") is None
    assert [file.suffix for file in store.folder.iterdir()] == [".json"]


def test_sessions_of_one_name_do_not_share_a_file(tmp_path: Path) -> None:
    store = Store(tmp_path / "results")
    store.keep(tmp_path / "monday" / "run", "k", RECORD)
    assert store.find(tmp_path / "tuesday" / "run", "k") is None


@pytest.mark.parametrize(
    "text", ["", '{"key": "k", "resu', "[]", '{"key": "k"}', '{"key": "k", "result": 1}']
)
def test_a_file_that_is_torn_or_not_ours_counts_as_none(text: str, tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.file_of(tmp_path / "run").write_text(text)
    assert store.find(tmp_path / "run", "k") is None


def test_a_failed_write_leaves_the_old_result(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.keep(tmp_path / "run", "k", RECORD)
    with pytest.raises(ValueError, match="JSON compliant"):
        store.keep(tmp_path / "run", "k", {"fit": float("nan")})
    assert store.find(tmp_path / "run", "k") == RECORD
    assert len(list(tmp_path.iterdir())) == 1


def test_a_folder_that_cannot_be_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ArchiveError, match="the folder for results cannot be created"):
        Store(tmp_path / "file")


def test_any_byte_of_a_session_changes_its_hash(tmp_path: Path) -> None:
    session = tmp_path / "run"
    session.mkdir()
    (session / "run_0.mcap").write_bytes(b"abc")
    (session / "run_1.mcap").write_bytes(b"def")
    before = content_of(session)
    (session / "notes.txt").write_text("does not matter")
    assert content_of(session) == before
    seen = {before}
    for name, content in (("run_0.mcap", b"abd"), ("run_1.mcap", b"de"), ("metadata.yaml", b"x")):
        (session / name).write_bytes(content)
        seen.add(content_of(session))
    (session / "run_1.mcap").rename(session / "run_2.mcap")
    assert content_of(session) not in seen
    assert len(seen) == 4


def test_bytes_cannot_move_between_files_unseen(tmp_path: Path) -> None:
    hashes = set()
    for k, (one, two) in enumerate([(b"ab", b"c"), (b"a", b"bc")]):
        session = tmp_path / str(k)
        session.mkdir()
        (session / "0.mcap").write_bytes(one)
        (session / "1.mcap").write_bytes(two)
        hashes.add(content_of(session))
    assert len(hashes) == 2


def test_the_key_holds_content_and_terms() -> None:
    assert len({key_of(c, t) for c in ("a", "b") for t in ("", "b")}) == 4
