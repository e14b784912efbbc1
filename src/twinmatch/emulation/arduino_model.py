"""The firmware's behaviour in Python, one millisecond at a time, for machines without an AVR simulator.

It follows `firmware/twinmatch_leonardo` rule by rule; the same test scenarios run against both.
"""

from __future__ import annotations

from twinmatch.links.pwm_link import AMPERES_PER_COUNT
from twinmatch.links.pwm_protocol import (
    PROTOCOL,
    SEQUENCES,
    Banner,
    BoardStatus,
    Code,
    Damage,
    Flags,
    FrameReader,
    Refusal,
    Reply,
    Request,
    Verb,
    is_newer,
    parse_request,
    seal,
)

__all__ = ["DEADLINE_MS", "FIRMWARE", "ArduinoModel"]

FIRMWARE = "standin-1.0.0"
"""Firmware name in the banner, which cannot be mistaken for the real firmware."""

DEADLINE_MS = 1000
_WATCHDOG_MS = 500
_REVERSAL_MS = 2
_SETTLE_MS = 10
_DEBOUNCE_MS = 5
_WATCHDOG_RESET = 0x08  # WDRF of MCUSR
_POWER_ON = 0x01  # PORF of MCUSR


class ArduinoModel:
    """The board between its serial line and the driver's pins."""

    def __init__(self) -> None:
        self.counts = 0
        """Reading of the current feedback, 0 to 1023."""
        self.fault = False
        """Whether the driver pulls its fault flag."""
        self.restarts = 0
        """Starts since power-up."""
        self._time_ms = 0
        self._reader = FrameReader()
        self._boot(_POWER_ON)

    @property
    def level(self) -> int:
        """PWM on the pins, −255 to 255."""
        return self._level

    @property
    def enabled(self) -> bool:
        """Whether the driver is on."""
        return bool(self._flags & Flags.ENABLED)

    def set_current(self, amperes: float) -> None:
        """Show a current on the feedback pin, A."""
        self.counts = min(1023, max(0, round(amperes / AMPERES_PER_COUNT)))

    def hang(self) -> None:
        """Stop everything except the watchdog."""
        self._hung_ms = 1

    def tick(self, data: bytes = b"") -> bytes:
        """Advance by one millisecond: takes received bytes, returns the bytes to send."""
        if self._hung_ms:
            return self._tick_hung()
        self._time_ms = (self._time_ms + 1) % 2**32
        self._watch_host()
        self._watch_driver()
        self._input += self._reader.feed(data)
        out = self._finish_turn() if self._turn else []
        while self._input and not self._turn:
            out += self._answer(self._input.pop(0))
        return b"".join(seal(str(reply)) for reply in out)

    def _boot(self, cause: int) -> None:
        self._cause = cause
        self._flags = Flags.TRIPPED | Flags.RESET
        self._level = self._time_ms = self._remaining = self._settle = self._low = self._hung_ms = 0
        self._heat = True
        self._last: int | None = None
        self._reader = FrameReader()
        self._input: list[bytes | Damage] = []
        self._turn: tuple[int, Request] | None = None

    def _tick_hung(self) -> bytes:
        self._hung_ms += 1
        if self._hung_ms > _WATCHDOG_MS:
            self.restarts = (self.restarts + 1) % SEQUENCES
            self._boot(_WATCHDOG_RESET)
        return b""

    def _watch_host(self) -> None:
        if self._remaining:
            self._remaining -= 1
            if not self._remaining:
                self._latch(Flags.DEADLINE)

    def _watch_driver(self) -> None:
        if not self.enabled:
            return
        if self._settle:
            self._settle -= 1
        else:
            self._low = self._low + 1 if self.fault else 0
            if self._low >= _DEBOUNCE_MS:
                self._latch(Flags.DRIVER)

    def _latch(self, reason: Flags) -> None:
        self._disable()
        self._flags |= Flags.TRIPPED | reason

    def _disable(self) -> None:
        self._level = 0
        self._flags &= ~Flags.ENABLED

    def _answer(self, event: bytes | Damage) -> list[Reply]:
        if isinstance(event, Damage):
            return [Refusal(None, Code(event.value))]
        request = parse_request(event)
        if isinstance(request, Refusal):
            return [request]
        if request.verb is Verb.HELLO:
            return [self._greet(request)]
        if request.verb is Verb.SET:
            return self._set(request)
        if request.verb is Verb.QUERY:
            return [self._status(request)]
        return [self._clear(request)]

    def _greet(self, request: Request) -> Banner:
        self._disable()
        self._remaining = 0
        self._last = request.sequence
        return Banner(request.sequence, FIRMWARE, PROTOCOL, self._cause, DEADLINE_MS, self.restarts)

    def _set(self, request: Request) -> list[Reply]:
        if self._flags & Flags.TRIPPED:
            return [Refusal(request.sequence, Code.LATCHED)]
        if not self._is_new(request):
            return [self._status(request, Flags.DUPLICATE)]
        if request.pwm and (request.pwm > 0) != self._heat:
            self._level = 0
            self._turn = _REVERSAL_MS, request
            return []
        return [self._apply(request)]

    def _finish_turn(self) -> list[Reply]:
        assert self._turn is not None  # noqa: S101  (asked by the only caller)
        left, request = self._turn
        if left > 1:
            self._turn = left - 1, request
            return []
        self._turn = None
        self._heat = request.pwm > 0
        return [self._apply(request)]

    def _apply(self, request: Request) -> Reply:
        if self._flags & Flags.TRIPPED:  # during the turn
            return Refusal(request.sequence, Code.LATCHED)
        self._remaining = DEADLINE_MS
        if not self.enabled:
            self._settle, self._low = _SETTLE_MS, 0
            self._flags |= Flags.ENABLED
        self._level = request.pwm
        return self._status(request)

    def _clear(self, request: Request) -> BoardStatus:
        if not self._is_new(request):
            return self._status(request, Flags.DUPLICATE)
        self._disable()
        self._remaining = 0
        self._flags = Flags.NONE
        return self._status(request)

    def _is_new(self, request: Request) -> bool:
        if self._last is not None and not is_newer(request.sequence, self._last):
            return False
        self._last = request.sequence
        return True

    def _status(self, request: Request, extra: Flags = Flags.NONE) -> BoardStatus:
        return BoardStatus(request.sequence, self._time_ms, self._level, self.counts, self._flags | extra)
