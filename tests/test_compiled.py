"""Kernels on disk: kept while their sources stay, never run after one of them has changed."""

from __future__ import annotations

import gc
import os
import pickle
import shutil
import sys
from pathlib import Path
from typing import Any

import numba
import pytest

from tests.support.processes import Process
from twinmatch.compiled import compiled
from twinmatch.kernel_stamps import stamp_of
from twinmatch.kernel_turns import KernelTurn

OURS = "from twinmatch.compiled import compiled"
NUMBAS = "import numba\ncompiled = numba.njit(cache=True)"

CALLEE = """
{decorator}
from shape import FACTOR, Point

@compiled
def scaled(point):
    return FACTOR * point.x

@compiled
def placed(x):
    return Point(x, 10.0).x
"""
ENTRY = """
{decorator}
import callee
from callee import scaled
from shape import Point

@compiled
def entry(point):
    return scaled(point) + callee.placed(1.0)

print(entry(Point(2.0, 5.0)), "kept" if entry.stats.cache_hits else "compiled")
"""
SHAPE = """
from typing import NamedTuple
FACTOR = 3.0

class Point(NamedTuple):
    x: float
    y: float
"""
FIELDS = ("    x: float\n    y: float", "    y: float\n    x: float")


def write(folder: Path, decorator: str = OURS) -> None:
    (folder / "shape.py").write_text(SHAPE)
    (folder / "callee.py").write_text(CALLEE.format(decorator=decorator))
    (folder / "entry.py").write_text(ENTRY.format(decorator=decorator))


def change(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


START = """
import runpy, sys, warnings
warnings.simplefilter("error")
sys.dont_write_bytecode = True
sys.path.insert(0, {folder!r})
runpy.run_path({entry!r}, run_name="__main__")
"""


def run(folder: Path, home: Path | None = None) -> str:
    """What the entry of a new process gives, and whether it had to be compiled."""
    keep = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA")}
    keep |= {
        "HOME": str(home or folder),
        "XDG_CACHE_HOME": str((home or folder) / "cache"),
    }
    start = folder / "start.py"
    start.write_text(START.format(folder=str(folder), entry=str(folder / "entry.py")))
    process = Process(
        sys.executable,
        start,
        output=folder / "said.txt",
        environment=keep,
        folder=folder,
        forked=True,
    )
    assert process.wait() == 0, process.text
    return process.text.strip()


def test_numba_alone_runs_old_mathematics(tmp_path: Path) -> None:
    """Why there is `compiled`: when this fails, numba has learnt it and ours can go."""
    write(tmp_path, NUMBAS)
    assert run(tmp_path) == "7.0 compiled"
    change(tmp_path / "callee.py", "FACTOR * point.x", "FACTOR + point.x * 100.0")
    assert run(tmp_path) == "7.0 kept"


CHANGES = {
    "called kernel": (
        "callee.py",
        "FACTOR * point.x",
        "FACTOR + point.x * 100.0",
        "204.0",
    ),
    "kernel of a module": (
        "callee.py",
        "Point(x, 10.0)",
        "Point(x + 1.0, 10.0)",
        "205.0",
    ),
    "constant of a called kernel": (
        "shape.py",
        "FACTOR = 3.0",
        "FACTOR = 5.0",
        "207.0",
    ),
    "fields": ("shape.py", *FIELDS, "515.0"),
}
"""What a kernel is made from, changed one after the other: file, text, new text, and what the entry gives."""


def test_whatever_a_kernel_is_made_from_is_compiled_again(tmp_path: Path) -> None:
    write(tmp_path)
    assert run(tmp_path) == "7.0 compiled"
    assert run(tmp_path) == "7.0 kept"
    for change_name, (file, old, new, value) in CHANGES.items():
        change(tmp_path / file, old, new)
        assert run(tmp_path) == f"{value} compiled", change_name
    assert run(tmp_path) == "515.0 kept"


def test_fields_of_an_argument_need_not_be_named_in_the_kernel(tmp_path: Path) -> None:
    (tmp_path / "shape.py").write_text(SHAPE)
    (tmp_path / "kernel.py").write_text(
        f"{OURS}\n@compiled\ndef first(point):\n    return point.x\n"
    )
    (tmp_path / "entry.py").write_text(
        "from kernel import first\nfrom shape import Point\nprint(first(Point(2.0, 5.0)))"
    )
    assert run(tmp_path) == "2.0"
    change(tmp_path / "shape.py", *FIELDS)
    assert run(tmp_path) == "5.0"


def test_a_kernel_that_was_kept_inside_another_first_returns_arrays(
    tmp_path: Path,
) -> None:
    """Both share what numba keeps for a function, which only its own entry point needs in full."""
    (tmp_path / "kernels.py").write_text(
        f"{OURS}\nimport numpy as np\n"
        "@compiled\ndef pair(x):\n    return np.full(2, x), x\n\n"
        "@compiled\ndef total(x):\n    return pair(x)[0].sum()\n"
    )
    (tmp_path / "entry.py").write_text(
        "from kernels import pair, total\n"
        "print(total(2.0), pair(3.0)[0].tolist(), len(pair.stats.cache_hits))"
    )
    assert run(tmp_path) == "4.0 [3.0, 3.0] 0"
    assert run(tmp_path) == "4.0 [3.0, 3.0] 1"


COUNTED = """
from twinmatch.compiled import compiled
from twinmatch.kernel_stamps import stamp_of

@compiled
def turned(x, rounds):
    first = x.copy()
    second = x.copy()
    for _ in range(rounds):
        if first[0] > second[0]:
            second = first + 1.0
        first, second = second, first
    return first
"""
COUNTING_ENTRY = """
import resource
import numpy as np
from counted import turned

def most_memory():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

megabytes = np.arange(1e6)
turned(megabytes, 5)
(kernel,) = turned.overloads.values()
counts_itself = "define internal fastcc void @NRT_incref" in kernel.library.get_llvm_str()
before = most_memory()
for _ in range(60):
    turned(megabytes, 7)
# each call makes three arrays of 8 MB
frees_all = most_memory() - before < 100_000
print("counts itself" if counts_itself else "numba counts", "and frees all" if frees_all else "and keeps arrays")
"""


def test_a_kernel_counts_references_by_itself_and_frees_its_arrays(
    tmp_path: Path,
) -> None:
    """numba's functions, which count in atomic steps, are not called, and an array is still freed once."""
    (tmp_path / "counted.py").write_text(COUNTED)
    (tmp_path / "entry.py").write_text(COUNTING_ENTRY)
    assert run(tmp_path) == "counts itself and frees all"


def test_what_a_kernel_does_not_use_may_change_and_so_may_comments(
    tmp_path: Path,
) -> None:
    write(tmp_path)
    (tmp_path / "other.py").write_text("VALUE = 1")
    change(tmp_path / "entry.py", "import callee", "import callee, other")
    assert run(tmp_path) == "7.0 compiled"
    (tmp_path / "other.py").write_text("VALUE = 2")
    assert run(tmp_path) == "7.0 kept"
    change(
        tmp_path / "callee.py",
        "@compiled\ndef scaled",
        "# a comment\n\n@compiled\ndef scaled",
    )
    assert run(tmp_path) == "7.0 kept"


def test_a_source_edited_while_a_process_runs_is_compiled_by_the_next(
    tmp_path: Path,
) -> None:
    """What the process had imported is kept under its own stamp, not under that of the edited file."""
    write(tmp_path)
    shutil.copy(tmp_path / "callee.py", tmp_path / "edited.py")
    change(tmp_path / "edited.py", "FACTOR * point.x", "FACTOR + point.x * 100.0")
    edit = "import os\nif os.path.exists('edited.py'):\n    os.replace('edited.py', 'callee.py')\n\nprint("
    change(tmp_path / "entry.py", "print(", edit)
    assert run(tmp_path) == "7.0 compiled"
    assert run(tmp_path) == "204.0 compiled"
    assert run(tmp_path) == "204.0 kept"


INTRINSIC = """
from numba.extending import intrinsic

@intrinsic
def given(context, x):
    return x(x), lambda context, builder, signature, arguments: {code}

def entry(x):
    return given(x)
"""


def test_what_an_intrinsic_generates_is_a_part_of_a_kernel() -> None:
    stamps = set()
    for code in ("arguments[0]", "builder.fneg(arguments[0])"):
        scope: dict[str, Any] = {}
        exec(INTRINSIC.format(code=code), scope)
        stamps.add(stamp_of(scope["entry"], b""))
    assert len(stamps) == 2


OPTIONS = ("inside=True", "inside=True, inlined=True", "innermost=True")


def test_a_kernel_compiled_in_another_way_is_compiled_again(tmp_path: Path) -> None:
    write(tmp_path)
    assert run(tmp_path) == "7.0 compiled"
    decorator = "@compiled"
    for options in OPTIONS:
        change(
            tmp_path / "callee.py",
            f"{decorator}\ndef scaled",
            f"@compiled({options})\ndef scaled",
        )
        decorator = f"@compiled({options})"
        assert run(tmp_path) == "7.0 compiled", options
    assert run(tmp_path) == "7.0 kept"


def test_files_generated_outside_of_the_package_are_kept_too(tmp_path: Path) -> None:
    (tmp_path / "generated").mkdir()
    write(tmp_path)
    (tmp_path / "generated" / "plant.py").write_text(
        f"{OURS}\nfrom callee import scaled\n@compiled\ndef step(point):\n    return scaled(point) + 1.0\n"
    )
    (tmp_path / "entry.py").write_text(
        "import importlib.util, sys\n"
        "from shape import Point\n"
        "spec = importlib.util.spec_from_file_location('plant_1a2b', 'generated/plant.py')\n"
        "plant = importlib.util.module_from_spec(spec)\n"
        "sys.modules[spec.name] = plant\n"
        "spec.loader.exec_module(plant)\n"
        "print(plant.step(Point(2.0, 5.0)), 'kept' if plant.step.stats.cache_hits else 'compiled')"
    )
    assert run(tmp_path) == "7.0 compiled"
    assert run(tmp_path) == "7.0 kept"
    change(tmp_path / "callee.py", "FACTOR * point.x", "FACTOR + point.x * 100.0")
    assert run(tmp_path) == "204.0 compiled"
    assert list((tmp_path / "generated").rglob("*.nbi"))


@pytest.mark.parametrize("home", ["writable", "read-only"])
def test_an_installation_that_cannot_be_written(tmp_path: Path, home: str) -> None:
    sources = tmp_path / "sources"
    where = tmp_path / "home"
    sources.mkdir()
    where.mkdir()
    write(sources)
    # A file where the folder should be stops root, too.
    (sources / "__pycache__").write_text("")
    if home == "read-only":
        (where / "cache").write_text("")
    assert run(sources, where) == "7.0 compiled"
    assert run(sources, where) == ("7.0 kept" if home == "writable" else "7.0 compiled")


def test_two_processes_never_give_one_name_to_what_they_compile(tmp_path: Path) -> None:
    """Else a kernel that is kept by both, once inside another, may take the other's data for its own."""
    write(tmp_path)
    named = (
        "\nprint(*(kept.fndesc.mangled_name for kept in entry.overloads.values()))\n"
    )
    (tmp_path / "entry.py").write_text((tmp_path / "entry.py").read_text() + named)
    names = set()
    for home in ("one", "other"):
        (tmp_path / home).mkdir()
        names.add(run(tmp_path, tmp_path / home).splitlines()[-1])
        shutil.rmtree(tmp_path / "__pycache__", ignore_errors=True)
    assert len(names) == 2, names


def test_a_cache_that_knows_a_class_of_arguments_that_is_gone_is_left(
    tmp_path: Path,
) -> None:
    """numba unpickles the types of all kernels that it has kept, and fails if one cannot be imported."""
    write(tmp_path)
    first = run(tmp_path)
    for name in ("shape.py", "callee.py", "entry.py"):
        file = tmp_path / name
        file.write_text(file.read_text().replace("Point", "Place"))
    assert first == "7.0 compiled"
    assert run(tmp_path) == "7.0 compiled"
    assert run(tmp_path) == "7.0 kept"


def test_an_index_that_holds_a_class_that_is_gone_counts_as_empty(
    tmp_path: Path,
) -> None:
    """The index is written by hand: it has a reference to a class, as the pickle of any object has it."""
    write(tmp_path)
    assert run(tmp_path) == "7.0 compiled"
    (index,) = (tmp_path / "__pycache__").glob("entry.entry*.nbi")
    version = pickle.dumps(numba.__version__)
    index.write_bytes(version + b"cshape\nGone\n.")
    assert run(tmp_path) == "7.0 compiled"
    assert run(tmp_path) == "7.0 kept"


def test_after_a_kernel_cannot_be_compiled_the_collector_runs_again() -> None:
    @compiled
    def wrong(x: float) -> Any:
        return x + "no sum"  # type: ignore[operator]

    assert gc.isenabled()
    with pytest.raises(numba.TypingError):
        wrong(1.0)
    assert gc.isenabled()


WAITING = """
import runpy, sys
from twinmatch.compiled import before_kernels, told
told.append(lambda name: print("needs", name, flush=True))
before_kernels.append(lambda: print("not on disk", flush=True))
sys.path.insert(0, {folder!r})
runpy.run_path({entry!r}, run_name="__main__")
"""


def test_a_kernel_that_another_process_compiles_is_waited_for_and_taken(
    tmp_path: Path,
) -> None:
    write(tmp_path)
    assert run(tmp_path) == "7.0 compiled"
    kept = tmp_path / "__pycache__"
    aside = tmp_path / "aside"
    aside.mkdir()
    kernels = list(kept.glob("entry.*.nb[ic]"))
    for file in kernels:
        shutil.move(file, aside / file.name)
    other = KernelTurn("entry")
    other.take(str(kept), lambda: None)
    process = start_waiting(tmp_path)
    process.said("^needs entry$")
    for file in kernels:
        shutil.move(aside / file.name, file)
    other.give_back()
    assert process.wait() == 0, process.text
    assert process.lines == ["not on disk", "needs entry", "7.0 kept"]


def test_a_process_compiles_what_another_one_gave_up(tmp_path: Path) -> None:
    write(tmp_path)
    kept = tmp_path / "__pycache__"
    kept.mkdir()
    other = KernelTurn("entry")
    other.take(str(kept), lambda: None)
    process = start_waiting(tmp_path)
    process.said("^needs entry$")
    other.give_back()
    assert process.wait() == 0, process.text
    assert process.lines == [
        "not on disk",
        "needs entry",
        "needs entry",
        "7.0 compiled",
    ]


def start_waiting(folder: Path) -> Process:
    """A process that calls the entry, and says which kernels it needs and when it compiles one."""
    start = folder / "start.py"
    start.write_text(WAITING.format(folder=str(folder), entry=str(folder / "entry.py")))
    without_numbas = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA")}
    return Process(
        sys.executable, start, output=folder / "said.txt", environment=without_numbas
    )


FAILING = """
import signal
from twinmatch.compiled import compiled
from twinmatch.kernel_stamps import stamp_of

@compiled
def wrong(x):
    return x + "no sum"

try:
    wrong(1.0)
except Exception:
    print("failed", flush=True)
    signal.pause()
"""


def test_nobody_waits_for_a_kernel_that_could_not_be_compiled(tmp_path: Path) -> None:
    script = tmp_path / "failing.py"
    script.write_text(FAILING)
    without_numbas = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA")}
    process = Process(
        sys.executable, script, output=tmp_path / "said.txt", environment=without_numbas
    )
    process.said("^failed$")
    waited: list[bool] = []
    turn = KernelTurn("wrong")
    turn.take(str(tmp_path / "__pycache__"), lambda: waited.append(True))
    turn.give_back()
    process.kill()
    assert (tmp_path / "__pycache__" / "wrong.lock").exists()
    assert not waited
