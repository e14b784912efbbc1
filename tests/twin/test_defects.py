"""Whatever part of a verdict has a defect: the verdict says so, and the run continues."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

import pytest

from tests.support.steps import drive_lost, quarter_of_an_hour
from tests.support.watched import copied
from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.defects import DefectWarning
from twinmatch.errors import TwinmatchError
from twinmatch.record import comparable, tree_of
from twinmatch.showing.lines import line_text
from twinmatch.signals import Sample
from twinmatch.twin import MatchReport, MatchRequest, Twin, TwinSettings, carry_out

BREAKS = 295
"""Sample from which on a part raises: the first match is due at sample 300."""
ENDS = 490
FIRST_CANDIDATE = 620
"""Sample by which a twin that begins where a part breaks has its first candidate."""
SAID = "no verdict could be made, because of a defect"
PARTS = (
    "twin.door.Refusals.settle",
    "twin.door.GapFiller.take",
    "health.monitor.Monitor.push",
    "twin.engine.Schedule.push",
    "twin.engine.BandHistory.push",
    "twin.engine.residuals",
    "twin.candidates.CandidatePool.admit",
    "twin.candidates.CandidatePool.leave_memory",
    "twin.candidates.StructureFits.push",
    "twin.family_scores.identify",
    "twin.family_scores.score_orders",
    "twin.family_scores.plant_gaps",
    "twin.family_scores.nu_gap_matrix",
    "twin.family_scores.nominal_of",
    "twin.family_scores.judge_uncertainty",
    "comparing.certainty.family_uncertainty",
    "twin.structure_fits.fit_structure",
    "twin.forecaster.Forecaster.push",
    "twin.forecaster.Forecaster.enter",
    "twin.forecaster.Forecaster.check_bands",
    "twin.forecaster.Followers.push",
    "twin.forecaster.Ledger.add",
    "twin.forecaster.Calibration.learn",
    "twin.forecaster.check_band",
    "twin.entrants.Standings.sentence",
    "twin.engine.verdict_of",
    "twin.knowledge.trust_of",
    "twin.knowledge.signal_scores",
)


class Broken:
    """A part that raises while it is `armed`, once or whenever it is run."""

    def __init__(
        self,
        patch: pytest.MonkeyPatch,
        part: str,
        error: BaseException,
        *,
        once: bool = True,
    ) -> None:
        self.armed = False
        self.raised = 0
        *path, name = part.split(".")
        owner: Any = import_module(".".join(["twinmatch", *path[:2]]))
        for inner in path[2:]:
            owner = getattr(owner, inner)
        real = getattr(owner, name)

        def broken(*of: Any, **more: Any) -> Any:
            if self.armed and (self.raised == 0 or not once):
                self.raised += 1
                raise error
            return real(*of, **more)

        patch.setattr(owner, name, broken)


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    return quarter_of_an_hour()


@pytest.fixture(scope="module")
def before(samples: list[Sample]) -> Twin:
    """A twin that has seen what comes before a part breaks; each test continues with a copy."""
    twin = Twin()
    for sample in samples[:BREAKS]:
        twin.push(sample)
    return twin


@pytest.fixture(scope="module")
def reports() -> dict[int, MatchReport]:
    """The matches that were made, by the sample that set them off: of the same window they are the same."""
    return {}


@pytest.fixture
def matched_once(
    reports: dict[int, MatchReport], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Have each window matched by the first test only that comes to it."""

    def report_on(request: MatchRequest, settings: TwinSettings) -> MatchReport:
        if request.sample not in reports:
            reports[request.sample] = carry_out(request, settings)
        return reports[request.sample]

    monkeypatch.setattr("twinmatch.twin.engine.carry_out", report_on)


@pytest.fixture
def twin(before: Twin) -> Twin:
    copy: Twin = copied(before)
    return copy


def run(
    samples: Sequence[Sample],
    broken: Broken,
    twin: Twin,
    breaks_at: int = BREAKS,
    until: Callable[[list[Verdict]], bool] = lambda _: False,
) -> list[Verdict]:
    """The verdicts on these samples, or on those until something holds; the part breaks at one of them."""
    verdicts: list[Verdict] = []
    for sample in samples:
        broken.armed = sample.index >= breaks_at
        verdicts += twin.push(sample).verdicts
        if until(verdicts):
            break
    return verdicts


def continues(verdicts: list[Verdict]) -> bool:
    """Whether there is a verdict after a defective one."""
    defective_verdicts = defective(verdicts)
    return bool(defective_verdicts) and verdicts[-1] is not defective_verdicts[0]


def defective(verdicts: Sequence[Verdict]) -> list[Verdict]:
    return [verdict for verdict in verdicts if verdict.reason.startswith(SAID)]


@pytest.mark.usefixtures("matched_once")
@pytest.mark.parametrize("part", PARTS)
def test_the_verdict_says_where_a_part_failed_and_the_run_continues(
    part: str, samples: list[Sample], twin: Twin, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = Broken(monkeypatch, part, ZeroDivisionError("a slip"))
    with pytest.warns(
        DefectWarning, match="ZeroDivisionError: a slip; please report it"
    ) as warned:
        verdicts = run(samples[BREAKS:ENDS], broken, twin, until=continues)
    assert broken.raised == 1
    assert len(warned) == 1
    (defective_verdict,) = defective(verdicts)
    assert (defective_verdict.level, defective_verdict.level_reason) == (
        TrustLevel.UNKNOWN,
        f"{SAID} of this program",
    )
    (defect,) = twin.discriminator.defects.values()
    assert defective_verdict.reason.endswith(
        f"{defect.place}, {defect.function}: ZeroDivisionError: a slip"
    )
    assert BREAKS <= defective_verdict.sample <= 420
    assert "a slip" in line_text(defective_verdict)
    assert comparable(tree_of(defective_verdict))
    assert verdicts[-1].sample > defective_verdict.sample, (
        "the verdicts after it are made as ever"
    )
    assert twin.discriminator.settled == verdicts[-1].sample


def test_without_a_test_the_same_defect_is_a_warning_and_here_an_error(
    samples: list[Sample], twin: Twin, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So no test of this suite passes while a verdict could not be made."""
    broken = Broken(monkeypatch, "twin.engine.verdict_of", ZeroDivisionError("a slip"))
    with pytest.raises(DefectWarning, match="a slip"):
        run(samples[BREAKS:ENDS], broken, twin)


def test_a_match_that_a_defect_prevents_is_refused_in_words(
    samples: list[Sample], twin: Twin, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twinmatch.twin.matcher.logged_defects", {})
    broken = Broken(monkeypatch, "twin.matcher.match", ZeroDivisionError("a slip"))
    with pytest.warns(DefectWarning, match="a window could not be matched"):
        verdicts = run(samples[BREAKS:ENDS], broken, twin)
    (refused,) = [verdict for verdict in verdicts if verdict.match]
    assert refused.match == "refused"
    assert "because of a defect in" in refused.reason
    assert "ZeroDivisionError: a slip" in refused.reason


def test_candidates_start_over_behind_a_sample_that_was_half_taken(
    samples: list[Sample], twin: Twin, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From then on they are those of a twin to which nothing was said before, bit for bit."""
    broken = Broken(monkeypatch, "twin.forecaster.Forecaster.push", ZeroDivisionError())
    with pytest.warns(DefectWarning):
        verdicts = run(samples[BREAKS:FIRST_CANDIDATE], broken, twin)
    fresh = Twin()
    later = [
        verdict
        for sample in samples[BREAKS + 1 : FIRST_CANDIDATE]
        for verdict in fresh.push(sample).verdicts
    ]
    assert [verdict.sample for verdict in later] == [
        v.sample for v in verdicts if v.sample > BREAKS
    ]
    newest = verdicts[-1]
    expected = later[-1]
    assert newest.candidates == expected.candidates
    assert newest.candidates
    assert [f.parameters for f in newest.forecasts] == [
        f.parameters for f in expected.forecasts
    ]
    assert newest.leader == expected.leader


def test_a_failing_verdict_costs_nothing_else(
    samples: list[Sample], twin: Twin, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To say what is known changes nothing of it: all other verdicts are as without the defect."""
    undisturbed = copied(twin)
    whole = [
        verdict
        for sample in samples[BREAKS:ENDS]
        for verdict in undisturbed.push(sample).verdicts
    ]
    broken = Broken(monkeypatch, "twin.engine.verdict_of", ZeroDivisionError())
    with pytest.warns(DefectWarning):
        verdicts = run(samples[BREAKS:ENDS], broken, twin)
    (defective_verdict,) = defective(verdicts)
    assert [repr(v) for v in verdicts if v is not defective_verdict] == [
        repr(v) for v in whole if v.sample != defective_verdict.sample
    ]


def test_a_defect_at_every_sample_is_logged_once_and_said_in_the_interval_of_verdicts(
    samples: list[Sample], twin: Twin, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = Broken(
        monkeypatch, "health.monitor.Monitor.push", ZeroDivisionError(), once=False
    )
    with pytest.warns(DefectWarning) as warned:
        verdicts = run(samples[BREAKS:420], broken, twin)
    assert len(warned) == 1
    assert broken.raised == 420 - BREAKS
    assert [verdict.sample for verdict in verdicts if verdict.sample >= BREAKS] == [
        295,
        355,
        415,
    ]


def test_a_fault_whose_watch_failed_stays_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """A monitor without a past knows nothing of a drive that was lost; nobody has seen it come back."""
    steps = drive_lost()
    twin = Twin()
    broken = Broken(monkeypatch, "health.monitor.Monitor.push", ZeroDivisionError())
    with pytest.warns(DefectWarning):
        verdicts = run(steps, broken, twin, breaks_at=690)
    (defective_verdict,) = defective(verdicts)
    assert (defective_verdict.fault, defective_verdict.fault_signal) == (
        "drive-lost",
        "pwm",
    )
    assert {verdict.fault for verdict in verdicts if verdict.sample >= 690} == {
        "drive-lost"
    }


@pytest.mark.parametrize(
    "error", [KeyboardInterrupt(), SystemExit(3), TwinmatchError("twin.yaml: no such")]
)
def test_who_ends_the_run_ends_it(
    error: BaseException,
    samples: list[Sample],
    twin: Twin,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    broken = Broken(monkeypatch, "twin.forecaster.Forecaster.push", error)
    with pytest.raises(type(error)):
        run(samples[BREAKS:ENDS], broken, twin)
