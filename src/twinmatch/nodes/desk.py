"""A desk: what a service is asked for, done in a thread of its own, one job after the other."""

from __future__ import annotations

import threading
import time
from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any, Final

from twinmatch.defects import defect_of
from twinmatch.errors import TwinmatchError
from twinmatch.nodes.node import Worker
from twinmatch.nodes.samples import TwinNode
from twinmatch.printing import one_line
from twinmatch.safety import Turn
from twinmatch.twin import Snapshot

Newest = Callable[[], Snapshot]
StampOf = Callable[[int], int]

PATIENCE: Final = 5.0
"""Time after which a service that does not answer is missing, wall s."""
_LOOK: Final = 0.1
"""Interval at which a desk that waits for an answer checks whether it should end, wall s."""


class DeskError(TwinmatchError):
    """Another node does not answer."""


class Desk:
    """Does what a service is asked for; whatever that is, the node continues."""

    def __init__(
        self, node: TwinNode, newest: Newest, stamp_of: StampOf, turn: Turn
    ) -> None:
        """Create the thread.

        Args:
            node: the node that serves.
            newest: returns the newest snapshot of all candidates.
            stamp_of: returns the stamp of a sample, ns.
            turn: whose turn it is to move the plant; shared by all desks of the node.
        """
        self._node = node
        self._newest = newest
        self._stamp_of = stamp_of
        self._turn = turn
        self._unfinished: deque[None] = deque()  # a mark for each that is not done
        self._worker: Worker[Callable[[], None]] = Worker(self._do, node.health)
        node.beside.append(self._worker)
        if node.step is not None:
            node.step.wait_for(lambda: bool(self._unfinished))

    @abstractmethod
    def refuse(self, reason: str) -> None:
        """Report that nothing comes of the request that is worked on."""

    def put(self, job: Callable[[], None]) -> None:
        """Queue a job."""
        self._unfinished.append(None)
        self._worker.put(job)

    def answer_of(self, client: Any, request: Any) -> Any:
        """What another node's service answers; called in this desk's thread.

        Raises:
            DeskError: it does not answer.
        """
        answered = threading.Event()
        future = client.call_async(request)
        future.add_done_callback(lambda _: answered.set())
        until = time.monotonic() + PATIENCE
        while not answered.wait(_LOOK):
            if self._worker.ending.is_set() or time.monotonic() > until:
                client.remove_pending_request(future)
                raise DeskError(
                    f"{client.srv_name} has not answered for {PATIENCE:g} s; is the controller running?"
                )
        answer = future.result()
        if not self._node.entrance.passes(client.srv_name, answer):
            raise DeskError(f"{client.srv_name} has answered with what cannot be used")
        return answer

    def _do(self, job: Callable[[], None]) -> None:
        try:
            self._report_failure_of(job)
        except Exception as error:  # of the report itself
            self._node.get_logger().error(defect_of(error).sentence)
        finally:
            self._unfinished.pop()

    def _report_failure_of(self, job: Callable[[], None]) -> None:
        try:
            job()
        except TwinmatchError as error:
            self.refuse(one_line(str(error)))
        except Exception as error:  # nothing that is asked ends a node
            words = defect_of(error).sentence
            self._node.get_logger().error(words)
            self.refuse(one_line(words))
