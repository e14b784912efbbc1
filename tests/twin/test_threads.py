"""Verdicts do not depend on how many threads the linear algebra may use."""

from __future__ import annotations

import hashlib
import inspect
import os
import subprocess
import sys

from tests.support.places import SHIPPED
from twinmatch.twin import Outcome

SAMPLES = 1000


def text_of(outcome: Outcome) -> str:
    """Everything that came of a sample, to the last bit."""
    report = outcome.match
    parts = (
        []
        if report is None
        else [report.match.covariance.tobytes().hex(), report.match.parameters]
    )
    return " ".join(map(repr, [*parts, *outcome.verdicts]))


SCRIPT = f"""
from __future__ import annotations
import sys
from pathlib import Path
from twinmatch.sessions import read_session
from twinmatch.twin import Outcome, Twin
{inspect.getsource(text_of)}
twin = Twin()
for sample in read_session(Path(sys.argv[1])).samples[:{SAMPLES}]:
    print(text_of(twin.push(sample)))
"""


def test_any_number_of_threads_gives_the_same_bits(
    simulated_outcomes: list[Outcome],
) -> None:
    threads = "4" if os.environ.get("OPENBLAS_NUM_THREADS") == "1" else "1"
    environment = {
        **os.environ,
        "OPENBLAS_NUM_THREADS": threads,
        "OMP_NUM_THREADS": threads,
    }
    command = [sys.executable, "-c", SCRIPT, str(SHIPPED)]
    process = subprocess.run(
        command, capture_output=True, check=True, env=environment, timeout=300
    )
    expected = "".join(
        f"{text_of(outcome)}\n" for outcome in simulated_outcomes[:SAMPLES]
    ).encode()
    assert len(expected) > 10_000
    assert hashlib.sha256(process.stdout).digest() == hashlib.sha256(expected).digest()
