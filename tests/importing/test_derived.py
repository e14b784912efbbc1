"""Columns that a map computes: the same text as beside a device gives the same numbers."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.plant_files import plant_file
from tests.support.processes import no_plant_files
from twinmatch.adding.written_files import written_source
from twinmatch.importing.column_map import read_map
from twinmatch.importing.derived import with_derived
from twinmatch.importing.mapped import (
    Mapped,
    map_samples,
    require_columns,
    with_plant_names,
)
from twinmatch.importing.tables import read_table
from twinmatch.plants import find_plant
from twinmatch.sampling.sources import SignalMap, parse_map
from twinmatch.sessions.files import RecordingError

TABLE = """t,T (°F),duty (%),mode,active,W,W_SF
0,68,10,H,1,80,-1
1,69.8,20,C,1,90,-1
2,-127,30,H,0,100,-1
3,71.6,40,unknown,1,110,-1
4,73.4,50,H,1,120,-1
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "log.csv"
    path.write_text(TABLE)
    return path


def mapped(path: Path, *entries: str) -> Mapped:
    """The samples with these entries, with those of the usual signals where they are missing."""
    usual = {"time": "t", "output": "T; missing=-127", "input": "active"}
    given = parse_map(entries).sources
    all_entries = [
        *entries,
        *(f"{name}={text}" for name, text in usual.items() if name not in given),
    ]
    table, signal_map = with_derived(read_table(path), parse_map(all_entries))
    with no_plant_files():
        plant = find_plant(str(plant_file(path.parent, "block_of_derived")))
        return map_samples(
            table, with_plant_names(table, plant, signal_map), plant, longest=3.0
        )


def test_marks_are_gaps_and_the_unit_of_the_title_stays(path: Path) -> None:
    outputs = [sample.output for sample in mapped(path).samples]
    assert outputs == pytest.approx([20.0, 21.0, 21.5, 22.0, 23.0])


def test_a_power_of_ten_in_another_column_counts(path: Path) -> None:
    samples = mapped(path, "input=w * 10**f; w=W; f=W_SF; unit=%").samples
    assert [sample.input for sample in samples] == pytest.approx(
        [8.0, 9.0, 9.0, 11.0, 12.0]
    )


def test_letters_beside_a_duty_give_its_sign_and_an_unknown_one_a_gap(
    path: Path,
) -> None:
    entry = "input=u * m / 10; u=duty; m=mode; H=1; C=0.5; scale=2"
    assert [sample.input for sample in mapped(path, entry).samples] == pytest.approx(
        [2.0, 2.0, 2.0, 2.0, 10.0]
    )


def test_a_command_counts_only_while_it_is_active(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(TABLE.replace("-127", "68"))
    samples = mapped(path, "input=u if a else 0; u=duty; a=active").samples
    assert [sample.input for sample in samples] == [10.0, 20.0, 0.0, 40.0, 50.0]


def test_a_rate_is_that_per_second_of_the_column_of_times(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(TABLE.replace("-127", "68"))
    assert [s.input for s in mapped(path, "input=rate(w); w=W").samples] == [10.0] * 4


def test_units_and_words_in_cells_are_those_of_devices(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,T,u\n0,68 °F,idle\n1,69.8 °F,heating\n2,71.6 °F,heat\n")
    samples = mapped(path, "output=T", "input=u; scale=50").samples
    assert [sample.output for sample in samples] == pytest.approx([20.0, 21.0, 22.0])
    assert [sample.input for sample in samples] == [0.0, 50.0, 50.0]


def test_two_units_in_a_column_stay_texts_and_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,T,active\n0,68 °F,0\n1,21 °C,1\n2,22 °C,1\n")
    with pytest.raises(
        RecordingError, match="line 3: 'T' is '21 °C', which is not a number"
    ):
        mapped(path, "output=T")


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("input=u * m; u=duty; m=mode; H=1", "line 3: 'C' is not a number"),
        ("input=u * m; u=duty; m=wibble", "wibble"),
        ("input=duty; per=2", "no cell of duty is 'per'"),
    ],
)
def test_what_cannot_be_computed_is_one_message(
    path: Path, entry: str, words: str
) -> None:
    with pytest.raises(RecordingError) as caught:
        mapped(path, entry)
    assert words in str(caught.value)


def test_a_map_that_was_written_to_a_file_computes_the_same(path: Path) -> None:
    entries = [
        "time=t",
        "output=T; missing=-127",
        "input=u * m; u=duty (%); m=mode; H=1; C=0.5; unit=1",
    ]
    _, derived = with_derived(read_table(path), parse_map(entries))
    lines = [
        f"  {signal}: {written_source(source)}"
        for signal, source in derived.sources.items()
    ]
    file = path.parent / "map.yaml"
    file.write_text("\n".join(["columns:", *lines]))
    table, again = with_derived(read_table(path), read_map(file))
    assert again == SignalMap(derived.sources)
    title = again.sources["input"].places[0]
    assert not table.unit(title)  # that of the duty is not that of the product
    assert list(table.columns[title][:3]) == [10.0, 10.0, 30.0]


def test_columns_of_words_are_named_with_what_to_map(tmp_path: Path) -> None:
    """HEAT and IDLE are numbers already; BOOST needs one."""
    path = tmp_path / "log.csv"
    path.write_text(
        "t,T,action,mode\n0,20,HEAT,BOOST\n1,21,IDLE,away\n2,22,HEAT,BOOST\n"
    )
    table = read_table(path)
    with pytest.raises(RecordingError) as caught:
        require_columns(table, parse_map(["time=t", "output=T"]))
    assert "no column is mapped to input" in str(caught.value)
    asked = "'mode' holds words (BOOST, away), and is mapped as 'SIGNAL=mode; BOOST=NUMBER; away=NUMBER'"
    assert asked in str(caught.value)
    assert [
        sample.input for sample in mapped(path, "output=T", "input=action").samples
    ] == [1.0, 0.0, 1.0]
    with_words = mapped(path, "output=T", "input=action; heat=1; idle=0").samples
    assert [sample.input for sample in with_words] == [1.0, 0.0, 1.0]
    with pytest.raises(RecordingError, match="'idle' is read as 0 in tables"):
        mapped(path, "output=T", "input=action; idle=2")
