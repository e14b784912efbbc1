"""VoSPI packets, telemetry and the Lepton source, on streams made here."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from types import SimpleNamespace

import numpy as np
import pytest
import twinmatch_camera.sources.lepton as lepton_module
from hypothesis import given
from hypothesis import strategies as st
from twinmatch_camera.errors import SourceError
from twinmatch_camera.sources.cci import SETTINGS, configure
from twinmatch_camera.sources.lepton import LeptonSource
from twinmatch_camera.sources.telemetry import exposure
from twinmatch_camera.sources.vospi import (
    PACKET_BYTES,
    RESYNC_SILENCE,
    Assembler,
    SyncLost,
    VospiFrame,
)

from twinmatch.links.thermal_frame import Exposure, FlatField, FrameFlags

DISCARD = bytes([0xFF, 0x12]) + bytes(162)


def crc(data: bytes) -> int:
    """CRC-16 by the polynomial x¹⁶ + x¹² + x⁵ + 1, bit by bit."""
    value = 0
    for byte in data:
        for bit in range(7, -1, -1):
            top = value >> 15 ^ (byte >> bit & 1)
            value = (value << 1 & 0xFFFF) ^ (0x1021 if top else 0)
    return value


def packet(number: int, words: Sequence[int], nibble: int = 0) -> bytes:
    payload = b"".join(int(word).to_bytes(2, "big") for word in words)
    check = crc(bytes([number >> 8, number & 255, 0, 0]) + payload)
    return (
        bytes([nibble << 4 | number >> 8, number & 255])
        + check.to_bytes(2, "big")
        + payload
    )


def telemetry_rows(counter: int = 1, status: int = 3 << 4, **words: int) -> np.ndarray:
    rows = np.zeros((3, 80), np.uint16)
    a = {
        1: 5000,
        3: status & 0xFFFF,
        4: status >> 16,
        20: counter & 0xFFFF,
        21: counter >> 16,
        24: 30315,
    }
    for word, value in {**a, 30: 1000}.items():
        rows[0, word] = value
    rows[2, 48:50] = 1
    for name, value in words.items():
        rows[{"a": 0, "c": 2}[name[0]], int(name[1:])] = value
    return rows


def frame_packets(
    counter: int = 1, level: int = 30000, **telemetry: int
) -> list[bytes]:
    image = np.full((60, 80), level) + np.arange(60)[:, None] * 10
    rows = np.vstack([image, telemetry_rows(counter, **telemetry)])
    return [packet(number, row.tolist()) for number, row in enumerate(rows)]


def feed(assembler: Assembler, packets: Iterable[bytes]) -> list[VospiFrame]:
    return [frame for frame in map(assembler.feed, packets) if frame is not None]


# --- packets to frames ---------------------------------------------------------------------------


def test_a_frame_among_discard_packets_and_joined_in_the_midst_of_one() -> None:
    packets = frame_packets()
    begun = [*packets[20:], *packets[:30], DISCARD, DISCARD, *packets[30:]]
    stream = [DISCARD] * 7 + begun + [DISCARD] * 3 + frame_packets(level=31000)
    first, second = feed(Assembler(), stream)
    assert first.image[:, 0].tolist() == [30000 + 10 * row for row in range(60)]
    assert first.telemetry.tolist() == telemetry_rows().tolist()
    assert second.image[0, 79] == 31000


def test_the_high_nibble_of_the_id_does_not_matter() -> None:
    packets = frame_packets()
    packets[20] = bytes([0x40 | packets[20][0]]) + packets[20][1:]
    assert len(feed(Assembler(), packets)) == 1


def test_a_frame_that_begins_before_the_last_one_ended_replaces_it() -> None:
    assert [
        f.image[0, 0]
        for f in feed(Assembler(), frame_packets()[:40] + frame_packets(level=31000))
    ] == [31000]


def test_a_missing_packet_is_lost_sync_and_the_next_frame_is_whole() -> None:
    packets = frame_packets()
    assembler = Assembler()
    with pytest.raises(SyncLost, match="packet 31 came where 30 was due"):
        feed(assembler, packets[:30] + packets[31:])
    assert len(feed(assembler, frame_packets())) == 1


def test_no_beginning_within_four_frames() -> None:
    assembler = Assembler()
    with pytest.raises(SyncLost, match="no frame began within 252 packets"):
        feed(assembler, frame_packets()[1:] * 5)


@given(st.integers(0, 62), st.integers(0, PACKET_BYTES * 8 - 1))
def test_any_flipped_bit_is_noticed_or_harmless(number: int, bit: int) -> None:
    packets = frame_packets()
    bad = bytearray(packets[number])
    bad[bit // 8] ^= 1 << bit % 8
    packets[number] = bytes(bad)
    assembler = Assembler()
    try:
        frames = feed(assembler, packets)
    except SyncLost:
        return
    # The high nibble of the ID is not covered and not used.
    assert bit // 8 == 0
    assert bit % 8 >= 4
    assert (
        frames[0].image.tolist() == feed(Assembler(), frame_packets())[0].image.tolist()
    )


@given(st.binary(min_size=PACKET_BYTES, max_size=PACKET_BYTES))
def test_noise_gives_no_frame(data: bytes) -> None:
    assembler = Assembler()
    for _ in range(70):
        try:
            assert assembler.feed(data) is None
        except SyncLost:
            return


# --- telemetry -----------------------------------------------------------------------------------


def telemetry_of(**words: int) -> Exposure:
    """What telemetry makes of an image."""
    return exposure(np.ones((60, 80), np.uint16), telemetry_rows(**words), 7)


def test_telemetry_words_become_the_fields_of_an_exposure() -> None:
    telemetry = telemetry_of(counter=70_000, status=1 << 20 | 3 << 4, a2=1, a31=0)
    assert (telemetry.frame_counter, telemetry.sensor_temperature, telemetry.stamp) == (
        70_000,
        30_315,
        7,
    )
    assert telemetry.flat_field is FlatField.COMPLETE
    assert telemetry.flat_field_age == 65_536 + 4000
    assert telemetry.flags is FrameFlags.OVERHEATING
    assert (telemetry.radiometric, telemetry.resolution) == (True, 0.01)


@pytest.mark.parametrize("state", list(FlatField))
def test_each_flat_field_state_is_read_and_has_an_age_unless_it_is_never(
    state: FlatField,
) -> None:
    telemetry = telemetry_of(status=state << 4)
    assert telemetry.flat_field is state
    assert (telemetry.flat_field_age is None) == (state is FlatField.NEVER)


@pytest.mark.parametrize(
    ("bit", "flag"),
    [
        (3, FrameFlags.FLAT_FIELD_DESIRED),
        (12, FrameFlags.GAIN_CONTROL),
        (15, FrameFlags.SHUTTER_LOCKED),
        (20, FrameFlags.OVERHEATING),
    ],
)
def test_each_status_bit_has_its_flag(bit: int, flag: FrameFlags) -> None:
    assert telemetry_of(status=1 << bit).flags is flag


def test_counts_that_are_not_temperatures_are_flagged() -> None:
    telemetry = telemetry_of(c48=0, c49=0)
    assert telemetry.flags is FrameFlags.NOT_RADIOMETRIC
    assert telemetry.resolution == 0.1
    assert not telemetry.radiometric


# --- the source ----------------------------------------------------------------------------------


class FakeCci:
    """Answers as a Lepton does: busy for a while, then done."""

    def __init__(
        self, *, error: int = 0, boots: bool = True, answers: bool = True
    ) -> None:
        self.set: list[tuple[int, list[int]]] = []
        self._data: list[int] = []
        self._busy = 2
        self._error = error
        self._boots = boots
        self._answers = answers
        self._length = 0

    def write(self, register: int, words: Sequence[int]) -> None:
        if register == 8:
            self._data = list(words)
        elif register == 6:
            self._length = words[0]
        elif register == 4:
            self.set.append((words[0], self._data[: self._length]))
            self._busy = 2

    def read(self, register: int) -> int:
        assert register == 2
        if not self._answers:
            raise OSError(121, "Remote I/O error")
        self._busy -= 1
        code = (self._error & 0xFF) << 8 if self.set else 0
        return code | (0b110 if self._boots else 0b010) | (self._busy > 0)


class FakeSpi:
    """A stream of packets, then discard packets for ever."""

    def __init__(self, packets: Iterable[bytes], idle: bytes = DISCARD) -> None:
        self._stream = self._bytes(packets, idle)
        self.closed = False

    @staticmethod
    def _bytes(packets: Iterable[bytes], idle: bytes) -> Iterator[bytes]:
        yield from packets
        while True:
            yield idle

    def readbytes(self, count: int) -> Sequence[int]:
        return list(b"".join(next(self._stream) for _ in range(count // PACKET_BYTES)))

    def close(self) -> None:
        self.closed = True


def opened(spi: FakeSpi, sleeps: list[float] | None = None) -> LeptonSource:
    record = [] if sleeps is None else sleeps
    source = LeptonSource(wires=lambda: (spi, FakeCci()), sleep=record.append)
    source.open()
    return source


def test_each_new_image_is_passed_on_once() -> None:
    packets = [
        p
        for counter in (1, 1, 1, 2, 2, 2, 3)
        for p in [*frame_packets(counter), DISCARD]
    ]
    source = opened(FakeSpi(packets))
    got = []
    while (passed_on := source.read(0.05)) is not None:
        got.append(passed_on.frame_counter)
    assert got == [1, 2, 3]
    assert source.name == "Lepton on /dev/spidev0.0 and /dev/i2c-1"


def test_a_picture_that_stands_still_is_repeated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ticks = itertools.count()
    clock = SimpleNamespace(
        monotonic=lambda: next(ticks) * 0.001, monotonic_ns=lambda: 5
    )
    monkeypatch.setattr(lepton_module, "time", clock)
    packets = [p for _ in range(26) for p in frame_packets(7, status=2 << 4)]
    source = opened(FakeSpi(packets))
    got = []
    while (passed_on := source.read(0.5)) is not None:
        got.append(passed_on)
    assert {e.frame_counter for e in got} == {7}
    assert all(e.frozen for e in got)
    # 63 packets of a millisecond each: a frame every 63 ms, of which every second is passed on.
    assert 12 <= len(got) <= 14


def test_lost_sync_means_silence_and_then_frames_again() -> None:
    sleeps: list[float] = []
    bad = frame_packets(1)
    bad[10] = bytes(4) + bad[10][4:]
    # After the damaged packet what was fetched with it is thrown away.
    source = opened(FakeSpi([*bad, *[DISCARD] * 20, *frame_packets(2)]), sleeps)
    first_after = source.read(1.0)
    assert first_after is not None
    assert first_after.frame_counter == 2
    assert sleeps.count(RESYNC_SILENCE) >= 2
    assert RESYNC_SILENCE > 5 / 27


@pytest.mark.parametrize("idle", [b"\xff" * PACKET_BYTES, bytes(PACKET_BYTES)])
def test_a_wire_without_a_camera_is_an_error_that_names_the_wiring(
    monkeypatch: pytest.MonkeyPatch, idle: bytes
) -> None:
    monkeypatch.setattr(lepton_module, "_PATIENCE", 0.05)
    source = opened(FakeSpi([], idle))
    with pytest.raises(SourceError, match=r"no frame in 0\.05 s; check wiring"):
        source.read(5.0)


def test_a_wire_that_fails_and_one_never_opened() -> None:
    class Broken(FakeSpi):
        def readbytes(self, _count: int) -> Sequence[int]:
            raise OSError(5, "Input/output error")

    source = opened(Broken([]))
    with pytest.raises(SourceError, match="Input/output error"):
        source.read(1.0)
    with pytest.raises(SourceError, match="read before it was opened"):
        LeptonSource().read(0.1)


def test_close_gives_the_bus_back_once() -> None:
    spi = FakeSpi([])
    source = opened(spi)
    source.close()
    source.close()
    assert spi.closed


def test_buses_that_cannot_be_opened_are_an_error_that_says_what_to_do() -> None:
    def missing() -> tuple[FakeSpi, FakeCci]:
        raise FileNotFoundError(2, "No such file or directory")

    with pytest.raises(SourceError, match="switch SPI and I2C on"):
        LeptonSource(wires=missing).open()

    def no_library() -> tuple[FakeSpi, FakeCci]:
        raise ModuleNotFoundError("No module named 'spidev'")

    with pytest.raises(SourceError, match="install with"):
        LeptonSource(wires=no_library).open()


# --- the command interface -----------------------------------------------------------------------


def test_settings_are_written_and_awaited() -> None:
    wire = FakeCci()
    configure(wire, sleep=lambda _: None)
    assert wire.set == [(command | 1, [value, 0]) for _, command, value in SETTINGS]
    assert (0x0219, [1, 0]) in wire.set


@pytest.mark.parametrize(
    ("wire", "message"),
    [
        (FakeCci(error=-3), "refuses gain control off with error -3"),
        (FakeCci(boots=False), r"waited 5\.0 s to boot, its status is 0x0002"),
        (FakeCci(answers=False), r"no answer on I2C .*Remote I/O error"),
    ],
)
def test_a_camera_that_refuses_does_not_boot_or_does_not_answer(
    wire: FakeCci, message: str
) -> None:
    with pytest.raises(SourceError, match=message):
        configure(wire, sleep=lambda _: None)
