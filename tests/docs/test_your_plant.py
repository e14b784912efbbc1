"""The page that leads from a table to a verdict does so: its commands run in their order and say what it
says."""

from __future__ import annotations

import importlib
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.places import PROJECT
from tests.support.processes import run_twinmatch

pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)

from twinmatch.showing.foxglove.layout import TOPICS

PAGE = PROJECT / "docs" / "your_plant.md"
HOT_END, ROOM, CELL, PLATE = (
    PROJECT / "docs" / f"{name}.md"
    for name in ("hot_end", "room", "cell", "uniformity")
)

WHOLE_PAGE = "every command of a page, with hours or days of its plant"


def commands(page: Path) -> list[list[str]]:
    blocks = re.findall(
        r"^```console\n(.*?)^```",
        page.read_text(encoding="utf-8"),
        re.DOTALL | re.MULTILINE,
    )
    return [
        shlex.split(line.removeprefix("$ "))
        for block in blocks
        for line in block.splitlines()
    ]


def files(page: Path, folder: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for name, code in re.findall(
        r"^```python (\w+\.py)\n(.*?)^```", text, re.DOTALL | re.MULTILINE
    ):
        (folder / name).write_text(code, encoding="utf-8")


def python(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *arguments]
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False
    )


def followed(page: Path, folder: Path) -> list[tuple[list[str], int, str]]:
    """What the commands of a page say in a folder with its files, with their exit codes."""
    files(page, folder)
    assert python("make_log.py", folder=folder).returncode == 0
    results: list[tuple[list[str], int, str]] = []
    for program, *arguments in commands(page):
        if program == "twinmatch":
            completed = run_twinmatch(*arguments, folder=folder)
        else:
            completed = python(*arguments, folder=folder)
        assert "Traceback" not in completed.stderr, completed.stderr
        results.append(
            (arguments, completed.returncode, completed.stdout + completed.stderr)
        )
    return results


@pytest.mark.long(WHOLE_PAGE)
def test_a_lead_that_breaks_has_its_name_in_the_last_line(tmp_path: Path) -> None:
    """And what the twin was before is what the page's table was made with."""
    results = followed(HOT_END, tmp_path)
    assert all(code == 0 for _, code, _ in results), results
    faults = re.search(r"Faults: (.*)", results[-1][2])
    assert faults is not None
    *before, last = faults[1].rstrip(".").split("; ")
    assert re.match(r"drive-lost since 21\d\d s", last)
    assert all(fault_text.startswith("drift from 21") for fault_text in before), (
        "until losses and drive are told apart"
    )
    parameters = dict(
        re.findall(
            r"(power|losses|blown|lag) ([\d.]+) (?:m?W/%|W/K|mW/K|s)", results[-1][2]
        )
    )
    wanted = {"power": 0.4, "losses": 0.07, "blown": 40.0, "lag": 4.0}
    assert {name: float(value) for name, value in parameters.items()} == pytest.approx(
        wanted, rel=0.05
    )


@pytest.mark.long(WHOLE_PAGE)
def test_a_room_lacks_a_store_and_then_names_an_open_window(tmp_path: Path) -> None:
    (_, lacking, asked), *results_after = followed(ROOM, tmp_path)
    assert lacking == 1
    assert re.search(
        "a second store beside air of about [0-9.]+ h would explain 9.%", asked
    )
    assert all(code == 0 for _, code, _ in results_after), results_after
    last = results_after[-1][2]
    assert re.search(
        r"Faults: losses-changed from 98\d\d\d\d to 10[12]\d\d\d\d s", last
    )
    parameters = dict(
        re.findall(r"(capacity|mass|losses|surface|shell) ([\d.]+) (?:J/K|W/K)", last)
    )
    wanted = {
        "capacity": 8e5,
        "mass": 6e6,
        "losses": 12.0,
        "surface": 150.0,
        "shell": 20.0,
    }
    assert {name: float(value) for name, value in parameters.items()} == pytest.approx(
        wanted, rel=0.1
    )


@pytest.mark.long(WHOLE_PAGE)
def test_a_contactor_that_opens_under_a_cell_is_a_lost_drive(tmp_path: Path) -> None:
    """Named within a minute; and what the cell was before comes out as it went in."""
    results = followed(CELL, tmp_path)
    assert all(code == 0 for _, code, _ in results), results
    last = results[-1][2]
    named = re.search(
        r"^(\d+) +fault .*\n +drive-lost: the drive has no effect", last, re.MULTILINE
    )
    assert named is not None
    assert 5000 < int(named[1]) <= 5060
    assert re.search(
        r"Faults: drive-lost from 49\d\d to 51\d\d s; drive-lost from 51\d\d", last
    )
    parameters = dict(
        re.findall(r"\b(slope|r|r1|t1) ([\d.]+) (?:mV/\(A h\)|mΩ|s)", last)
    )
    wanted = {"slope": 22.0, "r": 2.0, "r1": 1.0, "t1": 20.0}
    assert {name: float(value) for name, value in parameters.items()} == pytest.approx(
        wanted, rel=0.05
    )


@pytest.mark.long(WHOLE_PAGE)
def test_a_heater_that_comes_loose_under_an_even_plate_is_named(tmp_path: Path) -> None:
    """What is said before is what the page quotes; afterwards 0.6 of the right heater's power is left."""
    results = followed(PLATE, tmp_path)
    assert all(code == 0 for _, code, _ in results), results
    for quoted in re.findall(
        r"^> `(.*)`$", PLATE.read_text(encoding="utf-8"), re.MULTILINE
    )[:1]:
        assert quoted in results[0][2]
    named = re.search(
        r"^(\d+) +fault .*\n +drive-weak of right heater: right heater has (\d+)% of its effect",
        results[-1][2],
        re.MULTILINE,
    )
    assert named is not None
    flagged, power_left = map(int, named.groups())
    assert flagged <= 2160
    assert 45 <= power_left <= 75
    for said in (results[-2][2], results[-1][2]):
        since = re.search(r"Faults: drive-weak of right heater since (\d+) s\.", said)
        assert since is not None
        assert abs(int(since[1]) - 2100) <= 2  # onsets are two seconds apart


def test_the_page_leads_from_a_table_to_a_verdict(tmp_path: Path) -> None:
    results = followed(PAGE, tmp_path)
    looked = [
        (code, text) for arguments, code, text in results if "--data" in arguments
    ]
    other_results = [
        (arguments, code) for arguments, code, _ in results if "--data" not in arguments
    ]
    assert all(code == 0 for _, code in other_results), other_results
    ((code, text),) = looked
    assert code == 0
    parameters = dict(re.findall(r"(gain|lag|sensor_lag) = ([\d.]+) ±", text))
    # What the page's table was made with; its noise leaves less than a hundredth of it open.
    assert {name: float(value) for name, value in parameters.items()} == pytest.approx(
        {"gain": 0.45, "lag": 180.0, "sensor_lag": 12.0}, rel=0.02
    )
    assert re.search(
        "^Leader: .*trust it .* s ahead between", results[-1][2], re.MULTILINE
    )


# The notebook runs from its first to its last cell, without a warning, and finds what it shows.

nbformat = pytest.importorskip("nbformat", reason="nbformat is in the extra 'test'")
nbclient = pytest.importorskip("nbclient", reason="nbclient is in the extra 'test'")

NOTEBOOK = PROJECT / "docs" / "notebooks" / "recording_to_verdict.ipynb"

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
    strict = nbformat.v4.new_code_cell(
        "import warnings\nwarnings.simplefilter('error')"
    )
    notebook.cells = [strict, *notebook.cells, nbformat.v4.new_code_cell(ASK)]
    resources = {"metadata": {"path": str(NOTEBOOK.parent)}}
    return nbclient.NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources=resources
    ).execute()


def outputs(cell: Any, kind: str) -> str:
    return "".join(
        o.get("text", "") for o in cell.get("outputs", []) if o.get("name") == kind
    )


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
    answer = json.loads(outputs(run.cells[-1], "stdout"))
    assert answer["status"] == "accepted"
    truth = {"seebeck": 0.06, "conductance": 0.5, "heat_capacity": 27.0}
    for name, value in truth.items():
        assert answer["parameters"][name] == pytest.approx(value, rel=0.15)
    for name in ("seebeck", "heat_capacity"):
        low, high = answer["intervals"][name]
        assert low < truth[name] < high
    assert abs(answer["energy"]) < 1e-9
    assert answer["gains"] == answer["recorded_gains"], "by hand and by the twin"
    assert answer["chosen"] in {"22221", "33331", "44441", "55551"}
    assert answer["nominal"] == min(answer["sums"], key=answer["sums"].get)
    assert answer["fit"] > 0.98
    assert answer["level"] == "trusted"


def test_what_is_shown_is_what_comes_out(shown: Any, run: Any) -> None:
    """Words and structure; last digits may differ from processor to processor."""
    for cell_as_shown, cell_as_run in zip(shown.cells, run.cells[1:-1], strict=True):
        if cell_as_shown.cell_type == "code":
            before = outputs(cell_as_shown, "stdout").split()
            after = outputs(cell_as_run, "stdout").split()
            assert len(before) == len(after)
            words = [w for w in before if w.isalpha()]
            assert words == [w for w in after if w.isalpha()]


# Every name that the page on PlotJuggler and rqt tells is a number of a message that has a stamp.

PLOTJUGGLER = (PROJECT / "docs" / "plotjuggler.md").read_text("utf-8")
NAMES = sorted(set(re.findall(r"(?<![\w.])(/(?:plant|twin)/[\w\[\]/]+)", PLOTJUGGLER)))
NUMBER = re.compile(r"double|float|u?int(8|16|32|64)|boolean|sequence<double>")


def test_there_are_names_of_every_kind() -> None:
    assert len(NAMES) > 20
    assert {"/plant/sample/output[0]", "/twin/match/fit_y"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_it_is_a_number_with_a_stamp(name: str) -> None:
    topic, fields = re.fullmatch(r"/(\w+/\w+)/(.+)", name).groups()  # type: ignore[union-attr]
    kind = TOPICS[topic].replace("/msg/", "/")
    for number, field in enumerate(fields.split("/")):
        package, short = kind.split("/")
        field_types = getattr(
            importlib.import_module(f"{package}.msg"), short
        ).get_fields_and_field_types()
        assert number or field_types["header"] == "std_msgs/Header"
        kind = field_types[field.split("[")[0]]
        if "[" in field:
            kind = re.fullmatch(r"sequence<(.+)>", kind)[1]  # type: ignore[index]
    assert NUMBER.fullmatch(kind), f"{name} is {kind}"
