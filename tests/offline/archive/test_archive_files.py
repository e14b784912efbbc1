"""Which sessions a user means, results kept between runs, and what makes one stale."""

from __future__ import annotations

from pathlib import Path

import pytest

from twinmatch.offline.archive import ArchiveError, find_sessions, is_single
from twinmatch.offline.archive.files import Store, content_of, key_of


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
