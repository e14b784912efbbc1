"""Benchmarks of twinmatch and comparable programs: `python -m benchmarks`. See README.md.

Linear algebra uses one thread, here and in child processes; this is set before numpy is first imported.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"
