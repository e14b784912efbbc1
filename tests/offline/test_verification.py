"""Verifying sessions: the recorded verdicts are those of the core, to the last bit."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)

from benchmarks.bank.kits import run
from tests.support.places import SHIPPED
from tests.support.recorded import Change, write_judged
from tests.support.steps import quarter_of_an_hour
from twinmatch.cli import main
from twinmatch.comparing import Verdict
from twinmatch.defects import DefectWarning
from twinmatch.offline.judging import Judgement, Terms, TermsError
from twinmatch.offline.summary import summarise
from twinmatch.offline.verification import VerifyError, verify_session
from twinmatch.parameters.candidates import parse_candidates
from twinmatch.parameters.twin import (
    read_settings,
    settings_from,
    twin_values,
    values_of,
)
from twinmatch.plants import Peltier, TCLabBoth
from twinmatch.sessions import Session, SessionError, write_session
from twinmatch.sessions.metadata import parameters_of, parameters_record
from twinmatch.signals import Sample, stretches
from twinmatch.twin import Outcome, Twin, TwinSettings, engine
from twinmatch.twin.knowledge import Knowledge

pytestmark = pytest.mark.ros

LENGTH = 740
"""Samples: the last step is at 660."""
FAMILY = "candidates:\n  - {name: a guess, operating_point: 75.0, seebeck: 0.07, heat_capacity: 25.0}\n"


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    """A simulated rig with two set-point steps that count."""
    return quarter_of_an_hour()[:LENGTH]


@pytest.fixture(scope="module")
def outcomes(samples: list[Sample]) -> list[Outcome]:
    twin = Twin(TwinSettings(), parse_candidates(FAMILY, "family"))
    return [twin.push(sample) for sample in samples]


@pytest.fixture
def record(
    samples: list[Sample], outcomes: list[Outcome], tmp_path: Path
) -> Callable[..., Path]:
    """A session as the recorder makes one, with some parameters other than the twin's, or of other names."""

    def write(
        change: Change = lambda _matches, _scores: None,
        parameters: dict[str, Any] | None = None,
        unknown: dict[str, Any] | None = None,
        family: str | None = FAMILY,
        **more: Any,
    ) -> Path:
        values = twin_values(
            "twin", {"candidates": "family.yaml", **(parameters or {})}
        ) | (unknown or {})
        return write_judged(
            tmp_path / "run",
            samples,
            outcomes,
            values,
            change=change,
            family=family,
            **more,
        )

    return write


def test_a_recorded_session_is_identical(
    record: Callable[..., Path], capsys: Any, request: pytest.FixtureRequest
) -> None:
    folder = record()
    verification = verify_session(folder)
    assert verification.identical
    assert (verification.samples, verification.notes) == (LENGTH, ())
    assert verification.verdicts > 10
    assert verification.matches == 2
    request.getfixturevalue("judged")
    assert main(["verify", str(folder)]) == 0
    assert "identical, bit for bit" in capsys.readouterr().out


def test_a_session_of_a_plant_with_two_loops_is_identical(tmp_path: Path) -> None:
    steps = list(run(21, "nothing", 450))
    twin = Twin(TwinSettings.of(TCLabBoth, law=None))
    values = twin_values("twin", {"plant": TCLabBoth.name, "loop": "unknown"})
    folder = write_judged(
        tmp_path / "run", steps, [twin.push(sample) for sample in steps], values
    )
    verification = verify_session(folder)
    assert verification.identical
    assert (verification.verdicts > 5, verification.matches, verification.notes) == (
        True,
        2,
        (),
    )


def test_a_verdict_may_be_due_at_a_lost_sample(
    samples: list[Sample], outcomes: list[Outcome], tmp_path: Path
) -> None:
    due = {verdict.sample for outcome in outcomes for verdict in outcome.verdicts}
    received = [sample for sample in samples[:480] if sample.index not in due]
    twin = Twin(TwinSettings(), parse_candidates(FAMILY, "family"))
    outcomes_with_gaps = [twin.push(sample) for sample in received]
    assert {
        verdict.sample for outcome in outcomes_with_gaps for verdict in outcome.verdicts
    } & due
    values = twin_values("twin", {"candidates": "family.yaml"})
    stamps = twin.discriminator.stamps
    verification = verify_session(
        write_judged(
            tmp_path / "run",
            received,
            outcomes_with_gaps,
            values,
            family=FAMILY,
            stamps=stamps,
        )
    )
    assert verification.identical
    assert verification.verdicts > 5


@pytest.fixture
def judged(
    samples: list[Sample], outcomes: list[Outcome], monkeypatch: pytest.MonkeyPatch
) -> list[Terms]:
    """Saves the judging where only the comparison is of interest, or the terms by which would be judged."""
    given_terms: list[Terms] = []
    verdicts = tuple(v for o in outcomes for v in o.verdicts)
    judgement = Judgement(
        name="run",
        samples=samples,
        settings=TwinSettings(),
        matches=tuple(o.match for o in outcomes if o.match is not None),
        verdicts=verdicts,
        summary=summarise(stretches(samples, 1.0), verdicts, TwinSettings().law),
        stretches=stretches(samples, 1.0),
        stamps={sample.index: sample.stamp for sample in samples},
    )

    def judge(_session: Session, terms: Terms, **_: Any) -> Judgement:
        given_terms.append(terms)
        return judgement

    monkeypatch.setattr("twinmatch.offline.verification.judge", judge)
    return given_terms


def nudge(value: float) -> float:
    """The next float64."""
    return float(np.nextafter(value, np.inf))


def spoil_score(_matches: list[Any], scores: list[Any]) -> None:
    judged = next(s for s in scores if len(s.candidates) > 1 and not s.stands)
    judged.candidates[1].orders[2].y.naic = nudge(judged.candidates[1].orders[2].y.naic)


def spoil_match(matches: list[Any], _scores: list[Any]) -> None:
    matches[0].parameters.values[0] = nudge(matches[0].parameters.values[0])


def spoil_stamp(_matches: list[Any], scores: list[Any]) -> None:
    scores[0].header.stamp.nanosec += 1


def spoil_level(_matches: list[Any], scores: list[Any]) -> None:
    scores[2].level_name = "trusted?"


@pytest.mark.usefixtures("judged")
@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            spoil_score,
            [
                "verdict",
                "candidate a guess: candidates[1].orders[2].y.naic was recorded as",
            ],
        ),
        (spoil_match, ["match 1 at sample", "parameters.seebeck was recorded as"]),
        (spoil_stamp, ["verdict 1 at sample", "stamp was recorded as"]),
        (spoil_level, ["verdict 3 at sample", "level_name was recorded as 'trusted?'"]),
        (lambda matches, _: matches.pop(0), ["match 1 at sample", "sample"]),
        (
            lambda _, scores: scores.append(scores[-1]),
            ["all of it was recorded as 'there' and is 'absent' now"],
        ),
        (
            lambda _, scores: scores.__delitem__(slice(3, None)),
            ["verdict 4", "'absent' and is 'there' now"],
        ),
    ],
)
def test_a_single_bit_is_found(
    record: Callable[..., Path], capsys: Any, spoil: Change, words: list[str]
) -> None:
    folder = record(spoil)
    verification = verify_session(folder)
    assert not verification.identical
    for word in words:
        assert word in str(verification.difference)
    assert main(["verify", str(folder)]) == 1
    assert str(verification.difference) in capsys.readouterr().out.replace("\n", " ")


@pytest.mark.usefixtures("judged")
def test_a_last_verdict_may_have_come_too_late_for_the_recorder(
    record: Callable[..., Path],
) -> None:
    verification = verify_session(record(lambda _, scores: scores.pop()))
    assert verification.identical
    assert verification.notes == (
        "1 verdict at the very end came after the recording had stopped",
    )


@pytest.mark.usefixtures("judged")
def test_sentences_may_be_worded_better_by_a_later_version(
    record: Callable[..., Path],
) -> None:
    def word(matches: list[Any], scores: list[Any]) -> None:
        matches[0].suggestion = "A step up, please."
        scores[0].reason = "There was nothing to judge."

    verification = verify_session(record(word))
    assert verification.identical
    assert verification.notes == (
        "this version words some texts differently; they were not compared: reason, suggestion",
    )


@pytest.mark.usefixtures("judged")
def test_a_match_that_was_published_twice_is_compared_once(
    record: Callable[..., Path],
) -> None:
    """The discriminator may have asked again just when the answer came."""
    verification = verify_session(
        record(lambda matches, _: matches.insert(1, matches[0]))
    )
    assert verification.identical
    assert verification.matches == 2


def test_other_parameters_give_other_verdicts(record: Callable[..., Path]) -> None:
    verification = verify_session(record(parameters={"decimals": 1}))
    assert verification.difference is not None
    assert verification.difference.field == "decimals"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"change": lambda _, scores: scores.clear()},
            "has no verdicts on /twin/model_score",
        ),
        (
            {"nodes": ("/matcher",)},
            "the parameters of /discriminator were not recorded; give them with --config",
        ),
        (
            {"family": None},
            "from family.yaml, were not recorded; give them with --candidates",
        ),
        ({"family": ""}, "were not recorded"),
    ],
)
def test_what_cannot_be_verified_is_said(
    record: Callable[..., Path], capsys: Any, arguments: dict[str, Any], message: str
) -> None:
    folder = record(**arguments)
    with pytest.raises((VerifyError, TermsError), match=message):
        verify_session(folder)
    assert main(["verify", str(folder)]) == 2
    assert message in capsys.readouterr().err


def test_parameters_of_another_version_are_said(record: Callable[..., Path]) -> None:
    folder = record(unknown={"schedule.hurry": 3})
    with pytest.raises(
        TermsError, match=r"cannot be used: .*there is no parameter schedule.hurry"
    ):
        verify_session(folder)


def test_parameters_under_the_names_they_had_are_understood(
    record: Callable[..., Path], judged: list[Terms]
) -> None:
    old = {"noise.temperature": 0.1, "camera.resolution": 0.01, "pid.limit": 255.0}
    old |= {"start.sink_heat_capacity": 0.0, "start.sensor_lag": 0.0}
    assert verify_session(record(unknown=old)).identical
    assert [terms.settings for terms in judged] == [TwinSettings()]


def test_files_stand_in_for_what_was_not_recorded(
    record: Callable[..., Path], judged: list[Terms], tmp_path: Path
) -> None:
    folder = record(nodes=(), family=None)
    config = tmp_path / "twin.yaml"
    family = tmp_path / "family.yaml"
    config.write_text("/**:\n  ros__parameters:\n    decimals: 1\n")
    family.write_text(FAMILY)
    verify_session(folder, config=config, candidates=family)
    verify_session(folder, config=config)
    assert [terms.settings.decimals for terms in judged] == [1, 1]
    assert [[candidate.name for candidate in terms.given] for terms in judged] == [
        ["a guess"],
        [],
    ]


def test_recorded_parameters_have_to_be_json() -> None:
    with pytest.raises(
        SessionError, match="the recorded parameters of /matcher cannot be read"
    ):
        parameters_of({parameters_record("/matcher"): {"seed": "seven"}}, "/matcher")


# A session judged without its controller: recorded, verified, forecast, tested and written up.


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """A parameter file that takes the rig's loop as unknown."""
    path = tmp_path / "unknown.yaml"
    path.write_text("/**:\n  ros__parameters:\n    loop: unknown\n", encoding="utf-8")
    return path


def test_parameters_say_that_the_loop_is_not_known(
    config: Path, tmp_path: Path
) -> None:
    settings = read_settings(config)
    assert settings == TwinSettings.of(Peltier, law=None)
    assert settings_from(twin_values("again", values_of(settings))) == settings
    assert "pid.proportional" not in values_of(settings)
    wrong = tmp_path / "wrong.yaml"
    for line in ("pid.integral: 0.6", "schedule.min_input_step: 2.0"):
        wrong.write_text(
            f"/**:\n  ros__parameters:\n    loop: unknown\n    {line}\n",
            encoding="utf-8",
        )
        assert main(["replay", str(SHIPPED), "--config", str(wrong)]) == 2


def test_a_recorded_session_is_verified_bit_for_bit(tmp_path: Path) -> None:
    """Through messages and back: what is absent there is NaN."""
    samples = quarter_of_an_hour()[:LENGTH]
    settings = TwinSettings.of(Peltier, law=None)
    twin = Twin(settings)
    outcomes = [twin.push(sample) for sample in samples]
    verification = verify_session(
        write_judged(tmp_path / "run", samples, outcomes, values_of(settings))
    )
    assert verification.identical
    assert verification.matches >= 2


def test_a_forecast_is_asked_for_under_inputs(
    config: Path, capsys: Any, tmp_path: Path
) -> None:
    session = write_session(tmp_path / "quarter", quarter_of_an_hour())
    asked = ["forecast", str(session), "--config", str(config), "--at", "480"]
    assert (
        main(
            [
                *asked,
                "--hold",
                "80",
                "--horizon",
                "60",
                "--json",
                str(tmp_path / "f.json"),
            ]
        )
        == 0
    )
    printed = capsys.readouterr().out
    assert "80 PWM held" in printed
    assert "the loop is not known: the forecast is for the given inputs" in printed
    [document] = json.loads((tmp_path / "f.json").read_text(encoding="utf-8"))
    assert document["reference"] is None
    assert document["u"]["mean"] == [80.0] * 60
    assert main([*asked, "--reference", "recorded"]) == 0
    printed = capsys.readouterr().out
    assert "the recorded inputs" in printed
    assert "% of the temperature" in printed
    assert "nan" not in printed
    assert main([*asked, "--hold", "900"]) == 2
    assert (
        "the input now is 900 PWM; give one from -255 to 255 PWM"
        in capsys.readouterr().err
    )


def test_a_session_with_a_verdict_that_a_defect_prevented_is_verified(
    samples: list[Sample], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is recorded as any other. With the same defect a replay finds it again, without another."""
    real = engine.verdict_of

    def broken(knowledge: Knowledge) -> Verdict:
        if knowledge.sample == 360:
            raise ZeroDivisionError("a slip")
        return real(knowledge)

    values = twin_values("twin", {})

    def recorded() -> Path:
        twin = Twin(TwinSettings())
        outcomes = [twin.push(sample) for sample in samples[:500]]
        return write_judged(tmp_path / "run", samples[:500], outcomes, values)

    with monkeypatch.context() as patch:
        patch.setattr(engine, "verdict_of", broken)
        with pytest.warns(DefectWarning, match="a slip"):
            folder = recorded()
        with pytest.warns(DefectWarning, match="a slip"):
            assert verify_session(folder).identical
    mended = verify_session(folder)
    assert "verdict 7 at sample 360" in str(mended.difference)
    assert "because of a defect of this program" in str(mended.difference)
