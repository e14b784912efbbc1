"""A mistake of the user is one line that names it and exit code 2; nothing is printed or left behind."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from tests.support.places import SHIPPED
from tests.support.processes import run_twinmatch
from tests.support.steps import quarter_of_an_hour
from twinmatch.sessions import SessionWriter, samples_of, write_session
from twinmatch.sessions.cdr import encode_float64
from twinmatch.sessions.messages import REFERENCE
from twinmatch.signals import Window

ONE = "candidates:\n  - {name: a, operating_point: 50"
TEXTS = {
    "unknown.yaml": "/**:\n  ros__parameters:\n    schedule.strid: 60\n",
    "range.yaml": "/**:\n  ros__parameters:\n    schedule:\n      stride: 1\n",
    "type.yaml": "/**:\n  ros__parameters:\n    decimals: two\n",
    "choice.yaml": "/**:\n  ros__parameters:\n    free: [seebeck, colour]\n",
    "shape.yaml": "matcher: 5\n",
    "other.yaml": "other:\n  ros__parameters: {}\n",
    "torn.yaml": "a: [1\n",
    "none.yaml": "candidates: []\n",
    "misspelt.yaml": f"{ONE}, sebeck: 0.1}}\n",
    "lacking.yaml": "candidates:\n  - {name: a}\n",
    "warm.yaml": "candidates:\n  - {name: a, operating_point: warm}\n",
    "negative.yaml": f"{ONE}, seebeck: -1}}\n",
    "seven.yaml": "candidates:\n  - 7\n",
    "twice.yaml": f"{ONE}}}\n  - {{name: a, operating_point: 70}}\n",
    "past.csv": "-5,50\n",
    "back.csv": "10,50\n10,60\n",
    "hot.csv": "10,150\n",
    "words.csv": "10,warm\n",
    "empty.csv": "",
}


def table() -> np.ndarray:
    return np.column_stack(
        [np.zeros(20), np.full(20, 30.0), np.arange(20.0), np.full(20, 30.0)]
    )


def with_value(row: int, column: int, value: float) -> np.ndarray:
    values = table()
    values[row, column] = value
    return values


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sessions, recordings and files of parameters, candidates and set-points, most of them unusable."""
    directory = tmp_path_factory.mktemp("mistakes")
    for name, text in TEXTS.items():
        (directory / name).write_text(text, encoding="utf-8")
    for name, values in {
        "good": table(),
        "columns": np.zeros((5, 3)),
        "nan": with_value(7, 1, np.nan),
        "gap": np.delete(table(), 9, axis=0),
        "range": with_value(3, 0, 300.0),
    }.items():
        scipy.io.savemat(directory / f"{name}.mat", {"simout": values})
    (directory / "noise.mat").write_bytes(np.random.default_rng(3).bytes(5000))
    (directory / "torn.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(range(256)) * 4)
    (directory / "shipped").symlink_to(SHIPPED)
    reference = np.repeat([30.0, 50.0], 45)
    write_session(
        directory / "small", samples_of(Window(reference, reference, reference / 2))
    )
    write_session(directory / "quarter", quarter_of_an_hour())
    with SessionWriter(directory / "elsewhere") as writer:
        writer.add_topic(REFERENCE._replace(name="/somewhere/else"))
        writer.write("/somewhere/else", encode_float64(1.0), 10**9)
    return directory


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("import absent.mat -o new", ["absent.mat", "does not exist"]),
        ("import columns.mat -o new", ["columns.mat", "simout"]),
        ("import nan.mat -o new", ["nan.mat", "nan"]),
        ("import gap.mat -o new", ["gap.mat", "from row 9 to row 10"]),
        ("import range.mat -o new", ["range.mat", "300"]),
        ("import noise.mat -o new", ["noise.mat"]),
        ("import good.mat -o small", ["small"]),
        ("replay noise.mat", ["noise.mat"]),
        ("replay elsewhere", ["/somewhere/else"]),
        ("replay small --json no/out.json", ["no does not exist; create it first"]),
        (
            "replay small --config unknown.yaml",
            ["unknown.yaml", "schedule.strid", "schedule.stride"],
        ),
        ("replay small --config range.yaml", ["range.yaml", "schedule.stride", "4"]),
        ("replay small --config type.yaml", ["type.yaml", "decimals", "whole number"]),
        ("replay small --config choice.yaml", ["choice.yaml", "free", "seebeck"]),
        (
            "replay small --config shape.yaml",
            ["shape.yaml", "matcher", "ros__parameters"],
        ),
        ("replay small --config other.yaml", ["other.yaml", "section"]),
        ("replay small --config torn.yaml", ["torn.yaml", "YAML"]),
        ("replay small --candidates none.yaml", ["no list 'candidates'"]),
        ("replay small --candidates misspelt.yaml", ["candidate 1", "sebeck"]),
        (
            "replay small --candidates lacking.yaml",
            ["candidate 1", "operating_point: is missing"],
        ),
        ("replay small --candidates warm.yaml", ["operating_point: is 'warm'"]),
        ("replay small --candidates negative.yaml", ["candidate 1", "seebeck"]),
        ("replay small --candidates seven.yaml", ["candidate 1", "is 7"]),
        ("replay small --candidates twice.yaml", ["two candidates"]),
        ("report absent.mcap", ["absent.mcap", "does not exist"]),
        (
            "report shipped -o no/such/report.html",
            ["the folder no/such does not exist"],
        ),
        ("report shipped -o .", ["is a folder"]),
        ("report shipped --config absent.yaml", ["absent.yaml", "cannot be read"]),
        ("report torn.mat", ["torn.mat"]),
        ("backtest absent.mat", ["absent.mat"]),
        ("backtest shipped --horizon 0.5", ["shorter than one sample"]),
        ("backtest shipped --figure nowhere/card.png", ["create it first"]),
        ("backtest shipped --config absent.yaml", ["absent.yaml"]),
        (
            "forecast quarter --at 100",
            ["no candidate at sample 100", "from sample 300 on"],
        ),
        ("forecast quarter --at 920", ["has no sample 920", "0 to 919"]),
        ("forecast quarter --at 500 --horizon 0", ["horizon is 0 s", "positive"]),
        ("forecast quarter --at 500 --horizon -3", ["horizon is -3 s"]),
        ("forecast quarter --at 500 --horizon nan", ["horizon is nan s"]),
        (
            "forecast quarter --at 500 --horizon 1e9",
            ["horizon is 1e+09 s", "at most 86400"],
        ),
        (
            "forecast quarter --at 500 --horizon 0.5",
            ["0.5 s is shorter than one sample", "1 s"],
        ),
        (
            "forecast quarter --at 500 --candidate Bob",
            ["sample 500", "'Bob'", "there are: ", "40 °C"],
        ),
        ("forecast quarter --at 500 --hold 150", ["--hold", "150 °C", "0 to 100 °C"]),
        ("forecast quarter --at 500 --hold inf", ["--hold", "inf"]),
        (
            "forecast quarter --at 500 --hold 5 --reference recorded",
            ["--reference and --hold", "only one"],
        ),
        (
            "forecast quarter --at 500 --reference absent.csv",
            ["absent.csv: does not exist"],
        ),
        (
            "forecast quarter --at 500 --reference past.csv",
            ["past.csv", "row 1", "past"],
        ),
        (
            "forecast quarter --at 500 --reference back.csv",
            ["back.csv", "row 2", "increasing"],
        ),
        (
            "forecast quarter --at 500 --reference hot.csv",
            ["hot.csv", "row 1", "150 °C", "0 to 100 °C"],
        ),
        (
            "forecast quarter --at 500 --reference words.csv",
            ["words.csv", "line 1", "warm"],
        ),
        ("forecast quarter --at 500 --reference empty.csv", ["empty.csv", "no row"]),
        (
            "forecast quarter --at 919 --reference recorded",
            ["right after sample 919", "--hold"],
        ),
        (
            "forecast quarter --at 500 --json nowhere/out.json",
            ["folder nowhere does not exist"],
        ),
        (
            "dashboard --port 70000",
            ["dashboard: --port is 70000; give a port from 0 to 65535"],
        ),
        (
            "dashboard --namespace 'no name'",
            ["dashboard: 'no name' is not a namespace; give one such as"],
        ),
        (
            "foxglove --port 70000",
            ["foxglove: --port is 70000; give a port from 0 to 65535"],
        ),
        (
            "foxglove --namespace 'no name'",
            ["foxglove: 'no name' is not a namespace; give one such as"],
        ),
        (
            "foxglove --layout nowhere/out.json",
            ["nowhere does not exist; create it first"],
        ),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing(
    command: str, words: list[str], folder: Path
) -> None:
    before = set(folder.iterdir())
    completed = run_twinmatch(*shlex.split(command), folder=folder)
    assert completed.returncode == 2
    assert completed.stdout == ""
    assert completed.stderr.startswith("twinmatch: ")
    assert len(completed.stderr.strip().splitlines()) == 1, completed.stderr
    assert all(word.lower() in completed.stderr.lower() for word in words), (
        completed.stderr
    )
    assert set(folder.iterdir()) == before


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("replya", "replya"),
        (
            "backtest shipped --every 0",
            "'0' is not a time in seconds; give a positive number",
        ),
        ("backtest shipped --horizon soon", "'soon' is not a time in seconds"),
        ("backtest shipped --peers prophet", "prophet"),
        ("replay shipped --jobs 0", "'0' is not a number of processes; give 1 or more"),
        (
            "forecast --at 500 quarter",
            "not a sample index; give whole numbers, and the session before --at",
        ),
    ],
)
def test_options_that_mean_nothing_are_refused(
    command: str, words: str, folder: Path
) -> None:
    completed = run_twinmatch(*shlex.split(command), folder=folder)
    assert completed.returncode == 2
    assert words in completed.stderr
    assert "Traceback" not in completed.stderr
