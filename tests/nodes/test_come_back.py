"""A twin or a recorder that was killed or stopped leaves nothing out: all is said once, bit for bit."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from std_srvs.srv import SetBool

from tests.support.processes import Start
from tests.support.recorded import wait_for_recorded
from tests.support.ros import Listener
from twinmatch.nodes.messages import record_of
from twinmatch.nodes.topics import EVERYTHING
from twinmatch.offline.judging import TermsError
from twinmatch.offline.verification import Verification, VerifyError, verify_session
from twinmatch.sessions import SessionError, read_session, write_session
from twinmatch.signals import Sample
from twinmatch.twin import Outcome
from twinmatch_msgs.msg import Forecast, Match, ModelScore, TwinState

pytestmark = [
    pytest.mark.ros,
    pytest.mark.long("processes are killed or stand still, again and again"),
]


LENGTH = 700
"""Samples that are played: two matches, on samples 300 and 600, and a verdict a minute."""
TWIN_KILLED = (40, 112, 328, 590)
RECORDER_KILLED = (200, 430, 520)
"""Samples at which one or the other is killed, 3.5 s apart and more: back or still catching up."""

AROUND = 20
"""States around a kill that were under way: more than a second of them."""


class Run:
    """Player, twin and recorder, and what is received of them."""

    def __init__(
        self, start: Start, listener: Listener, session: Path, folder: Path
    ) -> None:
        self.listener = listener
        self._start = start
        self.scores = listener.hear(ModelScore, "twin/model_score", EVERYTHING)
        self.matches = listener.hear(Match, "twin/match", EVERYTHING)
        self.states = listener.hear(TwinState, "twin/state", EVERYTHING)
        self.forecasts = listener.hear(Forecast, "twin/forecast", EVERYTHING)
        self._folder = folder
        self.folders: list[Path] = []
        assert not listener.health
        self.record()
        self.twin = start("twin")
        listener.wait_for_publishers(
            "twin/match", "twin/model_score", "twin/state", "twin/forecast"
        )
        readers = "readers:=twin_simulator discriminator keeper recorder"
        words = (f"session:={session}", "rate:=20.0", readers, "wait_timeout:=60.0")
        start("player", *(word for parameter in words for word in ("-p", parameter)))

    def record(self) -> None:
        """Start a recorder with a folder of its own."""
        self.folders.append(self._folder / f"recorded_{len(self.folders) + 1}")
        arguments = (
            "-p",
            f"folder:={self._folder}",
            "-p",
            f"name:={self.folders[-1].name}",
        )
        self.recorder = self._start("recorder", *arguments)

    def until_state(self, index: int) -> None:
        self.listener.spin_until(
            lambda: self.states and self.states[-1].index >= index, f"sample {index}"
        )

    def shoot(self) -> None:
        self.twin.kill()
        self.twin = self._start("twin")

    def readers(self, name: str) -> set[tuple[int, ...]]:
        """Those that read the samples under this name; one that was killed is known for some seconds more."""
        subscriptions = self.listener.node.get_subscriptions_info_by_topic(
            "plant/sample"
        )
        return {
            tuple(info.endpoint_gid) for info in subscriptions if info.node_name == name
        }

    def hold_until_back(self, name: str, before: set[tuple[int, ...]]) -> None:
        """Pause the player until a node reads the samples again, however busy the machine is."""
        self._pause(True)
        self.listener.spin_until(lambda: self.readers(name) - before, f"another {name}")
        self._pause(False)

    def _pause(self, paused: bool) -> None:
        client = self.listener.node.create_client(SetBool, "player/pause")
        self.listener.spin_until(client.service_is_ready, "the player's service")
        answer = client.call_async(SetBool.Request(data=paused))
        self.listener.spin_until(answer.done, "the player's answer")
        self.listener.node.destroy_client(client)

    def stand_still(self, seconds: float) -> None:
        self.twin.freeze()
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.listener.spin_once()
        self.twin.thaw()

    def check(
        self, steps: list[Sample], offline: list[Outcome], shots: int = 0
    ) -> None:
        """Everything was said that is said offline, and nothing twice.

        What a process that was killed had just sent reaches some readers and others not, so around a kill a
        state or a forecast may be missing here, or come once more, and a verdict or a match may be missing:
        it is not said again if the keeper has it. The recorded session is whole.
        """
        verdicts = [
            repr(verdict) for outcome in offline for verdict in outcome.verdicts
        ]
        matches = [
            repr(outcome.match) for outcome in offline if outcome.match is not None
        ]
        self.listener.spin_until(
            lambda: (
                bool(self.scores)
                and repr(record_of(self.scores[-1])) == verdicts[-1]
                and self.states[-1].index >= steps[-1].index
            ),
            lambda: (
                f"{len(self.scores)} of {len(verdicts)} verdicts, {len(self.states)} of {len(steps)} states, "
                f"the last at {self.states[-1].index}"
            ),
        )
        for heard, expected in ((self.scores, verdicts), (self.matches, matches)):
            published = [repr(record_of(message)) for message in heard]
            assert published == [
                record for record in expected if record in published
            ]  # in order, and nothing twice
            assert len(expected) - len(published) <= shots
        last = steps[-1].index
        self.listener.spin_until(
            lambda: self.forecasts[-1].sample == last, "the last forecast"
        )
        mirrored = [s.index for s in self.states]
        foretold = [f.sample for f in self.forecasts]
        if shots == 0:
            assert mirrored == [sample.index for sample in steps]
            assert foretold == list(range(foretold[0], last + 1))
            return
        for published in (mirrored, foretold):
            all_indices = range(published[0], last + 1)
            assert len(published) - len(set(published)) <= AROUND * shots
            assert len(set(all_indices) - set(published)) <= AROUND * shots

    def verify(self) -> list[Verification]:
        """The folders that can be judged: a recorder killed soon after its start may lack what that takes."""
        self.listener.spin_until(
            lambda: self.listener.said("ended: all"), "the player's end"
        )
        self.recorder.end()
        verifications = []
        for folder in self.folders[:-1]:
            with suppress(SessionError, VerifyError, TermsError):
                verifications.append(verify_session(folder))
        return [*verifications, verify_session(self.folders[-1])]


@pytest.fixture
def begin(
    start_process: Start, listener: Listener, tmp_path: Path
) -> Callable[[list[Sample]], Run]:
    def play(samples: list[Sample]) -> Run:
        return Run(
            start_process,
            listener,
            write_session(tmp_path / "steps", samples),
            tmp_path,
        )

    return play


def test_twin_and_recorder_that_are_killed_again_and_again_come_back(
    begin: Callable[[list[Sample]], Run], steps: list[Sample], offline: list[Outcome]
) -> None:
    """Every session of a killed recorder verifies from its beginning; the last one has everything."""
    played = steps[:LENGTH]
    outcomes = offline[:LENGTH]
    run = begin(played)
    for index in sorted(TWIN_KILLED + RECORDER_KILLED):
        run.until_state(index)
        before = run.readers("discriminator" if index in TWIN_KILLED else "recorder")
        if index in TWIN_KILLED:
            # what it sent more than a second ago has arrived, on a busy machine too
            wait_for_recorded(
                run.folders[-1],
                twin__model_score=sum(
                    len(o.verdicts) for o in outcomes[: index - AROUND]
                ),
            )
            run.shoot()
            continue
        run.recorder.kill()
        run.record()
        run.until_state(index + 20)
        run.hold_until_back("recorder", before)
    run.hold_until_back("discriminator", before)
    run.check(played, outcomes, shots=len(TWIN_KILLED))
    verifications = run.verify()
    assert [verification.difference for verification in verifications] == [None] * len(
        verifications
    )
    assert verifications[-1].verdicts == sum(
        len(outcome.verdicts) for outcome in outcomes
    )
    assert read_session(run.folders[-1]).samples == played


def test_a_twin_that_stood_still_is_given_what_it_missed(
    begin: Callable[[list[Sample]], Run], steps: list[Sample], offline: list[Outcome]
) -> None:
    run = begin(steps[:600])  # the player, and so the keeper, outlasts the second time
    run.until_state(100)
    run.stand_still(10.0)
    run.listener.spin_until(lambda: run.matches, "a match")  # its verdict is being made
    run.stand_still(10.0)
    run.check(steps[:600], offline[:600])
    (verification,) = run.verify()
    assert verification.identical, verification.difference
