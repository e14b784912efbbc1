"""A heading in a first plant file, and in one that does not say that it begins again."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tests.support.compass import Ship, UncountedShip, course, written_course
from twinmatch.adding.data import data_for, findings_of_angles
from twinmatch.adding.proposal import propose
from twinmatch.adding.several import propose_several
from twinmatch.adding.written_files import files_of, written_source
from twinmatch.importing.column_map import read_map
from twinmatch.importing.tables import read_table
from twinmatch.sampling.sources import parse_map, parse_source

MAP = ["time=time", "output=heading", "input=rudder", "wind=wind"]
TURN = "turn=360.0,  # what a reading loses where it begins again; turns are counted"


def test_new_plant_writes_the_turn_and_reads_gain_and_lag_of_counted_turns(
    tmp_path: Path,
) -> None:
    headings = written_course(tmp_path / "log.csv")
    table = read_table(tmp_path / "log.csv")
    proposal = propose(table, parse_map(MAP))
    assert proposal.output.turn == 360.0
    assert proposal.output.high > headings.max()
    assert proposal.gain > 0.0
    assert math.isclose(proposal.noise, 0.1, rel_tol=0.9)
    files = files_of("compass_ship", proposal)
    assert TURN in files["compass_ship.py"]
    # no course of a ship is unsafe
    assert "safe=(" not in files["compass_ship.py"]
    (tmp_path / "map.yaml").write_text(files["compass_ship_map.yaml"])
    sources = read_map(tmp_path / "map.yaml").sources
    assert sources["wind"].turn == 360.0
    # what the file says is said once
    assert sources["output"].turn == 0.0
    said = [note for note in proposal.notes if "begins again after 360" in note]
    assert [note.partition(" ")[0] for note in said] == ["output", "wind"]
    assert "turn=360 is written into its Output" in said[0]
    assert "turn=360 is written into its source in the map" in said[1]


def test_new_plant_for_several_outputs_writes_it_too(tmp_path: Path) -> None:
    written_course(tmp_path / "log.csv")
    entries = ["time=time", "output.1=heading", "output.2=wind", "input=rudder"]
    table = read_table(tmp_path / "log.csv")
    proposal = propose_several(table, parse_map(entries))
    assert [output.signal.turn for output in proposal.outputs] == [360.0, 360.0]
    assert files_of("two_angles", proposal)["two_angles.py"].count(TURN) == 2


def test_other_outputs_are_written_as_before(tmp_path: Path) -> None:
    headings, rudder = course()
    rows = [
        f"{k},{y:.1f},{u}"
        for k, (y, u) in enumerate(zip(headings, rudder, strict=True))
    ]
    (tmp_path / "log.csv").write_text("\n".join(["time,angle,volts", *rows]))
    proposal = propose(
        read_table(tmp_path / "log.csv"),
        parse_map(["time=time; unit=s", "output=angle", "input=volts"]),
    )
    text = files_of("plain_angle", proposal)["plain_angle.py"]
    assert "turn=" not in text
    assert "safe=(" in text


def test_check_plant_finds_an_angle_that_the_file_does_not_count(
    tmp_path: Path,
) -> None:
    path = tmp_path / "log.csv"
    written_course(path)
    uncounted = data_for(path, UncountedShip, parse_map(MAP))
    (finding,) = findings_of_angles(uncounted, UncountedShip)
    assert finding.what.startswith("heading begins again after 360, as an angle does")
    assert finding.todo == "write turn=360 in its Output: its turns are counted then"
    counted = data_for(path, Ship, parse_map(MAP))
    assert [*findings_of_angles(counted, Ship)] == []


@pytest.mark.parametrize("setting", ["turn=360", "interval=before", "missing=-1"])
def test_what_a_map_says_of_a_column_is_in_the_map_that_is_written(
    tmp_path: Path, setting: str
) -> None:
    source = parse_source("here", f"heading; {setting}")
    text = f"columns:\n  output: {written_source(source)}\n"
    (tmp_path / "map.yaml").write_text(text)
    assert read_map(tmp_path / "map.yaml").sources["output"] == source
