"""Damage as a wire does it, for the fuzz tests of codecs, firmware and simulated board."""

from __future__ import annotations

import os
import random
from collections.abc import Iterator
from typing import Final

from twinmatch.links.pwm_protocol import seal

FUZZ: Final = int(os.environ.get("TWINMATCH_FUZZ", "20000"))
"""How many are damaged in each test of a codec."""


def _flip(rng: random.Random, data: bytearray) -> None:
    for _ in range(rng.randint(1, 3)):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def _burst(rng: random.Random, data: bytearray) -> None:
    place = rng.randrange(len(data))
    for i in range(place, min(len(data), place + rng.randint(1, 20))):
        data[i] = rng.randrange(256)


def _drop(rng: random.Random, data: bytearray) -> None:
    for _ in range(rng.randint(1, 3)):
        place = rng.randrange(len(data))
        del data[place : place + rng.randint(1, 2)]


def _duplicate(rng: random.Random, data: bytearray) -> None:
    place = rng.randrange(len(data))
    data[place:place] = data[place : place + rng.randint(1, 20)]


def _insert(rng: random.Random, data: bytearray) -> None:
    for _ in range(rng.randint(1, 3)):
        data.insert(
            rng.randrange(len(data) + 1),
            rng.choice(b"0123456789-PQCHSEB :*\r\n\x00\xff"),
        )


def _swap(rng: random.Random, data: bytearray) -> None:
    a = rng.randrange(len(data))
    b = rng.randrange(len(data))
    data[a], data[b] = data[b], data[a]


def _truncate(rng: random.Random, data: bytearray) -> None:
    del data[rng.randrange(len(data)) :]


def _replace(rng: random.Random, data: bytearray) -> None:
    """A digit, or a byte near the beginning."""
    digits = [i for i, byte in enumerate(data[:70]) if byte in b"0123456789ABCDEF"] or [
        0
    ]
    place = rng.choice([rng.choice(digits), rng.randrange(min(70, len(data)))])
    data[place] = rng.choice([rng.choice(b"0123456789ABCDEF"), rng.randrange(256)])


KINDS = (_flip, _burst, _drop, _duplicate, _insert, _swap, _truncate, _replace)


def damaged(sound: bytes, rng: random.Random, number: int) -> bytes:
    """A copy that differs; consecutive numbers are damaged in all ways in turn."""
    data = bytearray(sound)
    while data == sound:
        KINDS[number % len(KINDS)](rng, data)
    return bytes(data)


def damaged_lines(count: int, seed: int) -> Iterator[tuple[str, bytes]]:
    """`count` times a payload and its line, damaged so that it differs from what was sealed."""
    rng = random.Random(seed)
    for n in range(count):
        verb = rng.choice("PPPPHQC")
        payload = f"{verb} {rng.randrange(65536)}" + (
            f" {rng.randint(-255, 255)}" if verb == "P" else ""
        )
        yield payload, damaged(seal(payload), rng, n)
