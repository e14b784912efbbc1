"""Which sessions a user means."""

from __future__ import annotations

from pathlib import Path

import pytest

from twinmatch.offline.archive import ArchiveError, find_sessions, is_single


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
