"""What the programs say of recorded sessions is what they said before, bit for bit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from threadpoolctl import threadpool_limits

from tests.golden import SOURCES, MissingSourceError, compare, digest
from tests.golden.sources import documents_of
from tests.support.documented_trust import Document, check_trust
from tests.support.promises import page, said

LONG = {
    "fmu": pytest.mark.long(
        "compiles an FMU, and judges an hour with it in a process of its own"
    )
}


def check_page_of_incubator(verdicts: Sequence[Document]) -> None:
    """Check when the page says that its second run has a candidate and is trusted; samples are 3 s apart."""
    text = page("incubator.md")
    led = [verdict["sample"] for verdict in verdicts if verdict["leader"]]
    trusted = [verdict["sample"] for verdict in verdicts if verdict["trusted"]]
    minutes_of_candidate = said(text, r"After (\w+) minutes of the second run")
    minutes_of_trust = said(text, r"there is a candidate, after (\w+) it is `trusted`")
    assert round(led[0] * 3.0 / 60.0) == minutes_of_candidate
    assert round(trusted[0] * 3.0 / 60.0) == minutes_of_trust


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

    Those of the rig's hours are compared in `system/test_recorded_hours.py`, which judges them too. In each
    session the trusted horizons are those that pass the documented test.
    """
    try:
        with threadpool_limits(1, user_api="blas"):
            documents = documents_of(name, tmp_path)
    except MissingSourceError as error:
        pytest.skip(str(error))
    verdicts = documents.get("replay", {}).get("verdicts", [])
    check_trust(verdicts)
    if name == "incubator_second":
        check_page_of_incubator(verdicts)
    different, compared = compare(name, digest(documents))
    assert not different, f"compared: {compared}"
