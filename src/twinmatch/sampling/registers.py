"""Places in the tables of a Modbus device, and the numbers in them."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Iterator, Mapping
from typing import Final

from twinmatch.sampling.channels import Channel, SamplingError

LONGEST: Final = {"coil": 2000, "discrete": 2000, "holding": 125, "input": 125}
"""Most values that one request may read, by table."""
BITS: Final = ("coil", "discrete")
"""Tables of bits; those of the others are registers of 16 bits."""
_NAMES: Final = ("int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64")
_TYPES: Final = dict(zip(_NAMES, "hHiIqQfd", strict=True))
_PLACE: Final = re.compile(rf"(\w+)/([0-9]{{1,5}})(?:\s*:\s*({'|'.join(_NAMES)})(?:\s+(big|little))?)?")
_END: Final = 65536
_FORM: Final = f"tables are {', '.join(LONGEST)}, addresses 0 to {_END - 1}"

Span = tuple[str, int, int]
"""Consecutive values of a table, from an address up to that before another."""
Values = Mapping[tuple[str, int], int]
"""Bits and registers, by table and address."""


def parse_place(text: str) -> Channel:
    """A channel from `holding/100:float32 little`, `input/4` or `coil/3`.

    Raises:
        SamplingError: it is not such a place.
    """
    match = _PLACE.fullmatch(text.strip().lower())
    table, address, kind, order = match.groups("") if match else ("", "0", "", "")
    path = "" if table in BITS else f"{kind or 'int16'} {order}".strip()
    channel = Channel(f"{table}/{int(address)}", path)
    if table not in LONGEST or (kind and not path) or span_of(channel)[2] > _END:
        form = "write TABLE/ADDRESS, or of registers TABLE/ADDRESS:TYPE, such as holding/4:float32 little"
        raise SamplingError(f"{text.strip()!r} is not a place; {form}; {_FORM}, types {', '.join(_NAMES)}")
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
        raise SamplingError(f"{text!r} is not a range; write TABLE/FIRST-LAST, such as holding/0-50; {_FORM}")
    return table, first, end


def span_of(channel: Channel) -> Span:
    """Where the number of a place is."""
    table, _, first = channel.topic.partition("/")
    return table, int(first), int(first) + struct.calcsize(_code(channel)) // 2


def number_at(values: Values, channel: Channel) -> float:
    """The number of a place."""
    table, first, end = span_of(channel)
    step = -1 if channel.path.endswith("little") else 1
    words = [values[table, address] for address in range(first, end)][::step]
    return float(struct.unpack(_code(channel), struct.pack(f">{len(words)}H", *words))[0])


def _code(channel: Channel) -> str:
    return ">" + _TYPES.get(channel.path.partition(" ")[0], "H")


def values_in(answer: bytes, span: Span) -> Values:
    """The values of a span from an answer that a device gave: the number of bytes, then these bytes.

    Raises:
        SamplingError: it has another number of bytes than it says, or than the span has.
    """
    table, first, end = span
    count = end - first
    wanted = -(-count // 8) if table in BITS else 2 * count
    if len(answer) != wanted + 1 or answer[0] != wanted:
        stated = f"states {answer[0]} and has {len(answer) - 1}" if answer else "has 0"
        raise SamplingError(f"the answer to {span_text(span)} {stated} bytes of values, not {wanted}")
    if table in BITS:
        return {(table, first + k): answer[1 + k // 8] >> k % 8 & 1 for k in range(count)}
    return {(table, first + k): int.from_bytes(answer[1 + 2 * k : 3 + 2 * k], "big") for k in range(count)}


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


def described(values: Values, span: Span) -> Iterator[str]:
    """A line for each value, a register as the types that may be meant; then the parts without values."""
    for (table, address), value in sorted(values.items()):
        line = f"{table}/{address}  "
        line += f"{value}" if table in BITS else f"uint16 {value}  int16 {(value ^ 0x8000) - 0x8000}"
        for kind in ("float32", "float32 little") if (table, address + 1) in values else ():
            number = number_at(values, Channel(f"{table}/{address}", kind)) if table not in BITS else 0.0
            line += f"  {kind} {number:g}" if 1e-3 <= abs(number) < 1e7 else ""  # others are not plausible
        yield line
    table, first, end = span
    missing = ((table, k, k + 1) for k in range(first, end) if (table, k) not in values)
    yield from (f"{span_text(part)}  cannot be read" for part in joined(missing))
