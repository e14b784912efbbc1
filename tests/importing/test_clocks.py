"""Bags and tables whose clock, or whose inputs, are not what they seem: nothing is mixed, held or lost."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip(
    "rosbags", reason="rosbags is not installed; it is in the extra 'bags'"
)

from rosbags.rosbag2 import StoragePlugin, Writer

from tests.support.bags import START, STORE, number, temperature
from tests.support.plant_files import plant_file
from twinmatch.cli import main
from twinmatch.dynamics import Plant
from twinmatch.importing.mapped import Mapped, map_samples
from twinmatch.importing.mapped_bags import map_bag
from twinmatch.importing.tables import read_table
from twinmatch.plants import find_plant
from twinmatch.sampling.sources import parse_map
from twinmatch.sessions import read_session, write_session
from twinmatch.sessions.files import RecordingError

Messages = list[tuple[float, str, Any]]
"""Time of recording, s, topic and message, in the order of recording."""

ROWS = 120
STEP = 0.5
MAP = ["output=/block:temperature", "input=/heater", "reference=/sp"]
BOTH = [StoragePlugin.MCAP, StoragePlugin.SQLITE3]


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> type[Plant]:
    return find_plant(
        str(plant_file(tmp_path_factory.mktemp("plant"), "clocked_block"))
    )


def ticks(count: int = ROWS, first: int = 0) -> Iterator[tuple[float, float]]:
    """Time and reading; the reading says which tick it is."""
    for k in range(first, first + count):
        yield k * STEP, 20.0 + 0.1 * k


def loop(seconds: float, reading: float, *, recorded: float | None = None) -> Messages:
    recorded = seconds if recorded is None else recorded
    return [
        (recorded, "/block", temperature(seconds, reading)),
        (recorded + 0.01, "/heater", number(reading)),
    ]


def bag_of(
    folder: Path, timed_messages: Messages, storage: StoragePlugin = StoragePlugin.MCAP
) -> Path:
    """Write messages in this order, whatever their times are."""
    with Writer(folder, version=9, storage_plugin=storage) as writer:
        connections: dict[str, Any] = {}
        for seconds, name, message in timed_messages:
            kind = message.__msgtype__
            if name not in connections:
                connections[name] = writer.add_connection(name, kind, typestore=STORE)
            writer.write(
                connections[name],
                round((START + seconds) * 1e9),
                STORE.serialize_cdr(message, kind),
            )
    return folder


def mapped(
    source: Path, plant: type[Plant], entries: list[str] = MAP, **options: Any
) -> Mapped:
    return map_bag(source, parse_map(entries), plant, **options)


def readings(run: Mapped) -> list[float]:
    return [round(sample.output, 6) for sample in run.samples]


def stretches(run: Mapped) -> list[list[float]]:
    """The readings of each unbroken run of samples."""
    parts: list[list[float]] = [[]]
    for before, sample in zip([None, *run.samples], run.samples, strict=False):
        if before is not None and not sample.follows(before):
            parts.append([])
        parts[-1].append(round(sample.output, 6))
    return parts


SETPOINT: Messages = [(-0.1, "/sp", number(40.0)), (-0.1, "/heater", number(20.0))]


@pytest.mark.parametrize("storage", BOTH)
@pytest.mark.parametrize("back", [20.0, 5.13])
def test_a_clock_that_is_set_back_splits_a_bag_or_is_refused(
    back: float, storage: StoragePlugin, tmp_path: Path, plant: type[Plant]
) -> None:
    """Sorted by time, a third of the readings vanished, or those of both stretches alternated."""
    timed_messages = list(SETPOINT)
    half = ROWS // 2 * STEP
    for seconds, reading in ticks():
        timed_messages += loop(seconds if seconds < half else seconds - back, reading)
    source = bag_of(tmp_path / "bag", timed_messages, storage)
    with pytest.raises(
        RecordingError,
        match=r"in reading 60 to .* in reading 62; if a clock was set back",
    ):
        mapped(source, plant)
    run = mapped(source, plant, gaps="split")
    # The first reading after it comes before the first command by the same clock.
    assert [value for part in stretches(run) for value in part] == [
        round(value, 6) for seconds, value in ticks() if seconds != half
    ]
    assert [len(part) for part in stretches(run)] == [ROWS // 2, ROWS // 2 - 1]
    assert any("split into 2 stretches by steps back of " in note for note in run.notes)
    stamps = [sample.stamp for sample in run.samples]
    assert stamps == sorted(set(stamps))
    written = read_session(write_session(tmp_path / "session", run.samples, gaps=True))
    assert [s.output for s in written.samples] == [s.output for s in run.samples]


def test_two_runs_of_a_simulator_that_was_reset_stay_two(
    tmp_path: Path, plant: type[Plant]
) -> None:
    """Both begin at 10 s; the second one was taken for repeated messages."""
    timed_messages = [
        (seconds + 10.0, topic, message) for seconds, topic, message in SETPOINT
    ]
    for first in (0, 300):
        for (seconds, _), (_, reading) in zip(ticks(), ticks(first=first), strict=True):
            timed_messages += loop(seconds + 10.0, reading)
    run = mapped(bag_of(tmp_path / "bag", timed_messages), plant, gaps="split")
    assert [(len(part), part[1] > 40.0) for part in stretches(run)] == [
        (ROWS, False),
        (ROWS - 1, True),
    ]


def test_messages_that_arrive_late_do_not_set_the_clock_back(
    tmp_path: Path, plant: type[Plant]
) -> None:
    timed_messages = list(SETPOINT)
    for seconds, reading in ticks():
        timed_messages += loop(seconds, reading)
    late = timed_messages.pop(2 * 50)  # recorded 2.5 s after its stamp
    timed_messages.insert(2 * 55, (timed_messages[2 * 55][0], *late[1:]))
    run = mapped(bag_of(tmp_path / "bag", timed_messages), plant)
    assert readings(run) == [round(value, 6) for _, value in ticks()]


@pytest.mark.parametrize("gaps", ["refuse", "split"])
def test_a_table_whose_clock_goes_back_is_split_or_refused_too(
    gaps: Any, tmp_path: Path, plant: type[Plant]
) -> None:
    table = tmp_path / "log.csv"
    rows = [
        f"{seconds if seconds < 30.0 else seconds - 7.0},{reading},{reading}"
        for seconds, reading in ticks()
    ]
    table.write_text("\n".join(["time,output,input", *rows]), "utf-8")
    signal_map = parse_map(["time=time", "output=output", "input=input"])
    if gaps == "refuse":
        with pytest.raises(
            RecordingError,
            match=r"from 29.5 s in line 61 to 23 s in line 62; if a clock was set",
        ):
            map_samples(read_table(table), signal_map, plant)
        return
    run = map_samples(read_table(table), signal_map, plant, gaps=gaps)
    assert [len(part) for part in stretches(run)] == [60, 60]
    assert readings(run) == [round(value, 6) for _, value in ticks()]
    assert all(
        b.stamp - a.stamp in (round(STEP * 1e9), round(2 * STEP * 1e9))
        for a, b in pairwise(run.samples)
    )


def test_rows_in_no_order_are_not_stretches(tmp_path: Path, plant: type[Plant]) -> None:
    table = tmp_path / "log.csv"
    order = np.random.default_rng(3).permutation(60)
    table.write_text(
        "\n".join(["time,output,input", *(f"{k},{k},{k}" for k in order)]), "utf-8"
    )
    with pytest.raises(RecordingError, match="sort the rows, and keep one per time"):
        map_samples(
            read_table(table),
            parse_map(["time=time", "output=output", "input=input"]),
            plant,
            gaps="split",
        )


@pytest.mark.parametrize(("begin", "end"), [(20.0, 40.0), (40.0, 1e9)])
def test_a_hole_in_the_messages_of_an_input_is_a_gap(
    begin: float, end: float, tmp_path: Path, plant: type[Plant]
) -> None:
    """Its last value was held for as long as it lasted."""
    timed_messages = list(SETPOINT)
    for seconds, reading in ticks():
        both = loop(seconds, reading)
        timed_messages += both[:1] if begin < seconds < end else both
    source = bag_of(tmp_path / "bag", timed_messages)
    words = rf"input \(/heater\) has no message for .* s from reading {round(begin / STEP) + 3} on: .*--bridge"
    with pytest.raises(RecordingError, match=words):
        mapped(source, plant)
    run = mapped(source, plant, gaps="split")
    unknown = [value for seconds, value in ticks() if begin + STEP < seconds <= end]
    assert readings(run) == [
        round(value, 6) for _, value in ticks() if value not in unknown
    ]
    assert run.notes[-1].startswith(
        f"Of {ROWS} messages of the output, {ROWS - len(unknown)} are used "
        f"(left out: {len(unknown)} in holes of input (/heater)); read beside them: "
    )
    assert len(mapped(source, plant, longest=60.0).samples) == ROWS


def test_an_input_that_is_published_when_it_changes_applies_until_then(
    tmp_path: Path, plant: type[Plant]
) -> None:
    timed_messages = list(SETPOINT)
    changes = {0: 10.0, 3: 80.0, 7: 0.0, 8: 5.0, 9: 90.0, 11: 0.0, 14: 50.0, 100: 20.0}
    for k, (seconds, reading) in enumerate(ticks()):
        timed_messages += loop(seconds, reading)[:1]
        if k in changes:
            timed_messages.append((seconds, "/heater", number(changes[k])))
    run = mapped(bag_of(tmp_path / "bag", timed_messages), plant)
    assert [run.samples[k].input for k in (5, 12, 60, 110)] == [80.0, 0.0, 50.0, 20.0]


def joints(seconds: float, **positions: float) -> Any:
    header = temperature(seconds, 0.0).header
    values = np.array(list(positions.values()))
    return STORE.types["sensor_msgs/msg/JointState"](
        header=header,
        name=list(positions),
        position=values,
        velocity=np.array([]),
        effort=values,
    )


def reordered(k: int, seconds: float, value: float) -> Messages:
    both = {"arm/elbow": value, "wrist": -5.0}
    return [
        (
            seconds,
            "/joint_states",
            joints(seconds, **(both if k < 60 else dict(reversed(both.items())))),
        )
    ]


def with_gripper(k: int, seconds: float, value: float) -> Messages:
    arm_message = (seconds, "/joint_states", joints(seconds, **{"arm/elbow": value}))
    return (
        [
            arm_message,
            (seconds + 0.2, "/joint_states", joints(seconds + 0.2, gripper=-5.0)),
        ]
        if k % 2
        else [arm_message]
    )


@pytest.mark.parametrize(
    ("messages_of", "other_name"), [(reordered, "wrist"), (with_gripper, "gripper")]
)
def test_a_joint_is_followed_by_its_name_and_not_by_an_index_that_changes(
    messages_of: Any, other_name: str, tmp_path: Path, plant: type[Plant]
) -> None:
    joint_messages = [
        message
        for k, (seconds, value) in enumerate(ticks())
        for message in messages_of(k, seconds, value)
    ]
    source = bag_of(tmp_path / "bag", SETPOINT + joint_messages)
    entries = (
        "output=/joint_states:position[{0}]",
        "input=/joint_states:effort[{0}]",
        "reference=/sp",
    )
    words = rf"position\[0\] is arm/elbow in one message and {other_name} in another; .*position\[arm/elbow\]"
    with pytest.raises(RecordingError, match=words):
        mapped(source, plant, [entry.format(0) for entry in entries])
    run = mapped(source, plant, [entry.format("arm/elbow") for entry in entries])
    assert readings(run) == [round(value, 6) for _, value in ticks()]
    assert run.period == STEP


def test_joints_are_listed_and_proposed_by_their_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    joint_messages = [
        message
        for k, (seconds, value) in enumerate(ticks())
        for message in with_gripper(k, seconds, value)
    ]
    assert (
        main(
            [
                "import",
                str(bag_of(tmp_path / "bag", SETPOINT + joint_messages)),
                "--list",
            ]
        )
        == 0
    )
    listing = capsys.readouterr().out
    numbers = (
        "position[arm/elbow], effort[arm/elbow], position[gripper], effort[gripper]"
    )
    assert numbers in " ".join(re.sub("[│┃|]", " ", listing).split())
    assert "[0]" not in listing
    assert "'output=/joint_states:position[arm/elbow]'" in listing


def test_radians_of_a_joint_become_the_degrees_of_the_plant(tmp_path: Path) -> None:
    turned = find_plant(
        str(plant_file(tmp_path, "turned", ('unit="°C", noise', 'unit="deg", noise')))
    )
    joint_messages = [
        message
        for k, (seconds, value) in enumerate(ticks())
        for message in reordered(k, seconds, value / 100)
    ]
    entries = ["output=/joint_states:position[arm/elbow]", "input=/heater"]
    timed_messages = [
        message
        for k in range(ROWS)
        for message in (
            joint_messages[k],
            (joint_messages[k][0], "/heater", number(20.0)),
        )
    ]
    run = mapped(bag_of(tmp_path / "bag", timed_messages), turned, entries)
    assert run.samples[5].output == pytest.approx(np.rad2deg(0.205))


def test_the_clock_that_all_stamps_share_counts(
    tmp_path: Path, plant: type[Plant]
) -> None:
    """A simulator at half of real time: by the times of the bag, every time constant is doubled."""
    timed_messages: Messages = [
        (-0.5, "/sp", number(40.0)),
        (-0.5, "/heater", number(20.0)),
    ]
    for seconds, reading in ticks():
        timed_messages += loop(seconds + 5.0 - START, reading, recorded=2 * seconds)
    run = mapped(bag_of(tmp_path / "bag", timed_messages), plant)
    assert (len(run.samples), run.period) == (ROWS, STEP)
    assert any(
        "share a clock of their own, which counts" in n and "0.5 times as fast" in n
        for n in run.notes
    )
    # A command 10 ms after its reading by the bag's clock is 5 ms after it by the simulator's.
    assert run.samples[10].input == pytest.approx(0.01 * 20.9 + 0.99 * 21.0, abs=1e-4)


@pytest.mark.parametrize("of_the_room", [300.0, None])
def test_stamps_of_clocks_that_disagree_or_stand_are_not_used(
    of_the_room: float | None, tmp_path: Path, plant: type[Plant]
) -> None:
    """Without a stamp of the room, that of every reading is the same."""
    timed_messages = list(SETPOINT)
    for seconds, reading in ticks():
        stamp = seconds - 500.0 if of_the_room is not None else -500.0
        timed_messages += loop(stamp, reading, recorded=seconds)
        if of_the_room is not None:
            timed_messages.append(
                (seconds, "/room", temperature(seconds + of_the_room, 18.0))
            )
    entries = MAP if of_the_room is None else [*MAP, "room=/room:temperature"]
    run = mapped(bag_of(tmp_path / "bag", timed_messages), plant, entries)
    assert run.samples[0].stamp == START * 10**9
    assert any(
        "have clocks of their own" in n and "the times of the bag are used" in n
        for n in run.notes
    )
