"""Other people's bags as sessions: both storages, their own types, and one line on what cannot be used."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rosbags", reason="rosbags is not installed; it is in the extra 'bags'")

from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import get_types_from_msg

from tests.support.bags import START, STORE, bag, header, number, temperature
from tests.support.plant_files import plant_file
from tests.support.processes import run_twinmatch
from twinmatch.errors import TwinmatchError
from twinmatch.importing import bags
from twinmatch.importing.bags import _means, _Signal, map_bag
from twinmatch.plants import find_plant
from twinmatch.sampling.sources import parse_map
from twinmatch.sessions import read_session

STORE.register(get_types_from_msg("float32 value\nstring name", "lab_msgs/msg/Reading"))
STORE.register(get_types_from_msg("std_msgs/Header header\nReading[] readings", "lab_msgs/msg/Rack"))
TICKS = 60
PERIOD = 0.5
MAP = ["output=/rack:readings[1].value", "input=/heater", "reference=/sp:data", "room=/room:temperature"]


def rack(at: float, value: float) -> Any:
    reading = STORE.types["lab_msgs/msg/Reading"]
    readings = [reading(value=0.0, name="spare"), reading(value=value, name="block")]
    return STORE.types["lab_msgs/msg/Rack"](header=header(at), readings=readings)


def messages(ticks: int = TICKS, hole: tuple[int, int] = (0, 0)) -> list[tuple[float, str, Any]]:
    """A rig: readings on a clock, commands where it changes, a set-point once, the room every few seconds."""
    made = [(-0.2, "/sp", number(40.0)), (-0.1, "/heater", number(10.0))]
    for k in range(ticks):
        if hole[0] <= k < hole[1]:
            continue
        made.append((k * PERIOD, "/rack", rack(k * PERIOD, 20.0 + k)))
        if k % 10 == 5:
            made.append(((k + 0.25) * PERIOD, "/heater", number(10.0 + k)))
        if k % 6 == 0:
            made.append((k * PERIOD, "/room", temperature(k * PERIOD, 18.0 + 0.1 * k)))
    made.append((ticks * PERIOD, "/said", STORE.types["std_msgs/msg/String"](data="done")))
    return made


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return plant_file(tmp_path_factory.mktemp("plant"), "bagged_block")


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_bag_of_either_storage_becomes_a_session(
    tmp_path: Path, plant: Path, storage: StoragePlugin
) -> None:
    source = bag(tmp_path / "bag", storage, messages())
    done = run_twinmatch("import", source, "--plant", plant, "--map", *MAP, "-o", tmp_path / "session")
    assert done.returncode == 0, done.stderr
    session = read_session(tmp_path / "session")
    samples = session.samples
    assert (len(samples), session.period) == (TICKS, PERIOD)
    assert [s.output for s in samples] == [20.0 + k for k in range(TICKS)]
    assert {s.reference for s in samples} == {40.0}
    assert samples[0].stamp == START * 10**9  # by the header, not by the bag
    # The room every third second, in a line between, and standing after the last.
    assert [s.disturbances[0] for s in samples[:55]] == pytest.approx([18.0 + 0.1 * k for k in range(55)])
    # Commands have no header: the bag's time, 30 ms late.
    part = 0.25 + 0.03 / PERIOD
    assert samples[4].input == 10.0
    assert samples[5].input == pytest.approx(10.0 * part + 15.0 * (1 - part), abs=1e-5)
    assert samples[6].input == pytest.approx(15.0, abs=1e-9)


def test_list_shows_topics_and_proposes_a_map(tmp_path: Path) -> None:
    done = run_twinmatch("import", bag(tmp_path / "bag", StoragePlugin.MCAP, messages()), "--list")
    assert done.returncode == 0, done.stderr
    row = next(line for line in done.stdout.splitlines() if "/rack" in line)
    assert "lab_msgs/msg/Rack" in row
    assert f" {TICKS} " in row
    assert " 1.99 " in row  # a second, over all messages
    assert "readings[0].value" in row
    assert "reference=/sp:data" in done.stdout
    assert "input=/heater:data" in done.stdout
    assert "room=/room:temperature" in done.stdout


def test_without_a_set_point_the_session_says_so(tmp_path: Path, plant: Path) -> None:
    source = bag(tmp_path / "bag", StoragePlugin.MCAP, messages())
    entries = [entry for entry in MAP if not entry.startswith("reference")]
    done = run_twinmatch("import", source, "--plant", plant, "--map", *entries, "-o", tmp_path / "session")
    assert done.returncode == 0, done.stderr
    assert not read_session(tmp_path / "session").has_reference


def test_another_period_and_another_unit(tmp_path: Path, plant: Path) -> None:
    made = messages()
    source = bag(tmp_path / "bag", StoragePlugin.MCAP, made)
    entries = parse_map([*MAP[1:], "output=/rack:readings[1].value; scale=0.5; offset=1"])
    found = map_bag(source, entries.joined(parse_map([])), find_plant(str(plant)))
    assert found.samples[10].output == pytest.approx(0.5 * 30.0 + 1)
    slower = run_twinmatch(
        "import", source, "--plant", plant, "--map", *MAP, "--period", "1.5", "-o", tmp_path / "slow"
    )
    assert slower.returncode == 0, slower.stderr
    session = read_session(tmp_path / "slow")
    assert session.period == 1.5
    assert [s.output for s in session.samples[:5]] == pytest.approx([20.0, 23.0, 26.0, 29.0, 32.0])


def test_the_reading_of_a_bag_reports_its_progress(
    tmp_path: Path, plant: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bags, "_EVERY", 5)
    shares: list[float] = []
    source = bag(tmp_path / "bag", StoragePlugin.MCAP, messages())
    map_bag(
        source, parse_map(MAP), find_plant(str(plant)), progress=lambda done, of: shares.append(done / of)
    )
    assert shares == sorted(shares)
    assert shares[0] < 0.1
    assert 0.9 < shares[-1] <= 1.0


def test_headers_of_another_clock_are_reported_and_not_used(tmp_path: Path, plant: Path) -> None:
    source = bag(tmp_path / "bag", StoragePlugin.MCAP, messages(), behind=500.0)
    found = map_bag(source, parse_map(MAP), find_plant(str(plant)))
    assert any("headers have another clock (/rack by 500" in note for note in found.notes)
    assert found.samples[0].stamp == round((START + 500.03) * 1e9)


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        (["output=/rakc", "input=/heater"], "has no topic /rakc; it has /empty, /heater, /rack"),
        (["output=/rack:readings[1].temp", "input=/heater"], "has no field 'temp'; its numbers:"),
        (["output=/rack:readings[1].name", "input=/heater"], "readings[1].name is text; choose a number:"),
        (["output=/said", "input=/heater"], "std_msgs/msg/String has no numbers"),
        (["output=/empty", "input=/heater"], "topic /empty has no messages"),
        (["output=/room:temperature; unit=Pa", "input=/heater"], "is in Pa"),
        (["output=/room:temperature"], "no topic is mapped to input"),
        (["output=/rack:readings[7].value", "input=/heater"], "no message of output has a number"),
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
    words = ["import", source, "--plant", plant, "--map", *MAP, "-o", tmp_path / "session"]
    done = run_twinmatch(*words)
    assert done.returncode == 2
    assert "a gap of 6.5 s after reading 20" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert run_twinmatch(*words, "--bridge", "10").returncode == 0
    assert len(read_session(tmp_path / "session").samples) == TICKS


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_file_without_its_folder_will_do(tmp_path: Path, plant: Path, storage: StoragePlugin) -> None:
    folder = bag(tmp_path / "bag", storage, messages())
    (file,) = (path for path in folder.iterdir() if path.name != "metadata.yaml")
    alone = file.rename(
        tmp_path / f"0_anything_2026_05_23-10_00_00{file.suffix}"
    )  # as ROS 2 Lyrical names it
    found = map_bag(alone, parse_map(MAP), find_plant(str(plant)))
    again = bag(tmp_path / "again", storage, messages())
    assert found.samples == map_bag(again, parse_map(MAP), find_plant(str(plant))).samples


def test_a_gap_splits_a_bag_and_the_twin_judges_both_parts(tmp_path: Path, plant: Path) -> None:
    """The samples are those of the bag without the hole; one command of the heater is lost in it."""
    full = bag(tmp_path / "a", StoragePlugin.MCAP, messages())
    holed = bag(tmp_path / "b", StoragePlugin.MCAP, messages(hole=(20, 32)))
    for source, session in ((full, "whole"), (holed, "split")):
        words = ["import", source, "-o", tmp_path / session, "--plant", plant, "--gaps", "split"]
        done = run_twinmatch(*words, "--map", *MAP)
        assert done.returncode == 0, done.stderr
    assert "split into 2 stretches by gaps of 6.5 s" in done.stdout
    by_index = {sample.index: sample for sample in read_session(tmp_path / "whole").samples}
    samples = read_session(tmp_path / "split").samples
    assert [s.index for s in samples] == [k for k in range(TICKS) if not 20 <= k < 32]
    for sample in samples:
        same = by_index[sample.index]
        assert (sample.stamp, sample.output) == (same.stamp, same.output)
        assert sample.disturbances == pytest.approx(same.disturbances)
        assert sample.input == same.input or 32 <= sample.index <= 35
    assert run_twinmatch("replay", tmp_path / "split", "--plant", plant).returncode == 0


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_damaged_bag_is_one_line(tmp_path: Path, plant: Path, storage: StoragePlugin) -> None:
    source = bag(tmp_path / "bag", storage, messages())
    file = next(p for p in source.iterdir() if p.suffix in (".mcap", ".db3"))
    whole = file.read_bytes()
    for damaged in (b"", whole[: len(whole) // 2], b"\0" * 1000 + whole[1000:]):
        file.write_bytes(damaged)
        done = run_twinmatch("import", source, "--plant", plant, "--map", *MAP, "-o", tmp_path / "session")
        assert done.returncode == 2, done.stdout
        assert len(done.stderr.splitlines()) == 1
        assert "Traceback" not in done.stderr
    (source / "metadata.yaml").unlink()
    done = run_twinmatch("import", source, "--list")
    assert done.returncode == 2
    assert "has no metadata.yaml" in done.stderr


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
    done = run_twinmatch("import", first, "--plant", plant, "--map", *entries, "-o", tmp_path / "second")
    assert done.returncode == 0, done.stderr
    once, twice = (read_session(tmp_path / name).samples for name in ("first", "second"))
    assert [(s.output, s.reference, s.disturbances) for s in twice] == [
        (s.output, s.reference, s.disturbances) for s in once
    ]
    assert [s.input for s in twice] == pytest.approx([s.input for s in once], abs=1e-6)


@given(
    st.lists(st.tuples(st.floats(0.0, 20.0), st.floats(-100.0, 100.0)), min_size=1, max_size=30),
    st.lists(st.floats(0.01, 3.0), min_size=2, max_size=20),
)
def test_means_keep_what_the_drive_delivered(steps: list[tuple[float, float]], widths: list[float]) -> None:
    """The sum over the rows is that over the commands, summed step by step."""
    held = dict([(-1.0, 5.0), *steps])
    signal = _Signal(np.array(sorted(held)), np.array([held[at] for at in sorted(held)]))
    time = np.concatenate([[0.0], np.cumsum(widths)])
    means = _means(signal, time, np.inf)
    total = 0.0
    edges = [*[at for at in sorted(held) if 0.0 < at < time[-1]], time[-1]]
    at, value = 0.0, held[max(t for t in held if t <= 0.0)]
    for edge in edges:
        total += value * (edge - at)
        at, value = edge, held.get(edge, value)
    assert float(np.sum(means[:-1] * np.diff(time))) == pytest.approx(total, abs=1e-6)
