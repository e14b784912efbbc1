"""What a replay of an archive left."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import NamedTuple


class Replayed(NamedTuple):
    """`twinmatch replay` of that folder, in two processes."""

    done: subprocess.CompletedProcess[str]
    out: Path
    """Where the results of the sessions are."""
    table: str
    """What it wrote as JSON."""
