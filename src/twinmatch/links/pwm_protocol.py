"""The host side of the protocol, without a port and without a clock.

One request is outstanding at a time. Replies are matched by their sequence number: a reply to an earlier
request is counted and dropped; a damaged one marks the request as spoiled, so that the caller can repeat it
at once instead of waiting.
"""

from __future__ import annotations

from twinmatch.links.pwm_frame import Damage, FrameReader, seal
from twinmatch.links.pwm_messages import (
    SEQUENCES,
    Banner,
    Refusal,
    Reply,
    Request,
    Status,
    Verb,
    parse_reply,
)

__all__ = ["Conversation"]


class Conversation:
    """Numbers requests and finds their replies in the received bytes.

    `first` is the sequence number of the first request. A random one for every session prevents late replies
    to an earlier session from being accepted.
    """

    def __init__(self, first: int = 0) -> None:
        self._reader = FrameReader()
        self._next = first % SEQUENCES
        self._request: Request | None = None
        self.damaged = 0
        """Damaged or mismatched replies since this request was sent."""
        self.stale = 0
        """Replies to earlier requests since this one was sent."""
        self.spoiled = False
        """Whether waiting longer is useless because the request or its reply was damaged."""
        self.refused_line: Refusal | None = None
        """The board's report that it could not read the request, since this was last sent."""

    @property
    def outstanding(self) -> Request | None:
        """The request without a reply yet."""
        return self._request

    def ask(self, verb: Verb, pwm: int = 0) -> bytes:
        """Start a new request and abandon the outstanding one; returns the bytes to send."""
        self._request = Request(verb, self._next, pwm)
        self._next = (self._next + 1) % SEQUENCES
        self.damaged = self.stale = 0
        return self.repeat()

    def repeat(self) -> bytes:
        """The bytes of the outstanding request again, under the same number.

        Raises:
            ValueError: no request is outstanding.
        """
        if self._request is None:
            raise ValueError("conversation: no request is outstanding; ask() first")
        self.spoiled = False
        self.refused_line = None
        return seal(str(self._request))

    def hear(self, data: bytes) -> Reply | None:
        """Take received bytes; returns the reply to the outstanding request once it is complete."""
        answer = None
        for event in self._reader.feed(data):
            answer = self._judge(event) or answer
        return answer

    def _judge(self, event: bytes | Damage) -> Reply | None:
        if self._request is None:
            return None
        reply = None if isinstance(event, Damage) else parse_reply(event)
        if isinstance(reply, Refusal) and reply.sequence is None:
            self.refused_line = reply
            self.spoiled = True
        elif reply is not None and reply.sequence != self._request.sequence:
            self.stale += 1
        elif reply is None or not _fits(reply, self._request.verb):
            self.damaged += 1
            self.spoiled = True
        else:
            self._request = None
            return reply
        return None


def _fits(reply: Reply, verb: Verb) -> bool:
    if isinstance(reply, Refusal):
        return True
    return isinstance(reply, Banner if verb is Verb.HELLO else Status)
