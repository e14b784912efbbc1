"""The view of a run on a terminal, of a simulated session whose drive is lost."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Sequence

import pytest

from tests.support.steps import drive_lost
from twinmatch.offline.judging import Judgement, judge_samples
from twinmatch.offline.summary import nominal_score
from twinmatch.plants import Peltier
from twinmatch.showing.console import Console
from twinmatch.showing.family import FIGURES
from twinmatch.showing.lines import Lines
from twinmatch.showing.quantities import number, parameter_format
from twinmatch.showing.terminal import Screen
from twinmatch.showing.view import view_of
from twinmatch.twin import TwinSettings

LOST = 640
"""Sample at which the drive is lost."""
ESCAPE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


@pytest.fixture(scope="module")
def judged() -> Judgement:
    return judge_samples("drive_lost", drive_lost(LOST), TwinSettings())


def shown(
    judged: Judgement,
    width: int,
    height: int = 60,
    *,
    until: int = 720,
    period: float = 1.0,
    **options: object,
) -> str:
    """Everything that was written to a terminal of this size while the run continued and ended."""
    stream = io.StringIO()
    console = Console(
        file=stream, force_terminal=True, width=width, height=height, **options
    )  # type: ignore[arg-type]
    screen = Screen(console, judged.name, period, len(judged.samples))
    screen.open()
    tell(screen, judged, until)
    screen.close()
    screen.close()
    return stream.getvalue()


def tell(screen: Screen, judged: Judgement, until: int) -> None:
    for match in judged.matches:
        if match.sample <= until:
            screen.take_match(match)
    for verdict in judged.verdicts:
        if verdict.sample <= until:
            screen.take_verdict(verdict)
    screen.advance(until)


def last_screen(written: str) -> list[str]:
    """What stays: all after the last time the cursor went up to draw again."""
    return ESCAPE.sub("", re.split(r"\x1b\[1A\x1b\[2K", written)[-1]).splitlines()


def table_of(screen: Sequence[str]) -> dict[str, list[str]]:
    """The cells of every candidate, by its name; marks are left out."""
    rows = [re.sub("^[▶○]* *", "", line.strip()) for line in screen]
    of_candidates = [row for row in rows if re.match(r"\d+ °C  ", row)]
    table = {}
    for row in of_candidates:
        name, *cells = re.split(r" {2,}", row)
        table[name] = [cell.strip() for cell in cells]
    return table


def test_a_wide_terminal_shows_every_figure_of_every_candidate(
    judged: Judgement,
) -> None:
    screen = last_screen(shown(judged, 160, until=LOST - 1))
    verdict = next(v for v in reversed(judged.verdicts) if v.sample < LOST)
    table = table_of(screen)
    assert list(table) == [c.name for c in verdict.modelled]
    for score in verdict.modelled:
        total = next(o for o in score.orders if o.order == score.chosen_order).total
        assert table[score.name] == [
            number(score.operating_point, 1),
            *(
                parameter_format(Peltier, name).text(score.parameters[name])
                + ("*" if name in believed(judged, score.first) else "")
                for name in ("seebeck", "conductance", "heat_capacity")
            ),
            score.chosen_order,
            number(total.gain, 0),
            number(total.naic, 3),
            number(total.bic, 1),
            number(total.mdl, 4),
            number(score.nu_gap_sum, 3),
            *(column.text(score) for column in FIGURES[1:]),
        ]
    text = "\n".join(screen)
    for unit in ("mV/K", "W/K", "J/K", "characters", "°C²+PWM²"):
        assert unit in text
    assert re.search(rf"▶? ?○ {verdict.nominal}", text)
    assert f"{verdict.leader} (confidence " in text
    assert ", its forecasts save " in text


def believed(judged: Judgement, first: int) -> tuple[str, ...]:
    return next(m.match.believed for m in judged.matches if m.match.samples[0] == first)


def test_level_progress_fault_and_events_are_reported(judged: Judgement) -> None:
    written = shown(judged, 120, color_system="truecolor")
    text = " ".join(" ".join(last_screen(written)).split())
    assert "drive_lost" in text
    assert "100 %, 0:12:00 of 0:12:00 h" in text
    assert " FAULT " in text
    first_fault = next(v for v in judged.verdicts if v.fault)
    assert f"fault drive-lost since {first_fault.fault_since} s" in text
    assert f"{first_fault.sample} s ! fault: drive-lost" in text
    assert "match admitted: candidate 70 °C" in text
    assert f"{nominal_score(first_fault).name} is nominal" in text  # type: ignore[union-attr]
    assert f"{next(v.leader for v in judged.verdicts if v.leader)} leads" in text
    assert re.search(r"\x1b\[[0-9;]*31[0-9;]*m FAULT ", written)


def test_times_of_a_fast_plant_have_the_decimals_of_its_period(
    judged: Judgement,
) -> None:
    lines = last_screen(shown(judged, 120, period=0.01))
    text = " ".join(" ".join(lines).split())
    first_fault = next(v for v in judged.verdicts if v.fault)
    assert f"since {0.01 * first_fault.fault_since:.2f} s" in text
    assert f"{0.01 * first_fault.sample:.2f} s ! fault: drive-lost" in text
    newest = judged.verdicts[-1]
    assert f"at {0.01 * newest.sample:.2f} s: " in text


@pytest.mark.parametrize("width", [30, 60, 80, 100])
def test_no_line_is_wider_than_the_terminal_and_no_number_is_cut(
    judged: Judgement, width: int
) -> None:
    screen = last_screen(shown(judged, width))
    assert max(len(line.rstrip()) for line in screen) <= width
    wide = table_of(last_screen(shown(judged, 200)))
    narrow = table_of(screen)
    assert set(narrow) == set(wide)
    for score in judged.verdicts[-1].modelled:
        assert set(narrow[score.name]) <= set(wide[score.name])
        assert score.chosen_order in narrow[score.name]


def test_a_low_terminal_is_never_overfilled_while_the_run_continues(
    judged: Judgement,
) -> None:
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=True, width=80, height=24)
    screen = Screen(console, judged.name, 1.0, None)
    tell(screen, judged, len(judged.samples))
    drawn = console.render_lines(screen)
    assert len(drawn) < 24
    assert "fault: drive-lost" in "".join(s.text for line in drawn for s in line)


def test_what_was_drawn_can_be_wiped_away(judged: Judgement) -> None:
    stream = io.StringIO()
    screen = Screen(
        Console(file=stream, force_terminal=True, width=80, height=24), "run", 1.0, None
    )
    screen.open()
    tell(screen, judged, 300)
    screen.close(wipe=True)
    assert last_screen(stream.getvalue() + "after") == ["after"]


def test_a_run_that_fails_before_it_is_shown_ends_with_its_own_error() -> None:
    """It closes the view that it has not opened."""
    Screen(Console(file=io.StringIO(), force_terminal=True), "never opened").close()


def test_a_line_of_somebody_else_stands_above_the_view(judged: Judgement) -> None:
    stream = io.StringIO()
    screen = Screen(
        Console(file=stream, force_terminal=True, width=80, height=40), "run", 1.0, None
    )
    screen.open()
    tell(screen, judged, 300)
    screen.say("[twin] word", "red")
    screen.close()
    text = ESCAPE.sub("", stream.getvalue())
    assert "[twin] word" in text
    assert text.rindex("[twin] word") < text.rindex("plant time 0:05:00 h, 300 samples")


def test_only_a_terminal_gets_the_view(monkeypatch: pytest.MonkeyPatch) -> None:
    assert isinstance(view_of("run"), Lines)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    assert isinstance(view_of("run"), Screen)
    monkeypatch.setenv("TERM", "dumb")
    assert isinstance(view_of("run"), Lines)
