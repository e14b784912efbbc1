"""What the programs say of recorded sessions is what they said before, bit for bit."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.golden import SOURCES, MissingSourceError, compare, entry_of

LONG = {
    "fmu": pytest.mark.long(
        "compiles an FMU, and judges an hour with it in a process of its own"
    )
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=LONG.get(name, ()))
        for name in SOURCES
        if not name.startswith("rig_")
    ],
)
def test_results_are_the_golden_ones(name: str, tmp_path: Path) -> None:
    """`python -m tests.golden` says the same faster; with `--make` it writes them again.

    Those of the rig's hours are compared in `system/test_recorded_hours.py`, which judges them too.
    """
    try:
        entry = entry_of(name, tmp_path)
    except MissingSourceError as error:
        pytest.skip(str(error))
    different, compared = compare(name, entry)
    assert not different, f"compared: {compared}"
