"""The notebook runs from its first to its last cell, without a warning, and finds what it shows."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

nbformat = pytest.importorskip("nbformat", reason="nbformat is in the extra 'test'")
nbclient = pytest.importorskip("nbclient", reason="nbclient is in the extra 'test'")

NOTEBOOK = Path(__file__).resolve().parents[2] / "docs" / "notebooks" / "recording_to_verdict.ipynb"

ASK = """
import json
print(json.dumps({
    "status": result.status.value,
    "parameters": {n: result.parameters[n] for n in result.free},
    "intervals": {n: list(interval(result, n)[:2]) for n in result.free},
    "energy": now["from_plate"] + now["from_sink"] + now["voltage"] * now["current"],
    "gains": [s.total.gain for s in scores],
    "recorded_gains": [
        o.total.gain for c in verdict.candidates if c.first == window.first for o in c.orders
    ],
    "chosen": chosen,
    "sums": {c.name: c.nu_gap_sum for c in verdict.candidates},
    "nominal": verdict.nominal,
    "fit": judgement.summary.fit_y,
    "level": verdict.level.value,
}))
"""


@pytest.fixture(scope="module")
def shown() -> Any:
    """The notebook as it lies in the project."""
    return nbformat.read(NOTEBOOK, as_version=4)


@pytest.fixture(scope="module")
def run(shown: Any) -> Any:
    """The notebook executed again, with warnings as errors and a question at its end."""
    notebook = nbformat.reads(nbformat.writes(shown), as_version=4)
    strict = nbformat.v4.new_code_cell("import warnings\nwarnings.simplefilter('error')")
    notebook.cells = [strict, *notebook.cells, nbformat.v4.new_code_cell(ASK)]
    client = nbclient.NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(NOTEBOOK.parent)}}
    )
    return client.execute()


def outputs(cell: Any, kind: str) -> str:
    return "".join(o.get("text", "") for o in cell.get("outputs", []) if o.get("name") == kind)


def test_it_is_shipped_executed_with_its_pictures_and_stays_small(shown: Any) -> None:
    code = [c for c in shown.cells if c.cell_type == "code"]
    assert [c.execution_count for c in code] == list(range(1, len(code) + 1))
    pictures = [o for c in code for o in c.outputs if "image/png" in o.get("data", {})]
    assert len(pictures) == 3
    assert NOTEBOOK.stat().st_size < 600_000


def test_no_path_of_a_machine_is_in_it() -> None:
    text = NOTEBOOK.read_text(encoding="utf-8")
    assert not re.search("/(home|root|work|Users|tmp)/", text)


def test_every_cell_runs_without_a_warning(run: Any) -> None:
    for cell in run.cells:
        if cell.cell_type == "code":
            assert not outputs(cell, "stderr")
            assert all(o.output_type != "error" for o in cell.outputs)


def test_it_finds_what_the_session_was_made_with(run: Any) -> None:
    """The rig of the sample session: 60 mV/K, 0.5 W/K, 27 J/K on a sink that the twin does not know."""
    found = json.loads(outputs(run.cells[-1], "stdout"))
    assert found["status"] == "accepted"
    truth = {"seebeck": 0.06, "conductance": 0.5, "heat_capacity": 27.0}
    for name, value in truth.items():
        assert found["parameters"][name] == pytest.approx(value, rel=0.15)
    for name in ("seebeck", "heat_capacity"):
        low, high = found["intervals"][name]
        assert low < truth[name] < high
    assert abs(found["energy"]) < 1e-9
    assert found["gains"] == found["recorded_gains"], "by hand and by the twin"
    assert found["chosen"] in {"22221", "33331", "44441", "55551"}
    assert found["nominal"] == min(found["sums"], key=found["sums"].get)
    assert found["fit"] > 0.98
    assert found["level"] == "trusted"


def test_what_is_shown_is_what_comes_out(shown: Any, run: Any) -> None:
    """Words and structure; last digits may differ from processor to processor."""
    for one, other in zip(shown.cells, run.cells[1:-1], strict=True):
        if one.cell_type == "code":
            before, after = outputs(one, "stdout").split(), outputs(other, "stdout").split()
            assert len(before) == len(after)
            words = [w for w in before if w.isalpha()]
            assert words == [w for w in after if w.isalpha()]
