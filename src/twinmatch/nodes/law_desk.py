"""May this law be run now? Answered from the candidates; by the operator's word the controller runs it."""

from __future__ import annotations

import hashlib
from typing import Any, Final

import numpy as np

from twinmatch.nodes.experimenter import Desk, Newest, StampOf
from twinmatch.nodes.messages import message_of
from twinmatch.nodes.samples import TwinNode
from twinmatch.nodes.topics import RELIABLE
from twinmatch.safety import LawReport, TrialPhase
from twinmatch.safety.trial import GAINS
from twinmatch.sessions.documents import parse_json
from twinmatch_msgs import msg as messages
from twinmatch_msgs.srv import ApplyLaw, TryLaw

PATIENCE: Final = 10
"""Samples outside the bands, less those inside since, after which the law before is back."""


class LawDesk(Desk):
    """Serves `twin/try_law`, and publishes on `twin/law` what comes of it.

    A law is always tried again at the moment at which it is to be run. If the candidates are not those of the
    answer that the operator has seen, that answer has expired.
    """

    def __init__(self, node: TwinNode, newest: Newest, stamp_of: StampOf) -> None:
        """Create service and topic; as for a `Desk`."""
        super().__init__(node, newest, stamp_of)
        self._reports = node.create_publisher(messages.LawReport, "twin/law", RELIABLE)
        self._apply = node.create_client(ApplyLaw, "plant/apply_law")
        node.create_service(TryLaw, "twin/try_law", self._on_request)

    def refuse(self, reason: str) -> None:
        """Report that a law is not run."""
        self._publish(LawReport(0, TrialPhase.REFUSED, reason=reason))

    def _on_request(self, request: TryLaw.Request, _: TryLaw.Response) -> TryLaw.Response:
        if self._jobs:
            return TryLaw.Response(success=False, message="another law is being tried; wait for its answer")
        if request.run and (why := self.busy()):
            return TryLaw.Response(success=False, message=why)
        if request.run and not self._apply.service_is_ready():
            why = f"no controller is here (no service {self._apply.srv_name}): run the law yourself"
            return TryLaw.Response(success=False, message=why)
        self._put(self._try, request)
        return TryLaw.Response(success=True, message="trying; twin/law has the answer")

    def _try(self, request: TryLaw.Request) -> None:
        """Answer; if asked to, and if it is safe or the operator insists, have the controller run it."""
        from twinmatch.controllers import Holding, gains_from, try_now  # noqa: PLC0415 — slow, seldom needed
        from twinmatch.dynamics import PidLoops  # noqa: PLC0415
        from twinmatch.twin.matcher import one_thread  # noqa: PLC0415
        from twinmatch.twin.tried import tried_twins  # noqa: PLC0415

        settings, snapshot = self._node.settings, self._newest()
        gains = gains_from(parse_json(request.law, "law"), settings.plant, settings.period)
        outlook = snapshot.outlook()
        law, sample = gains[0] if len(gains) == 1 else PidLoops.of(*gains), outlook.sample
        holding = Holding(settings.law, settings.period, settings.schedule.span)
        with one_thread():
            found = try_now(tried_twins(snapshot), law, holding, np.array(sample.references))
        vectors = [one.parameters.vector.tobytes() for one in snapshot.outlooks.values()]
        family = hashlib.blake2b(b"".join([*vectors, repr(gains).encode()]), digest_size=6).hexdigest()
        decision, reason = found.answer.decision.value, found.answer.sentence
        answer = LawReport(sample.index, TrialPhase.ANSWERED, 0, decision, family, reason=reason)
        self._publish(answer.of(gains))
        if not request.run:
            return
        if request.family and request.family != family:
            self.refuse("the twins have changed since that answer; ask again")
        elif decision != "safe" and not request.although:
            self.refuse(f"not run, since it {reason}")
        else:
            asked = ApplyLaw.Request(
                low=found.low.ravel().tolist(),
                high=found.high.ravel().tolist(),
                shadow=round(request.shadow / settings.period),
                patience=PATIENCE,
                sample=sample.index,
                decision=decision,
                although=request.although,
                family=family,
                **{name: [getattr(g, name) for g in gains] for name in GAINS},
            )
            self._apply.call_async(asked).add_done_callback(self._on_applied)

    def _on_applied(self, said: Any) -> None:
        if not said.result().success:
            self._put(self.refuse, said.result().message)

    def _publish(self, report: LawReport) -> None:
        self._node.health.set("law", f"{report.phase.value}: {report.reason}")
        self._node.publish(self._reports, message_of(report, self._stamp_of(report.sample)))
