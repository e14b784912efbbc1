"""The entrance to a node: what it receives is checked before anything else sees it.

DDS lets anybody on the domain publish anything under the name of the right type. So every subscription and
every service of a `TwinmatchNode` is behind its `Entrance`, also those that rclpy makes for itself: /clock
and the parameters. Bytes that are not a message of the type, and a message that is not what `expected` says,
are refused: counted, and told on /diagnostics.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from rcl_interfaces.msg import SetParametersResult
from rclpy.event_handler import QoSSubscriptionEventType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.serialization import deserialize_message

from twinmatch.defects import defect_of
from twinmatch.errors import TwinmatchError
from twinmatch.nodes.cdr import serialized
from twinmatch.nodes.expected import MESSAGES, MessageRules, check, check_readable
from twinmatch.nodes.fields import Expected, MessageError
from twinmatch.nodes.health import Level, NodeHealth
from twinmatch.printing import printable

Take = Callable[[Any], None]

LOOK: Final = 0.5
"""Shortest interval between two looks at who publishes a topic, wall s."""
AGREEING: Final = 3
"""Messages in a row that follow each other but not those before, from which on they are believed."""
ALONE: Final = 2.0
"""Time since a second publisher was last there, wall s: until then a message of his may still be queued."""

UNKNOWN: Final = "_NODE_NAME_UNKNOWN_"
"""What rmw gives for a publisher that it knows before its node."""
_FIGURES: Final = re.compile(r"[−-]?[\d.,]+(e[-+]\d+)?")


@dataclass
class _ReportedRefusal:
    """A refusal that was reported."""

    at: float
    """When a message was last refused for it, wall s."""
    text: str
    name: str
    """Of the topic or service."""
    topic: str
    """The topic whose publisher has still to be named; empty once it is, and for a service."""


class Entrance:
    """Checks what a node receives, and tells what it refuses."""

    REMEMBER: Final = 60.0
    """Time for which a refusal stays on /diagnostics after the last of its kind, wall s."""
    MAX_KINDS: Final = 20
    """Most kinds of refusals on /diagnostics; all are counted."""
    MAX_REASONS: Final = 3
    """Most kinds of them for one topic or service."""
    MAX_NAMES: Final = 3
    """Most publishers of a topic that are named as possible senders."""
    MAX_TEXT: Final = 200
    """Longest reason told, characters."""

    def __init__(self, node: Node, health: NodeHealth) -> None:
        """Parameters of any plant pass until `plant` is set."""
        self.plant: Expected = None
        self._node = node
        self._health = health
        self._refusals: dict[str, _ReportedRefusal] = {}
        self._senders: dict[str, tuple[float, str]] = {}
        self._seconds: dict[Any, SecondPublisher] = {}

    def course(self, kind: Any, topic: str) -> Course | None:
        """What the messages of a topic have to follow, if anything."""
        expected = MESSAGES.get(kind, MessageRules())
        if expected.departs is None:
            return None
        return Course(
            expected.departs, partial(self._publishers, topic), owned=expected.owned
        )

    def before(
        self,
        kind: Any,
        topic: str,
        take: Take,
        course: Course | None = None,
        *,
        raw: bool = False,
    ) -> Take:
        """What a raw subscription calls in place of `take`, which gets what `MESSAGES` makes of the bytes.

        If `raw`, it gets bytes again: those of the message that was checked, without what follows its last
        field. Bytes of types that are not in the table pass as they are. What another process says of a plant
        that only it has loaded may pass, too.
        """
        if raw and kind not in MESSAGES:
            return take
        expected = MESSAGES.get(kind, MessageRules())

        def receive(data: bytes) -> None:
            try:
                message = _message(data, kind)
                check(message, self.plant)
                if course is not None:
                    course.follow(message, time.monotonic())
                if raw:
                    check_readable(message)
                take(serialized(message) if raw else expected.read(message))
            except TwinmatchError as error:
                self.refuse(topic, str(error), topic)

        return receive

    def second(self, subscription: Any) -> SecondPublisher:
        """What tells whether a subscription has a second publisher.

        Each subscription has one of its own: an answer is about the time since the last question.
        """
        if subscription not in self._seconds:
            self._seconds[subscription] = SecondPublisher(subscription)
        return self._seconds[subscription]

    def release(self, subscription: Any) -> None:
        """Release what watches a subscription that ends."""
        if subscription in self._seconds:
            self._seconds.pop(subscription).destroy()

    def serving(
        self, name: str, answer: Callable[[Any, Any], Any]
    ) -> Callable[[Any, Any], Any]:
        """What a service calls in place of `answer`: it answers, whatever it was asked."""

        def respond(request: Any, response: Any) -> Any:
            try:
                check(request, self.plant)
                return answer(request, response)
            except TwinmatchError as error:
                self.refuse(name, str(error))
                return _refuse(request, response, str(error))
            except Exception as error:  # nothing that is asked ends a node
                words = defect_of(error).sentence
                self._node.get_logger().error(f"{name}: {words}")
                self.refuse(name, words)
                return _refuse(request, response, words)

        return respond

    def passes(self, name: str, answer: Any) -> bool:
        """Whether the answer of a service of that name may be used."""
        try:
            check(answer, self.plant)
        except TwinmatchError as error:
            self.refuse(name, str(error))
            return False
        return True

    @property
    def refusals(self) -> int:
        """Number of the refusals that are reported now."""
        return len(self._refusals)

    def refuse(self, name: str, why: str, topic: str = "") -> None:
        """Count a message that is not used, and report it once for as long as messages of its kind are
        received.

        For a topic, the report names the sender as soon as DDS knows a new node's name.
        """
        self._health.count(f"refused: {name}")
        why = why if len(why) <= self.MAX_TEXT else f"{why[: self.MAX_TEXT]}…"
        kind = f"{name}: {_FIGURES.sub('', why)}"
        wall_now = time.monotonic()
        if kind not in self._refusals:
            reasons_given = sum(
                refusal.name == name for refusal in self._refusals.values()
            )
            if (
                reasons_given >= self.MAX_REASONS
                or len(self._refusals) >= self.MAX_KINDS
            ):
                return
            self._refusals[kind] = _ReportedRefusal(
                wall_now, f"refused: {name}: {why}", name, topic
            )
            self._tell(kind)
        self._refusals[kind].at = wall_now

    def watch(self, wall_now: float) -> None:
        """Withdraw the refusals of `REMEMBER` seconds ago and before, by the wall clock."""
        for kind, refusal in list(self._refusals.items()):
            if wall_now - refusal.at > self.REMEMBER:
                del self._refusals[kind]
                self._health.withdraw(kind)
        for kind, refusal in list(self._refusals.items()):
            if refusal.topic:
                self._tell(kind)

    def _tell(self, kind: str) -> None:
        refusal = self._refusals[kind]
        sender = self._sender(refusal.topic) if refusal.topic else ""
        if sender:
            refusal.text = f"{refusal.text} (published by {sender})"
            refusal.topic = ""
        self._health.flag(kind, Level.ERROR, refusal.text)

    def _sender(self, topic: str) -> str:
        """Who publishes a topic, as far as DDS tells: it does not say of whom a message is.

        Empty while it does not know a name yet.
        """
        looked_up, names = self._senders.get(topic, (-LOOK, ""))
        if time.monotonic() - looked_up > LOOK:
            publishers = {
                info.node_name
                for info in self._node.get_publishers_info_by_topic(topic)
            }
            names = " or ".join(sorted(publishers)) or "a node that is gone"
            if len(publishers) > self.MAX_NAMES:
                names = f"one of {len(publishers)} nodes; ros2 topic info -v {topic} lists them"
            names = "" if UNKNOWN in publishers else names
            self._senders[topic] = time.monotonic(), names
        return names

    def _publishers(self, topic: str) -> frozenset[bytes]:
        return frozenset(
            bytes(info.endpoint_gid)
            for info in self._node.get_publishers_info_by_topic(topic)
        )


class Course:
    """Whether messages follow each other; who departs is believed if the publisher was replaced.

    The message before may have been the wrong one. So who departs `AGREEING` times in a row is believed, too,
    each time in line with the last, with nothing in between that follows. A topic that is owned belongs to
    the publisher that began: nobody who departs is believed while several publish it. All times are wall s.
    """

    def __init__(
        self,
        departs: Callable[[Any, Any, float], str],
        publishers: Callable[[], frozenset[bytes]],
        *,
        owned: bool = False,
    ) -> None:
        """`departs` says why a message does not follow another one so long after it, in which a publisher
        that is alone may do what it likes; `publishers` returns who they are now."""
        self.second: Callable[[], bool] = lambda: False
        """Whether a second publisher is there or was since the last call; must know it before its message."""
        self.owned = owned
        self._departs = departs
        self._publishers = publishers
        self._before: Any = None
        self._received_at = 0.0
        self._owners: frozenset[bytes] = frozenset()
        self._refused: list[Any] = []
        self._looked = -LOOK
        # when a second publisher was last there; None: long ago
        self._second: float | None = None

    def follow(self, message: Any, now: float) -> None:
        """Take the next message.

        Raises:
            MessageError: it does not follow.
        """
        alone = self._alone(now)
        elapsed = math.inf if alone else now - self._received_at
        why = (
            ""
            if self._before is None
            else self._departs(self._before, message, elapsed)
        )
        if why and not self._is_believed(message, now, alone=alone):
            raise MessageError(why)
        if why or self._before is None:
            self._owners = self._publishers()
        self._before = message
        self._received_at = now
        self._refused.clear()

    def _alone(self, now: float) -> bool:
        """Whether one publisher is there, and has been for so long that this message is his."""
        if self.second():
            self._second = now
        elif self._second is not None and now - self._second > ALONE:
            self._second = None
            self._owners = self._publishers()
        return self._second is None

    def _is_believed(self, message: Any, now: float, *, alone: bool) -> bool:
        """Whether a message that departs is believed: enough of them agree, or all publishers are new."""
        if self._refused and self._departs(self._refused[-1], message, math.inf):
            self._refused.clear()
        self._refused.append(message)
        agree = len(self._refused) >= AGREEING and (alone or not self.owned)
        return agree or self._all_new(now)

    def _all_new(self, now: float) -> bool:
        """Whether all publishers are new; looked up at most every `LOOK` seconds."""
        if now - self._looked < LOOK:
            return False
        publishers = self._publishers()
        self._looked = now
        return bool(publishers) and not publishers & self._owners


class SecondPublisher:
    """Whether a subscription has a second publisher, or had one since the last call, as DDS knows then.

    The events that an executor takes come too late: behind the first message of a publisher.
    """

    def __init__(self, subscription: Any) -> None:
        """Watch a subscription, until `destroy`."""
        kind = QoSSubscriptionEventType.RCL_SUBSCRIPTION_MATCHED
        self._matched = rclpy_implementation.EventHandle(subscription.handle, kind)

    def __call__(self) -> bool:
        """Look."""
        with self._matched:
            matched = self._matched.take_event()
        return bool(
            matched.current_count > 1
            or (matched.total_count > 1 and matched.total_count_change > 0)
        )

    def destroy(self) -> None:
        """Release the subscription, which others would see until it is collected."""
        self._matched.destroy_when_not_in_use()


def _message(data: bytes, kind: Any) -> Any:
    """The message of a type that these bytes are."""
    try:
        return deserialize_message(data, kind)
    except Exception as error:
        # rclpy raises several kinds for damaged bytes, and gives them no public names
        raise MessageError(f"{len(data)} bytes are not a {kind.__name__}") from error


def _refuse(request: Any, response: Any, why: str) -> Any:
    """A response that says why there is no other one, where its type has a place for that."""
    if hasattr(response, "results"):
        response.results = [SetParametersResult(successful=False, reason=why)] * len(
            request.parameters
        )
    elif isinstance(getattr(response, "result", None), SetParametersResult):
        response.result = SetParametersResult(successful=False, reason=why)
    elif hasattr(response, "message"):
        response.success = False
        response.message = printable(why)
    return response
