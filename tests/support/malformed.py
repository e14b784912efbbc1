"""Malformed documents of every kind that commands read, and the calls that read them.

A sound document is changed in one to three places, as a tree or as bytes. What reads it may accept it, or
raise a TwinmatchError; any other exception is a bug.
"""

from __future__ import annotations

import contextlib
import copy
import io
import json
import random
import sqlite3
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from tests.support.damage import KINDS as DAMAGES
from tests.support.lessons import lived_rig
from tests.support.plants import Lag
from twinmatch.adding import propose
from twinmatch.cli import main
from twinmatch.controllers import (
    ControllerQuestion,
    FilteredPid,
    Holding,
    TriedTwin,
    pid_law,
    try_controller,
)
from twinmatch.errors import TwinmatchError
from twinmatch.fmu.mapping import read_maps
from twinmatch.importing.column_map import columns_of, proposed, read_map
from twinmatch.importing.mapped import map_samples, with_plant_names
from twinmatch.importing.tables import read_table
from twinmatch.memory import Memory
from twinmatch.offline.controllers import planned_profile, read_law
from twinmatch.offline.outlooks import planned_rows
from twinmatch.offline.starting import remembered_start
from twinmatch.parameters.candidates import candidates_text, read_candidates
from twinmatch.parameters.twin import read_settings
from twinmatch.plants import Peltier
from twinmatch.sampling.sources import SignalMap

LIMITS = {"low": -10.0, "high": 10.0}
HELD = pid_law(
    [FilteredPid(proportional=1.0, integral=0.2, back_calculation=0.5, **LIMITS)], 1.0
)
STEPS = np.repeat([[3.0], [5.0]], 30, axis=0)
MATRICES = {
    "A": [[1.0]],
    "B": [[-0.1]],
    "C": [[1.0]],
    "D": [[-2.0]],
    "E": [[2.0]],
    "F": [[0.1]],
}
REGULATOR = {key: [[0.5]] for key in ("A", "B", "C", "K", "Qs", "Rs", "Cd")}
LAWS: tuple[dict[str, Any], ...] = (
    {
        "kind": "pid",
        "proportional": 2.0,
        "integral": 0.1,
        "derivative": 0.5,
        "filter": 1.0,
        **LIMITS,
    },
    {
        "kind": "pid",
        "loops": [{"proportional": 2.0, "integral": 0.1}],
        "period": 1.0,
        "units": {"u": "V"},
    },
    {
        "kind": "two-level",
        "off": 0.0,
        "on": 5.0,
        "below": 0.5,
        "above": 0.2,
        "least_on": 3.0,
    },
    {"kind": "state-space", **MATRICES, "outputs": ["y"], "inputs": ["u"]},
    {**REGULATOR, "Bd": [[0.0]], "K": [[0.1], [0.2]], "u0": [[1.0]], "y0": [[2.0]]},
)
ODD: tuple[Any, ...] = (
    None, True, 0, -1, 1, 10**400, -(10**25), 1e308, -1e308, 1e-320, float("nan"), float("inf"),
    -float("inf"), "", "x", "1", "9" * 5000, " " * 700, "\x1b[2J", "a\nb", "é²", "((((", "1e999", "pid", [],
    [[]], [1], [1, [2, 3]], [[1, 2], [3]], {}, {"x": 1}, {"kind": "pid"}, "../../etc/passwd",
    [["x"] * 3] * 3, [0.0] * 1000,
)  # fmt: skip
NUMBERS = (
    0.0,
    -1.0,
    1.0,
    0.5,
    3.0,
    1e-300,
    1e-9,
    1e6,
    1e9,
    1e154,
    1e300,
    -1e300,
    1.7e308,
)
SEVERAL = (1, 1, 1, 2, 3)
"""Changes of a document."""
DEEP: Any = 1
for _ in range(300):
    DEEP = [DEEP]
LARGE: list[Any] = [[float(k)] * 60 for k in range(60)]
CELLS = ("", "x", "1e999", "nan", "-", "9" * 5000, " " * 700, '"', "1,5", "2022-13-45", "\x00", "é", "1e7",
         "1e308",
         "(" * 300, "temperature (" + " " * 400, "#", "inf", "-1")  # fmt: skip
TABLE = "time (s),temperature (°C),heater (%)\n" + "".join(
    f"{k},{20 + 0.1 * (k % 17)},{10 * (k % 3)}\n" for k in range(40)
)
PROFILE = "seconds,temperature\n0,50\n60,55.5\n120,45\n300,50\n"
MAP = {
    "plant": "peltier", "period": 1.0,
    "columns": {
        "time": {"column": "time", "unit": "s"}, "output": ["temperature"],
        "input": {"column": "heater", "scale": 2.0, "unit": "PWM"},
        "reference": {"column": "temperature", "scale": 1.0, "offset": 0.5},
    },
}  # fmt: skip
FMU_MAP = {
    "plant": "peltier",
    "structures": {
        "shop": {
            "fmu": "plate.fmu", "kind": "", "free": ["k"], "fixed": {"seebeck": 0.07}, "patience": 5.0,
            "variables": {
                "temperature": "celsius", "pwm": {"variable": "pwm", "factor": 2.0, "offset": 0.0},
                "plate": "plate", "seebeck": "seebeck", "k": "k",
            },
            "starts": {"plate": "temperature + 273.15"}, "searches": [{"k": 1.0}],
            "parameters": {"k": {"unit": "W/K", "default": 1.0, "bounds": [0.1, 2.0], "positive": True}},
        }
    },
}  # fmt: skip
SETTINGS = {
    "/**": {
        "ros__parameters": {
            "plant": "peltier", "period": 1.0, "decimals": 2, "free": ["seebeck"],
            "schedule": {"stride": 60, "scale": 1.0}, "pid": {"low": -255.0}, "limits": {"doubtful": 1.5},
        }
    }
}  # fmt: skip


class Malformed:
    """Draws documents; the same seed gives the same ones."""

    def __init__(self, seed: int, folder: Path) -> None:
        self._random = random.Random(seed)
        self._folder = folder
        self._table = folder / "sound.csv"
        self._table.write_text(TABLE, "utf-8")
        lessons = lived_rig(1, "step", 6).lessons
        model = Peltier.model(lessons[0].structure)
        self._lessons = [
            replace(lesson, equations=model.equations) for lesson in lessons
        ]
        self._memory = folder / "sound.sqlite"
        Memory(self._memory).add(self._lessons)
        start = remembered_start(self._memory, "", "peltier")
        self._candidates = yaml.safe_load(candidates_text(start.candidates))

    def laws(self) -> None:
        path = self._written(
            "law.json", self._json(self._changed(self._random.choice(LAWS)))
        )
        law = read_law(path, Lag, 1.0)
        twin = TriedTwin("nominal", Lag.model().parameters())
        try_controller(
            [twin],
            ControllerQuestion(law, STEPS, STEPS[0], Holding(HELD, 1.0, 60), draws=25),
        )

    def memories(self) -> None:
        path = self._folder / "rig.sqlite"
        path.write_bytes(self._memory.read_bytes())
        with contextlib.closing(sqlite3.connect(path)) as database:
            names = [row[1] for row in database.execute("PRAGMA table_info(lesson)")]
            for _ in range(self._random.choice(SEVERAL)):
                name = self._random.choice(names)
                value = getattr(self._lessons[0], name)
                some = self._random.choice(("1", "rowid = 2"))
                with contextlib.suppress(
                    sqlite3.Error, OverflowError, UnicodeEncodeError
                ):
                    database.execute(
                        f"UPDATE lesson SET {name} = ? WHERE {some}",
                        [self._cell(value)],
                    )
            database.commit()
        if self._random.random() < 0.1:
            self._written(path.name, path.read_bytes(), always=True)
        self._command(
            "memory", "--memory", str(path), "--json", str(self._folder / "out.json")
        )
        remembered_start(path, "", "")
        Memory(path).forget(["run_1"])

    def candidates(self) -> None:
        path = self._written(
            "candidates.yaml", self._yaml(self._changed(self._candidates))
        )
        read_candidates(path)

    def profiles(self) -> None:
        path = self._written("profile.csv", self._cells(PROFILE, ",").encode())
        rows = [line.split(",") for line in planned_rows(path) if line.strip()]
        planned_profile(Peltier, np.array([50.0]), rows, 1.0, 60)

    def maps(self) -> None:
        path = self._written("map.yaml", self._yaml(self._changed(MAP)))
        table = read_table(self._table)
        signal_map = read_map(path)
        map_samples(table, with_plant_names(table, Peltier, signal_map), Peltier)

    def fmu_maps(self) -> None:
        read_maps(self._written("fmus.yaml", self._yaml(self._changed(FMU_MAP))))

    def settings(self) -> None:
        read_settings(self._written("twin.yaml", self._yaml(self._changed(SETTINGS))))

    def tables(self) -> None:
        path = self._written(
            "table.csv", self._cells(TABLE, self._random.choice(",,,;\t")).encode()
        )
        table = read_table(path)
        columns = columns_of(table)
        propose(table, SignalMap(proposed(columns)))

    def _command(self, *words: str) -> None:
        """Run a command, whose own refusals are what it has to say."""
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            code = main(words)
        if code == 2:
            raise TwinmatchError(printed.getvalue())
        assert code == 0

    def _written(self, name: str, content: bytes, *, always: bool = False) -> Path:
        """The file, one in five of them damaged as a wire does it."""
        if always or self._random.random() < 0.2:
            data = bytearray(content or b" ")
            self._random.choice(DAMAGES)(self._random, data)
            content = bytes(data)
        path = self._folder / name
        path.write_bytes(content)
        return path

    def _changed(self, sound: Any) -> Any:
        tree = copy.deepcopy(sound)
        for _ in range(self._random.choice(SEVERAL)):
            owner, key = self._random.choice([*_places(tree)] or [(None, None)])
            if owner is None:
                return self._odd()
            kind = self._random.random()
            if kind < 0.15:
                del owner[key]
            elif kind < 0.25 and isinstance(owner, dict):
                owner[
                    self._random.choice(("x", "\x1b[2J", " " * 700, "kind", "9" * 300))
                ] = owner[key]
            elif kind < 0.35:
                owner[key] = [owner[key]]
            elif kind < 0.7 and isinstance(owner[key], float | int):
                owner[key] = self._random.choice(NUMBERS)
            else:
                owner[key] = self._odd()
        return tree if self._random.random() < 0.97 else self._odd()

    def _odd(self) -> Any:
        return copy.deepcopy(self._random.choice((*ODD, LARGE, DEEP)))

    def _cell(self, value: Any) -> Any:
        """What may stand in a column of a database; in one with JSON mostly some other JSON."""
        draw = self._random
        if isinstance(value, tuple | dict) and draw.random() < 0.7:
            return self._json(self._changed(json.loads(self._json(value)))).decode()
        return draw.choice(
            (None, -1, 0, 2**63 - 1, -(2**63), 1e308, float("inf"), "", "x", "9" * 5000, b"\xff\x00",
             "[" * 5000, "²", "\x1b[2J", "trusted", "\ud800", "peltier", "held sink")
        )  # fmt: skip

    def _cells(self, text: str, divider: str) -> str:
        rows = [line.split(",") for line in text.splitlines()]
        for _ in range(self._random.choice(SEVERAL)):
            row = self._random.choice(rows[:2] if self._random.random() < 0.4 else rows)
            kind = self._random.random()
            place = self._random.randrange(len(row) or 1)
            if kind < 0.1:
                rows.remove(row) if len(rows) > 1 else None
            elif kind < 0.2:
                row.append(self._random.choice(CELLS))
            elif kind < 0.25:
                rows += [list(row)] * self._random.choice((1, 3000))
            elif row:
                row[place] = self._random.choice(CELLS)
        return "\n".join(map(divider.join, rows))

    @staticmethod
    def _json(tree: Any) -> bytes:
        return json.dumps(tree, default=str).encode("utf-8", "surrogatepass")

    @staticmethod
    def _yaml(tree: Any) -> bytes:
        return yaml.dump(tree, allow_unicode=True).encode("utf-8", "surrogatepass")


KINDS = (
    "laws",
    "memories",
    "candidates",
    "profiles",
    "maps",
    "fmu_maps",
    "settings",
    "tables",
)


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Every place in a tree, as its owner and its key there."""
    keys: Iterable[Any] = ()
    if isinstance(tree, dict):
        keys = list(tree)
    elif isinstance(tree, list):
        keys = range(len(tree))
    for key in keys:
        yield tree, key
        yield from _places(tree[key])


class Reading(NamedTuple):
    """The result of reading one document."""

    accepted: bool
    refusal: str = ""
    """The message of a refusal."""
    bug: Exception | None = None


def readings(kind: str, number: int, seed: int, folder: Path) -> Iterator[Reading]:
    """Draw and read so many documents of a kind."""
    drawn = Malformed(seed, folder)
    read: Callable[[], None] = getattr(drawn, kind)
    for _ in range(number):
        try:
            read()
        except TwinmatchError as error:
            yield Reading(accepted=False, refusal=str(error))
        except Exception as error:
            yield Reading(accepted=False, bug=error)
        else:
            yield Reading(accepted=True)
