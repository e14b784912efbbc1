"""May this law be run now? Answered from the candidates; by the operator's word the controller runs it."""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from twinmatch.errors import TwinmatchError
from twinmatch.nodes.desk import Desk, Newest, StampOf
from twinmatch.nodes.messages import message_of
from twinmatch.nodes.samples import TwinNode
from twinmatch.nodes.signature import WITHOUT, RunSignature
from twinmatch.nodes.topics import RELIABLE
from twinmatch.safety import LawReport, Mover, TrialPhase, Turn
from twinmatch.safety.trial import GAINS
from twinmatch.sessions.documents import parse_json
from twinmatch_msgs import msg as messages
from twinmatch_msgs.srv import ApplyLaw, TryLaw

if TYPE_CHECKING:
    from twinmatch.controllers import TrialAnswer
    from twinmatch.dynamics import PidGains

PATIENCE: Final = 10
"""Samples outside the bands, less those inside since, after which the law before is back."""
MAX_SHADOW: Final = 1e5
"""Longest time in the shadow, s."""


class RefusedLawError(TwinmatchError):
    """A law is not run."""


class LawDesk(Desk):
    """Serves `twin/try_law`, and publishes on `twin/law` what comes of it.

    A law is always tried again at the moment at which it is to be run. If the candidates are not those of the
    answer that the operator has seen, that answer has expired. What the controller is asked for is signed.
    """

    def __init__(
        self, node: TwinNode, newest: Newest, stamp_of: StampOf, turn: Turn
    ) -> None:
        """Create service and topic; as for a `Desk`."""
        super().__init__(node, newest, stamp_of, turn)
        self._signature = RunSignature.of_run()
        self._trying = False
        """Whether a request has not been answered yet."""
        self._request = TryLaw.Request()
        """The newest request that was not refused at once."""
        self._word = ""
        """The word of the law that the controller was asked to run: its reports on that law carry it."""
        self._reports = node.create_publisher(messages.LawReport, "twin/law", RELIABLE)
        self._apply = node.create_client(ApplyLaw, "plant/apply_law")
        node.create_service(TryLaw, "twin/try_law", self._on_request)

    def refuse(self, reason: str) -> None:
        """Report that a law is not run."""
        self._end_request()
        self._publish(LawReport(0, TrialPhase.REFUSED, reason=reason))

    def observe(self, report: LawReport) -> None:
        """Take what the controller says of a law on trial: until its end nothing else moves the plant."""
        if report.phase in {TrialPhase.SHADOW, TrialPhase.DRIVING}:
            self._turn.observe(Mover.LAW)
        elif (
            not self._trying or report.request == self._word
        ):  # a report on an earlier law may be received late
            self._turn.give_back(Mover.LAW)

    def begin_again(self) -> None:
        """Note that the rig has been restarted: the law of its configuration drives."""
        if not self._trying:
            self._turn.give_back(Mover.LAW)

    def _on_request(
        self, request: TryLaw.Request, _: TryLaw.Response
    ) -> TryLaw.Response:
        if why := self._reason_to_refuse(request):
            return TryLaw.Response(success=False, message=why)
        self._trying = True
        self._request = request
        self.put(partial(self._try, request))
        return TryLaw.Response(success=True, message="trying; twin/law has the answer")

    def _reason_to_refuse(self, request: TryLaw.Request) -> str:
        """Why a request is refused at once; empty if it is not. A law that is to be run then has its turn."""
        if self._trying:
            return "another law is being tried; wait for its answer"
        if not 0.0 <= request.shadow <= MAX_SHADOW:
            return f"shadow is {request.shadow:g} s; give 0 to {MAX_SHADOW:g} s"
        if not request.run:
            return ""
        if not self._apply.service_is_ready():
            return f"no controller is here (no service {self._apply.srv_name}): run the law yourself"
        if self._signature is None:
            return f"the twin {WITHOUT}"
        return self._turn.take(Mover.LAW)

    def _try(self, request: TryLaw.Request) -> None:
        """Answer; if asked to, and if it is safe or the operator insists, have the controller run it."""
        from twinmatch.controllers import Holding, gains_from, try_now  # noqa: PLC0415
        from twinmatch.dynamics import PidLoops  # noqa: PLC0415
        from twinmatch.twin.matcher import one_thread  # noqa: PLC0415
        from twinmatch.twin.tried import tried_twins  # noqa: PLC0415

        settings = self._node.settings
        snapshot = self._newest()
        gains = gains_from(
            parse_json(request.law, "law"), settings.plant, settings.period
        )
        leader = snapshot.outlook()
        law = gains[0] if len(gains) == 1 else PidLoops.of(*gains)
        sample = leader.sample
        holding = Holding(settings.law, settings.period, settings.schedule.span)
        with one_thread():
            tried = try_now(
                tried_twins(snapshot), law, holding, np.array(sample.references)
            )
        vectors = [
            outlook.parameters.vector.tobytes()
            for outlook in snapshot.outlooks.values()
        ]
        family = hashlib.blake2b(
            b"".join([*vectors, repr(gains).encode()]), digest_size=6
        ).hexdigest()
        answer = LawReport(
            sample.index,
            TrialPhase.ANSWERED,
            decision=tried.answer.decision.value,
            family=family,
            reason=tried.answer.sentence,
        )
        self._trying = request.run  # the reader of the answer may ask at once
        self._publish(answer.of(gains))
        if request.run:
            self._run(request, tried, gains, answer)
            self._trying = False

    def _run(
        self,
        request: TryLaw.Request,
        tried: TrialAnswer,
        gains: Sequence[PidGains],
        answer: LawReport,
    ) -> None:
        """Have the controller put a law on trial that was answered about.

        Raises:
            TwinmatchError: the answer is not the one that the operator has seen, or not safe, or the
                controller refuses.
        """
        if request.family and request.family != answer.family:
            raise RefusedLawError("the twins have changed since that answer; ask again")
        if answer.decision != "safe" and not request.although:
            raise RefusedLawError(f"not run, since it {answer.reason}")
        self._word = request.request or secrets.token_hex(4)
        by_name = {}
        for name in GAINS:
            by_name[name] = [getattr(loop_gains, name) for loop_gains in gains]
        law_request = ApplyLaw.Request(
            low=tried.low.ravel().tolist(),
            high=tried.high.ravel().tolist(),
            shadow=round(request.shadow / self._node.settings.period),
            patience=PATIENCE,
            sample=answer.sample,
            decision=answer.decision,
            although=request.although,
            family=answer.family,
            request=self._word,
            **by_name,
        )
        assert self._signature is not None  # noqa: S101
        law_request.signature = self._signature.of(law_request)
        response: Any = self.answer_of(self._apply, law_request)
        if not response.success:
            raise RefusedLawError(response.message)

    def _end_request(self) -> None:
        """Let the next request come, and give the turn back that this one has taken."""
        self._trying = False
        if self._request.run:
            self._turn.give_back(Mover.LAW)

    def _publish(self, report: LawReport) -> None:
        report = replace(report, request=self._request.request)
        self._node.health.set("law", f"{report.phase.value}: {report.reason}")
        self._node.publish(
            self._reports, message_of(report, self._stamp_of(report.sample))
        )
