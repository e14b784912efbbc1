"""Places in the tables of a Modbus device, and the numbers in them."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterable, Iterator, Mapping
from typing import Final

from twinmatch.sampling.channels import Channel, SamplingError

LONGEST: Final = {"coil": 2000, "discrete": 2000, "holding": 125, "input": 125}
"""Most values that one request may read, by table."""
BITS: Final = ("coil", "discrete")
"""Tables of bits; those of the others are registers of 16 bits."""
_NAMES: Final = (
    "int16",
    "uint16",
    "int32",
    "uint32",
    "int64",
    "uint64",
    "float32",
    "float64",
)
_TYPES: Final = dict(zip(_NAMES, "hHiIqQfd", strict=True))
_PLACE: Final = re.compile(
    rf"(\w+)/([0-9]{{1,5}})(?:\s*:\s*({'|'.join(_NAMES)})(?:\s+(big|little))?(?:\s+(swapped))?)?"
)
_END: Final = 65536
_PLAUSIBLE: Final = (1e-3, 1e7)
"""Smallest and largest number that a listing takes for a reading."""
_ABSURD: Final = (1e-9, 1e9)
"""Numbers beyond are hardly ever readings: registers or bytes were taken in the wrong order."""
_ORDERS: Final = ("", " little", " swapped", " little swapped")
_MARKS: Final = (-32768, 32767)
"""Values of a register with which many devices say that there is no sensor."""
_FORM: Final = f"tables are {', '.join(LONGEST)}, addresses 0 to {_END - 1}"

Span = tuple[str, int, int]
"""Consecutive values of a table, from an address up to that before another."""
Values = Mapping[tuple[str, int], int]
"""Bits and registers, by table and address."""


class NoValuesError(SamplingError):
    """A device answers as it should, but without values."""


def parse_place(text: str) -> Channel:
    """A channel from `holding/100:float32 little`, `input/4` or `coil/3`.

    Raises:
        SamplingError: it is not such a place.
    """
    match = _PLACE.fullmatch(text.strip().lower())
    table, address, kind, order, swapped = (
        match.groups("") if match else ("", "0", "", "", "")
    )
    path = (
        ""
        if table in BITS
        else " ".join(filter(None, (kind or "int16", order, swapped)))
    )
    channel = Channel(f"{table}/{int(address)}", path)
    if table not in LONGEST or (kind and not path) or span_of(channel)[2] > _END:
        form = "write TABLE/ADDRESS, or of registers TABLE/ADDRESS:TYPE, such as holding/4:float32 little"
        raise SamplingError(
            f"{text.strip()!r} is not a place; {form}; {_FORM}, types {', '.join(_NAMES)}"
        )
    return channel


def parse_range(text: str) -> Span:
    """The values of `input/0-20`, or of `input/7`.

    Raises:
        SamplingError: it is not such a range.
    """
    place, _, last = text.strip().partition("-")
    table, first, end = span_of(parse_place(place))
    end = int(last) + 1 if re.fullmatch("[0-9]{1,5}", last) else end * (not last)
    if not first < end <= _END:
        raise SamplingError(
            f"{text!r} is not a range; write TABLE/FIRST-LAST, such as holding/0-50; {_FORM}"
        )
    return table, first, end


def span_of(channel: Channel) -> Span:
    """Where the number of a place is."""
    table, _, first = channel.topic.partition("/")
    return table, int(first), int(first) + struct.calcsize(_code(channel)) // 2


def number_at(values: Values, channel: Channel) -> float:
    """The number of a place."""
    table, first, end = span_of(channel)
    orders = channel.path.split()
    step = -1 if "little" in orders else 1
    words = [values[table, address] for address in range(first, end)][::step]
    if "swapped" in orders:
        words = [_swapped(word) for word in words]
    return float(
        struct.unpack(_code(channel), struct.pack(f">{len(words)}H", *words))[0]
    )


def _swapped(word: int) -> int:
    """A register with its two bytes exchanged."""
    return (word & 0xFF) << 8 | word >> 8


def doubt(values: Values, channel: Channel) -> str:
    """Which order makes an absurd real number plausible; empty if it is not absurd, or none does."""
    kind, *_ = channel.path.split() or [""]
    if not kind.startswith("float"):
        return ""
    number = number_at(values, channel)
    if (
        not math.isfinite(number)
        or number == 0.0
        or _ABSURD[0] < abs(number) < _ABSURD[1]
    ):
        return ""
    others = [Channel(channel.topic, kind + order) for order in _ORDERS]
    proposals = [
        f"{other.text} is {number_at(values, other):g}"
        for other in others
        if _reads(values, other)
    ]
    if not proposals:
        return ""
    better = " and ".join(proposals)
    return f"{channel.text} is {number:g}, which is hardly a reading; in another order, {better}"


def _reads(values: Values, channel: Channel) -> bool:
    """Whether a number is of a size that readings have."""
    return _PLAUSIBLE[0] <= abs(number_at(values, channel)) < _PLAUSIBLE[1]


def _code(channel: Channel) -> str:
    return ">" + _TYPES.get(channel.path.partition(" ")[0], "H")


def values_in(answer: bytes, span: Span) -> Values:
    """The values of a span from an answer that a device gave: the number of bytes, then these bytes.

    Raises:
        NoValuesError: it is in order, and has no values.
        SamplingError: it has another number of bytes than it says, or than the span has.
    """
    table, first, end = span
    count = end - first
    wanted = -(-count // 8) if table in BITS else 2 * count
    if answer == b"\0":
        raise NoValuesError(
            f"the answer to {span_text(span)} states 0 and has 0 bytes of values: the device has none there "
            "now"
        )
    if len(answer) != wanted + 1 or answer[0] != wanted:
        stated = f"states {answer[0]} and has {len(answer) - 1}" if answer else "has 0"
        raise SamplingError(
            f"the answer to {span_text(span)} {stated} bytes of values, not {wanted}"
        )
    if table in BITS:
        return {
            (table, first + k): answer[1 + k // 8] >> k % 8 & 1 for k in range(count)
        }
    return {
        (table, first + k): int.from_bytes(answer[1 + 2 * k : 3 + 2 * k], "big")
        for k in range(count)
    }


def joined(spans: Iterable[Span]) -> list[Span]:
    """The fewest spans with these and nothing else, none longer than a request; each is whole in one."""
    longer: list[Span] = []
    for span in sorted(spans):
        table, first, end = longer[-1] if longer else ("", 0, 0)
        last = max(end, span[2])
        joins = span[0] == table and span[1] <= end and last - first <= LONGEST[table]
        longer[-1:] = [(table, first, last)] if joins else [*longer[-1:], span]
    return longer


def span_text(span: Span) -> str:
    """A span as `--list` takes it."""
    table, first, end = span
    return f"{table}/{first}" + (f"-{end - 1}" if end > first + 1 else "")


def _reals(values: Values, topic: str) -> str:
    """The real numbers that two registers may be; those with swapped bytes only if they are no others."""
    for orders in (_ORDERS[:2], _ORDERS[2:]):
        channels = [Channel(topic, f"float32{order}") for order in orders]
        readings = [channel for channel in channels if _reads(values, channel)]
        if readings:
            return "".join(
                f"  {channel.path} {number_at(values, channel):g}"
                for channel in readings
            )
    return ""


def described(values: Values, span: Span) -> Iterator[str]:
    """A line for each value, a register as the types that may be meant; then the parts without values."""
    for (table, address), value in sorted(values.items()):
        line = f"{table}/{address}  "
        line += (
            f"{value}"
            if table in BITS
            else f"uint16 {value}  int16 {(value ^ 0x8000) - 0x8000}"
        )
        if table not in BITS and (table, address + 1) in values:
            line += _reals(values, f"{table}/{address}")
        if table not in BITS and (mark := (value ^ 0x8000) - 0x8000) in _MARKS:
            line += f"  (no sensor? then write '; missing={mark}')"
        yield line
    table, first, end = span
    missing = ((table, k, k + 1) for k in range(first, end) if (table, k) not in values)
    yield from (f"{span_text(part)}  cannot be read" for part in joined(missing))
