"""Devices of pymodbus as a source, over TCP and a serial line: in step, through losses, and only read."""

from __future__ import annotations

import asyncio
import os
import pty
import re
import select
import signal
import socket
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.client import ModbusTcpClient
from pymodbus.pdu import ModbusPDU
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.server.base import ModbusBaseServer
from pymodbus.simulator import DataType, SimData, SimDevice

from tests.support.foreign_rig import Oven
from tests.support.oven import HOLD, oven_file
from tests.support.places import PROJECT
from tests.support.processes import VERDICT_LINE, Processes, no_plant_files
from tests.support.waiting import PATIENCE, wait_for
from twinmatch.cli import main
from twinmatch.links.modbus_source import (
    ModbusDevice,
    ModbusError,
    RefusedReadError,
    listing,
    open_source,
)
from twinmatch.parameters.sampler import (
    listener_of,
    sampler_values,
    source_of,
    sources_of,
)
from twinmatch.sampling.channels import Channel, SamplingError
from twinmatch.sampling.listener import SignalListener
from twinmatch.sampling.registers import (
    LONGEST,
    described,
    doubt,
    joined,
    number_at,
    parse_place,
    parse_range,
    span_of,
    values_in,
)
from twinmatch.sampling.sources import SignalMap, parse_map
from twinmatch.sessions import read_session
from twinmatch.signals import Sample

PERIOD = 0.05
PLACES = (
    "reference=holding/0; scale=0.01",
    "output=holding/1:float32 little",
    "input=input/5:uint16; scale=0.01",
)
TYPES = {
    "int16": 16,
    "uint16": 16,
    "int32": 32,
    "uint32": 32,
    "int64": 64,
    "uint64": 64,
}
DATATYPE = ModbusTcpClient.DATATYPE
to_registers = ModbusTcpClient.convert_to_registers


class ServedOven:
    """The oven in a device's registers: reading set-point and reading together takes it a tick further."""

    def __init__(self) -> None:
        self._oven = Oven(PERIOD, HOLD)
        self.served: list[tuple[float, float, float]] = []
        self._step()

    def _step(self) -> None:
        self.served.append(self._oven.step())

    async def read(
        self,
        code: int,
        _start: int,
        address: int,
        count: int,
        words: list[int],
        _wanted: object,
    ) -> None:
        if (code, address, count) == (3, 0, 3):
            self._step()
        wanted, reading, heater = self.served[-1]
        if code == 3:
            words[:3] = [
                round(100 * wanted),
                *to_registers(reading, DATATYPE.FLOAT32, "little"),
            ]
        if code == 4:
            words[5] = round(100 * heater)

    def device(self) -> SimDevice:
        bits = [True, False, False, True] * 8
        words = [7, 0, 16968, 65535, 0, 0, 0, 0]
        tables = (
            [SimData(0, values=bits, datatype=DataType.BITS)],
            [SimData(0, values=bits[::-1], datatype=DataType.BITS)],
            [SimData(0, values=words, datatype=DataType.REGISTERS)],
            [SimData(0, values=words, datatype=DataType.REGISTERS)],
        )
        return SimDevice(1, tables, action=self.read)


class RunningDevice:
    """A server in a thread with a loop of its own, which may be ended and started again."""

    def __init__(
        self,
        make: Callable[[SimDevice, Any], ModbusBaseServer],
        device: SimDevice,
        url: str,
    ) -> None:
        self.url = url
        self.codes = set[int]()
        self._make = make
        self._device = device
        self.start()

    def start(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever)
        self._thread.start()
        asyncio.run_coroutine_threadsafe(self._serve(), self._loop).result(PATIENCE)

    async def _serve(self) -> None:
        self._server = self._make(self._device, self._trace)
        await self._server.serve_forever(background=True)

    def _trace(self, sending: bool, pdu: ModbusPDU) -> ModbusPDU:
        if not sending:
            self.codes.add(pdu.function_code)
        return pdu

    def end(self) -> None:
        """As if it lost its power."""
        if self._thread.is_alive():
            asyncio.run_coroutine_threadsafe(self._shutdown(), self._loop).result(
                PATIENCE
            )
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join()
            self._loop.close()

    async def _shutdown(self) -> None:
        await self._server.shutdown()  # type: ignore[no-untyped-call]
        unfinished = asyncio.all_tasks() - {asyncio.current_task()}
        for task in unfinished:
            task.cancel()
        await asyncio.gather(*unfinished, return_exceptions=True)


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


@pytest.fixture
def oven() -> ServedOven:
    return ServedOven()


@pytest.fixture
def device(oven: ServedOven) -> Iterator[RunningDevice]:
    port = free_port()

    def make(simulated: SimDevice, trace: Any) -> ModbusBaseServer:
        return ModbusTcpServer(simulated, address=("127.0.0.1", port), trace_pdu=trace)

    running = RunningDevice(make, oven.device(), f"modbus://127.0.0.1:{port}/1")
    yield running
    running.end()
    assert running.codes <= {1, 2, 3, 4}  # those that read


@pytest.fixture
def line(oven: ServedOven) -> Iterator[RunningDevice]:
    """The same behind two pseudo-terminals, whose other sides pass on what each receives."""
    ours, our_end = pty.openpty()
    theirs, their_end = pty.openpty()
    for end in (our_end, their_end):
        tty.setraw(end)
    halt, halted = os.pipe()

    def pass_on() -> None:
        while halt not in (ready := select.select([ours, theirs, halt], [], [])[0]):
            for side in ready:
                os.write(theirs if side == ours else ours, os.read(side, 4096))

    wire = threading.Thread(target=pass_on)
    wire.start()

    def make(simulated: SimDevice, trace: Any) -> ModbusBaseServer:
        return ModbusSerialServer(
            simulated, port=os.ttyname(their_end), baudrate=115200, trace_pdu=trace
        )

    url = f"modbus+rtu://{os.ttyname(our_end)}?baud=115200&unit=1"
    running = RunningDevice(make, oven.device(), url)
    yield running
    running.end()
    os.write(halted, b"\0")
    wire.join()
    for handle in (ours, our_end, theirs, their_end, halt, halted):
        os.close(handle)
    assert running.codes <= {1, 2, 3, 4}


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with no_plant_files():
        yield str(oven_file(tmp_path_factory.mktemp("plant")))


class Listening:
    """A listener on a device, and the samples it has given."""

    def __init__(self, url: str, plant: str, places: tuple[str, ...] = PLACES) -> None:
        mapped = parse_map(places).joined(SignalMap(plant=plant, period=PERIOD))
        values, _ = sampler_values(None, mapped, url)
        self.listener: SignalListener = listener_of("sampler", values, time.time_ns)
        opened = source_of(values)
        assert opened is not None
        self.samples: list[Sample] = []
        self.listener.open(opened)
        self.listener.search()

    def until(self, condition: Callable[[], Any], what: str) -> None:
        def look() -> Any:
            self.samples += self.listener.samples()
            return condition()

        wait_for(
            look,
            lambda: (
                f"{what}; {len(self.samples)} samples, {self.listener.trouble('output')}"
            ),
        )


@pytest.fixture
def listen(plant: str) -> Iterator[Callable[..., Listening]]:
    opened: list[Listening] = []

    def start(url: str, *places: str) -> Listening:
        opened.append(Listening(url, plant, places or PLACES))
        return opened[-1]

    yield start
    for listening in opened:
        listening.listener.close()


def assert_served(samples: list[Sample], oven: ServedOven) -> None:
    """Each sample is one tick as it was served: a float32, and hundredths in integers."""
    ticks = {
        float(np.float32(reading)): k for k, (_, reading, _) in enumerate(oven.served)
    }
    order = [ticks[sample.output] for sample in samples]
    assert order == sorted(set(order))
    for tick, sample in zip(order, samples, strict=True):
        wanted, _, heater = oven.served[tick]
        assert sample.reference == pytest.approx(wanted, abs=1e-9)
        assert sample.input == pytest.approx(heater, abs=0.005 + 1e-9)
    indices = [sample.index for sample in samples]
    assert indices == sorted(set(indices))


def test_samples_over_tcp_are_what_was_served(
    device: RunningDevice, oven: ServedOven, listen: Callable[..., Listening]
) -> None:
    listening = listen(device.url)
    assert listening.listener.failed is None
    listening.until(lambda: len(listening.samples) > 2 * HOLD, "two set-points")
    assert_served(listening.samples, oven)
    assert device.codes == {3, 4}


def test_samples_over_a_serial_line_are_what_was_served(
    line: RunningDevice, oven: ServedOven, listen: Callable[..., Listening]
) -> None:
    listening = listen(line.url)
    assert listening.listener.failed is None
    listening.until(lambda: len(listening.samples) > 30, "samples")
    assert_served(listening.samples, oven)


def test_a_device_that_is_off_for_a_while_leaves_a_gap_and_is_reported(
    device: RunningDevice, oven: ServedOven, listen: Callable[..., Listening]
) -> None:
    listening = listen(device.url)
    listening.until(lambda: len(listening.samples) > 5, "samples")
    device.end()
    no_connection = "no connection .*Connection refused"
    listening.until(
        lambda: re.search(no_connection, listening.listener.trouble("output")),
        "what is wrong",
    )
    assert "holding/0-2" in listening.listener.trouble("output")
    before = len(listening.samples)
    device.start()
    listening.until(lambda: len(listening.samples) > before + 5, "samples again")
    assert_served(listening.samples, oven)
    indices = [sample.index for sample in listening.samples]
    assert max(np.diff(indices)) > 3  # the values of three periods may be held
    assert not listening.listener.trouble("output")


def test_a_line_that_falls_silent_is_reported_and_read_again(
    line: RunningDevice, oven: ServedOven, listen: Callable[..., Listening]
) -> None:
    listening = listen(line.url)
    listening.until(lambda: len(listening.samples) > 5, "samples")
    line.end()
    listening.until(
        lambda: (
            "no valid answer within 1 s; check unit, baud"
            in listening.listener.trouble("output")
        ),
        "silence",
    )
    before = len(listening.samples)
    line.start()
    listening.until(lambda: len(listening.samples) > before + 5, "samples again")
    assert_served(listening.samples, oven)


def test_nonsense_from_the_network_ends_nothing(
    device: RunningDevice, listen: Callable[..., Listening]
) -> None:
    """Something else takes the port, and answers with nonsense."""
    listening = listen(device.url)
    listening.until(lambda: len(listening.samples) > 3, "samples")
    device.end()
    port = int(device.url.partition("1:")[2].partition("/")[0])
    noise = np.random.default_rng(3)
    with socket.create_server(("127.0.0.1", port)) as server:
        server.settimeout(PATIENCE)
        for _ in range(4):
            with server.accept()[0] as connection:
                request = connection.recv(64)
                connection.sendall(request[:7] + noise.bytes(30))
    before = len(listening.samples)
    device.start()
    listening.until(lambda: len(listening.samples) > before + 3, "samples again")


class AnsweringWrongly:
    """A server that answers each request over TCP with what `answer` makes of it."""

    def __init__(self, answer: Callable[[bytes], bytes]) -> None:
        self._answer = answer
        self._server = socket.create_server(("127.0.0.1", 0))
        self.url = f"modbus://127.0.0.1:{self._server.getsockname()[1]}/1"
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        with suppress(OSError):  # it has been closed
            while True:
                with self._server.accept()[0] as connection:
                    while request := connection.recv(64):
                        connection.sendall(self._answer(request))

    def close(self) -> None:
        self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        self._thread.join()


def framed(
    request: bytes, pdu: bytes, *, transaction: int = 0, unit: int = 1, longer: int = 0
) -> bytes:
    """An answer to a request over TCP, with a transaction and a length that are off by so many."""
    number = (int.from_bytes(request[:2], "big") + transaction) % 65536
    length = len(pdu) + 1 + longer
    return (
        number.to_bytes(2, "big")
        + b"\0\0"
        + length.to_bytes(2, "big")
        + bytes((unit,))
        + pdu
    )


RIGHT = bytes((3, 4, 0, 1, 0, 2))
"""Two holding registers."""


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (
            lambda r: framed(r, bytes((4, 4, 0, 1, 0, 2))),
            "the answer is of function 4, but function 3 was asked",
        ),
        (
            lambda r: framed(r, bytes((1, 4, 0, 1, 0, 2))),
            "the answer is of function 1, but function 3 was asked",
        ),
        (
            lambda r: framed(r, bytes((6, 0, 0, 0, 2))),
            "the answer is of function 6, but function 3 was asked",
        ),
        (
            lambda r: framed(r, bytes((0x84, 2))),
            "the answer is of function 4, but function 3 was asked",
        ),
        (
            lambda r: framed(r, bytes((3, 5, 0, 1, 0, 2))),
            "states 5 and has 4 bytes of values, not 4",
        ),
        (
            lambda r: framed(r, bytes((3, 3, 0, 1, 0, 2))),
            "states 3 and has 4 bytes of values, not 4",
        ),
        (
            lambda r: framed(r, bytes((3, 4, 0, 1, 0, 2, 0))),
            "states 4 and has 5 bytes of values, not 4",
        ),
        (
            lambda r: framed(r, bytes((3, 2, 0, 1))),
            "states 2 and has 2 bytes of values, not 4",
        ),
        (lambda r: framed(r, bytes((3,))), "has 0 bytes of values, not 4"),
        (
            lambda r: framed(r, bytes((3, 0))),
            "0 bytes of values: the device has none there now",
        ),
        (
            lambda r: framed(r, RIGHT, unit=2),
            "the answer is damaged, or belongs to another",
        ),
        (
            lambda r: framed(r, RIGHT, transaction=1),
            "belongs to another request, number 2 instead of 1: ",
        ),
        (
            lambda r: framed(r, RIGHT, transaction=-1),
            "the answer is damaged, or belongs to another",
        ),
        (
            lambda r: framed(r, RIGHT, longer=1),
            "the answer is damaged, or belongs to another",
        ),
        (
            lambda r: framed(r, RIGHT, longer=-1),
            "states 4 and has 3 bytes of values, not 4",
        ),
        (
            lambda r: framed(r, bytes((0x55, 4, 0, 1, 0, 2))),
            "the answer is damaged, or belongs to another",
        ),
    ],
)
def test_what_answers_another_request_is_not_taken_as_values(
    answer: Callable[[bytes], bytes], words: str
) -> None:
    server = AnsweringWrongly(answer)
    device = ModbusDevice(server.url)
    with pytest.raises(ModbusError) as caught:
        device.read(("holding", 0, 2))
    assert words in str(caught.value)
    # a listing would halve the range for ever
    assert not isinstance(caught.value, RefusedReadError)
    device.close()
    server.close()


def test_what_answers_the_request_is_taken_as_values() -> None:
    server = AnsweringWrongly(lambda request: framed(request, RIGHT))
    device = ModbusDevice(server.url)
    assert device.read(("holding", 0, 2)) == {("holding", 0): 1, ("holding", 1): 2}
    device.close()
    server.close()


@pytest.mark.parametrize("size", [0, 1, 3])
def test_bits_come_in_as_many_bytes_as_they_fill(size: int) -> None:
    answer = bytes((size, *range(size)))
    with pytest.raises(
        SamplingError, match=rf"answer to coil/0-8 states {size} and has {size} bytes"
    ):
        values_in(answer, ("coil", 0, 9))
    assert values_in(bytes((2, 0b101, 1)), ("coil", 0, 9)) == {
        ("coil", k): int(k in (0, 2, 8)) for k in range(9)
    }


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("holding/8", r"holding/8: the device answers: illegal address \(2\)"),
        ("holding/7:float32", r"holding/7-8: the device answers: illegal address"),
        ("input/400", "input/400: the device answers: illegal address"),
        ("coil/90", "coil/90: the device answers: illegal address"),
    ],
)
def test_a_place_that_a_device_does_not_have_is_an_error_at_the_start(
    device: RunningDevice, listen: Callable[..., Listening], place: str, words: str
) -> None:
    failed = listen(device.url, *PLACES[:2], f"input={place}").listener.failed
    assert failed is not None
    assert re.search(words, str(failed))


def test_no_device_at_the_start_is_an_error_with_its_reason(
    listen: Callable[..., Listening],
) -> None:
    failed = listen(f"modbus://127.0.0.1:{free_port()}/1").listener.failed
    assert "holding/0: no connection ([Errno 111] Connection refused)" in str(failed)
    failed = listen("modbus+rtu:///dev/no_such_line").listener.failed
    assert re.search(
        r"/dev/no_such_line: holding/0: no connection .*No such file", str(failed)
    )


def test_bits_and_means_are_read(
    device: RunningDevice, listen: Callable[..., Listening]
) -> None:
    listening = listen(
        device.url,
        PLACES[0],
        "output=holding/1:float32 little, holding/1:float32 little",
        "input=coil/3; scale=50",
    )
    listening.until(lambda: listening.samples, "a sample")
    assert listening.samples[0].input == 50.0
    assert device.codes == {1, 3}


def test_a_listing_shows_each_register_and_what_cannot_be_read(
    device: RunningDevice, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["attach", "--source", device.url, "--list", "input/0-20"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "input/0  uint16 7  int16 7"
    assert lines[1] == "input/1  uint16 0  int16 0  float32 little 50"
    assert lines[2] == "input/2  uint16 16968  int16 16968  float32 50.25"
    assert lines[3] == "input/3  uint16 65535  int16 -1"
    assert lines[-1] == "input/8-20  cannot be read"
    assert list(listing(device.url, "coil/2-3")) == ["coil/2  0", "coil/3  1"]
    assert list(listing(device.url, "discrete/0")) == ["discrete/0  1"]
    assert list(listing(device.url, "input/100-300")) == [
        "input/100-224  cannot be read",
        "input/225-300  cannot be read",
    ]
    default = list(listing(device.url, ""))
    assert default[0].startswith("holding/0 ")
    assert default[-1] == "holding/8-49  cannot be read"


@pytest.mark.parametrize(
    "url",
    [
        "modbus://",
        "modbus://host",
        "modbus://host/256",
        "modbus://host/one",
        "modbus://host:port/1",
        "modbus://host:70000/1",
        "modbus://me@host/1",
        "modbus://host/1?baud=9600",
        "modbuss://host/1",
        "modbus+udp://host/1",
        "modbus+rtu://host/1",
        "modbus+rtu://",
    ],
)
def test_a_url_that_cannot_be_used_is_one_message(url: str) -> None:
    with pytest.raises(
        ModbusError,
        match=r"this URL cannot be used; write modbus://HOST:PORT/UNIT or modbus\+rtu",
    ) as got:
        open_source(url, 1.0, [], lambda *_, **__: None)
    assert "\n" not in str(got.value)


@pytest.mark.parametrize(
    "setting",
    [
        "speed=1",
        "baud=fast",
        "baud=9",
        "parity=X",
        "stop=3",
        "unit=0",
        "unit=248",
        "unit=",
    ],
)
def test_a_setting_of_a_line_that_cannot_be_used_is_named(setting: str) -> None:
    with pytest.raises(ModbusError, match=f"{setting} cannot be used; write modbus"):
        open_source(
            f"modbus+rtu:///dev/ttyUSB0?{setting}", 1.0, [], lambda *_, **__: None
        )


@pytest.mark.parametrize(
    "text",
    [
        "", "holding", "holding/", "register/4", "holding/-1", "holding/65536", "holding/65535:int32",
        "coil/3:int16", "holding/4:double", "holding/4:float32 middle", "holding/4 float32", "40001",
    ],
)  # fmt: skip
def test_an_invalid_place_is_one_message(text: str) -> None:
    with pytest.raises(SamplingError, match="is not a place; write TABLE/ADDRESS"):
        parse_place(text)


@pytest.mark.parametrize(
    "text", ["holding/9-3", "holding/0-65536", "holding/0-x", "wire/0-3"]
)
def test_an_invalid_range_is_one_message(text: str) -> None:
    with pytest.raises(SamplingError, match=r"is not a (range|place); write"):
        parse_range(text)


def test_the_word_order_comes_through_maps_and_parameter_files(
    tmp_path: Path, plant: str
) -> None:
    text = f"sampler:\n  ros__parameters:\n    plant: {plant}\n    source: modbus://plc/1\n"
    text += "    map.input: holding/9\n    map.output: holding/100:float32 little, Input/4:INT32 Big; scale=0.1\n"
    (tmp_path / "rig.yaml").write_text(text)
    values, _ = sampler_values(tmp_path / "rig.yaml", SignalMap())
    for source in (
        sources_of("rig", values)["output"],
        parse_map(
            ["output=holding/100:float32 little, input/4:int32 big; scale=0.1"]
        ).sources["output"],
    ):
        channels = source.channels("output", parse_place)
        assert channels == (
            Channel("holding/100", "float32 little"),
            Channel("input/4", "int32 big"),
        )
        assert source.scale == 0.1
    assert [span_of(channel) for channel in channels] == [
        ("holding", 100, 102),
        ("input", 4, 6),
    ]


def numbers() -> st.SearchStrategy[tuple[str, float]]:
    whole = [
        st.tuples(
            st.just(kind),
            st.integers(0, 2**bits - 1)
            if kind[0] == "u"
            else st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1),
        )
        for kind, bits in TYPES.items()
    ]
    real = [
        st.tuples(st.just(f"float{bits}"), st.floats(width=bits, allow_nan=False))
        for bits in (32, 64)
    ]
    return st.one_of(*whole, *real)


@given(
    numbers(),
    st.sampled_from(["", "big", "little"]),
    st.sampled_from(["", "swapped"]),
    st.sampled_from(["holding", "input"]),
    st.integers(0, 65532),
)
def test_registers_give_the_number_that_pymodbus_put_into_them(
    typed: tuple[str, float], order: Any, swapped: str, table: str, address: int
) -> None:
    kind, number = typed
    words = to_registers(number, DATATYPE[kind.upper()], order or "big")
    if swapped:
        words = [int.from_bytes(word.to_bytes(2, "big"), "little") for word in words]
    place = parse_place(f"{table}/{address}:{kind} {order} {swapped}")
    assert span_of(place) == (table, address, address + len(words))
    values = {(table, address + k): word for k, word in enumerate(words)}
    assert number_at(values, place) == float(number)


@pytest.mark.parametrize("order", ["", " little", " swapped", " little swapped"])
def test_an_absurd_real_number_proposes_the_order_in_which_it_is_a_reading(
    order: str,
) -> None:
    words = to_registers(
        21.5, DATATYPE.FLOAT32, "little" if "little" in order else "big"
    )
    if "swapped" in order:
        words = [int.from_bytes(word.to_bytes(2, "big"), "little") for word in words]
    values = {("holding", k): word for k, word in enumerate(words)}
    assert not doubt(values, Channel("holding/0", f"float32{order}"))
    others = [
        Channel("holding/0", f"float32{other}")
        for other in ("", " little", " swapped", " little swapped")
    ]
    doubts = list(filter(None, (doubt(values, other) for other in others)))
    assert all(f"holding/0:float32{order} is 21.5" in text for text in doubts)
    assert doubts or order in ("", " little")


def test_a_listing_names_swapped_bytes_and_usual_marks() -> None:
    swapped = [
        int.from_bytes(word.to_bytes(2, "big"), "little")
        for word in to_registers(21.3, DATATYPE.FLOAT32)
    ]
    values = {("holding", k): word for k, word in enumerate([*swapped, 0x8000])}
    first, _, third = described(values, ("holding", 0, 3))
    assert first.endswith("  float32 swapped 21.3")
    assert third.endswith("int16 -32768  (no sensor? then write '; missing=-32768')")


class Limited:
    """Answers over TCP with each register's address as its value, under a rule; it counts requests."""

    def __init__(self, refusal: Callable[[int, int], int]) -> None:
        """`refusal`: from the number of a request and its registers, the code of the refusal; 0: none."""
        self.requests = 0
        self._refusal = refusal

    def __call__(self, request: bytes) -> bytes:
        self.requests += 1
        first = int.from_bytes(request[8:10], "big")
        count = int.from_bytes(request[10:12], "big")
        if code := self._refusal(self.requests, count):
            return framed(request, bytes((request[7] | 0x80, code)))
        words = b"".join(
            address.to_bytes(2, "big") for address in range(first, first + count)
        )
        return framed(request, bytes((request[7], len(words))) + words)


def taken_from(server: AnsweringWrongly, *places: str) -> dict[str, float]:
    """What a source gives for these places, in its first cycle."""
    taken: dict[str, float] = {}
    channels = [parse_place(place) for place in places]

    def receive(topic: str, read: Any, *_: Any, **__: Any) -> None:
        taken[topic] = read(
            next(channel for channel in channels if channel.topic == topic)
        )

    source = open_source(server.url, PERIOD, channels, receive)

    def takes() -> bool:
        source.poll()
        return bool(taken)

    try:
        source.search(0.0)
        wait_for(takes, "a cycle")
    finally:
        source.close()
    return taken


def test_a_device_that_is_busy_is_asked_again_within_the_period() -> None:
    device = Limited(lambda number, _count: 6 * (number % 2))
    server = AnsweringWrongly(device)
    assert taken_from(server, "holding/20", "holding/21") == {
        "holding/20": 20.0,
        "holding/21": 21.0,
    }
    # two places, one joined request and a cycle, each of them twice
    assert device.requests >= 8
    server.close()


def test_requests_are_split_where_a_device_gives_one_register_each() -> None:
    server = AnsweringWrongly(Limited(lambda _number, count: 3 * (count > 1)))
    assert taken_from(server, "holding/20", "holding/21") == {
        "holding/20": 20.0,
        "holding/21": 21.0,
    }
    with pytest.raises(
        ModbusError, match="gives one register per request, so that this number"
    ):
        taken_from(server, "holding/20:float32")
    server.close()


spans = st.builds(
    lambda table, first, count: (table, first, first + count),
    st.sampled_from(sorted(LONGEST)),
    st.integers(0, 300),
    st.sampled_from([1, 2, 4]),
)


@given(st.lists(spans, max_size=200))
def test_requests_have_what_is_wanted_and_nothing_else(
    wanted: list[tuple[str, int, int]],
) -> None:
    requests = joined(wanted)
    for table, first, end in wanted:
        assert any(t == table and f <= first and end <= e for t, f, e in requests)
    assert all(e - f <= LONGEST[t] for t, f, e in requests)
    addresses = {(t, k) for t, f, e in wanted for k in range(f, e)}
    assert {(t, k) for t, f, e in requests for k in range(f, e)} == addresses
    runs = sum((t, k - 1) not in addresses for t, k in addresses)
    assert runs <= len(requests) <= runs + len(addresses) // 100


def test_the_page_leads_from_a_plc_to_a_verdict(tmp_path: Path) -> None:
    page = (
        (PROJECT / "docs" / "modbus.md")
        .read_text("utf-8")
        .replace("5020", str(free_port()))
    )
    [program] = re.findall(
        r"^```python plc\.py\n(.*?)^```$", page, re.MULTILINE | re.DOTALL
    )
    (tmp_path / "plc.py").write_text(program)
    oven_file(tmp_path)
    listed, attach = re.findall(r"^```sh\n(.*)\n```$", page, re.MULTILINE)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "PYTHONUNBUFFERED": "1"}
    processes = Processes(tmp_path / "output")
    try:
        processes.python("plc.py", folder=tmp_path)

        def lines() -> str:
            run = processes.start(
                "bash", "-c", listed, environment=environment, folder=tmp_path
            )
            return run.text if run.wait() == 0 else ""

        text = wait_for(lines, "the listing of the PLC")
        assert re.search(r"^holding/11  .* float32 little \d", text, re.MULTILINE)
        assert "holding/0-9  cannot be read\nholding/14-20  cannot be read" in text
        run = processes.start(
            "bash", "-c", f"exec {attach}", environment=environment, folder=tmp_path
        )
        run.said(VERDICT_LINE)
        assert run.end(signal.SIGINT) == 0
        assert re.search(r"ended: \d+ samples, [1-9]\d* verdicts", run.text)
    finally:
        processes.end()
    assert len(read_session(tmp_path / "first").samples) >= 30
    [config] = re.findall(r"^```yaml\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    (tmp_path / "plc.yaml").write_text(
        config.replace("oven.py", str(tmp_path / "oven.py"))
    )
    with no_plant_files():
        values, _ = sampler_values(tmp_path / "plc.yaml", SignalMap())
        assert sources_of("plc", values)["output"].places == (
            "holding/11:float32 little",
        )
