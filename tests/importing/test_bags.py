"""Other people's bags as sessions: both storages, their own types, and one line on what cannot be used."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
import zstandard
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip(
    "rosbags", reason="rosbags is not installed; it is in the extra 'bags'"
)

from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.support.bags import START, STORE, bag, header, number, temperature
from tests.support.exchanging import Heaters
from tests.support.plant_files import plant_file
from tests.support.processes import run_twinmatch
from twinmatch.cli import main
from twinmatch.errors import TwinmatchError
from twinmatch.importing import bag_files, bags
from twinmatch.importing.bags import open_bag
from twinmatch.importing.mapped_bags import map_bag
from twinmatch.importing.timed_signals import TimedSignal
from twinmatch.plants import find_plant
from twinmatch.sampling.channels import Channel
from twinmatch.sampling.sources import parse_map
from twinmatch.sessions import read_session
from twinmatch.sessions.files import RecordingError

STORE.register(get_types_from_msg("float32 value\nstring name", "lab_msgs/msg/Reading"))
STORE.register(
    get_types_from_msg(
        "std_msgs/Header header\nReading[] readings", "lab_msgs/msg/Rack"
    )
)
BOTH = (StoragePlugin.MCAP, StoragePlugin.SQLITE3)
TICKS = 60
PERIOD = 0.5
MAP = [
    "output=/rack:readings[1].value",
    "input=/heater",
    "reference=/sp:data",
    "room=/room:temperature",
]


def rack(seconds: float, value: float) -> Any:
    reading = STORE.types["lab_msgs/msg/Reading"]
    readings = [reading(value=0.0, name="spare"), reading(value=value, name="block")]
    return STORE.types["lab_msgs/msg/Rack"](header=header(seconds), readings=readings)


def messages(
    ticks: int = TICKS, hole: tuple[int, int] = (0, 0)
) -> list[tuple[float, str, Any]]:
    """A rig: readings on a clock, commands where it changes, a set-point once, the room every few seconds."""
    timed_messages = [(-0.2, "/sp", number(40.0)), (-0.1, "/heater", number(10.0))]
    for k in range(ticks):
        if hole[0] <= k < hole[1]:
            continue
        timed_messages.append((k * PERIOD, "/rack", rack(k * PERIOD, 20.0 + k)))
        if k % 10 == 5:
            timed_messages.append(((k + 0.25) * PERIOD, "/heater", number(10.0 + k)))
        if k % 6 == 0:
            timed_messages.append(
                (k * PERIOD, "/room", temperature(k * PERIOD, 18.0 + 0.1 * k))
            )
    timed_messages.append(
        (ticks * PERIOD, "/said", STORE.types["std_msgs/msg/String"](data="done"))
    )
    return timed_messages


RACK = Channel("/rack", "readings[1].value")


def stored(folder: Path) -> Path:
    """The only file of a bag beside its metadata."""
    (file,) = (path for path in folder.iterdir() if path.name != "metadata.yaml")
    return file


def read(path: Path, *channels: Channel) -> tuple[list[list[float]], list[str]]:
    """The numbers of channels, and what is said of the bag."""
    with open_bag(path) as opened:
        return [
            series.values.tolist() for series in opened.series(channels or [RACK])
        ], opened.notes


def listed(path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["import", str(path), "--list"]) == 0
    return capsys.readouterr().out


def metadata(folder: Path, change: Callable[[Any], object]) -> None:
    """Change what `metadata.yaml` says."""
    file = folder / "metadata.yaml"
    document = yaml.safe_load(file.read_text())
    change(document["rosbag2_bagfile_information"])
    file.write_text(yaml.safe_dump(document))


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return plant_file(tmp_path_factory.mktemp("plant"), "bagged_block")


@pytest.mark.parametrize("storage", BOTH)
def test_a_bag_of_either_storage_becomes_a_session(
    tmp_path: Path, plant: Path, storage: StoragePlugin
) -> None:
    source = bag(tmp_path / "bag", storage, messages())
    process = run_twinmatch(
        "import", source, "--plant", plant, "--map", *MAP, "-o", tmp_path / "session"
    )
    assert process.returncode == 0, process.stderr
    session = read_session(tmp_path / "session")
    samples = session.samples
    assert (len(samples), session.period) == (TICKS, PERIOD)
    assert [s.output for s in samples] == [20.0 + k for k in range(TICKS)]
    assert {s.reference for s in samples} == {40.0}
    assert samples[0].stamp == START * 10**9  # by the header, not by the bag
    # The room every third second, in a line between, and standing after the last.
    assert [s.disturbances[0] for s in samples[:55]] == pytest.approx(
        [18.0 + 0.1 * k for k in range(55)]
    )
    # Commands have no header: the bag's time, 30 ms late.
    part = 0.25 + 0.03 / PERIOD
    assert samples[4].input == 10.0
    assert samples[5].input == pytest.approx(10.0 * part + 15.0 * (1 - part), abs=1e-5)
    assert samples[6].input == pytest.approx(15.0, abs=1e-9)


def test_a_bag_of_two_loops_has_a_row_for_each_reading_of_the_first_output(
    tmp_path: Path,
) -> None:
    """The second sensor begins three readings later and is read between those of the first; one of the
    commands comes with every reading, the other when it changes."""
    timed_messages = [
        (-0.2, "/sp", number(40.0)),
        (-0.2, "/sp2", number(50.0)),
        (-0.1, "/q2", number(7.0)),
    ]
    for k in range(TICKS):
        timed_messages += [
            (k * PERIOD, "/one", temperature(k * PERIOD, 20.0 + k)),
            (k * PERIOD, "/q1", number(1.0 + k)),
        ]
        if k >= 3:
            timed_messages.append(
                ((k + 0.5) * PERIOD, "/two", temperature((k + 0.5) * PERIOD, 90.0 - k))
            )
    source = bag(tmp_path / "bag", StoragePlugin.MCAP, timed_messages)
    entries = [
        "output.1=/one:temperature",
        "second=/two:temperature",
        "first_power=/q1",
        "input.2=/q2",
    ]
    closed = [*entries, "reference.1=/sp", "second_reference=/sp2"]
    run = map_bag(source, parse_map(closed), Heaters)
    assert run.has_reference
    assert [s.outputs[0] for s in run.samples] == [20.0 + k for k in range(4, TICKS)]
    assert [s.outputs[1] for s in run.samples[:-1]] == pytest.approx(
        [90.5 - k for k in range(4, TICKS - 1)]
    )
    assert {(s.references, s.inputs[1]) for s in run.samples} == {((40.0, 50.0), 7.0)}
    # The bag's time, 30 ms late: so long the command before still acts.
    late = 0.03 / PERIOD
    assert [s.inputs[0] for s in run.samples] == pytest.approx(
        [1.0 + k - late for k in range(4, TICKS)]
    )
    assert (
        f"Of {TICKS} messages of first, {TICKS - 4} are used (left out: 4 before the first"
        in run.notes[-1]
    )
    with pytest.raises(
        RecordingError,
        match="no topic is mapped to second; add --map second=TOPIC:FIELD",
    ):
        map_bag(source, parse_map([entries[0], *entries[2:]]), Heaters)
    with pytest.raises(
        RecordingError, match=r"second and output.2 are the same signal; give it once"
    ):
        map_bag(source, parse_map([*entries, "output.2=/one"]), Heaters)
    with pytest.raises(
        RecordingError, match=r"is in degC .*, but the plant's first_power in %"
    ):
        map_bag(
            source,
            parse_map(["first_power=/one:temperature", *entries[:2], entries[3]]),
            Heaters,
        )


def test_list_shows_topics_and_proposes_a_map(tmp_path: Path) -> None:
    process = run_twinmatch(
        "import", bag(tmp_path / "bag", StoragePlugin.MCAP, messages()), "--list"
    )
    assert process.returncode == 0, process.stderr
    row = next(line for line in process.stdout.splitlines() if "/rack" in line)
    assert "lab_msgs/msg/Rack" in row
    assert f" {TICKS} " in row
    assert " 1.99 " in row  # a second, over all messages
    assert "readings[0].value" in row
    assert "reference=/sp:data" in process.stdout
    assert "input=/heater:data" in process.stdout
    assert "room=/room:temperature" in process.stdout


def test_without_a_set_point_the_session_says_so(tmp_path: Path, plant: Path) -> None:
    source = bag(tmp_path / "bag", StoragePlugin.MCAP, messages())
    entries = [entry for entry in MAP if not entry.startswith("reference")]
    process = run_twinmatch(
        "import",
        source,
        "--plant",
        plant,
        "--map",
        *entries,
        "-o",
        tmp_path / "session",
    )
    assert process.returncode == 0, process.stderr
    assert not read_session(tmp_path / "session").has_reference


def test_a_bag_is_imported_with_another_period_and_another_unit(
    tmp_path: Path, plant: Path
) -> None:
    timed_messages = messages()
    source = bag(tmp_path / "bag", StoragePlugin.MCAP, timed_messages)
    entries = parse_map(
        [*MAP[1:], "output=/rack:readings[1].value; scale=0.5; offset=1"]
    )
    run = map_bag(source, entries.joined(parse_map([])), find_plant(str(plant)))
    assert run.samples[10].output == pytest.approx(0.5 * 30.0 + 1)
    slower = run_twinmatch(
        "import",
        source,
        "--plant",
        plant,
        "--map",
        *MAP,
        "--period",
        "1.5",
        "-o",
        tmp_path / "slow",
    )
    assert slower.returncode == 0, slower.stderr
    session = read_session(tmp_path / "slow")
    assert session.period == 1.5
    assert [s.output for s in session.samples[:5]] == pytest.approx(
        [20.0, 23.0, 26.0, 29.0, 32.0]
    )


def test_the_reading_of_a_bag_reports_its_progress(
    tmp_path: Path, plant: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bags.Bag, "PROGRESS_EVERY", 5)
    shares: list[float] = []
    source = bag(tmp_path / "bag", StoragePlugin.MCAP, messages())
    map_bag(
        source,
        parse_map(MAP),
        find_plant(str(plant)),
        progress=lambda done, of: shares.append(done / of),
    )
    assert shares == sorted(shares)
    assert shares[0] < 0.1
    assert 0.9 < shares[-1] <= 1.0


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        (
            ["output=/rakc", "input=/heater"],
            "has no topic /rakc; it has /empty, /heater, /rack",
        ),
        (
            ["output=/rack:readings[1].temp", "input=/heater"],
            "has no field 'temp'; its numbers:",
        ),
        (
            ["output=/rack:readings[1].name", "input=/heater"],
            "readings[1].name is text; choose a number:",
        ),
        (["output=/said", "input=/heater"], "std_msgs/msg/String has no numbers"),
        (["output=/empty", "input=/heater"], "topic /empty has no messages"),
        (["output=/room:temperature; unit=Pa", "input=/heater"], "is in Pa"),
        (["output=/room:temperature"], "no topic is mapped to input"),
        (
            ["output=/rack:readings[7].value", "input=/heater"],
            "no message of output has a number",
        ),
        (["output=/ra ck", "input=/heater"], "names no topic"),
        (
            ["time=/rack:header", "output=/room:temperature", "input=/heater"],
            "a bag has the times of its messages",
        ),
    ],
)
def test_what_does_not_fit_is_one_line_that_says_what_there_is(
    tmp_path: Path, plant: Path, entries: list[str], words: str
) -> None:
    source = bag(tmp_path / "bag", StoragePlugin.SQLITE3, messages())
    with pytest.raises(TwinmatchError) as caught:
        map_bag(source, parse_map(entries), find_plant(str(plant)))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_gap_is_refused_with_its_place_or_bridged_where_that_is_asked_for(
    tmp_path: Path, plant: Path
) -> None:
    source = bag(tmp_path / "bag", StoragePlugin.MCAP, messages(hole=(20, 32)))
    words = [
        "import",
        source,
        "--plant",
        plant,
        "--map",
        *MAP,
        "-o",
        tmp_path / "session",
    ]
    process = run_twinmatch(*words)
    assert process.returncode == 2
    assert "a gap of 6.5 s after reading 20" in process.stderr
    assert len(process.stderr.splitlines()) == 1
    assert run_twinmatch(*words, "--bridge", "10").returncode == 0
    assert len(read_session(tmp_path / "session").samples) == TICKS


@pytest.mark.parametrize("storage", BOTH)
def test_a_file_without_its_folder_will_do(
    tmp_path: Path, plant: Path, storage: StoragePlugin
) -> None:
    folder = bag(tmp_path / "bag", storage, messages())
    (file,) = (path for path in folder.iterdir() if path.name != "metadata.yaml")
    alone = file.rename(
        tmp_path / f"0_anything_2026_05_23-10_00_00{file.suffix}"
    )  # as ROS 2 Lyrical names it
    run = map_bag(alone, parse_map(MAP), find_plant(str(plant)))
    second_bag = bag(tmp_path / "again", storage, messages())
    assert (
        run.samples
        == map_bag(second_bag, parse_map(MAP), find_plant(str(plant))).samples
    )


def test_a_gap_splits_a_bag_and_the_twin_judges_both_parts(
    tmp_path: Path, plant: Path
) -> None:
    """The samples are those of the bag without the hole; one command of the heater is lost in it."""
    full = bag(tmp_path / "a", StoragePlugin.MCAP, messages())
    holed = bag(tmp_path / "b", StoragePlugin.MCAP, messages(hole=(20, 32)))
    for source, session in ((full, "whole"), (holed, "split")):
        words = [
            "import",
            source,
            "-o",
            tmp_path / session,
            "--plant",
            plant,
            "--gaps",
            "split",
        ]
        process = run_twinmatch(*words, "--map", *MAP)
        assert process.returncode == 0, process.stderr
    assert "split into 2 stretches by gaps of 6.5 s" in process.stdout
    by_index = {
        sample.index: sample for sample in read_session(tmp_path / "whole").samples
    }
    samples = read_session(tmp_path / "split").samples
    assert [s.index for s in samples] == [k for k in range(TICKS) if not 20 <= k < 32]
    for sample in samples:
        whole_sample = by_index[sample.index]
        assert (sample.stamp, sample.output) == (
            whole_sample.stamp,
            whole_sample.output,
        )
        assert sample.disturbances == pytest.approx(whole_sample.disturbances)
        assert sample.input == whole_sample.input or 32 <= sample.index <= 35
    assert run_twinmatch("replay", tmp_path / "split", "--plant", plant).returncode == 0


@pytest.mark.parametrize(
    ("storage", "damage"),
    [
        (StoragePlugin.MCAP, "empty"),
        (StoragePlugin.SQLITE3, "empty"),
        (StoragePlugin.SQLITE3, "no beginning"),
        (StoragePlugin.SQLITE3, "half"),
    ],
)
def test_a_damaged_bag_is_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    storage: StoragePlugin,
    damage: str,
) -> None:
    source = bag(tmp_path / "bag", storage, messages())
    file = stored(source)
    whole = file.read_bytes()
    half = whole[: len(whole) // 2]
    file.write_bytes(
        {"empty": b"", "half": half, "no beginning": b"\0" * 1000 + whole[1000:]}[
            damage
        ]
    )
    assert main(["import", str(source), "--list"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert file.name in line


def test_a_bag_without_its_beginning_is_read_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of MCAP, whose records can be found anywhere in a file."""
    source = bag(tmp_path / "bag", StoragePlugin.MCAP, messages())
    file = stored(source)
    file.write_bytes(b"\0" * 1000 + file.read_bytes()[1000:])
    assert main(["import", str(source), "--list"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert f"{file.name}: the file is damaged: its first bytes are wrong" in printed
    assert "/rack" in printed


def test_our_own_session_is_a_bag_like_any_other(tmp_path: Path, plant: Path) -> None:
    first = tmp_path / "first"
    source = bag(tmp_path / "bag", StoragePlugin.MCAP, messages())
    words = ["import", source, "--plant", plant, "--map", *MAP, "-o", first]
    assert run_twinmatch(*words).returncode == 0
    shutil.rmtree(source)
    entries = [
        "output=/plant/sample:output[0]",
        "input=/plant/sample:input[0]",
        "reference=/plant/sample:reference[0]",
        "room=/plant/sample:disturbances[0]",
    ]
    process = run_twinmatch(
        "import", first, "--plant", plant, "--map", *entries, "-o", tmp_path / "second"
    )
    assert process.returncode == 0, process.stderr
    once, twice = (
        read_session(tmp_path / name).samples for name in ("first", "second")
    )
    assert [(s.output, s.reference, s.disturbances) for s in twice] == [
        (s.output, s.reference, s.disturbances) for s in once
    ]
    assert [s.input for s in twice] == pytest.approx([s.input for s in once], abs=1e-6)


@given(
    st.lists(
        st.tuples(st.floats(0.0, 20.0), st.floats(-100.0, 100.0)),
        min_size=1,
        max_size=30,
    ),
    st.lists(st.floats(0.01, 3.0), min_size=2, max_size=20),
)
def test_means_keep_what_the_drive_delivered(
    steps: list[tuple[float, float]], widths: list[float]
) -> None:
    """The sum over the rows is that over the commands, summed step by step."""
    values_from = dict([(-1.0, 5.0), *steps])
    signal = TimedSignal(
        np.array(sorted(values_from)),
        np.array([values_from[begin] for begin in sorted(values_from)]),
    )
    time = np.concatenate([[0.0], np.cumsum(widths)])
    means = signal.means(time, np.inf)
    total = 0.0
    edges = [
        *[begin for begin in sorted(values_from) if 0.0 < begin < time[-1]],
        time[-1],
    ]
    previous = 0.0
    value = values_from[max(t for t in values_from if t <= 0.0)]
    for edge in edges:
        total += value * (edge - previous)
        previous = edge
        value = values_from.get(edge, value)
    assert float(np.sum(means[:-1] * np.diff(time))) == pytest.approx(total, abs=1e-6)


READINGS = [20.0 + k for k in range(TICKS)]
PROFILE = {
    "history": "keep_last", "depth": 10, "reliability": "best_effort", "durability": "volatile",
    "deadline": {"sec": 0, "nsec": 0}, "lifespan": {"sec": 0, "nsec": 0}, "liveliness": "automatic",
    "liveliness_lease_duration": {"sec": 0, "nsec": 0}, "avoid_ros_namespace_conventions": False,
}  # fmt: skip


@pytest.mark.parametrize("storage", BOTH)
def test_messages_are_read_whatever_their_quality_of_service_is_said_to_be(
    tmp_path: Path, storage: StoragePlugin
) -> None:
    """It was edited, lost by a converter, or changed between two recordings in one folder."""
    source = bag(tmp_path / "bag", storage, messages())
    metadata(
        source,
        lambda held: [
            topic["topic_metadata"].update(offered_qos_profiles=[PROFILE])
            for topic in held["topics_with_message_count"]
        ],
    )
    assert read(source) == ([READINGS], [])


@pytest.mark.parametrize("storage", BOTH)
def test_what_was_read_is_counted_against_the_metadata(
    tmp_path: Path,
    plant: Path,
    capsys: pytest.CaptureFixture[str],
    storage: StoragePlugin,
) -> None:
    source = bag(tmp_path / "bag", storage, messages())
    metadata(
        source,
        lambda held: held["topics_with_message_count"][0].update(message_count=7),
    )
    words = "metadata.yaml lists other numbers of messages than the files hold: 7 of /empty (0 found)."
    assert f"Note: {words}" in listed(source, capsys)
    assert words in map_bag(source, parse_map(MAP), find_plant(str(plant))).notes


def test_a_metadata_file_or_a_table_of_another_form_ends_in_no_traceback(
    tmp_path: Path,
) -> None:
    source = bag(tmp_path / "bag", StoragePlugin.SQLITE3, messages())
    for count in (float("inf"), None, [], "many"):
        metadata(
            source,
            lambda held, n=count: held["topics_with_message_count"][1].update(
                message_count=n
            ),
        )
        assert read(source) == ([READINGS], [])
    with closing(sqlite3.connect(stored(source))) as data:
        data.execute("ALTER TABLE topics DROP COLUMN serialization_format")
        data.commit()
    with pytest.raises(TwinmatchError, match="serialization_format"):
        read(source)


def test_files_that_the_metadata_does_not_list_or_that_are_missing_are_named(
    tmp_path: Path,
) -> None:
    source = bag(tmp_path / "bag", StoragePlugin.MCAP, messages())
    shutil.copy(stored(source), source / "copy.mcap")
    assert read(source) == (
        [READINGS],
        ["copy.mcap is not listed in metadata.yaml and is left out; read it alone."],
    )
    (source / "bag.mcap").unlink()
    with pytest.raises(TwinmatchError, match=r"has no \.mcap"):
        read(source)


@pytest.mark.parametrize("storage", BOTH)
def test_the_folder_of_a_killed_recorder_is_read_without_its_metadata(
    tmp_path: Path, plant: Path, storage: StoragePlugin
) -> None:
    source = bag(tmp_path / "bag", storage, messages())
    whole = map_bag(source, parse_map(MAP), find_plant(str(plant)))
    (source / "metadata.yaml").unlink()
    run = map_bag(source, parse_map(MAP), find_plant(str(plant)))
    assert run.samples == whole.samples
    assert (
        "metadata.yaml is missing or unreadable: the recording was not finished."
        in run.notes
    )


def test_a_truncated_file_is_read_up_to_its_end_and_says_so(tmp_path: Path) -> None:
    file = stored(bag(tmp_path / "bag", StoragePlugin.MCAP, messages()))
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 3])
    (readings,), (note,) = read(file)
    assert 0 < len(readings) < TICKS
    assert readings == READINGS[: len(readings)]
    assert note.startswith("bag.mcap: the file is truncated; ")


@pytest.mark.parametrize("beside", ["-wal", "-journal"])
def test_what_sqlite_has_not_moved_into_the_file_yet_is_read(
    tmp_path: Path, beside: str
) -> None:
    """As a kill leaves it: the newest messages in the log beside the file, or a change half made in it."""
    source = bag(tmp_path / "bag", StoragePlugin.SQLITE3, messages())
    file = stored(source)
    with closing(sqlite3.connect(file)) as data:
        if beside == "-wal":
            data.executescript(
                "PRAGMA journal_mode = wal; PRAGMA wal_autocheckpoint = 0;"
            )
            rows = data.execute(
                "SELECT topic_id, timestamp, data FROM messages ORDER BY id"
            ).fetchall()
            data.execute("DELETE FROM messages")
            data.executemany(
                "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
                rows[:30],
            )
            data.commit()
            data.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            data.executemany(
                "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
                rows[30:],
            )
            data.commit()
        else:
            data.executescript(
                "PRAGMA cache_size = 1; BEGIN; DELETE FROM messages WHERE id > 9;"
            )
        shutil.copytree(source, tmp_path / "killed")
    killed = tmp_path / "killed"
    assert (killed / f"bag.db3{beside}").stat().st_size
    before = {path.name: path.read_bytes() for path in killed.iterdir()}
    assert read(killed) == ([READINGS], [])
    assert {path.name: path.read_bytes() for path in killed.iterdir()} == before


@pytest.mark.parametrize("surplus", [4, 24, 100])
def test_bytes_behind_the_last_field_are_not_an_error(
    tmp_path: Path, surplus: int
) -> None:
    """As `serialize_message` of rclpy writes them, and with it every recorder in Python."""
    source = bag(
        tmp_path / "bag", StoragePlugin.MCAP, messages(), surplus=b"\xfe" * surplus
    )
    assert read(source) == ([READINGS], [])


def mixed(file: Path, profile: str) -> Path:
    """An MCAP file with topics that cannot be read beside two that can; one has no definition."""
    with file.open("wb") as stream:
        out = McapWriter(stream)
        out.start(profile=profile, library="somebody")
        kind = "std_msgs/msg/Float64"
        schemas = {
            "/stated": ("cdr", out.register_schema(kind, "ros2msg", b"float64 data")),
            "/standard": ("cdr", out.register_schema(kind, "", b"")),
            "/idl": ("cdr", out.register_schema(kind, "ros2idl", b"module { nonsense")),
            "/json": ("json", out.register_schema("Note", "jsonschema", b"{}")),
            "/bare": ("json", 0),
            "/protobuf": (
                "protobuf",
                out.register_schema("Pose", "protobuf", b"\xff\x00"),
            ),
            "/broken": (
                "cdr",
                out.register_schema("lab_msgs/msg/Broken", "ros2msg", b"float64[ data"),
            ),
            "/unknown": ("cdr", out.register_schema("lab_msgs/msg/Unknown", "", b"")),
            "/nested": (
                "cdr",
                out.register_schema(
                    "lab_msgs/msg/Nested", "ros2msg", b"lab_msgs/Part part"
                ),
            ),
            "/short": (
                "cdr",
                out.register_schema(
                    "lab_msgs/msg/Long", "ros2msg", b"float64 a\nfloat64 b"
                ),
            ),
        }
        channels = {
            name: out.register_channel(name, encoding, schema)
            for name, (encoding, schema) in schemas.items()
        }
        for k in range(3):
            for channel in channels.values():
                out.add_message(
                    channel, k, bytes(STORE.serialize_cdr(number(k), kind)), k
                )
        out.finish()
    return file


@pytest.mark.parametrize("profile", ["ros2", ""])
def test_topics_that_cannot_be_read_are_listed_with_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], profile: str
) -> None:
    file = mixed(tmp_path / "mixed.mcap", profile)
    for name in ("/stated", "/standard", "/idl"):
        assert read(file, Channel(name, "")) == ([[0.0, 1.0, 2.0]], [])
    rows = {
        line.split("│")[1].strip(): line
        for line in listed(file, capsys).splitlines()
        if "│ /" in line
    }
    assert len(rows) == 10
    for name, words in {
        "/stated": " data ",
        "/json": "messages in json",
        "/bare": "messages in json",
        "/protobuf": "messages in protobuf",
        "/broken": "the definition of lab_msgs/msg/Broken",
        "/unknown": "does not contain",
        "/nested": "does not contain",
        "/short": " a, b ",
    }.items():
        assert words in rows[name], name
    with pytest.raises(
        TwinmatchError, match=r"/unknown: .* source the workspace that has it, or map"
    ):
        read(file, Channel("/unknown", "x"))
    with pytest.raises(
        TwinmatchError, match="/short: a message of 12 bytes is not a lab_msgs/msg/Long"
    ):
        read(file, Channel("/short", "a"))


def test_a_type_without_a_definition_is_found_in_the_workspace(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As Humble writes SQLite: no table of definitions, no hashes."""
    source = bag(tmp_path / "bag", StoragePlugin.SQLITE3, messages())
    with closing(sqlite3.connect(stored(source))) as data:
        data.executescript(
            "DROP TABLE message_definitions; UPDATE schema SET schema_version = 3;"
        )
        data.execute("UPDATE topics SET type_description_hash = ''")
        data.commit()
    share = tmp_path / "install" / "share" / "lab_msgs" / "msg"
    share.mkdir(parents=True)
    (share / "Rack.msg").write_text("std_msgs/Header header\nReading[] readings\n")
    standard = tmp_path / "install" / "share" / "std_msgs" / "msg"
    standard.mkdir(parents=True)
    (standard / "Header.msg").write_text(
        "builtin_interfaces/Time stamp\nstring frame_id\n"
    )
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "install"))
    with pytest.raises(
        TwinmatchError, match="/rack: the bag does not contain the definition of lab"
    ):
        read(source)  # a nested one is missing
    (share / "Reading.msg").write_text(
        "float32 value  # as it was recorded\nstring name\n"
    )
    assert read(source, RACK, Channel("/heater", "")) == (
        [READINGS, [10.0, *range(15, 66, 10)]],
        [],
    )


def test_an_installed_type_that_is_not_that_which_was_recorded_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "one.mcap"
    with file.open("wb") as stream:
        out = McapWriter(stream)
        out.start(profile="ros2", library="somebody")
        schema = out.register_schema("lab_msgs/msg/Level", "", b"")
        channel = out.register_channel(
            "/level", "cdr", schema, {"topic_type_hash": "RIHS01_" + "0" * 64}
        )
        out.add_message(channel, 1, b"\0\1\0\0" + bytes(8), 1)
        out.finish()
    share = tmp_path / "install" / "share" / "lab_msgs" / "msg"
    share.mkdir(parents=True)
    (share / "Level.msg").write_text("float64 value\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "install"))
    with pytest.raises(
        TwinmatchError, match=r"/level: .* recorded with another definition than"
    ):
        read(file, Channel("/level", ""))


@pytest.mark.parametrize("storage", BOTH)
@pytest.mark.parametrize("mode", [CompressionMode.MESSAGE, CompressionMode.FILE])
def test_compressed_messages_and_files_are_read_also_without_the_metadata(
    tmp_path: Path, storage: StoragePlugin, mode: CompressionMode
) -> None:
    source = bag(tmp_path / "bag", storage, messages(), compression=mode)
    assert read(source) == ([READINGS], [])
    (source / "metadata.yaml").unlink()
    assert read(source)[0] == [READINGS]


def test_an_invalid_compressed_file_or_message_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "bag.mcap.zstd"
    file.write_bytes(b"nonsense")
    with pytest.raises(TwinmatchError, match="cannot be unpacked"):
        read(file)
    source = bag(tmp_path / "bag", StoragePlugin.SQLITE3, messages())
    monkeypatch.setattr(bag_files, "MAX_UNPACKED", 10**5)
    bomb = zstandard.compress(bytes(10**5 + 1))
    with closing(sqlite3.connect(stored(source))) as data:
        data.execute("UPDATE messages SET data = ?", (bomb,))
        data.commit()
    with pytest.raises(TwinmatchError, match="a compressed message of 100001 bytes"):
        read(source)


def test_a_bag_of_ros_1_is_read_in_the_order_of_recording(tmp_path: Path) -> None:
    """Its clock was set back between the third message and the fourth."""
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer1(tmp_path / "one.bag") as writer:
        heater = writer.add_connection(
            "/heater", "std_msgs/msg/Float64", typestore=store
        )
        for second, value in ((5, 1.0), (6, 2.0), (7, 3.0), (1, 4.0)):
            message = store.types["std_msgs/msg/Float64"](data=value)
            writer.write(
                heater,
                second * 10**9,
                store.serialize_ros1(message, "std_msgs/msg/Float64"),
            )
    assert read(tmp_path / "one.bag", Channel("/heater", "")) == (
        [[1.0, 2.0, 3.0, 4.0]],
        [],
    )
    (tmp_path / "one.bag").write_bytes((tmp_path / "one.bag").read_bytes()[:2000])
    with pytest.raises(TwinmatchError, match="cannot be read as a bag, or is damaged"):
        read(tmp_path / "one.bag")


def test_a_mode_in_a_formula_holds_until_the_next(tmp_path: Path, plant: Path) -> None:
    """A mode of 0 that is published every five seconds, and then one of 3: in between there is no other."""
    timed_messages: list[tuple[float, str, Any]] = []
    for k in range(TICKS):
        timed_messages.append((k * PERIOD, "/oven", temperature(k * PERIOD, 20.0 + k)))
        timed_messages.append((k * PERIOD, "/power", number(50.5)))
        if k % 10 == 0:
            timed_messages.append((k * PERIOD, "/mode", number(0.0 if k < 30 else 3.0)))
    source = bag(tmp_path / "bag", StoragePlugin.MCAP, timed_messages)
    entries = [
        "output=/oven:temperature",
        "input=p*(m == 0) - p*(m == 2); p=/power:data; m=/mode:data",
    ]
    run = map_bag(source, parse_map(entries), find_plant(str(plant)))
    inputs = [sample.input for sample in run.samples]
    # The bag's times are 30 ms late, so the first reading has no input yet.
    assert inputs[:29] == pytest.approx([50.5] * 29, abs=1e-6)
    assert inputs[30:] == pytest.approx([0.0] * (TICKS - 31), abs=1e-6)
