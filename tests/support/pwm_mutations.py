"""Damage as a serial line does it, for the fuzz tests of codec, firmware and simulated board."""

from __future__ import annotations

import random
from collections.abc import Iterator

from twinmatch.links.pwm_protocol import seal


def _flip(rng: random.Random, line: bytearray) -> None:
    for _ in range(rng.randint(1, 3)):
        line[rng.randrange(len(line))] ^= 1 << rng.randrange(8)


def _burst(rng: random.Random, line: bytearray) -> None:
    at = rng.randrange(len(line))
    for i in range(at, min(len(line), at + rng.randint(1, 6))):
        line[i] = rng.randrange(256)


def _drop(rng: random.Random, line: bytearray) -> None:
    for _ in range(rng.randint(1, 3)):
        del line[rng.randrange(len(line))]


def _duplicate(rng: random.Random, line: bytearray) -> None:
    at = rng.randrange(len(line))
    end = min(len(line), at + rng.randint(1, 8))
    line[at:at] = line[at:end]


def _insert(rng: random.Random, line: bytearray) -> None:
    for _ in range(rng.randint(1, 3)):
        line.insert(rng.randrange(len(line) + 1), rng.choice(b"0123456789-PQCHSEB :*\r\n\x00\xff"))


def _swap(rng: random.Random, line: bytearray) -> None:
    a, b = rng.randrange(len(line)), rng.randrange(len(line))
    line[a], line[b] = line[b], line[a]


def _truncate(rng: random.Random, line: bytearray) -> None:
    del line[rng.randrange(len(line)) :]


def _replace_digit(rng: random.Random, line: bytearray) -> None:
    digits = [i for i, byte in enumerate(line) if byte in b"0123456789ABCDEF"]
    line[rng.choice(digits)] = rng.choice(b"0123456789ABCDEF")


KINDS = (_flip, _burst, _drop, _duplicate, _insert, _swap, _truncate, _replace_digit)


def damaged_lines(count: int, seed: int) -> Iterator[tuple[str, bytes]]:
    """`count` times a payload and its line, damaged so that it differs from what was sealed."""
    rng = random.Random(seed)
    for n in range(count):
        verb = rng.choice("PPPPHQC")
        payload = f"{verb} {rng.randrange(65536)}" + (f" {rng.randint(-255, 255)}" if verb == "P" else "")
        sound = seal(payload)
        line = bytearray(sound)
        while bytes(line) == sound:
            KINDS[n % len(KINDS)](rng, line)
        yield payload, bytes(line)
