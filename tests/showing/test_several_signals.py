"""A plant with two loops on the terminal, as lines and as JSON: its signals by name, side by side."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from tests.showing.conftest import LIES_FROM
from tests.showing.test_terminal import last_screen, shown
from twinmatch import showing
from twinmatch.cli import main
from twinmatch.comparing import TrustLevel, statements_of
from twinmatch.description import Quantity
from twinmatch.health import EstimatedReading
from twinmatch.offline.judging import Judgement
from twinmatch.plants.records import description_of
from twinmatch.sessions import read_session, write_session
from twinmatch.sessions.metadata import PLANT
from twinmatch.showing.figures.drawing import cells_for
from twinmatch.showing.lines import line_text
from twinmatch.showing.page.panels import what_to_do
from twinmatch.showing.page.state import DashboardState
from twinmatch.showing.quantities import shown_outputs
from twinmatch.showing.summary import document, sentence
from twinmatch.showing.verdicts import estimate_words, missed, trust_by_signal

T1 = "temperature T1"
T2 = "temperature T2"
QUANTITY = Quantity("second", T2, "°C")


def test_the_summary_names_every_output(two: Judgement) -> None:
    assert two.summary.fits is not None
    first, second = two.summary.fits.outputs
    trusted = next(v for v in reversed(two.verdicts) if v.level is TrustLevel.TRUSTED)
    summed_up = sentence(replace(two.summary, trust=statements_of(trusted).trust))
    assert f"{T1} fit {100 * first:.1f} %, {T2} fit {100 * second:.1f} %" in summed_up
    assert f"°C of {T1}" in summed_up
    assert summed_up.endswith(f"Faults: sensor-drift of {T2} since {LIES_FROM} s.")
    written = json.loads(
        json.dumps(document(two.name, two.verdicts, two.summary, two.matches))
    )
    assert written["summary"]["fit"] == {"y": [first, second], "u": [None, None]}
    assert [score["signal"] for score in written["verdicts"][-1]["signals"]] == [
        "temperature",
        "second_temperature",
    ]


def test_the_page_says_of_which_output_the_levels_are(two: Judgement) -> None:
    """A verdict records levels of the first output; the page and the summary say so in the same words."""
    settings = two.settings
    state = DashboardState(described=description_of(settings.plant))
    for sample in two.samples:
        state.push_sample(sample, 0.0)
    for verdict in two.verdicts:
        state.push_verdict(replace(verdict, level=TrustLevel.TRUSTED, fault=""))
    levels = str(two.summary.range)
    assert levels.endswith(f"°C of {T1}")
    assert what_to_do(state).endswith(f"its forecasts have come true {levels}.")


def test_no_display_takes_the_first_of_several() -> None:
    """It would show a part as the whole; a single loop has `.output`, which several do not."""
    for path in Path(showing.__file__).parent.rglob("*.py"):
        firsts = re.findall(r"\.(?:references|outputs|inputs)\[0\]", path.read_text())
        assert firsts == [], path


def test_misses_are_those_of_the_signals_in_their_order(two: Judgement) -> None:
    last = two.verdicts[-1]
    outputs = shown_outputs(two.settings.plant)
    assert [signal.name for signal in outputs] == [T1, T2]
    assert last.misses == tuple(score.miss for score in last.signals)
    # recorded before verdicts had scores of signals: nothing may be said of a wrong signal
    assert replace(last, signals=()).misses == ()


def test_a_terminal_has_a_row_for_each_signal(two: Judgement) -> None:
    screen = last_screen(shown(two, 200, until=two.samples[-1].index))
    last = two.verdicts[-1]
    rows = trust_by_signal(last)
    assert [row["signal"] for row in rows] == [T1, T2]
    for row in rows:
        (line,) = (line for line in screen if line.startswith(row["signal"]))
        assert line.split() == " ".join(row.values()).split()
    text = "\n".join(screen)
    assert f"sensor-drift of {T2} since {last.fault_since} s" in text
    assert missed(last) in text
    assert missed(last).startswith(f"{T1} ")
    for candidate in last.candidates:  # none has models, so that all are listed
        assert candidate.name in text
    assert "gain" not in text


def test_lines_name_the_signal_of_a_fault(two: Judgement) -> None:
    assert f"sensor-drift of {T2}: " in line_text(two.verdicts[-1])
    assert "sensor-drift" not in line_text(
        next(v for v in reversed(two.verdicts) if not v.fault)
    )


@pytest.mark.parametrize(
    ("sample", "words"),
    [(500, "good for 10 min"), (1000, "good for 1.7 min"), (1100, "no longer good")],
)
def test_an_estimate_says_for_how_long_yet_it_is_good(sample: int, words: str) -> None:
    estimate = EstimatedReading(
        sample, "second", 41.27, 0.94, 46.3, since=500, wide=1.2, good=600.0
    )
    expected = (
        f"the twin reads through {T2}: 41.3 ± 0.9 °C instead of 46.3, to ± 1.2 {words}"
    )
    assert estimate_words(estimate, QUANTITY, 1.0) == expected
    assert estimate_words(
        replace(estimate, good=4200.0, sample=500), QUANTITY, 1.0
    ).endswith("an hour")


def test_four_signals_are_side_by_side_and_more_below() -> None:
    whole = Figure().add_gridspec(1, 1)[0, 0]
    assert cells_for(1, whole) == [whole]
    for number, shape in ((2, (1, 2)), (4, (1, 4)), (6, (2, 4))):
        cells = cells_for(number, whole)
        assert len(cells) == number
        assert {cell.get_gridspec().get_geometry() for cell in cells} == {shape}
        assert [cell.colspan.start for cell in cells] == [k % 4 for k in range(number)]


@pytest.fixture(scope="module")
def short(kit: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its first ten minutes."""
    folder = tmp_path_factory.mktemp("short") / "short"
    samples = read_session(kit).samples[:600]
    return write_session(folder, samples, records={PLANT: {"plant": "tclab-both"}})


def test_replay_shows_it_alone_and_in_a_table(
    short: Path, driven: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [str(short), "--config", str(driven)]
    wanted = tmp_path / "one.json"
    figure = tmp_path / "one.png"
    assert (
        main(["replay", *arguments, "--json", str(wanted), "--figure", str(figure)])
        == 0
    )
    assert f"; {T1} fit " in capsys.readouterr().out
    assert figure.read_bytes().startswith(b"\x89PNG")
    single_document = json.loads(wanted.read_text())
    many = tmp_path / "many.json"
    assert main(["replay", *arguments, "--jobs", "1", "--json", str(many)]) == 0
    table = capsys.readouterr().out
    table_document = json.loads(many.read_text())
    assert table_document["sessions"][0]["summary"] == single_document["summary"]
    rows = table_document["candidates"]
    assert [row["name"] for row in rows] == [
        c["name"] for c in single_document["verdicts"][-1]["candidates"]
    ]
    assert all(len(row["fit"]["y"]) == 2 and row["criteria"] is None for row in rows)
    assert f"fit {T1}" in " ".join(table.split())
    assert "gain" not in table
