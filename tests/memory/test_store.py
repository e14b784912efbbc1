"""The file of a memory: what is in it, and what happens to it when programs and disks fail."""

from __future__ import annotations

import json
import math
import os
import random
import resource
import signal
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.lessons import HOUR, comparison, lesson
from twinmatch.cli import main
from twinmatch.memory import Memory, MemoryFaultError, default_file
from twinmatch.memory.store import VERSION

WRITER = """
import sys
from pathlib import Path
from tests.support.lessons import lesson
from twinmatch.memory import Memory
memory, first = Memory(Path(sys.argv[1])), int(sys.argv[2])
print("ready", flush=True)
for number in range(first, first + int(sys.argv[3])):
    memory.add([lesson(number, structure) for structure in ("paper", "rich", "other")])
"""


def writer(path: Path, first: int, sessions: int) -> subprocess.Popen[str]:
    """A program that remembers sessions one by one, three lessons each; it has just begun."""
    words = [sys.executable, "-c", WRITER, str(path), str(first), str(sessions)]
    program = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert program.stdout is not None
    with program.stdout:
        assert program.stdout.readline() == "ready\n"
    return program


def of_sessions(path: Path) -> Counter[str]:
    """How many lessons there are of each session."""
    return Counter(stored.session for stored in Memory(path).lessons())


def test_lessons_come_back_as_they_were_oldest_first(tmp_path):
    memory = Memory(tmp_path / "folder" / "rig.sqlite")
    assert memory.lessons() == []
    assert not memory.path.exists()
    unknown = lesson(3, persistence_skill=(math.nan, 0.5), fault_at=2155)
    assert memory.add([unknown, lesson(1)]) == 2
    assert memory.add([lesson(2)]) == 1
    first, second, third = memory.lessons("peltier", "", {"e1"})
    assert (first, second) == (lesson(1), lesson(2))
    assert math.isnan(third.persistence_skill[0])
    assert third.fault_at == 2155
    assert third.deviations == pytest.approx([1e-3, 1e-2])


def test_a_session_counts_once(tmp_path):
    memory = Memory(tmp_path / "rig.sqlite")
    memory.add([lesson(1), lesson(1, "rich")])
    renamed_copy = lesson(1, name="a copy", duration=1.0)
    assert memory.add([renamed_copy, lesson(2)]) == 1
    assert [stored.name for stored in memory.lessons()] == ["run_1", "run_1", "run_2"]
    # the plant's file was changed: a lesson of its own
    changed = lesson(1, equations="e2")
    assert memory.add([changed]) == 1
    assert memory.lessons("peltier", "", {"e2"}) == [changed]


def test_plants_and_rigs_are_kept_apart(tmp_path):
    memory = Memory(tmp_path / "all.sqlite")
    memory.add(
        [
            lesson(1),
            lesson(1, rig="left"),
            lesson(2, rig="left"),
            lesson(1, plant="tclab"),
        ]
    )
    assert [stored.name for stored in memory.lessons("peltier", "left")] == [
        "run_1",
        "run_2",
    ]
    assert memory.lessons("peltier", "") == [lesson(1)]
    assert len(memory.lessons()) == 4


def test_forgotten_sessions_are_gone_by_name_or_digest(tmp_path):
    memory = Memory(tmp_path / "rig.sqlite")
    memory.add(
        [lesson(n, structure) for n in (1, 2, 3) for structure in ("paper", "rich")]
    )
    assert memory.forget(["run_1", "digest-3", "run_9"]) == ["run_1", "run_3"]
    assert [(stored.name, stored.structure) for stored in memory.lessons()] == [
        ("run_2", "paper"),
        ("run_2", "rich"),
    ]
    assert Memory(tmp_path / "none.sqlite").forget(["run_1"]) == []


def test_sessions_without_dates_are_ordered_by_their_numbers(tmp_path):
    memory = Memory(tmp_path / "rig.sqlite")
    names = ["BMData14_022722", "BMData2_022722", "BMData1_022722", "BMData9_022722"]
    memory.add([lesson(n, name=name, began=HOUR) for n, name in enumerate(names)])
    assert [s.name for s in memory.lessons()] == [
        f"BMData{n}_022722" for n in (1, 2, 9, 14)
    ]


def test_comparisons_come_back_as_they_were_one_a_session_and_are_forgotten(tmp_path):
    memory = Memory(tmp_path / "rig.sqlite")
    assert memory.comparisons("peltier") == []
    diverged = comparison(2, high=math.inf, median=math.nan, rig="left")
    assert [memory.add_comparison(new) for new in (comparison(1), diverged)] == [
        True,
        True,
    ]
    assert not memory.add_comparison(comparison(1, measured=9.0))
    assert memory.comparisons("peltier", "") == [comparison(1)]
    first, second = memory.comparisons("peltier")
    assert first == comparison(1)
    assert second.high == math.inf
    assert math.isnan(second.median)
    memory.add([lesson(1)])
    assert memory.forget(["run_1"]) == ["run_1"]
    assert memory.lessons() == memory.comparisons("peltier", "") == []
    assert memory.forget(["digest-2"]) == ["run_2"]


def test_a_file_of_the_first_version_is_read_and_gets_its_second_table_when_written(
    tmp_path,
):
    memory = Memory(tmp_path / "rig.sqlite")
    memory.add([lesson(1)])
    change(memory.path, "DROP TABLE comparison")
    change(memory.path, "PRAGMA user_version = 1")
    before = memory.path.read_bytes()
    assert (memory.lessons(), memory.comparisons("peltier")) == ([lesson(1)], [])
    assert memory.path.read_bytes() == before
    assert memory.add_comparison(comparison(1))
    assert memory.lessons() == [lesson(1)]
    assert memory.comparisons("peltier") == [comparison(1)]


@settings(max_examples=30, deadline=None)
@given(
    name=st.text(st.characters(exclude_categories=["Cs"]), max_size=20),
    values=st.lists(
        st.floats(allow_nan=False, allow_infinity=False), min_size=2, max_size=2
    ),
    began=st.integers(0, 2**62),
)
def test_any_name_and_any_number_comes_back_bit_for_bit(
    tmp_path_factory, name, values, began
):
    memory = Memory(tmp_path_factory.mktemp("memory") / "rig.sqlite")
    odd_lesson = lesson(
        1,
        name=name,
        began=began,
        parameters=dict(zip(("seebeck", "conductance"), values, strict=True)),
    )
    memory.add([odd_lesson])
    assert memory.lessons() == [odd_lesson]
    assert memory.forget([name]) == [name]


def test_other_programs_read_it(tmp_path):
    memory = Memory(tmp_path / "rig.sqlite")
    memory.add([lesson(1)])
    database = sqlite3.connect(memory.path)
    query = (
        "SELECT name, json_extract(parameters, '$.conductance'), covariance FROM lesson"
    )
    name, conductance, covariance = database.execute(query).fetchone()
    database.close()
    assert (name, conductance) == ("run_1", 0.5)
    assert json.loads(covariance) == [[1e-6, 2e-6], [2e-6, 1e-4]]
    memory.add(
        [lesson(n, structure) for n in range(100) for structure in ("paper", "rich")]
    )
    assert memory.path.stat().st_size < 100 * 5000  # a few kB a session


def test_a_killed_writer_leaves_complete_sessions_only(tmp_path):
    path = tmp_path / "rig.sqlite"
    draw = random.Random(4)
    for attempt in range(2):
        program = writer(path, 1000 * attempt, 1000)
        time.sleep(draw.uniform(0.0, 0.3))
        program.send_signal(signal.SIGKILL)
        program.wait()
        assert {*of_sessions(path).values()} <= {3}
    assert Memory(path).add([lesson(9999)]) == 1


def test_two_writers_at_once_lose_nothing(tmp_path):
    path = tmp_path / "rig.sqlite"
    # half of the sessions are the same
    programs = [writer(path, first, 40) for first in (0, 20)]
    while any(program.poll() is None for program in programs):
        assert {*of_sessions(path).values()} <= {3}
        time.sleep(0.05)
    assert [program.returncode for program in programs] == [0, 0]
    assert len(of_sessions(path)) == 60


def test_a_full_disk_is_reported_and_what_was_there_stays(tmp_path):
    memory = Memory(tmp_path / "rig.sqlite")
    memory.add([lesson(n) for n in range(20)])
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(
        resource.RLIMIT_FSIZE, (memory.path.stat().st_size + 4096, before[1])
    )
    try:
        with pytest.raises(
            MemoryFaultError, match="free some disk space, or choose another folder"
        ):
            memory.add([lesson(n) for n in range(20, 400)])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert len(of_sessions(memory.path)) == 20
    assert memory.add([lesson(20)]) == 1


def test_a_locked_file_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr("twinmatch.memory.store.WAIT", 0.05)
    memory = Memory(tmp_path / "rig.sqlite")
    memory.add([lesson(1)])
    writer = sqlite3.connect(memory.path, isolation_level=None)
    writer.execute("BEGIN EXCLUSIVE")
    with pytest.raises(
        MemoryFaultError, match=r"rig\.sqlite: another program is writing it; try again"
    ):
        memory.lessons()
    writer.close()
    assert len(memory.lessons()) == 1


def garbage(path: Path) -> None:
    path.write_bytes(random.Random(1).randbytes(20_000))


def foreign(path: Path) -> None:
    database = sqlite3.connect(path)
    database.execute("CREATE TABLE lesson (a)")
    database.close()


def newer(path: Path) -> None:
    Memory(path).add([lesson(1)])
    change(path, f"PRAGMA user_version = {VERSION + 1}")


def folder(path: Path) -> None:
    path.mkdir()


def pipe(path: Path) -> None:
    os.mkfifo(path)


def edited(path: Path) -> None:
    Memory(path).add([lesson(1)])
    change(path, "UPDATE lesson SET covariance = '[[1.0]]'")


def unreadable(path: Path) -> None:
    Memory(path).add([lesson(1)])
    change(path, "UPDATE lesson SET outputs = 'somebody was here'")


def endless(path: Path) -> None:
    Memory(path).add([lesson(1)])
    change(path, "ALTER TABLE lesson RENAME TO held")
    many = "WITH RECURSIVE n(k) AS (SELECT 0 UNION ALL SELECT k + 1 FROM n) SELECT held.* FROM held, n"
    change(path, f"CREATE VIEW lesson AS {many}")


def of_other_types(path: Path) -> None:
    Memory(path).add([lesson(1)])
    change(path, "UPDATE lesson SET began = 'monday'")


def truncated(path: Path) -> None:
    Memory(path).add([lesson(n) for n in range(50)])
    os.truncate(path, path.stat().st_size // 2)


def change(path: Path, statement: str) -> None:
    database = sqlite3.connect(path)
    database.execute(statement)
    database.commit()
    database.close()


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (garbage, "is not a memory of twinmatch; give another file, or move it away"),
        (foreign, "is a database of another program; give another file"),
        (newer, "was written by a newer version of twinmatch .*; update twinmatch"),
        (folder, "is not a regular file; give a file"),
        (pipe, "is not a regular file; give a file"),
        (
            edited,
            "lesson of run_1, paper: 2 free parameters and 1 covariances do not belong together",
        ),
        (unreadable, "a row cannot be read"),
        (
            endless,
            "has views, triggers or indexes, which no memory has; give another file",
        ),
        (of_other_types, "began: is 'monday'; give a whole number"),
        (truncated, "is damaged .*; move it away, and remember its sessions again"),
    ],
)
def test_a_file_that_cannot_be_used_is_one_sentence(tmp_path, damage, message):
    memory = Memory(tmp_path / "rig.sqlite")
    damage(memory.path)
    with pytest.raises(MemoryFaultError, match=rf"^memory .*rig\.sqlite: {message}"):
        memory.lessons()


def test_a_file_that_takes_too_long_is_one_sentence(tmp_path, monkeypatch):
    memory = Memory(tmp_path / "rig.sqlite")
    memory.add([lesson(n) for n in range(2000)])
    monkeypatch.setattr("twinmatch.memory.store.PATIENCE", -1.0)
    with pytest.raises(
        MemoryFaultError,
        match=r"takes more than .* s to read; give another file, or forget",
    ):
        memory.lessons()


def test_only_the_newest_lessons_are_read_and_the_command_says_so(
    tmp_path, monkeypatch, capsys
):
    memory = Memory(tmp_path / "rig.sqlite")
    memory.add([lesson(n, began=HOUR) for n in range(20)])
    monkeypatch.setattr("twinmatch.memory.store.MOST", 3)
    assert [stored.name for stored in memory.lessons()] == [
        "run_17",
        "run_18",
        "run_19",
    ]
    assert (
        memory.unread(),
        memory.unread("another"),
        Memory(tmp_path / "none").unread(),
    ) == (17, 0, 0)
    monkeypatch.setattr("twinmatch.cli.memory.MOST", 3)
    main(["memory", "--memory", str(memory.path)])
    assert (
        "rig.sqlite: the newest 3 lessons are read; 17 older ones are not\n"
        in capsys.readouterr().out
    )


def test_an_empty_file_becomes_a_memory(tmp_path):
    memory = Memory(tmp_path / "rig.sqlite")
    memory.path.touch()
    assert memory.lessons() == []
    assert memory.add([lesson(1)]) == 1


def test_a_lesson_with_a_value_that_is_not_finite_is_refused():
    with pytest.raises(
        MemoryFaultError, match="lesson of run_1, paper: a value is not finite"
    ):
        lesson(1, parameters={"seebeck": math.inf, "conductance": 0.5})


def test_the_default_file_is_named_after_plant_and_rig(monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", "/data")
    assert default_file("peltier") == Path("/data/twinmatch/peltier.sqlite")
    assert default_file("peltier", "left-2") == Path(
        "/data/twinmatch/peltier@left-2.sqlite"
    )
    with pytest.raises(
        MemoryFaultError, match=r"rig '\.\./x': is not a name for a rig"
    ):
        default_file("peltier", "../x")


def test_a_memory_with_wrong_bytes_is_one_sentence_or_still_read(tmp_path):
    memory = Memory(tmp_path / "sound.sqlite")
    memory.add(
        [
            lesson(number, structure)
            for number in range(6)
            for structure in ("paper", "rich")
        ]
    )
    sound = memory.path.read_bytes()
    rng = random.Random(3)
    broken = Memory(tmp_path / "broken.sqlite")
    refusals = []
    for _ in range(150):
        content = bytearray(sound)
        for _ in range(rng.choice([1, 3, 30, 300])):
            content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
        broken.path.write_bytes(content)
        for use in (
            broken.lessons,
            lambda: broken.comparisons("peltier"),
            lambda: broken.add([lesson(99)]),
        ):
            try:
                use()
            except MemoryFaultError as error:
                refusals.append(str(error))
    assert refusals
    for sentence in refusals:
        assert sentence.startswith(f"memory {broken.path}: ")
        assert "\n" not in sentence
        assert len(sentence) < len(str(broken.path)) + 250
