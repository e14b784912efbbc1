"""Damaged sessions: what is read of them, beside what plain readers find, and whether a repair is right.

    python -m benchmarks.damage 200 --seed 1

Every file of 600 samples is damaged in one of eight ways. Of the samples that are in it unchanged, the table
counts those that plain readers find (plain), those that a session has (ours), and how many these lack
(fewer); then files that are called complete although a strict reader refuses them (complete), sessions in
which a repair loses a sample that was read (repaired), tracebacks, and calls of more than ten seconds of
processor time (slow).
"""

from __future__ import annotations

import argparse
import random
import tempfile
import time
from collections import Counter
from pathlib import Path

from mcap.writer import CompressionType

from tests.support.broken_sessions import (
    KINDS,
    as_session,
    broken,
    kind_of,
    plainly_found,
    samples_in,
    strictly_read,
    whole_file,
)
from twinmatch.errors import TwinmatchError
from twinmatch.sessions import SessionError, read_session
from twinmatch.sessions.messages import SAMPLE
from twinmatch.sessions.recording import repair_session
from twinmatch.sessions.scan import messages_of

PATIENCE = 10.0
COLUMNS = (
    "files",
    "refused",
    "plain",
    "ours",
    "fewer",
    "complete",
    "repaired",
    "tracebacks",
    "slow",
)


def measure(
    sound: bytes, rng: random.Random, number: int, folder: Path
) -> Counter[str]:
    """What becomes of one damaged file."""
    content = broken(sound, rng, number)
    there = samples_in(sound)
    plain = plainly_found(content, there)
    session = as_session(folder, content)
    begin = time.process_time()
    counts = Counter(files=1, plain=len(plain))
    try:
        ours = _read(session) & there
        counts["ours"] = len(ours)
        counts["refused"] = not ours
        counts["fewer"] = max(0, len(plain) - len(ours))
        counts += _repair(session, ours, strict=strictly_read(content))
    except TwinmatchError:
        counts["refused"] = 1
        counts["fewer"] = len(plain)
    except Exception as error:
        counts["tracebacks"] = 1
        print(number, kind_of(number), repr(error))
    counts["slow"] = time.process_time() - begin > PATIENCE
    if counts["fewer"] or counts["complete"] or counts["repaired"] or counts["slow"]:
        print(f"file {number} ({kind_of(number)}): {dict(counts)}")
    return counts


def _read(session: Path) -> set[bytes]:
    """The samples of a session, as messages; reading it as a session finds as many."""
    found = [
        m.data
        for m in messages_of(sorted(session.glob("*.mcap")))
        if m.topic.name == SAMPLE.name
    ]
    if found:
        assert len(read_session(session).samples) == len(found)
    return set(found)


def _repair(session: Path, ours: set[bytes], *, strict: bool) -> Counter[str]:
    (session / "metadata.yaml").unlink(missing_ok=True)
    counts: Counter[str] = Counter()
    try:
        repair = repair_session(session)
    except SessionError:
        counts["repaired"] = bool(ours)
        return counts
    if not strict and not any(
        "damaged" in fault or "truncated" in fault for fault in repair.faults
    ):
        counts["complete"] = 1
    counts["repaired"] = not _read(session) >= ours or bool(
        repair_session(session).faults
    )
    return counts


def main() -> None:
    """Damage and count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("number", type=int, nargs="?", default=200)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng = random.Random(options.seed)
    totals: dict[str, Counter[str]] = {}
    kinds = (
        CompressionType.NONE,
        CompressionType.NONE,
        CompressionType.ZSTD,
        CompressionType.LZ4,
    )
    sound = [whole_file(compression=kind) for kind in kinds]
    with tempfile.TemporaryDirectory() as base:
        for number in range(options.number):
            which = number // len(KINDS) % len(kinds)
            counts = measure(sound[which], rng, number, Path(base) / f"s{number}")
            totals.setdefault(
                f"{kind_of(number)} {kinds[which].name.lower()}", Counter()
            ).update(counts)
    print(f"{'':24}", *(f"{name:>10}" for name in COLUMNS))
    totals["all"] = sum(totals.values(), Counter())
    for kind, counts in totals.items():
        print(f"{kind:24}", *(f"{int(counts[name]):10}" for name in COLUMNS))


if __name__ == "__main__":
    main()
