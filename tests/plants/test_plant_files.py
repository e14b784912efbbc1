"""Plants outside this package: in a file that somebody names, or of another installed package."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import sys
from functools import partial
from pathlib import Path
from zlib import crc32

import pytest

from tests.support.plant_files import plant_file
from tests.support.processes import no_plant_files
from twinmatch.dynamics import Plant, PlantError, equations
from twinmatch.dynamics.equations import at_most
from twinmatch.plants import (
    PLANTS,
    Peltier,
    files,
    find_plant,
    plant_named,
    written_name,
)
from twinmatch.plants.files import declared_plants


def test_a_plant_is_found_by_its_file_and_then_by_its_name(tmp_path: Path) -> None:
    path = plant_file(tmp_path, "block_found")
    plant = find_plant(str(path))
    assert plant.name == "block_found"
    assert find_plant("block_found") is plant is find_plant(str(path))
    assert written_name(plant) == str(path)
    assert written_name(Peltier) == "peltier"


def test_a_file_that_a_recording_names_is_not_run(tmp_path: Path) -> None:
    path = plant_file(
        tmp_path, "block_told", ('"""A heated', 'open("ran", "w")\n"""A heated')
    )
    with pytest.raises(
        PlantError,
        match=r"files are run only if you name them: add --plant .*block_told\.py",
    ):
        plant_named(str(path))
    assert not (tmp_path / "ran").exists()


def test_a_file_named_by_a_user_is_found_by_its_name_in_a_recording(
    tmp_path: Path,
) -> None:
    plant = find_plant(str(plant_file(tmp_path, "block_recorded")))
    assert plant_named("/somebody/elses/folder/block_recorded.py") is plant
    assert plant_named("block_recorded") is plant


def _name_in_another_process(plant: type[Plant]) -> tuple[str, int]:
    return plant.name, len(plant.parameters)


def test_a_plant_of_a_file_travels_to_another_process(tmp_path: Path) -> None:
    plant = find_plant(str(plant_file(tmp_path, "block_travels")))
    assert pickle.loads(pickle.dumps(plant)) is plant
    assert pickle.loads(pickle.dumps(Peltier)) is Peltier
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(_name_in_another_process, (plant,)) == ("block_travels", 3)


def test_a_plant_may_use_a_file_beside_it(tmp_path: Path) -> None:
    (tmp_path / "tables_of_block.py").write_text("LIMIT = 80.0\n")
    path = plant_file(
        tmp_path, "block_beside", ("limits=(0.0, 100.0)", "limits=(0.0, tables_of_block.LIMIT)"),
        ('"""A heated', 'import tables_of_block\n"""A heated'),
    )  # fmt: skip
    before = list(sys.path)
    assert find_plant(str(path)).drive.limits == (0.0, 80.0)
    assert sys.path == before


def test_an_edit_within_the_second_that_leaves_the_size_is_seen(tmp_path: Path) -> None:
    path = plant_file(tmp_path, "block_edited")
    limits = []
    for limit in ("100.0", "120.0"):
        path.write_text(
            path.read_text().replace("limits=(0.0, 100.0)", f"limits=(0.0, {limit})")
        )
        os.utime(path, (1_000_000_000, 1_000_000_000))
        with no_plant_files():  # as in a new process
            limits.append(find_plant(str(path)).drive.limits)
    assert limits == [(0.0, 100.0), (0.0, 120.0)]


OTHER = """\
class Other(Plant):
    y = Output(noise=1.0, span=(0.0, 1.0))
    u = Drive(limits=(0.0, 1.0), noise=1.0)
    x = State(span=(0.0, 1.0))
    a = Parameter(default=1.0, bounds=(0.0, 1.0))
    structures = {'a': Structure(free=('a',))}


"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("Output(unit", "Output(unti", r"TypeError: Output\(\) got .*unti"),
        ("unit=\"°C\", noise=0.1, ", "unit=\"°C\", ", r"TypeError: Output\(\) missing 1 required .*noise"),
        ("bounds=(0.05, 5.0)", "bounds=(5.0, 0.05)", r"bounds of a parameter is \(5\.0, 0\.05\)"),
        ("default=0.5, ", "default=0.5 ", r"invalid Python: "),
        ("Disturbance(", "Disturbence(", r"NameError: name 'Disturbence' is not defined"),
        ('free=("gain", "capacity")', 'free=("gian",)', r"plant .*no parameter 'gian'"),
        ("State, Structure", "State, Structur", r"ImportError: cannot import name 'Structur'"),
        ("noise=0.1, span", "noise='0.1', span", r"noise of the output is '0\.1'; give a finite "
            r"number above 0"),
        ("limits=(0.0, 100.0)", "limits=(100.0, 0.0)", r"limits of the drive is \(100\.0, 0\.0\); give two"),
        ("span=(0.0, 110.0)", "span=110.0", r"span of a state is 110\.0; give two finite numbers"),
        ('free=("gain", "capacity")', 'free=("gain")', r"free of a structure is the text 'gain'; "
            r"write \('gain',\)"),
        ("gain = Parameter(", "sensor = Parameter(", r"'sensor' is an attribute of every plant"),
        ("class Heated(Plant, ", "class Heated(object, ", r"TypeError: "),
        ('unit="W/K"', "unit=3", r"unit of a quantity is 3; give a short text in quotes"),
        ("default=0.5", "default=-0.5", r"default of a parameter is -0\.5; it must be finite and positive"),
        ("noise=1.0", "noise=1.0, rest=500.0", r"rest of the drive is 500; give a value within its limits"),
        ("noise=1.0", "noise=1.0, rest=float('nan')", r"rest of the drive is nan; give a finite number"),
        ("120.0)", "120.0), set_points=(50.0, 10.0)", r"set_points of the output is \(50\.0, 10\.0\); give"),
        ("120.0)", "120.0), absolute='K'", r"absolute of the output is 'K'; give a finite number"),
        ("110.0)", "110.0), start_bounds=(5.0, 1.0)", r"start_bounds of a state is \(5\.0, 1\.0\); give two"),
        ("class Heated", "raise SystemExit(0)\nclass Heated", "the file exits Python; remove that call"),
        ("class Heated", "raise ValueError('a\\nb')\nclass Heated", "ValueError: a b$"),
        ("class Heated", "raise type('E', (BaseException,), {})('own')\nclass Heated", "E: own$"),
        ("class Heated", "raise type('K', (KeyboardInterrupt,), {})('own')\nclass Heated", "K: own$"),
        ("class Heated", "raise GeneratorExit\nclass Heated", "GeneratorExit$"),
        ("class Heated", "raise type('E', (Exception,), {'__str__': lambda e: 3})\nclass Heated", "E$"),
        ("class Heated", "float(10**400)\nclass Heated", "a number is too large for floating point"),
        ('unit="W/K"', 'unit="m**9**9**9**9"', r"unit of a quantity is 'm\*\*9\*\*9\*\*9\*\*9', too long or"),
        ("noise=0.1", "noise=10**400", r"noise of the output is 10{58}…; give a finite number above 0$"),
        ("noise=0.1", "noise=10**5000", "noise of the output is of type int, too long to be shown; give a"),
        ("default=20.0", "default=-10**400", r"default of a disturbance is -10{57}…; give a finite number$"),
        ("span=(0.0, 110.0)", "span=(0.0, 10**400)", r"span of a state is \(0\.0, 10{52}…; give two finite"),
        ("class Heated", f"{OTHER}class Heated", r"has 2 plants, Heated, Other; give each"),
    ],
)  # fmt: skip
def test_a_mistake_is_reported_with_its_line(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = plant_file(tmp_path, "block_bad", (old, new))
    line = 1 + path.read_text().partition(
        "class" if "gian" in new or "sensor" in new else new
    )[0].count("\n")
    with pytest.raises(PlantError, match=message) as raised:
        find_plant(str(path))
    assert str(raised.value).startswith(
        f"{path}: " if new.startswith(OTHER) else f"{path}, line {line}: "
    )
    assert "\n" not in str(raised.value)


STRUCTURES = 'structures = {"block": Structure(free=("gain", "capacity"))}'


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            STRUCTURES,
            "structures = [Structure(free=())]",
            "`structures` is of type list; write a dictionary",
        ),
        (
            STRUCTURES,
            'structures = {"a": "gain"}',
            r"is 'gain'; write Structure\(free=",
        ),
        (
            STRUCTURES,
            "structures = {1: Structure(free=())}",
            "name of a structure .* is 1; give a short text",
        ),
        (
            '("gain", "capacity")',
            '("gain", "gain")',
            "`free` names 'gain' twice; name it once",
        ),
        (
            '("gain", "capacity")',
            '("gain",), fixed={"loss": -1.0}',
            "loss is -1.0; it must be finite and pos",
        ),
        (
            '("gain", "capacity")',
            '("gain",), starts=({"los": 1.0},)',
            "no parameter 'los'; the plant has",
        ),
        (
            STRUCTURES,
            f"{STRUCTURES}; typical = {{'gain': 'much'}}",
            "gain is 'much'; it must be finite and",
        ),
        (
            STRUCTURES,
            f"{STRUCTURES}; typical = ['gain']",
            r"is \['gain'\]; write a dictionary of names",
        ),
        (
            STRUCTURES,
            f"{STRUCTURES}; loop = 'pid'",
            r"`loop` is 'pid'; give a PidGains\(…\)",
        ),
        (
            STRUCTURES,
            f"{STRUCTURES}; sensor = 'camera'",
            r"`sensor` is 'camera'; give a Sensor\(…\)",
        ),
        (
            STRUCTURES,
            f"{STRUCTURES}; parts = 'lag'",
            r"`parts` is 'lag'; write texts in a tuple",
        ),
        (
            STRUCTURES,
            f"{STRUCTURES}; title = 3",
            "title of .* is 3; give a short text in quotes",
        ),
        (
            STRUCTURES,
            f"{STRUCTURES}; time_constant = 10**400",
            "`time_constant` is 10{58}…; give seconds",
        ),
        (
            '("gain", "capacity")',
            '("gain",), fixed={"loss": 10**400}',
            "loss is 10{58}…; it must be finite",
        ),
        (
            "    def equations",
            "    def __init__(self): raise BaseException\n    def equations",
            "its own __init__ or __new__",
        ),
        (
            "def equations(self, parts)",
            "def equations(self)",
            r"write def equations\(self, parts\)",
        ),
        (
            "room",
            "reference",
            "a disturbance is called 'reference', like a signal of every recording",
        ),
        (
            'name="block_class_',
            'name="../block_class_',
            "is not a valid name; use letters, digits and _",
        ),
    ],
)
def test_a_class_that_contradicts_itself_is_refused(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    name = f"block_class_{crc32(repr((old, new)).encode())}"
    with pytest.raises(PlantError, match=message) as raised:
        find_plant(str(plant_file(tmp_path, name, (old, new))))
    assert str(raised.value).startswith(f"{tmp_path / name}.py, line 6: ")
    assert "\n" not in str(raised.value)


def test_a_file_that_never_ends_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (files, equations):
        monkeypatch.setattr(module, "at_most", partial(at_most, 1.0))
    ends = ('"""A heated', 'while True: pass\n"""A heated')
    with pytest.raises(
        PlantError, match=r"line 1: the file was not loaded within .* look for a loop"
    ):
        find_plant(str(plant_file(tmp_path, "block_endless", ends)))
    ends = ("        lost = ", "        while True: pass\n        lost = ")
    with pytest.raises(PlantError, match="line 19: `equations` did not return within"):
        _ = (
            find_plant(str(plant_file(tmp_path, "block_endless_too", ends)))
            .model()
            .states
        )


def test_files_without_a_plant_and_names_that_are_taken_are_refused(
    tmp_path: Path,
) -> None:
    with pytest.raises(PlantError, match="there is no such file"):
        find_plant(str(tmp_path / "none.py"))
    empty = tmp_path / "empty.py"
    empty.write_text("x = 1\n")
    with pytest.raises(PlantError, match="has no plant; write a class such as"):
        find_plant(str(empty))
    with pytest.raises(
        PlantError, match="is called peltier, like one that comes with twinmatch"
    ):
        find_plant(str(plant_file(tmp_path, "peltier")))
    assert all(find_plant(name) is plant for name, plant in PLANTS.items())
    find_plant(str(plant_file(tmp_path, "block_twice")))
    (tmp_path / "copy").mkdir()
    with pytest.raises(
        PlantError,
        match=r"is called block_twice, like that of .*give one of them another name",
    ):
        find_plant(str(plant_file(tmp_path / "copy", "block_twice")))
    with pytest.raises(
        PlantError,
        match=r"plant 'nothing': not known; choose from peltier.*nothing\.py",
    ):
        find_plant("nothing")


def installed(folder: Path, value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package as pip leaves it, with one entry point."""
    info = folder / "block_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: block-package\nVersion: 1.0\n"
    )
    (info / "entry_points.txt").write_text(
        f"[twinmatch.plants]\nblock_package = {value}\n"
    )
    monkeypatch.syspath_prepend(folder)
    declared_plants.cache_clear()


def test_a_plant_of_an_installed_package_is_found_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant_file(tmp_path, "block_package")
    installed(tmp_path, "block_package:Heated", monkeypatch)
    try:
        plant = find_plant("block_package")
        assert plant.__module__ == "block_package"
        assert written_name(plant) == "block_package"
        with pytest.raises(PlantError, match=r"choose from peltier.*block_package"):
            find_plant("another")
    finally:
        monkeypatch.undo()
        declared_plants.cache_clear()


def test_what_a_package_declares_wrongly_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant_file(tmp_path, "block_package")
    installed(tmp_path, "block_package:Plan", monkeypatch)
    try:
        with pytest.raises(
            PlantError,
            match="plant 'block_package' of block-package: cannot be imported",
        ):
            find_plant("block_package")
    finally:
        monkeypatch.undo()
        declared_plants.cache_clear()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "self.loss *",
            "self.los *",
            r"line 19: self\.los is not declared; did you mean loss\?",
        ),
        (
            "self.loss *",
            "self.xyz *",
            r"line 19: self\.xyz is not declared; declare it as",
        ),
        ("lost = ", "lots = ", r"line 21: NameError: name 'lost' is not defined"),
        (
            "        lost = ",
            "        if self.block > 3: pass\n        lost = ",
            "line 19: equations cannot branch",
        ),
        (
            "lost = ",
            "raise type('E', (BaseException,), {})('own')  # ",
            "line 19: E: own$",
        ),
        (
            "lost = ",
            "raise type('K', (KeyboardInterrupt,), {})('own')  # ",
            "line 19: K: own$",
        ),
        (
            "self.loss * (",
            "10**400 * (",
            "the rate of block has a number that is too large for floating",
        ),
        (
            "output=self.block",
            "output=self.block + 10**5000",
            "the output has a number that is too large",
        ),
        ("output=self.block", "output=self.heater", "the output depends on no state"),
        (
            "start={self.block: self.temperature}",
            "start={}",
            "state block has no start value",
        ),
        (
            "rates={self.block: ",
            "rates={self.gain: ",
            "`rates` has gain, which is not declared as a state",
        ),
        (
            "rates={self.block: (self.gain * self.heater - lost) / self.capacity}",
            "rates={}",
            "no state has a rate",
        ),
        ("return Equations(", "return dict(", "returns dict; return Equations"),
        (
            "self.loss * (",
            "math.sin(self.loss) * (",
            "line 19: a function of numbers .* use SymPy's",
        ),
        (
            "self.loss * (",
            "round(self.loss) * (",
            "line 19: a function of numbers .* use SymPy's",
        ),
        (
            "self.loss * (",
            "sympy.gamma(self.loss) * (",
            "uses gamma, which cannot be compiled; use only Abs",
        ),
        ("self.loss * (", "1j * (", "the rate of block is complex"),
        (
            "/ self.capacity",
            "/ (self.gain - self.gain)",
            "the rate of block is not finite .* divides by zero",
        ),
        (
            "output=self.block",
            "output=self.room",
            "the output depends on no state; write it in terms of",
        ),
        (
            "output=self.block",
            "output=self.temperature",
            "the output uses temperature, which is the output",
        ),
        (
            "output=self.block",
            "output='block'",
            "the output is 'block', of type str; write an expression",
        ),
        (
            "{self.block: self.temperature}",
            "{self.block: self.block}",
            "which is not known before the first",
        ),
        (
            "{self.block: self.temperature}",
            "{self.block: abs(self.room)}",
            "the start has a kink",
        ),
        (
            "{self.block: self.temperature}",
            "{'block': self.temperature}",
            "`start` has 'block', .*self.block",
        ),
        (
            "- lost) / self.capacity",
            "- lost) > 0",
            "the rate of block is a condition; write an expression",
        ),
        (
            "self.loss *",
            "sympy.Piecewise((1, self.block > 0)) *",
            "give its last piece the condition True",
        ),
    ],
)
def test_a_mistake_in_the_equations_is_reported(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    plant = find_plant(
        str(
            plant_file(
                tmp_path,
                f"block_equations_{crc32(repr((old, new)).encode())}",
                (old, new),
                ("\n\n\nclass", "\n\nimport math, sympy\nclass"),
            )
        )
    )
    with pytest.raises(PlantError, match=message) as raised:
        _ = plant.model().states
    assert "\n" not in str(raised.value)


def test_integers_beyond_64_bits_are_floating_point(tmp_path: Path) -> None:
    path = plant_file(
        tmp_path, "block_far", ("110.0)", "10**30)"), ("noise=0.1", "noise=10**30")
    )
    plant = find_plant(str(path))
    assert plant.states["block"].span == (0.0, 1e30)
    assert [type(end) for end in (*plant.states["block"].span, plant.output.noise)] == [
        float
    ] * 3


def test_ctrl_c_while_a_file_is_loaded_stays_one(tmp_path: Path) -> None:
    path = plant_file(
        tmp_path,
        "block_stopped",
        ("class Heated", "raise KeyboardInterrupt\nclass Heated"),
    )
    with pytest.raises(KeyboardInterrupt):
        find_plant(str(path))
    path = plant_file(
        tmp_path, "block_stopped_later", ("lost = ", "raise KeyboardInterrupt  # ")
    )
    with pytest.raises(KeyboardInterrupt):
        _ = find_plant(str(path)).model().states


def test_no_name_of_a_parameter_is_taken_for_a_kink(tmp_path: Path) -> None:
    changes = (("gain", "switch_0"), ("self.loss * (", "abs(self.loss) * ("))
    plant = find_plant(str(plant_file(tmp_path, "block_switch", *changes)))
    derived = equations.derive(plant(), frozenset(), frozenset())
    assert [str(symbol) for symbol in derived.parameters] == [
        "switch_0",
        "loss",
        "capacity",
    ]
    assert not {*derived.switches} & {*derived.parameters}
