"""FMUs among the structures of a running plant: matched, compared, forecast with, and done without."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.support.fmus import build_python_fmu, write_map
from twinmatch.cli import main
from twinmatch.dynamics import (
    Model,
    PlantError,
    Structure,
    StructureLostError,
    begin,
    simulate_closed_loop,
)
from twinmatch.fmu import is_fmu
from twinmatch.offline.judging import Judgement, judge_samples
from twinmatch.offline.verification import ForeignError, check_fmus
from twinmatch.parameters.twin import ParameterError, read_settings, recorded_values
from twinmatch.plants import Peltier
from twinmatch.record.trees import parameters_of, parameters_tree
from twinmatch.sessions import write_session
from twinmatch.showing.report.report import make_report
from twinmatch.signals import Sample, Window
from twinmatch.twin import Twin, TwinSettings, watched
from twinmatch.twin.structures import choose_structure

NATIVE = Peltier.model("held sink")
TRUTH = {"seebeck": 0.06, "conductance": 0.7, "heat_capacity": 28.0}


def a_session(samples: int = 800, seed: int = 5) -> list[Sample]:
    """A held sink, whose set-point moves every 250 s."""
    truth = NATIVE.parameters(**TRUTH)
    levels = (40.0, 60.0, 35.0, 55.0)
    reference = np.array([levels[k // 250 % len(levels)] for k in range(samples)])
    run = simulate_closed_loop(
        truth,
        reference,
        states=begin(truth, 38.0),
        sensor=Peltier.sensor.realise(samples, 1.0, seed),
    )
    rows = zip(reference.tolist(), run.output.tolist(), run.input.tolist(), strict=True)
    return [Sample(k, 10**9 * k, *values) for k, values in enumerate(rows)]


def judged(samples: list[Sample]) -> Judgement:
    return judge_samples("a session", samples, TwinSettings())


@pytest.fixture
def only_fmus(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside the matches nothing competes but FMUs, which keeps the test short."""
    structures = {
        n: s if is_fmu(n) else _unwatched(s) for n, s in Peltier.structures.items()
    }
    monkeypatch.setattr(Peltier, "structures", structures)


def _unwatched(structure: Structure) -> Structure:
    return replace(structure, watched=structure is NATIVE.structure)


def test_wrong_physics_loses_the_choice_of_structures(
    adopted: Callable[..., Model], exchange_fmu: Path, wrong_fmu: Path
) -> None:
    window = Window.from_samples(a_session(600))
    right = adopted(exchange_fmu, "right")
    wrong = adopted(wrong_fmu, "wrong")
    choice = choose_structure(window, [wrong, right, NATIVE])
    assert choice.chosen != wrong.structure_name
    error_of = {score.name: score.off for score in choice.scores}
    # The right one is the native one; the wrong one errs in the transient of the part held back.
    assert error_of[right.structure_name] == pytest.approx(
        error_of["held sink"], rel=1e-6
    )
    assert error_of[wrong.structure_name] > 1.2 * error_of["held sink"]


@pytest.mark.usefixtures("only_fmus")
def test_wrong_physics_forecasts_worse_and_a_report_names_both(
    adopted: Callable[..., Model], exchange_fmu: Path, wrong_fmu: Path, tmp_path: Path
) -> None:
    right = adopted(exchange_fmu, "right").structure_name
    wrong = adopted(wrong_fmu, "wrong").structure_name
    report = make_report(write_session(tmp_path / "run", a_session(700)))
    verdict = report.judged.judgement.verdicts[-1]
    gains = {score.name: score.gain for score in verdict.forecasts}
    assert gains[right] > gains[wrong]
    assert verdict.leader != wrong
    page = report.html()
    assert right in page
    assert wrong in page


@pytest.mark.usefixtures("only_fmus")
def test_two_judgements_are_the_same_to_the_last_bit(
    adopted: Callable[..., Model], exchange_fmu: Path
) -> None:
    model = adopted(exchange_fmu)
    first, second = (judged(a_session(600)).verdicts for _ in range(2))
    names = {score.name for verdict in first for score in verdict.forecasts}
    assert model.structure_name in names
    assert repr(first) == repr(second)


@pytest.mark.usefixtures("only_fmus")
def test_one_that_is_lost_takes_no_one_with_it(
    adopted: Callable[..., Model], tmp_path: Path, capfd
) -> None:
    samples = a_session(600)
    alone = judged(samples).verdicts
    model = adopted(
        build_python_fmu(tmp_path, "Hanging", culprit="hangs", steps=2), patience=0.5
    )
    beside = judged(samples).verdicts
    assert "no answer within" in model.lost
    assert "everything else continues without this structure" in capfd.readouterr().err
    assert [v.sample for v in beside] == [v.sample for v in alone]
    assert [v.leader for v in beside] == [v.leader for v in alone]
    assert model.structure_name not in {s.name for v in beside for s in v.forecasts}


@pytest.mark.usefixtures("only_fmus")
def test_one_that_is_lost_while_it_leads_leaves(
    adopted: Callable[..., Model], exchange_fmu: Path
) -> None:
    model = adopted(exchange_fmu)
    samples = a_session(700)
    twin = Twin(TwinSettings())
    for sample in samples[:560]:
        twin.push(sample)
    forecaster = twin.discriminator.forecaster
    assert model.structure_name in forecaster.names
    model.structure.external.lose("a test took it away")  # type: ignore[union-attr]
    for sample in samples[560:]:
        twin.push(sample)
    assert model.structure_name not in forecaster.names
    assert forecaster.leader is not None
    assert any("a test took it away" in note for note in forecaster.notes)


@pytest.mark.usefixtures("adopted")
def test_a_configuration_lets_fmus_run_and_a_recording_does_not(
    exchange_fmu: Path, tmp_path: Path
) -> None:
    maps = write_map(tmp_path, exchange_fmu, "from a file")
    config = tmp_path / "twin.yaml"
    config.write_text(
        yaml.safe_dump({"/**": {"ros__parameters": {"allow_fmu": str(maps)}}})
    )
    recorded_values("session x", {"plant": "peltier", "allow_fmu": str(maps)})
    assert not [name for name in Peltier.structures if is_fmu(name)]
    read_settings(config)
    (name,) = [name for name in Peltier.structures if is_fmu(name)]
    assert name.startswith("from a file (FMU ")
    assert Peltier.structures[name].watched
    config.write_text(
        yaml.safe_dump({"/**": {"ros__parameters": {"allow_fmu": "nowhere.yaml"}}})
    )
    with pytest.raises(ParameterError, match=r"nowhere\.yaml"):
        read_settings(config)


@pytest.mark.usefixtures("adopted", "only_fmus")
def test_a_command_lets_the_fmus_run_that_it_names(
    exchange_fmu: Path, tmp_path: Path
) -> None:
    maps = write_map(tmp_path, exchange_fmu, "from the command")
    session = write_session(tmp_path / "minute", a_session(60))
    assert main(["replay", str(session), "--allow-fmu", str(maps)]) == 0
    (name,) = [name for name in Peltier.structures if is_fmu(name)]
    assert name.startswith("from the command (FMU ")
    assert Peltier.structures[name].watched


def test_a_session_is_verified_with_its_own_fmu_only(
    adopted: Callable[..., Model], exchange_fmu: Path, wrong_fmu: Path
) -> None:
    native = tuple(Peltier.structures)
    check_fmus("x", Peltier, native)
    old_name = adopted(wrong_fmu, "the shop's").structure_name
    check_fmus("x", Peltier, (*native, old_name))
    with pytest.raises(ForeignError, match="was judged without the FMU"):
        check_fmus("x", Peltier, native)
    new_name = adopted(exchange_fmu, "the shop's").structure_name
    assert new_name != old_name
    assert old_name not in Peltier.structures
    with pytest.raises(
        ForeignError, match=r"the one given, .* is another FMU or has another map"
    ):
        check_fmus("x", Peltier, (*native, old_name))


def test_a_page_shows_an_fmu_that_it_does_not_have(
    adopted: Callable[..., Model], exchange_fmu: Path
) -> None:
    parameters = adopted(exchange_fmu).parameters(seebeck=0.06)
    tree = parameters_tree(parameters)
    Peltier.disown(parameters.model.structure_name)
    restored = parameters_of(tree)
    assert restored is not None
    assert restored.model.structure_name == parameters.model.structure_name
    assert dict(restored) == dict(parameters)
    assert restored.model not in watched(Peltier)
    with pytest.raises(StructureLostError, match="is not loaded in this process"):
        begin(restored, 30.0)
    with pytest.raises(ForeignError, match="give that FMU's map file"):
        check_fmus("x", Peltier, [restored.model.structure_name])
    adopted_again = adopted(exchange_fmu)
    assert not adopted_again.lost
    with pytest.raises(PlantError, match="no structure 'nobody knows it'"):
        parameters_of({**tree, "structure": "nobody knows it"})
