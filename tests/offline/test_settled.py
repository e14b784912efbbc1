"""A reading that the twin refuses counts nowhere, also where only a verdict says by which twin: every door
settles a stream as the discriminator does."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import twinmatch
from tests.support import untaught
from tests.support.untaught import SPIKE, TAUGHT
from twinmatch.offline.backtest.run import LEADER, Choices, Listener, graded
from twinmatch.offline.judging import judge_samples
from twinmatch.showing.page.state import DashboardState, update_sentence
from twinmatch.showing.summary import sentence
from twinmatch.signals import Window
from twinmatch.twin import Mirror, Twin, filled_stretches, window_fit


def equal(a: Window, b: Window) -> bool:
    """Whether these are the same window, bit for bit."""
    same_samples = (a.first, a.lost) == (b.first, b.lost)
    return (
        same_samples
        and np.array_equal(a.output, b.output)
        and np.array_equal(a.input, b.input)
    )


def same_windows(windows: Sequence[Window], expected: Sequence[Window]) -> bool:
    """Whether these are the same windows, bit for bit."""
    return all(equal(a, b) for a, b in zip(windows, expected, strict=True))


def test_one_spike_changes_no_fit_and_no_stretch() -> None:
    """It was refused by the twin, and counted in every summary: a fit of 84.6 % where it is 98.5 %."""
    judgement = untaught.judged()
    assert [window.lost for window in judgement.stretches] == [[SPIKE]]
    without = Window.from_samples(untaught.clean())
    leader = judgement.summary.parameters
    assert leader is not None
    # One of 640 samples is left out of the fit; a spike of 40 °C would take 8 % from it.
    assert judgement.summary.fit_y == pytest.approx(
        window_fit(leader, without, None)[0], abs=1e-3
    )


@pytest.mark.parametrize(
    "lost", [(), range(TAUGHT - 1, TAUGHT + 2), (SPIKE - 1, SPIKE + 1)]
)
def test_every_door_settles_as_the_discriminator_did(lost: Sequence[int]) -> None:
    """Also where the sample of the first nominal twin is itself a stand-in."""
    samples = untaught.spiked(lost)
    settings = untaught.settings()
    judgement = (
        judge_samples("spiked", samples, settings) if lost else untaught.judged()
    )
    assert any(SPIKE in window.lost for window in judgement.stretches)
    assert same_windows(
        filled_stretches(samples, settings, judgement.verdicts), judgement.stretches
    )
    assert set(judgement.stamps) >= {verdict.sample for verdict in judgement.verdicts}


def test_the_page_says_what_the_terminal_says() -> None:
    judgement = untaught.judged()
    state = DashboardState()
    for sample in untaught.spiked():
        state.push_sample(sample, 0.0)
    for verdict in judgement.verdicts:
        state.push_verdict(verdict)
    update_sentence(state, untaught.settings())
    assert state.sentence == sentence(judgement.summary)


def test_forecasts_are_not_scored_at_a_refused_reading() -> None:
    samples = untaught.spiked()
    settings = untaught.settings()
    # forecasts are made at samples 9, 19, and so on: one of them ends at the spike
    horizon = 21
    listener = Listener(
        "spiked", settings, Choices(every=10.0, horizons=(float(horizon),))
    )
    judgement = judge_samples("spiked", samples, settings, beside=listener)
    tested = graded(judgement, listener)
    assert same_windows(tested.came, judgement.stretches)
    ends = {mark.sample + horizon for mark in tested.marked if mark.who == LEADER}
    assert {SPIKE - 10, SPIKE + 10} <= ends
    assert SPIKE not in ends
    errors = [
        mark.marks.error
        for mark in tested.marked
        if mark.who == LEADER and mark.sample > TAUGHT
    ]
    assert max(errors) < 10.0, "a spike of 40 °C in between counts nowhere"


def test_the_twin_beside_the_plant_is_not_compared_with_a_refused_reading() -> None:
    judgement = untaught.judged()
    settings = untaught.settings()
    mirror = Mirror(settings.start, None, period=1.0)
    assert judgement.summary.parameters is not None
    mirror.parameters = judgement.summary.parameters
    twin = Twin(settings)
    settled = [
        kept
        for sample in untaught.spiked()[: SPIKE + 1]
        for kept in twin.push(sample).settled
    ]
    states = [mirror.push(sample) for sample in settled]
    assert (states[-1].sample.seen, states[-1].sample.refused) == (
        False,
        (untaught.clean()[SPIKE].output + 40.0,),
    )
    assert states[-1].driven_rms_y == states[-2].driven_rms_y


WITHOUT_ENGINE = {
    "launching/live.py",
    "launching/replay.py",
    "nodes/twin.py",
    "showing/page/state.py",
}
"""Modules of processes that only receive samples, verdicts and leaders."""


def test_where_a_twin_runs_its_answer_is_taken() -> None:
    """Nothing else settles samples: two doors beside each other may differ."""
    folder = Path(twinmatch.__file__).parent
    settling = set()
    for path in folder.rglob("*.py"):
        text = path.read_text()
        if any(
            name in text
            for name in (
                "Door",
                "filled_stretches(",
                "GapFiller",
                "Refusals(",
            )
        ):
            settling.add(str(path.relative_to(folder)))
    rooms = {
        module for module in settling if not module.startswith(("twin/", "health/"))
    }
    assert rooms == WITHOUT_ENGINE
