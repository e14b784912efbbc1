"""One request and its reply over a serial port, with retries, and an error for each kind of failure."""

from __future__ import annotations

import contextlib
import secrets
import time

import serial

from twinmatch.links.pwm_errors import (
    PwmCorruptReplyError,
    PwmLinkError,
    PwmPortLostError,
    PwmRejectedError,
    PwmStaleReplyError,
    PwmTimeoutError,
)
from twinmatch.links.pwm_messages import SEQUENCES, Reply, Verb
from twinmatch.links.pwm_port import WIRE_ERRORS, LinkSettings, open_port
from twinmatch.links.pwm_protocol import Conversation

__all__ = ["Exchange"]


class Exchange:
    """An open port and the conversation on it.

    Raises:
        PwmPortMissingError, PwmPortBusyError: the port cannot be opened.
    """

    def __init__(self, port: str, settings: LinkSettings) -> None:
        self.port = port
        self.settings = settings
        self._wire: serial.Serial | None = open_port(port, settings.timeout)
        # A random number, so that late replies to an earlier session are not taken for ours.
        self._talk = Conversation(secrets.randbelow(SEQUENCES))

    @property
    def is_open(self) -> bool:
        """Whether the port is still held."""
        return self._wire is not None

    def ask(self, verb: Verb, pwm: int = 0) -> Reply:
        """Send a request and return its reply, with retries under the same sequence number.

        Raises:
            PwmPortLostError: the port was lost; it is closed now.
            PwmTimeoutError, PwmCorruptReplyError, PwmStaleReplyError, PwmRejectedError: there was no valid
                reply.
        """
        line = self._talk.ask(verb, pwm)
        for attempt in range(self.settings.retries + 1):
            if attempt:
                line = self._talk.repeat()
            reply = self._attempt(line)
            if reply is not None:
                return reply
        raise self._unanswered(verb)

    def close(self) -> None:
        """Release the port, whatever its state."""
        if self._wire is not None:
            with contextlib.suppress(*WIRE_ERRORS):
                self._wire.close()
        self._wire = None

    def _attempt(self, line: bytes) -> Reply | None:
        """Send a line and wait for its reply; None if none arrived in time or it was damaged."""
        if self._wire is None:
            msg = f"PWM link: {self.port} was lost; reopen() it"
            raise PwmPortLostError(msg)
        try:
            self._wire.write(line)
            end = time.monotonic() + self.settings.timeout
            while (left := end - time.monotonic()) > 0 and not self._talk.spoiled:
                self._wire.timeout = left
                reply = self._talk.hear(self._wire.read(max(1, self._wire.in_waiting)))
                if reply is not None:
                    return reply
        except serial.SerialTimeoutException:
            return None  # the board accepts no bytes: equivalent to no answer
        except WIRE_ERRORS as error:
            self.close()
            msg = f"PWM link: {self.port} was lost ({error}); check the cable, then reopen()"
            raise PwmPortLostError(msg) from error
        return None

    def _unanswered(self, verb: Verb) -> PwmLinkError:
        talk, tries = self._talk, self.settings.retries + 1
        what = f"PWM link: {self.port} gave {verb.name.lower()} no answer in {tries} attempts"
        if talk.refused_line is not None:
            code = talk.refused_line.code
            return PwmRejectedError(f"{what}: requests arrive damaged ({code.value}); check the cable", code)
        if talk.damaged:
            return PwmCorruptReplyError(f"{what}: {talk.damaged} arrived damaged; check the cable")
        if talk.stale:
            return PwmStaleReplyError(
                f"{what}: {talk.stale} replies were to earlier requests; is the machine overloaded?"
            )
        wait = f"{self.settings.timeout:g} s"
        return PwmTimeoutError(f"{what} of {wait}; is this the right port, and is the board running?")
