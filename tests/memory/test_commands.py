"""`twinmatch remember`, `memory` and `forget`."""

from __future__ import annotations

import json
from dataclasses import replace
from html import escape

import numpy as np
import pytest

from tests.support.lessons import lived_rig
from tests.support.rig import rig, run
from twinmatch.cli import main
from twinmatch.memory import Memory, default_file
from twinmatch.plants import Peltier
from twinmatch.sessions.recording import EPOCH
from twinmatch.showing.memory import began_text, memory_words


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A data folder of its own."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    return tmp_path


def write_table(path, seed, hold=200):
    """A recording of the simulated rig, as a table; each of four levels is held for so many seconds."""
    levels = np.repeat([40.0, 60.0, 35.0, 55.0], hold)
    window = run(rig("held sink", seebeck=0.06, conductance=0.6), levels, seed=seed)
    rows = np.column_stack(
        [np.arange(4.0 * hold), window.reference, window.output, window.input]
    )
    header = "time,reference,temperature,pwm"
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.4f")


def test_a_session_is_remembered_once_shown_and_forgotten(folder, capsys):
    write_table(folder / "monday.csv", 1)
    assert main(["remember", str(folder / "monday.csv"), "--rig", "left"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("monday: ")
    assert printed.strip().endswith("peltier@left.sqlite")
    lessons = Memory(default_file("peltier", "left")).lessons()
    learned = next(lesson for lesson in lessons if lesson.structure == "held sink")
    errors = (learned.values[:2] - [0.06, 0.6]) / learned.deviations[:2]
    assert np.all(np.abs(errors) < 4.0)
    assert main(["remember", str(folder / "monday.csv"), "--rig", "left"]) == 0
    assert capsys.readouterr().out == "monday: remembered already\n"
    assert main(["memory", "--json", str(folder / "out.json")]) == 0
    assert "What changes shows from 4 sessions on" in capsys.readouterr().out
    (document,) = json.loads((folder / "out.json").read_text())
    assert document["rig"] == "left"
    assert [entry["name"] for entry in document["lessons"]] == ["monday"] * len(lessons)
    assert main(["forget", str(folder / "monday.csv"), "sunday"]) == 3
    forgetting = capsys.readouterr()
    assert forgetting.out == "monday: forgotten\n"
    assert forgetting.err == "twinmatch: sunday: is not remembered\n"
    assert main(["forget", "monday"]) == 2


def test_what_has_changed_is_said_and_drawn(folder, capsys):
    lived = lived_rig(1, "step")
    file = folder / "rig.sqlite"
    equations = Peltier.model(lived.lessons[0].structure).equations
    Memory(file).add([replace(lesson, equations=equations) for lesson in lived.lessons])
    Memory(file).add(
        [replace(lived.lessons[0], session="old", name="old", equations="others")]
    )
    assert (
        main(["memory", "--memory", str(file), "--figure", str(folder / "memory.svg")])
        == 0
    )
    printed = capsys.readouterr().out
    assert f"Since run_{lived.since} the " in printed
    assert "before and after it was steady" in printed
    assert "Not compared: 1 session remembered with other equations" in printed
    assert "run_11" in printed
    drawn = (folder / "memory.svg").read_text()
    assert drawn.startswith("<?xml")


def test_errors_are_one_sentence(folder, capsys):
    assert main(["remember", str(folder / "none.csv")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    (folder / "rig.sqlite").write_text("not a memory" * 100)
    for command in (["memory"], ["forget", "monday"]):
        assert main([*command, "--memory", str(folder / "rig.sqlite")]) == 2
        printed = capsys.readouterr().err
        assert printed.endswith(
            "is not a memory of twinmatch; give another file, or move it away\n"
        )
        assert printed.count("\n") == 1
    write_table(folder / "monday.csv", 1)
    assert (
        main(
            [
                "remember",
                str(folder / "monday.csv"),
                "--memory",
                str(folder / "rig.sqlite"),
            ]
        )
        == 2
    )
    assert "is not a memory of twinmatch" in capsys.readouterr().err
    assert main(["memory"]) == 0
    assert capsys.readouterr().out.startswith("Nothing is remembered yet")
    assert main(["remember", str(folder / "monday.csv"), "--rig", "../x"]) == 2
    assert "is not a name for a rig" in capsys.readouterr().err


def test_a_report_says_what_earlier_sessions_say(folder, capsys):
    lived = lived_rig(1, "step")
    file = default_file("peltier", "left")
    equations = Peltier.model(lived.lessons[0].structure).equations
    Memory(file).add(
        [replace(lesson, equations=equations, rig="left") for lesson in lived.lessons]
    )
    words = memory_words(Peltier, None, "left")
    assert words[0].startswith(f"Since run_{lived.since} the ")
    assert memory_words(Peltier, None, "") == []
    assert memory_words(Peltier, None, "right") == []
    (folder / "broken").write_text("not a memory" * 100)
    (broken,) = memory_words(Peltier, folder / "broken", "")
    assert broken.startswith("Nothing is known of earlier sessions: memory ")
    write_table(folder / "monday.csv", 1, hold=30)
    out = folder / "report.html"
    assert (
        main(
            [
                "report",
                str(folder / "monday.csv"),
                "--rig",
                "left",
                "--peers",
                "-o",
                str(out),
            ]
        )
        == 0
    )
    assert words[0] in capsys.readouterr().out
    assert escape(words[0]) in out.read_text()


def test_a_recording_without_a_date_has_none():
    first = lived_rig(1, "steady").lessons[0]
    assert began_text(first) == "1970-01-01 00:00"
    assert began_text(replace(first, began=EPOCH)) == "–"
