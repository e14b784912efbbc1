"""A run may last for weeks: what sees every sample and every verdict keeps no more for it."""

from __future__ import annotations

import io
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rich.console import Console

from tests.support import faulty_rig
from twinmatch.comparing import Verdict
from twinmatch.health import Monitor
from twinmatch.launching.live import Live
from twinmatch.launching.plan import LivePlan
from twinmatch.offline.judging import judge, terms_from_files
from twinmatch.offline.summary import Tally, conclude, summarise
from twinmatch.sessions import Recording, open_any, read_session
from twinmatch.sessions.messages import SAMPLE, encode_sample
from twinmatch.showing.terminal import MOST_EVENTS, Screen
from twinmatch.showing.verdicts import events
from twinmatch.signals import Sample

SESSION = Path(__file__).resolve().parents[2] / "bags" / "four_setpoints"


def growth(step: Callable[[int], object], warm: int, count: int) -> int:
    """Bytes that are held after `count` more steps, and were not before them."""
    tracemalloc.start()
    try:
        for k in range(warm):
            step(k)
        before = tracemalloc.get_traced_memory()[0]
        for k in range(warm, warm + count):
            step(k)
        return tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()


@pytest.fixture(scope="module")
def judged() -> tuple[list[Sample], list[Verdict]]:
    found = judge(session := open_any(SESSION), terms_from_files(session))
    return list(found.samples), list(found.verdicts)


def test_the_launcher_keeps_no_samples_in_memory() -> None:
    live = Live(LivePlan(Path("rig.yaml")))
    assert growth(lambda k: live.take_sample(Sample(k, k, 1.0, 2.0, 3.0)), 1000, 20_000) < 20_000
    assert len(live.samples) == 21_000
    live.samples.close()


def test_the_monitor_keeps_no_samples() -> None:
    samples, _ = faulty_rig.run(np.tile(np.repeat([40.0, 60.0], 400), 6), None, seed=2)
    monitor = Monitor()
    assert growth(lambda k: monitor.push(samples[k]), 2400, 2400) < 100_000


def test_a_recording_keeps_nothing_of_what_it_has_written(tmp_path: Path) -> None:
    """Brought to the disk every 0.4 s, it has 200,000 chunks a day; finishing it writes the index of all."""
    recording = Recording(tmp_path / "long")
    recording.add_topic(SAMPLE)

    def step(k: int) -> None:
        recording.write(SAMPLE.name, encode_sample(Sample(k, k * 10**9, 1.0, 2.0, 3.0)), k * 10**9)
        recording.flush()

    assert growth(step, 100, 400) < 20_000
    recording.close()
    with (tmp_path / "long" / "long_0.mcap").open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert [index.message_start_time // 10**9 for index in summary.chunk_indexes] == list(range(500))
    assert len(read_session(tmp_path / "long").samples) == 500


def test_the_view_keeps_what_it_shows(judged: tuple[list[Sample], list[Verdict]]) -> None:
    _, verdicts = judged
    screen = Screen(Console(file=io.StringIO()), "live")
    many = [replace(v, sample=v.sample + 10_000 * k) for k in range(20) for v in verdicts]
    assert growth(lambda k: screen.take_verdict(many[k]), len(many) // 2, len(many) // 2) < 20_000
    assert list(screen._events) == events(many)[-MOST_EVENTS:]


def test_the_figures_of_the_end_are_those_of_all_samples_and_verdicts(
    judged: tuple[list[Sample], list[Verdict]],
) -> None:
    samples, verdicts = judged
    holed = [s for s in samples if s.index not in (300, 301, 900)]
    gains = None
    for given in (samples, holed):
        live = Live(LivePlan(Path("rig.yaml")))
        for sample in given:
            live.take_sample(sample)
        for verdict in verdicts:
            live.verdicts.push(verdict)
        found, expected = conclude(live.verdicts, live.longest, gains), summarise(given, verdicts, gains)
        assert repr(found) == repr(expected)  # which makes nan equal to nan
        live.samples.close()
    assert conclude(Tally(), lambda _: pytest.fail("nobody to hold it against"), gains).verdicts == 0
