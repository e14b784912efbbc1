"""What is known at a sample of the samples after it: nothing."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.plants import Lag, Motor
from tests.support.steps import drive_lost
from twinmatch.dynamics import Sensor, begin, simulate_closed_loop
from twinmatch.forecasting import Forecast, ForecastError
from twinmatch.offline import judging, outlooks
from twinmatch.offline.judging import Judgement, Terms, judge_samples
from twinmatch.offline.outlooks import (
    Prospect,
    planned_ahead,
    prospects,
    recorded_ahead,
    samples_at,
)
from twinmatch.plants import Incubator, Peltier, TCLabBoth
from twinmatch.sessions import Session, read_session, samples_of, write_session
from twinmatch.signals import Sample, Window
from twinmatch.twin import TwinSettings

FIRST = 420
MIDDLE = 610
LAST = 640
"""Of the motor's samples: the second is two after a step, in the middle of a transient."""


def motor_samples() -> list[Sample]:
    """Forty seconds of a motor under a measured load that changes from sample to sample."""
    truth = Motor.model("without friction").parameters(k=0.06, j=5e-4, b=2e-4)
    reference = np.repeat([50.0, 150.0, 90.0, -60.0], [200, 200, 208, 192])
    load = 0.02 * np.sin(np.arange(reference.size) / 31.0)[:, None]
    sensor = Sensor(noise=0.2).realise(reference.size, 0.05, 3)
    run = simulate_closed_loop(
        truth,
        reference,
        states=begin(truth, 0.0),
        law=Motor.loop,
        sensor=sensor,
        disturbances=load,
    )
    return [
        Sample(k, k * 50_000_000, float(r), float(y), float(u), (float(d),))
        for k, (r, y, u, d) in enumerate(
            zip(reference, run.output, run.input, load[:, 0], strict=True)
        )
    ]


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    return motor_samples()


@pytest.fixture(scope="module")
def session(samples: list[Sample], tmp_path_factory: pytest.TempPathFactory) -> Session:
    return stored(samples, tmp_path_factory.mktemp("motor") / "whole")


@pytest.fixture(scope="module")
def prospect_of_sample(session: Session) -> dict[int, Prospect]:
    return prospects(session, TERMS, [LAST, FIRST, MIDDLE])


TERMS = Terms(TwinSettings.of(Motor, period=0.05))


def stored(samples: list[Sample], folder: Path) -> Session:
    return read_session(write_session(folder, samples))


def numbers(forecast: Forecast) -> list[np.ndarray]:
    bands = (forecast.output, forecast.input)
    return [
        forecast.time,
        *(v for band in bands for v in (band.mean, band.low, band.high)),
    ]


def assert_same(forecast: Forecast, expected: Forecast) -> None:
    """To the last bit."""
    for name in ("sample", "candidate", "structure", "notes"):
        assert getattr(forecast, name) == getattr(expected, name)
    np.testing.assert_array_equal(numbers(forecast), numbers(expected))


@pytest.mark.parametrize("sample", [FIRST, MIDDLE])
def test_a_session_that_ends_there_gives_the_same_bits(
    sample: int,
    samples: list[Sample],
    prospect_of_sample: dict[int, Prospect],
    tmp_path: Path,
) -> None:
    ahead = np.linspace(100.0, 60.0, 100)
    cut = stored(samples[: sample + 1], tmp_path / "cut")
    alone = prospects(cut, TERMS, [sample])[sample]
    assert alone.leader == prospect_of_sample[sample].leader
    assert alone.leader_confidence == prospect_of_sample[sample].leader_confidence
    assert_same(
        alone.outlook.forecast(ahead),
        prospect_of_sample[sample].outlook.forecast(ahead),
    )


def test_a_cut_session_gives_the_same_bits_for_every_candidate(
    samples: list[Sample], session: Session, tmp_path: Path
) -> None:
    cut = stored(samples[: MIDDLE + 1], tmp_path / "cut")
    for name in ("with friction", "90 rad/s"):
        whole = prospects(session, TERMS, [MIDDLE, LAST], candidate=name)[MIDDLE]
        alone = prospects(cut, TERMS, [MIDDLE], candidate=name)[MIDDLE]
        assert whole.outlook.candidate == name
        assert whole.leads == (name == whole.leader)
        assert_same(
            alone.outlook.forecast([90.0] * 50), whole.outlook.forecast([90.0] * 50)
        )


def test_of_a_long_session_the_newest_windows_are_enough(
    samples: list[Sample],
    session: Session,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A session that begins there gives the same bits, and has no note."""
    monkeypatch.setattr(outlooks, "_WINDOWS", 1)
    asked_at = 790
    # The match on the step at sample 400 is in the first half.
    since = asked_at - TERMS.settings.schedule.capacity
    newest = prospects(session, TERMS, [asked_at])[asked_at]
    cut_session = stored(samples[since : asked_at + 1], tmp_path / "cut")
    cut = prospects(cut_session, TERMS, [asked_at], whole=True)[asked_at]
    assert (newest.since, cut.since) == (since, None)
    [note] = set(newest.outlook.notes) - set(cut.outlook.notes)
    assert f"from {since} on" in note
    newest_forecast, cut_forecast = (
        prospect.outlook.forecast([90.0] * 50) for prospect in (newest, cut)
    )
    np.testing.assert_array_equal(numbers(newest_forecast), numbers(cut_forecast))
    assert newest.leader_confidence == cut.leader_confidence


def test_it_begins_earlier_if_nothing_is_known_there(
    session: Session,
    prospect_of_sample: dict[int, Prospect],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The window before this sample begins just behind a step, and the next match is in its second half."""
    monkeypatch.setattr(outlooks, "_WINDOWS", 1)
    prospect = prospects(session, TERMS, [LAST])[LAST]
    assert prospect.since is None
    assert_same(
        prospect.outlook.forecast([90.0] * 50),
        prospect_of_sample[LAST].outlook.forecast([90.0] * 50),
    )


def test_what_disturbs_the_plant_is_held(
    session: Session, prospect_of_sample: dict[int, Prospect]
) -> None:
    outlook = prospect_of_sample[MIDDLE].outlook
    ahead = np.full(40, 90.0)
    sample = session.samples[MIDDLE]
    held_forecast = outlook.predicted(ahead, np.tile(sample.disturbances, (41, 1)))
    np.testing.assert_array_equal(
        outlook.forecast(ahead).output.mean, held_forecast.means[0]
    )
    loaded = outlook.predicted(ahead, np.tile(sample.disturbances, (41, 1)) + 0.05)
    # the load matters
    assert np.abs(loaded.means[0] - held_forecast.means[0]).max() > 1.0


def test_the_band_covers_the_measurements(
    session: Session, prospect_of_sample: dict[int, Prospect]
) -> None:
    """The load keeps changing, slowly; within two seconds it moves the speed by less than its noise."""
    reference = [s.reference for s in session.samples[LAST + 1 : LAST + 41]]
    forecast = prospect_of_sample[LAST].outlook.forecast(reference)
    came = np.array([s.output for s in session.samples[LAST + 1 : LAST + 41]])
    is_inside = (forecast.output.low <= came) & (came <= forecast.output.high)
    # Of 40 readings each held with probability 0.9, fewer than 28 come once in 5000 times.
    assert is_inside.sum() >= 28


@pytest.mark.parametrize(
    ("asked_samples", "words"),
    [
        ([FIRST, 5], ["no candidate at sample 5", "from sample"]),
        ([800], ["has no sample 800", "0 to 799"]),
        ([-1], ["has no sample -1"]),
    ],
)
def test_samples_without_an_outlook_are_named(
    session: Session, asked_samples: list[int], words: list[str]
) -> None:
    with pytest.raises(ForecastError) as caught:
        prospects(session, TERMS, asked_samples)
    assert all(word in str(caught.value) for word in words)


def test_the_first_sample_that_is_named_has_a_candidate(session: Session) -> None:
    with pytest.raises(ForecastError, match="no candidate at sample 10") as caught:
        prospects(session, TERMS, [10])
    first = int(str(caught.value).split("from sample ")[1].split(" ")[0])
    assert prospects(session, TERMS, [first])[first].leads
    with pytest.raises(ForecastError, match=f"from sample {first} on"):
        prospects(session, TERMS, [first - 1])


def test_an_unknown_candidate_is_answered_with_the_known_ones(session: Session) -> None:
    with pytest.raises(
        ForecastError, match=rf"sample {MIDDLE}: .*'nobody'; there are: .*150 rad/s"
    ):
        prospects(session, TERMS, [MIDDLE], candidate="nobody")


def still(samples: int, folder: Path) -> Session:
    level = np.full(samples, 30.0)
    return stored(samples_of(Window(level, level, level / 2)), folder)


def test_a_sample_that_is_missing_is_named(tmp_path: Path) -> None:
    session = still(60, tmp_path / "gap")
    session = replace(session, samples=[s for s in session.samples if s.index != 31])
    with pytest.raises(
        ForecastError, match=r"has no sample 31 .* it has 0 to 59 without that one"
    ):
        samples_at(session, [31])


def test_a_session_without_any_candidate_says_so(tmp_path: Path) -> None:
    session = still(200, tmp_path / "still")
    with pytest.raises(ForecastError, match="or later, since no match was accepted"):
        prospects(session, Terms(TwinSettings()), [150])


def test_a_fault_is_in_the_notes(tmp_path: Path) -> None:
    session = stored(drive_lost(at=640), tmp_path / "fault")
    prospect_at = prospects(session, Terms(TwinSettings()), [630, 700])
    assert not [n for n in prospect_at[630].outlook.notes if "drive-lost" in n]
    assert [
        n
        for n in prospect_at[700].outlook.notes
        if "has shown drive-lost since sample 6" in n
    ]


# The rehearsal reaches everything that a first run would otherwise compile, and happens once.


def test_a_rehearsal_matches_judges_and_forecasts_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged: list[Judgement] = []

    def judge(*args: Any, **settings: Any) -> Judgement:
        judged.append(judge_samples(*args, **settings))
        return judged[-1]

    monkeypatch.setattr(judging, "cache_folder", lambda: tmp_path / "cache")
    monkeypatch.setattr(judging, "judge_samples", judge)
    for _ in range(2):
        judging.rehearse(Peltier, TwinSettings(), lambda _done, _total: None)
    (only,) = judged
    last = only.verdicts[-1]
    assert any(report.match.accepted for report in only.matches)
    assert len(last.candidates) >= 2
    assert last.nu_gap
    assert last.forecasts


def test_a_plant_needs_no_loop() -> None:
    """It is judged under its inputs, and every structure has its parameters."""
    assert Lag.loop is None
    assert Lag.model().parameters()["lag"] == 5.0
    level = np.full(30, 20.0)
    judged = judge_samples(
        "still", samples_of(Window(level, level, level)), TwinSettings.of(Lag)
    )
    assert judged.settings.law is None
    assert not judged.summary.closed


def test_a_plant_without_a_loop_is_not_rehearsed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(judging, "cache_folder", lambda: tmp_path)
    judging.rehearse(Incubator, TwinSettings(), lambda _done, _total: None)
    assert not list(tmp_path.iterdir())


def test_several_inputs_ahead_are_held_given_or_recorded(tmp_path: Path) -> None:
    settings = TwinSettings.of(TCLabBoth, law=None)
    samples = [
        Sample(k, k * 10**9, (0.0, 0.0), (40.0, 35.0), (20.0 + k, 45.0))
        for k in range(20)
    ]
    planned = partial(planned_ahead, samples[9], 3, settings=settings)
    standing = planned(reference=None, hold=(), rows=None)
    assert standing.values.tolist() == [[29.0, 45.0]] * 3
    assert standing.words == "its inputs of 29 %, 45 % held"
    given = planned(reference=None, hold=(10.0, 80.0), rows=None)
    assert given.values.tolist() == [[10.0, 80.0]] * 3
    with pytest.raises(
        ForecastError, match="--hold: 1 of the plant's 2 inputs; give it once for each"
    ):
        planned(reference=None, hold=(10.0,), rows=None)
    with pytest.raises(
        ForecastError,
        match=r"ahead.csv: the plant has 2 inputs, and this file has those of",
    ):
        planned(reference="ahead.csv", hold=(), rows=["0,10"])
    settled = (Window.from_samples(samples),)
    recorded = recorded_ahead(
        stored(samples, tmp_path / "kit"), samples[9], 3, settled, settings
    )
    assert recorded.values.tolist() == [[30.0, 45.0], [31.0, 45.0], [32.0, 45.0]]
