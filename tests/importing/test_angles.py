"""Headings of bags and of tables of states, whose values come at times of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.compass import Ship, course, written_course
from twinmatch.cli import main
from twinmatch.importing.mapped import map_samples
from twinmatch.importing.table_files import open_table
from twinmatch.sampling.sources import parse_map
from twinmatch.sessions.files import RecordingError

MAP = ["output=/compass", "input=/rudder", "wind=/wind; turn=360"]


def wind_at(second: float) -> float:
    """A wind that turns by 2° a second, deg, counted on."""
    return 2.0 * second


def written_states(path: Path) -> None:
    """Headings and the wind as states with times of their own, the wind between two headings."""
    headings, rudder = course()
    rows = ["entity_id,state,last_changed"]
    for k in range(60):
        stamp = f"2026-03-01T00:00:{k:02d}"
        rows.append(f"sensor.heading,{headings[300 + k] % 360:.1f},{stamp}.500Z")
        rows.append(f"sensor.wind,{(300.0 + wind_at(k)) % 360.0:.1f},{stamp}.000Z")
        rows.append(f"number.rudder,{rudder[300 + k]:.1f},{stamp}.000Z")
    path.write_text("\n".join(rows) + "\n")


def test_between_two_readings_of_a_bag_no_angle_is_interpolated_backwards(
    tmp_path: Path,
) -> None:
    pytest.importorskip("rosbags", reason="rosbags is missing; extra 'bags'")
    from rosbags.rosbag2 import StoragePlugin

    from tests.support.bags import bag, number
    from twinmatch.importing.mapped_bags import map_bag

    headings, rudder = course()
    messages = []
    for k, (heading, angle) in enumerate(zip(headings, rudder, strict=True)):
        messages.append((float(k), "/compass", number(heading % 360.0)))
        messages.append((k - 0.1, "/rudder", number(float(angle))))
        messages.append((k - 0.5, "/wind", number(wind_at(k - 0.5) % 360.0)))
    path = bag(tmp_path / "bag", StoragePlugin.MCAP, messages)
    run = map_bag(path, parse_map(MAP), Ship)
    assert len(run.samples) >= 598
    read = [sample.output for sample in run.samples]
    first = int(np.argmin(np.abs(headings - read[0])))
    assert read == pytest.approx(headings[first : first + len(read)])
    wind = np.array([sample.disturbances[0] for sample in run.samples])
    # behind the last one the wind is what it was
    assert np.diff(wind)[:-1] == pytest.approx(2.0, abs=1e-6)
    with pytest.raises(RecordingError, match="the mean of 359 and 1 would be 180"):
        map_bag(path, parse_map(["output=/compass, /wind", "input=/rudder"]), Ship)


def test_of_states_an_angle_at_another_row_is_the_newest_one(tmp_path: Path) -> None:
    written_states(tmp_path / "history.csv")
    entries = [
        "time=last_changed",
        "output=sensor.heading",
        "input=number.rudder",
        "wind=sensor.wind; turn=360",
    ]
    table = open_table(tmp_path / "history.csv")
    run = map_samples(table, parse_map(entries), Ship)
    wind = np.array([sample.disturbances[0] for sample in run.samples])
    assert wind.max() > 400.0
    assert np.diff(wind) == pytest.approx(2.0)


def test_a_list_says_which_columns_begin_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    written_course(tmp_path / "log.csv")
    assert main(["import", str(tmp_path / "log.csv"), "--list"]) == 0
    said = capsys.readouterr().out
    assert "heading (deg) begins again after 360, as an angle does" in said
    assert "rudder (deg) begins" not in said
