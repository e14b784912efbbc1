"""A Modbus device as a source, over TCP or a serial line (RTU). It reads, and writes nothing."""

from __future__ import annotations

import logging
import re
import socket
import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from typing import Any, Final
from urllib.parse import parse_qsl

from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU
from serial import Serial

from twinmatch.ending import end_in_order
from twinmatch.errors import TwinmatchError
from twinmatch.links import Background
from twinmatch.sampling import registers
from twinmatch.sampling.channels import Channel, SamplingError
from twinmatch.sampling.listener import Receive
from twinmatch.sampling.registers import Span, Values, parse_place

__all__ = ["ModbusSource", "listing", "open_source", "parse_place"]

_TCP: Final = re.compile(
    r"modbus://(\[[\da-f:.]+]|[^][/?#@:\s]+)(?::(\d{1,5}))?/(\d{1,3})", re.A | re.I
)
_RTU: Final = re.compile(r"modbus\+rtu://(/[^?#]+)(?:\?(.*))?")
_KEYS: Final = {
    "baud": r"[1-9]\d{2,5}",
    "parity": "[NEO]",
    "stop": "[12]",
    "unit": r"[1-9]\d?|1\d\d|2[0-3]\d|24[0-7]",
}
_USUAL: Final = {"baud": "9600", "parity": "N", "stop": "1", "unit": "1"}
_FORM: Final = "write modbus://HOST:PORT/UNIT or modbus+rtu:///dev/ttyUSB0?baud=9600&parity=N&stop=1&unit=1"
_BUSY: Final = 6
_ANSWERS: Final = {
    1: "illegal function",
    2: "illegal address",
    3: "illegal value",
    4: "device failure",
    5: "not ready yet",
    _BUSY: "busy",
    10: "the gateway has no way to the device",
    11: "the device behind the gateway does not answer",
}
_BUSY_PAUSE: Final = 0.02
"""Before a device that is busy is asked again, s."""
_BUSY_SHARE: Final = 0.7
"""Share of a period after which a busy device is not asked again within it."""
_BUSY_START: Final = 3.0
"""How long a busy device is asked again at the start, s."""
_FUNCTIONS: Final = {"coil": 1, "discrete": 2, "holding": 3, "input": 4}
"""Code of the function that reads a table."""
_PATIENCE: Final = 1.0
"""Longest wait for a connection or an answer, and the pause after a failure, s."""

# it would print each lost answer
logging.getLogger("pymodbus").addHandler(logging.NullHandler())


class ModbusError(TwinmatchError):
    """A Modbus device cannot be read."""


class RefusedReadError(ModbusError):
    """It answers that it cannot be read there."""


class BusyError(ModbusError):
    """It answers that it has no time now."""


class _ReadAnswer(ModbusPDU):
    """An answer with values, undecoded: pymodbus takes byte counts that do not fit for right."""

    rtu_byte_count_pos = 2
    payload = b""

    def decode(self, data: bytes) -> None:
        """Keep the byte count and what follows it."""
        self.payload = data


_READ_ANSWERS: Final = [
    type(f"_ReadAnswer{code}", (_ReadAnswer,), {"function_code": code})
    for code in _FUNCTIONS.values()
]


class ModbusDevice:
    """One unit, for one thread at a time; reading connects where there is no connection."""

    _ERROR: Final = 0x80
    """Bit of the function code that marks an answer as an error."""
    _QUOTED: Final = 24
    """Most bytes of an answer that a message quotes."""

    def __init__(self, url: str) -> None:
        """Parse the URL; raise a ModbusError if it cannot be used."""
        self._text = url.partition("?")[0]
        tcp = _TCP.fullmatch(url)
        rtu = _RTU.fullmatch(url)
        line_settings = (
            dict(parse_qsl(rtu[2] or "", keep_blank_values=True)) if rtu else {}
        )
        wrong = []
        for key, value in line_settings.items():
            if not re.fullmatch(_KEYS.get(key, "(?!)"), value, re.A):
                wrong.append(f"{key}={value}")
        keys = _USUAL | line_settings
        self._tcp = bool(tcp)
        self._client: Any  # its methods have no types
        self._open: partial[Any]
        if rtu and not wrong:
            baud = int(keys["baud"])
            self._unit = int(keys["unit"])
            self._client = ModbusSerialClient(
                rtu[1],
                baudrate=baud,
                timeout=_PATIENCE,
                retries=0,
                trace_packet=self._trace,
            )
            line = partial(
                Serial, rtu[1], baud, parity=keys["parity"], stopbits=int(keys["stop"])
            )
            self._open = partial(
                line, timeout=_PATIENCE, write_timeout=_PATIENCE, exclusive=True
            )
        elif tcp and (port := int(tcp[2] or 502)) < 65536 and int(tcp[3]) < 256:
            host = tcp[1].strip("[]")
            self._unit = int(tcp[3])
            self._client = ModbusTcpClient(
                host, port=port, timeout=_PATIENCE, retries=0, trace_packet=self._trace
            )
            self._open = partial(socket.create_connection, (host, port), _PATIENCE)
        else:
            raise ModbusError(
                f"{self._text}: {', '.join(wrong) or 'this URL'} cannot be used; {_FORM}"
            )
        self._sent = b""
        self._received = b""
        for answer in _READ_ANSWERS:
            self._client.register(answer)

    def read(self, span: Span) -> Values:
        """The values of a span that one request may read; raise a ModbusError if they do not come."""
        table, first, end = span
        where = f"{self._text}: {registers.span_text(span)}"
        answer = self._request(table, first, end - first, where)
        code = answer.function_code & ~self._ERROR
        if code != _FUNCTIONS[table]:
            self._leave()
            raise ModbusError(
                f"{where}: the answer is of function {code}, but function {_FUNCTIONS[table]} was asked "
                f"({self._quoted}); is this a Modbus device?"
            )
        if answer.isError():
            text = f"{_ANSWERS.get(answer.exception_code, 'error')} ({answer.exception_code})"
            refusal = BusyError if answer.exception_code == _BUSY else RefusedReadError
            raise refusal(f"{where}: the device answers: {text}")
        try:
            return registers.values_in(answer.payload, span)
        except registers.NoValuesError as error:
            raise ModbusError(f"{self._text}: {error}") from None
        except SamplingError as error:
            self._leave()
            raise ModbusError(
                f"{self._text}: {error} ({self._quoted}); is this a Modbus device?"
            ) from None

    def _request(self, table: str, first: int, count: int, where: str) -> Any:
        """The answer to a request, which may be a refusal; raise a ModbusError if none comes."""
        client = self._client
        self._received = b""
        reads = {
            "coil": client.read_coils,
            "discrete": client.read_discrete_inputs,
            "holding": client.read_holding_registers,
            "input": client.read_input_registers,
        }
        try:
            # its own way to connect does not say what failed
            client.socket = client.socket or self._open()
            return reads[table](first, count=count, device_id=self._unit)
        except (OSError, ValueError) as error:
            raise ModbusError(
                f"{where}: no connection ({error}); check the address"
            ) from None
        except ModbusException as error:
            self._leave()
            to_check = "the unit" if self._tcp else "unit, baud, parity and stop"
            received = ""
            if self._received:
                numbers = self._numbers_differ
                received = f" (the answer is damaged, or belongs to another request{numbers}: {self._quoted})"
            raise ModbusError(
                f"{where}: no valid answer within {_PATIENCE:g} s{received}; check {to_check}"
            ) from error

    @property
    def _quoted(self) -> str:
        """The bytes since the last request, in hexadecimal."""
        return self._received[: self._QUOTED].hex(" ") + (
            " …" if len(self._received) > self._QUOTED else ""
        )

    @property
    def _numbers_differ(self) -> str:
        """That request and answer have different numbers, over TCP; empty if not."""
        asked = int.from_bytes(self._sent[:2], "big")
        answered = int.from_bytes(self._received[:2], "big")
        return (
            f", number {answered} instead of {asked}"
            if self._tcp and asked != answered
            else ""
        )

    def _trace(self, sending: bool, data: bytes) -> bytes:
        if sending:
            self._sent = data
        else:
            self._received = data
        return data

    def _leave(self) -> None:
        """Close a connection on which an answer was amiss: another one may be under way.

        A serial line stays open, as opening it restarts some devices.
        """
        if self._tcp:
            self._client.close()

    def patiently(self, span: Span, longest: float) -> Values:
        """Read a span, again and again for `longest` s while the device is busy."""
        until = time.monotonic() + longest
        while True:
            try:
                return self.read(span)
            except BusyError:
                if time.monotonic() + _BUSY_PAUSE > until:
                    raise
            time.sleep(_BUSY_PAUSE)

    def surely(self, span: Span) -> Values:
        """Read a span in up to three attempts: opening a serial line may have restarted the device."""
        for _ in range(2):
            with suppress(ModbusError):
                return self.patiently(span, _BUSY_START)
        return self.patiently(span, _BUSY_START)

    def close(self) -> None:
        """Disconnect."""
        self._client.close()


class ModbusSource:
    """Reads the places of some channels once per period, in a thread of its own."""

    def __init__(
        self,
        device: ModbusDevice,
        period: float,
        wanted: list[Channel],
        receive: Receive,
    ) -> None:
        """Send nothing yet."""
        self.kinds: dict[str, str] = {}
        # what is not answered becomes stale: there is a reading per period, or none
        self.lost = ""
        self._device = device
        self._period = period
        self._channels = wanted
        self._receive = receive
        self._requests = registers.joined(map(registers.span_of, wanted))
        # older ones would be stale
        self._cycles: deque[tuple[int, Values]] = deque(maxlen=3)
        self._newest: dict[tuple[str, int], int] = {}
        """The values of the newest cycle."""
        self._trouble = ""
        self._handed = 0.0
        self._thread = Background("modbus", self._run, 3 * _PATIENCE)

    def search(self, waited: float) -> None:  # noqa: ARG002
        """Read each place once, and start the thread; raise a ModbusError if one cannot be read."""
        if not self.kinds:
            for channel in self._channels:
                self._newest |= self._first(channel)
            self._requests = [
                part for request in self._requests for part in self._accepted(request)
            ]
            self.kinds = dict.fromkeys(
                (channel.topic for channel in self._channels), ""
            )
            self._thread.start()

    def _first(self, channel: Channel) -> Values:
        """The values of a place; raise a ModbusError if it cannot be read."""
        table, first, end = registers.span_of(channel)
        try:
            return self._device.surely((table, first, end))
        except RefusedReadError:
            if end - first == 1:
                raise
            with suppress(RefusedReadError):
                for address in range(first, end):
                    self._device.surely((table, address, address + 1))
                raise ModbusError(
                    f"{channel.text}: the device gives one register per request, so that this number would "
                    "be put together from several moments; map a place of one register"
                ) from None
            raise

    def _accepted(self, request: Span) -> list[Span]:
        """The requests by which a device gives what is in one: that, or one for each place in it."""
        table, first, end = request
        spans = {registers.span_of(channel) for channel in self._channels}
        inside = sorted(
            span for span in spans if span[0] == table and first <= span[1] < end
        )
        try:
            self._device.surely(request)
        except RefusedReadError:
            if len(inside) < 2:
                raise
            return inside
        return [request]

    def path(self, channel: Channel) -> str:
        """Type and order."""
        return channel.path

    def poll(self) -> None:
        """Hand on the oldest cycle; half a period apart, so that a sampler that was held up keeps all."""
        if self._thread.failure is not None:
            raise self._thread.failure
        if self._cycles and time.monotonic() >= self._handed + self._period / 2:
            self._handed = time.monotonic()
            stamp, values = self._cycles.popleft()
            for topic in self.kinds:
                self._receive(topic, partial(registers.number_at, values), stamp)

    def trouble(self, topic: str) -> str:
        """Why the newest cycle was dropped, or the order in which a number would be a reading."""
        newest = self._newest
        doubts = [
            registers.doubt(newest, channel)
            for channel in self._channels
            if channel.topic == topic
        ]
        return self._trouble or next(filter(None, doubts), "")

    def news(self) -> list[str]:
        """Nothing: what is wrong is an error or a trouble."""
        return []

    def close(self) -> bool:
        """End the thread, and disconnect."""
        return end_in_order(self._thread.close, self._device.close)

    def _run(self) -> None:
        due = time.monotonic()
        while not self._thread.ending.wait(max(due - time.monotonic(), 0.0)):
            pause = 0.0
            try:
                values: dict[tuple[str, int], int] = {}
                for span in self._requests:
                    left = due + _BUSY_SHARE * self._period - time.monotonic()
                    values |= self._device.patiently(span, left)
                self._newest = values
                self._cycles.append((time.time_ns(), values))
                self._trouble = ""
            except BusyError as error:
                self._trouble = str(error)
            except ModbusError as error:
                self._trouble = str(error)
                pause = _PATIENCE
            late = time.monotonic() - due + pause
            due += self._period * (1 + late // self._period)


def open_source(
    url: str, period: float, channels: list[Channel], receive: Receive
) -> ModbusSource:
    """The places of the device at a URL; raise a ModbusError if it cannot be used."""
    return ModbusSource(ModbusDevice(url), period, channels, receive)


def listing(url: str, where: str) -> Iterator[str]:
    """The values of a range such as `holding/0-50`, a line each, then the parts that cannot be read.

    Raises:
        TwinmatchError: URL or range cannot be used, or the device does not answer.
    """
    device = ModbusDevice(url)
    span = registers.parse_range(where or "holding/0-49")
    try:
        yield from registers.described(_readable(device, *span), span)
    finally:
        device.close()


def _readable(device: ModbusDevice, table: str, first: int, end: int) -> Values:
    """The values of a span that can be read, found by halving what is refused."""
    try:
        if end - first <= registers.LONGEST[table]:
            return device.patiently((table, first, end), _BUSY_START)
    except RefusedReadError:
        if end - first == 1:
            return {}
    middle = (first + end) // 2
    return {
        **_readable(device, table, first, middle),
        **_readable(device, table, middle, end),
    }
