"""How fast twinmatch is, beside its peers: `python -m benchmarks`. See README.md.

One thread for linear algebra, here and in what is started from here; set before numpy is first imported.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"
