"""Angles that begin again after a turn are counted on, alike from tables, bags and beside a running plant."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.compass import Ship, UncountedShip, course, written_course
from twinmatch.dynamics import Output, PlantError
from twinmatch.health import HealthSettings, Refusals
from twinmatch.importing.derived import with_derived
from twinmatch.importing.mapped import Mapped, map_samples
from twinmatch.importing.resampling import Gaps
from twinmatch.importing.tables import read_table
from twinmatch.parameters.candidates import parse_candidates
from twinmatch.plants import find_plant
from twinmatch.sampling.channels import SamplingError
from twinmatch.sampling.names import turns_of
from twinmatch.sampling.sampler import Limits, Sampler
from twinmatch.sampling.sources import SignalSource, parse_map, parse_source
from twinmatch.sampling.turns import (
    TurnCounter,
    all_beside,
    beside,
    counted_on,
    shown_turn,
    uncertain_gaps,
)
from twinmatch.sessions.files import RecordingError
from twinmatch.signals import Sample

SECOND = 1_000_000_000
MAP = [
    "time=time",
    "output=heading",
    "reference=set",
    "input=rudder",
    "wind=wind; turn=360",
]


def imported(
    path: Path,
    entries: list[str] | None = None,
    *,
    plant: type[Ship] = Ship,
    gaps: Gaps = "refuse",
) -> Mapped:
    table, signal_map = with_derived(read_table(path), parse_map(entries or MAP))
    return map_samples(table, signal_map, plant, gaps=gaps)


@given(st.lists(st.floats(-170.0, 170.0), min_size=1, max_size=50), st.floats(0, 360))
def test_a_plant_that_moves_less_than_half_a_turn_is_followed(
    steps: list[float], begin: float
) -> None:
    truth = begin + np.cumsum(steps)
    counted = counted_on(truth % 360.0, 360.0)
    counter = TurnCounter(360.0)
    assert [counter.counted(reading) for reading in truth % 360.0] == counted.tolist()
    assert np.ptp(counted - truth) == pytest.approx(0.0, abs=1e-9)
    assert counted[0] == truth[0] % 360.0


def test_no_reading_ends_no_count() -> None:
    readings = [359.0, math.nan, 1.0, math.inf, 2.0]
    counter = TurnCounter(360.0)
    counted = [359.0, math.nan, 361.0, math.inf, 362.0]
    assert [counter.counted(reading) for reading in readings] == pytest.approx(
        counted, nan_ok=True
    )
    assert counted_on(np.array(readings), 360.0) == pytest.approx(counted, nan_ok=True)
    assert counted_on(np.array([math.nan]), 360.0) == pytest.approx(
        [math.nan], nan_ok=True
    )


def test_a_set_point_is_that_of_the_shorter_way() -> None:
    assert beside(10.0, 350.0, 360.0) == 370.0
    assert beside(350.0, 730.0, 360.0) == 710.0
    set_points = np.array([10.0, 350.0, math.nan])
    assert all_beside(set_points, np.array([350.0, 730.0, 1.0]), 360.0) == (
        pytest.approx([370.0, 710.0, math.nan], nan_ok=True)
    )


def test_angles_are_recognised_by_their_unit_or_name_and_by_their_jumps() -> None:
    headings = course()[0] % 360.0
    signed = (headings + 180.0) % 360.0 - 180.0
    assert shown_turn(headings, "deg", "psi") == 360.0
    assert shown_turn(signed, "", "Heading") == 360.0
    assert shown_turn(np.radians(signed), "rad", "psi") == pytest.approx(2 * math.pi)
    # of another unit, without jumps, or of a narrower range
    assert shown_turn(headings, "°C", "heading") == 0.0
    assert shown_turn(headings, "", "level") == 0.0
    assert shown_turn(course()[0], "deg", "psi") == 0.0
    assert shown_turn(0.5 * headings, "deg", "psi") == 0.0
    # a valve that is switched from one end to the other, and the middle
    switched = np.tile([0.0, 360.0, 120.0], 40)
    assert shown_turn(switched, "deg", "angle") == 0.0
    assert shown_turn(np.array([]), "deg", "angle") == 0.0


def test_a_table_gives_the_course_that_was_steered(tmp_path: Path) -> None:
    headings = written_course(tmp_path / "log.csv")
    run = imported(tmp_path / "log.csv")
    assert [sample.output for sample in run.samples] == pytest.approx(headings)
    assert np.ptp(headings) > 180.0
    assert headings.max() > 370.0
    references = [sample.reference for sample in run.samples]
    assert references == pytest.approx(headings + 170.0)
    assert [s.disturbances[0] for s in run.samples] == list(range(0, 1200, 2))
    # the map says it of a file that does not
    entries = [*MAP[:1], "output=heading; turn=360", *MAP[2:]]
    narrow = pytest.raises(RecordingError, match="beyond the span of its output")
    with narrow:
        imported(tmp_path / "log.csv", entries, plant=UncountedShip)
    wide = type(
        "Wide",
        (UncountedShip,),
        {"heading": replace(UncountedShip.heading, span=(-999.0, 999.0))},
        name="ship-of-wide-span",
    )
    assert imported(tmp_path / "log.csv", entries, plant=wide).samples == run.samples


def test_what_begins_again_is_said_where_nobody_has_said_so(tmp_path: Path) -> None:
    written_course(tmp_path / "log.csv")
    entries = [*MAP[:-1], "wind=wind"]
    notes = imported(tmp_path / "log.csv", entries, plant=UncountedShip).notes
    ways = "write turn=360 in the plant file's Output, or 'output=COLUMN; turn=360'"
    assert [ways in note for note in notes if note.startswith("output begins")] == [
        True
    ]
    assert [note for note in notes if note.startswith("wind begins again after 360")]
    assert not [
        note for note in imported(tmp_path / "log.csv").notes if "begins" in note
    ]


@pytest.mark.parametrize(("left_out", "is_said"), [(4, False), (290, True)])
def test_a_gap_that_may_hide_more_than_half_a_turn_is_said(
    tmp_path: Path, left_out: int, *, is_said: bool
) -> None:
    written_course(tmp_path / "log.csv", left_out=range(50, 50 + left_out))
    notes = imported(tmp_path / "log.csv", gaps="split").notes
    said = [note for note in notes if "output may have moved" in note]
    assert len(said) == is_said
    for note in said:
        assert "more than half a turn in the 291 s behind line 51, " in note
        assert "the shorter way is taken" in note


def test_no_rate_says_how_far_a_plant_moves_in_gaps_alone() -> None:
    seconds = np.array([0.0, 100.0])
    assert uncertain_gaps(seconds, np.array([0.0, 90.0]), 360.0, [0]) == []


def test_the_mean_of_two_angles_is_refused(tmp_path: Path) -> None:
    written_course(tmp_path / "log.csv")
    entries = ["time=time", "output=heading, set", "input=rudder"]
    with pytest.raises(RecordingError, match="the mean of 359 and 1 would be 180"):
        imported(tmp_path / "log.csv", entries)
    several = {"output": SignalSource(("/a:x, /b:x",))}
    with pytest.raises(SamplingError, match="output begins again after 360, and is"):
        turns_of(Ship, several)
    formula = parse_source("here", "a - b; a=/a:x; b=/b:x")
    assert turns_of(Ship, {"output": formula}) == {"output": 360.0}


def test_a_map_says_the_turn_and_is_written_as_it_was_read(tmp_path: Path) -> None:
    source = parse_source("here", "yaw; unit=rad; turn=6.28318530718")
    assert source.turn == 6.28318530718
    assert parse_source("here", source.text) == source
    with pytest.raises(
        RecordingError, match="turn is -360; give what the signal loses"
    ):
        parse_source("here", "yaw; turn=-360")
    # the map comes before the file, and a set-point has the turn of its output
    sources = parse_map(["output=a; turn=400", "reference=b; turn=7", "wind=c"]).sources
    assert turns_of(Ship, sources) == {"output": 400.0, "reference": 400.0}
    assert turns_of(UncountedShip, parse_map(["reference=b; turn=7"]).sources) == {}
    # of a formula, too
    written_course(tmp_path / "log.csv")
    formula = [MAP[0], "output=a + b - b; a=heading; b=wind", *MAP[2:]]
    run = imported(tmp_path / "log.csv", formula)
    assert [s.output for s in run.samples] == pytest.approx(course()[0])


def test_beside_a_running_ship_the_samples_are_those_of_its_table(
    tmp_path: Path,
) -> None:
    written_course(tmp_path / "log.csv")
    turns = turns_of(Ship, parse_map(MAP).sources)
    signals = dict.fromkeys(("reference", "output", "input", "wind"), Limits())
    sampler = Sampler(signals, 1.0, "output", disturbances={"wind": 0.0}, turns=turns)
    samples: list[Sample] = []
    headings, rudder = course()
    for k, (heading, angle) in enumerate(zip(headings, rudder, strict=True)):
        now = k * SECOND
        values = {
            "wind": float((2 * k) % 360),
            "input": float(angle),
            "reference": float(f"{(heading + 170.0) % 360.0:.1f}"),
            "output": float(f"{heading % 360.0:.1f}"),
        }
        for name, value in values.items():
            sampler.take(name, value, now, now)
        samples += sampler.collect(now + SECOND // 2)
    samples += sampler.collect(601 * SECOND)
    of_table = imported(tmp_path / "log.csv").samples
    assert len(samples) >= 599
    for live, read in zip(samples, of_table, strict=False):
        assert live.outputs == read.outputs
        assert live.references == read.references
        assert live.disturbances == read.disturbances


def test_counted_turns_are_not_beyond_the_span() -> None:
    assert UncountedShip.heading.readable == UncountedShip.heading.span
    low, high = Ship.heading.readable
    assert low < -1e9 < 1e9 < high
    settings = HealthSettings(reference=Ship.model().parameters(), period=1.0)
    refusals = Refusals(settings, 3)
    far = Sample(0, 0, (0.0,), (7200.0,), (0.0,), (0.0,))
    assert refusals.settle(far).refused == ()


@pytest.mark.parametrize(
    ("plant", "is_refused"), [(Ship, False), (UncountedShip, True)]
)
def test_no_counted_reading_is_one_that_the_ship_cannot_have_reached(
    tmp_path: Path, plant: type[Ship], *, is_refused: bool
) -> None:
    """Where turns are not counted, the way from 359.9° to 0.4° is that of a sensor that fails."""
    written_course(tmp_path / "log.csv")
    run = imported(tmp_path / "log.csv", [*MAP[:2], *MAP[3:]], plant=plant)
    twin = plant.model().parameters()
    refusals = Refusals(HealthSettings(reference=twin, period=1.0), 3)
    refusals.know(twin)
    settled = [refusals.settle(sample) for sample in run.samples]
    assert any(sample.refused for sample in settled) == is_refused


def test_a_candidate_is_remembered_with_the_turns_that_were_counted(
    tmp_path: Path,
) -> None:
    lines = (
        "from tests.support.compass import Ship",
        'class RememberedShip(Ship, name="remembered_ship"):',
        '    title = "Ship"',
    )
    path = tmp_path / "remembered_ship.py"
    path.write_text("\n".join(lines) + "\n")
    entry = (
        f"{{name: a, plant: {path}, structure: first order, gain: 0.1, lag: 9.0, "
        "operating_point: 7200.0}"
    )
    (candidate,) = parse_candidates(f"candidates: [{entry}]", "file", find_plant)
    assert candidate.operating_point == 7200.0


@pytest.mark.parametrize("turn", [-360.0, math.inf, math.nan])
def test_a_turn_is_a_positive_number(turn: float) -> None:
    with pytest.raises(PlantError, match="turn of the output is"):
        Output(unit="deg", noise=0.1, span=(0.0, 360.0), turn=turn)
