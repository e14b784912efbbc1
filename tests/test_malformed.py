"""What is malformed is refused in words: laws, memories, candidates, profiles, maps, settings, tables."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest

from tests.support.malformed import KINDS, readings
from twinmatch.decoding import FiniteNumber, decoded, decoded_json
from twinmatch.errors import TwinmatchError
from twinmatch.importing.tables import LIMITS, RecordingError, read_table, split_title

DOCUMENTS = 30


@pytest.mark.parametrize("kind", KINDS)
def test_malformed_documents_are_refused_or_read(kind: str, tmp_path: Path) -> None:
    """`python -m benchmarks.malformed` reads a thousand of each kind."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of numbers near the largest
        results = list(readings(kind, DOCUMENTS, 11, tmp_path))
    bugs = [reading.bug for reading in results if reading.bug is not None]
    if bugs:
        raise bugs[0]
    assert sum(not reading.accepted for reading in results) > 0


@pytest.mark.parametrize(
    ("tree", "kind", "words"),
    [
        (
            {"a": ["x"]},
            dict[str, list[float]],
            "file: [...][0]: is text; give a number",
        ),
        ([1.0, "x"], list[float], "file: [1]: is 'x'; give a number"),
        ([1, 2, 3], tuple[float, float], "file: is [1, 2, 3]; give a list of length 2"),
        (float("nan"), FiniteNumber, "file: is nan; give a finite number"),
        (None, float | str, "file: is None; give a number or text"),
    ],
)
def test_a_value_of_another_type_is_named_with_its_place(
    tree: object, kind: type, words: str
) -> None:
    with pytest.raises(TwinmatchError) as caught:
        decoded(tree, kind, "file")
    assert str(caught.value) == words


@pytest.mark.parametrize(
    "text",
    ["[" * 100_000, "1" + "0" * 5000, "[1e999]", "[NaN]", b"\xff", '["\x1b[2J"]', ""],
)
def test_no_text_is_decoded_into_numbers_that_are_not_there(text: str | bytes) -> None:
    with pytest.raises(TwinmatchError) as caught:
        decoded_json(text, list[float], "file")
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 300


def test_a_title_is_split_in_one_way(tmp_path: Path) -> None:
    """Of 400 blanks after a bracket, no two ways of matching them are tried."""
    assert split_title("T (a) (°C)") == ("T (a)", "°C")
    assert split_title("flow [m³/(s·m)]") == ("flow", "m³/(s·m)")
    assert split_title("( " * 200 + "x" + " " * 400) == (("( " * 200 + "x"), "")
    path = tmp_path / "wide.csv"
    titles = ",".join(f"c{number}" for number in range(LIMITS.columns + 1))
    row = ",".join(["1"] * (LIMITS.columns + 1))
    path.write_text("\n".join([titles, row, row, row]))
    with pytest.raises(
        RecordingError,
        match=r"has 2001 columns, more than 2000; give each sample its own row",
    ):
        read_table(path)
    path.write_text("t,y" + " " * 700 + "x\n1,2\n2,3\n3,4\n")
    with pytest.raises(
        RecordingError, match="has a column title of 702 characters; give at most 500"
    ):
        read_table(path)
