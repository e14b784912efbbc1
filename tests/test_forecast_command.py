"""`twinmatch forecast` as a user meets it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.places import SHIPPED
from tests.support.steps import quarter_of_an_hour
from twinmatch.cli import main
from twinmatch.sessions import read_session, write_session
from twinmatch.signals import Sample

AT = 700
"""In the middle of a transient: the set-point went from 60 to 45 °C at sample 660."""


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    return quarter_of_an_hour()


@pytest.fixture(scope="module")
def session(samples: list[Sample], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_session(tmp_path_factory.mktemp("forecast") / "quarter", samples)


def asked(session: Path, out: Path, *options: object) -> list[dict[str, Any]]:
    assert main(["forecast", str(session), "--json", str(out), *map(str, options)]) == 0
    found: list[dict[str, Any]] = json.loads(out.read_text(encoding="utf-8"))
    return found


def test_the_json_is_a_list_in_the_order_that_was_asked_for(session: Path, tmp_path: Path) -> None:
    found = asked(session, tmp_path / "out.json", "--at", AT, 500, "--at", AT, "--horizon", 60)
    assert [f["sample"] for f in found] == [AT, 500, AT]
    assert found[0] == found[2]
    for one in found:
        assert set(one) == {
            *("sample", "candidate", "structure", "confidence", "t", "y", "u", "reference", "notes"),
        }
        assert one["confidence"] == 0.9
        assert one["t"] == [float(k) for k in range(1, 61)]
        for signal in ("y", "u"):
            assert set(one[signal]) == {"mean", "low", "high"}
            low, mean, high = (np.array(one[signal][edge]) for edge in ("low", "mean", "high"))
            assert low.size == 60
            assert np.all(low <= mean)
            assert np.all(mean <= high)
    assert found[1]["reference"] == [60.0] * 60  # held as it was
    assert found[0]["reference"] == [45.0] * 60


def test_nothing_later_than_the_sample_is_known(samples: list[Sample], session: Path, tmp_path: Path) -> None:
    whole = asked(session, tmp_path / "whole.json", "--at", AT, 900, "--hold", 70)[0]
    cut = write_session(tmp_path / "cut", samples[: AT + 1])
    alone = asked(cut, tmp_path / "cut.json", "--at", AT, "--hold", 70)[0]
    assert alone == whole  # JSON gives every float64 back


def test_the_recorded_set_points_are_all_it_knows(
    samples: list[Sample], session: Path, tmp_path: Path
) -> None:
    told = asked(session, tmp_path / "told.json", "--at", 600, "--reference", "recorded", "--horizon", 120)[0]
    assert told["reference"] == [60.0] * 59 + [45.0] * 61
    rows = "\n".join(f"{k - 600},{samples[k].reference}" for k in range(601, 721))
    (tmp_path / "ahead.csv").write_text(f"time,set-point\n{rows}\n", encoding="utf-8")
    cut = write_session(tmp_path / "cut", samples[:601])
    alone = asked(
        cut, tmp_path / "cut.json", "--at", 600, "--reference", tmp_path / "ahead.csv", "--horizon", 120
    )[0]
    assert alone == told


def test_recorded_set_points_end_with_the_session(session: Path, tmp_path: Path) -> None:
    found = asked(session, tmp_path / "out.json", "--at", 900, "--reference", "recorded")[0]
    assert len(found["t"]) == 19
    assert "shortened to 19 s: the session ends there" in found["notes"]


def test_another_candidate_may_be_asked(session: Path, tmp_path: Path, capsys: Any) -> None:
    leader = asked(session, tmp_path / "a.json", "--at", AT, "--horizon", 20)[0]
    found = asked(session, tmp_path / "b.json", "--at", AT, "--candidate", "60 °C", "--horizon", 20)[0]
    assert leader["candidate"] != found["candidate"] == "60 °C"
    assert f"the leader is {leader['candidate']}" in capsys.readouterr().out


def test_what_was_never_visited_is_noted(session: Path, tmp_path: Path, capsys: Any) -> None:
    found = asked(session, tmp_path / "out.json", "--at", AT, "--hold", 88)[0]
    assert any("was visited" in note for note in found["notes"])
    assert "Note: the forecast covers " in capsys.readouterr().out
    assert not asked(session, tmp_path / "out.json", "--at", AT, "--hold", 50)[0]["notes"]


def test_the_answer_is_printed_as_sentences(session: Path, tmp_path: Path, capsys: Any) -> None:
    picture = tmp_path / "fan.png"
    assert main(["forecast", str(session), "--at", "500", "--hold", "80", "--figure", str(picture)]) == 0
    said = capsys.readouterr().out
    for words in (
        "At 500 s (sample 500), 80 °C held:",
        "forecasts 300 s; the leader (confidence 0.",
        "temperature after 300 s: 80.",
        "within 1 °C of 80 °C: first after ",
        "largest control: 255 PWM after 1 s",
        "at 10 s; ",
        "at 60 s; ",
        "at 300 s",
        "The leader is the candidate to forecast with",
    ):
        assert words in said
    assert "compared with" not in said  # the session continued under other set-points
    assert picture.stat().st_size > 10_000


def test_it_is_compared_with_the_measurements(session: Path, capsys: Any) -> None:
    assert main(["forecast", str(session), "--at", "600"]) == 0
    assert (
        "compared with the next 59 s of measurements, under the same set-points: error 0."
        in capsys.readouterr().out
    )


def test_the_shipped_session_is_forecast_within_its_bands(tmp_path: Path) -> None:
    """Its generator is the paper's plant with a camera's noise, so the bands have every chance to hold it."""
    at = list(range(450, 1650, 100))
    samples = {s.index: s for s in read_session(SHIPPED).samples}
    held = []
    for one in asked(SHIPPED, tmp_path / "out.json", "--reference", "recorded", "--at", *at):
        came = np.array([samples[one["sample"] + k + 1].output for k in range(len(one["t"]))])
        held.append(np.mean((np.array(one["y"]["low"]) <= came) & (came <= np.array(one["y"]["high"]))))
    # Twelve forecasts of 300 readings, 90 % of them promised; neighbours share readings and a twin.
    assert 0.8 < np.mean(held) < 0.98
