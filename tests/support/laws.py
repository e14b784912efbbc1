"""Files of laws, and a recording of a real kit with both heaters as a session."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from tests.support.recorded_kits import kit_rows
from twinmatch.sessions import Session, read_session, write_session
from twinmatch.signals import Sample

RUNNING = {
    "kind": "pid",
    "proportional": 38.57,
    "integral": 1.46877,
    "derivative": 6.66875,
    "back_calculation": 1.0,
}


def law_file(folder: Path, **changes: Any) -> Path:
    path = folder / "law.json"
    path.write_text(json.dumps(RUNNING | changes), encoding="utf-8")
    return path


def kit_session(name: str, folder: Path, size: int | None = None) -> Session:
    """A recording of a real kit with both heaters, or its first samples."""
    rows = kit_rows("tclab_2x2", name)[:size]
    closed = "SP1" in rows[0]
    samples = [
        Sample(
            k,
            10**9 * k,
            (row["SP1"], row["SP2"]) if closed else (0.0, 0.0),
            (row["T1"], row["T2"]),
            (row["Q1"], row["Q2"]),
        )
        for k, row in enumerate(rows)
    ]
    return replace(
        read_session(write_session(folder / name, samples)),
        plant="tclab-both",
        has_reference=closed,
    )
