"""Verdicts do not depend on how many threads the linear algebra may use."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys

import pytest

from tests.support.places import PROJECT

pytestmark = pytest.mark.slow

SCRIPT = """
import sys
from pathlib import Path
from twinmatch.sessions import read_session
from twinmatch.twin import Twin
twin = Twin()
for sample in read_session(Path(sys.argv[1])).samples[:1000]:
    outcome = twin.push(sample)
    if outcome.match is not None:
        print(outcome.match.match.covariance.tobytes().hex(), outcome.match.match.parameters)
    print(*map(repr, outcome.verdicts))
"""


def judged(threads: int) -> str:
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": str(threads), "OMP_NUM_THREADS": str(threads)}
    command = [sys.executable, "-c", SCRIPT, str(PROJECT / "bags" / "four_setpoints")]
    done = subprocess.run(command, capture_output=True, check=True, env=environment, timeout=300)
    assert len(done.stdout) > 10_000
    return hashlib.sha256(done.stdout).hexdigest()


def test_any_number_of_threads_gives_the_same_bits() -> None:
    assert judged(1) == judged(4)
