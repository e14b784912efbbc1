"""What is used of numba without being documented: it is where it was, and nowhere else than in one module."""

from __future__ import annotations

import ast
import importlib
import inspect
import operator
import subprocess
import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from llvmlite import ir
from numba.extending import lower_builtin, type_callable
from packaging.requirements import Requirement

from tests.support.places import PROJECT
from twinmatch.compiled import compiled
from twinmatch.numba_insides import NEWEST, OLDEST, NumbaError, check_version

INSIDES = {
    "bytecode:FunctionIdentity._unique_ids": None,
    "caching:CompileResultCacheImpl.locator": None,
    "caching:CompileResultCacheImpl.rebuild": ("self", "target_context", "payload"),
    "caching:CompileResultCacheImpl.reduce": ("self", "cres"),
    "caching:FunctionCache._impl_class": None,
    "caching:FunctionCache.save_overload": ("self", "sig", "data"),
    "caching:FunctionCache.cache_path": None,
    "caching:FunctionCache._index_key": ("self", "sig", "codegen"),
    "caching:FunctionCache._load_overload": ("self", "sig", "target_context"),
    "caching:FunctionCache.load_overload": ("self", "sig", "target_context"),
    "codegen:JITCPUCodegen._library_class": None,
    "caching:IndexDataCacheFile._load_index": ("self",),
    "codegen:JITCPUCodegen.set_env": ("self", "env_name", "env"),
    "codegen:JITCodeLibrary._ensure_finalized": ("self",),
    "codegen:JITCodeLibrary._finalize_dynamic_globals": ("self",),
    "codegen:JITCodeLibrary._finalized": None,
    "codegen:JITCodeLibrary._get_module_for_linking": ("self",),
    "codegen:JITCodeLibrary._optimize_final_module": ("self",),
    "codegen:JITCodeLibrary._optimize_functions": ("self", "ll_module"),
    "codegen:JITCodeLibrary.enable_object_caching": ("self",),
    "codegen:JITCodeLibrary.finalize": ("self",),
    "codegen:JITCodeLibrary.get_pointer_to_function": ("self", "name"),
    "compiler:CompileResult._find_referenced_environments": ("self",),
    "compiler:CompileResult._rebuild": (
        "cls",
        "target_context",
        "libdata",
        "fndesc",
        "env",
        "signature",
        "objectmode",
        "lifted",
        "typeann",
        "reload_init",
        "referenced_envs",
    ),
    "cpu:CPUContext.create_cfunc_wrapper": (
        "self",
        "library",
        "fndesc",
        "env",
        "call_helper",
    ),
    "cpu:CPUContext.create_cpython_wrapper": (
        "self",
        "library",
        "fndesc",
        "env",
        "call_helper",
        "release_gil",
    ),
    "cpu:CPUContext.get_executable": ("self", "library", "fndesc", "env"),
    "dispatcher:Dispatcher.get_call_template": ("self", "args", "kws"),
    "dispatcher:Dispatcher.get_overload": ("self", "sig"),
    "dispatcher:_FunctionCompiler.compile": ("self", "args", "return_type"),
    "environment:_rebuild_env": ("modname", "consts", "env_name"),
    "funcdesc:PythonFunctionDescriptor.llvm_cpython_wrapper_name": None,
    "datamodel.models:DataModel.contains_nrt_meminfo": ("self",),
    "datamodel.models:DataModel.get_nrt_meminfo": ("self", "builder", "value"),
    "datamodel.models:DataModel.has_nrt_meminfo": ("self",),
    "datamodel.models:DataModel.traverse": ("self", "builder"),
    "registry:cpu_target.target_context.codegen": ("self",),
    "registry:cpu_target.target_context.data_model_manager": None,
    "runtime.context:NRTContext.get_meminfos": ("self", "builder", "ty", "val"),
    "runtime:rtsys.initialize": ("self", "ctx"),
    "types:Function.get_call_type": ("self", "context", "args", "kws"),
}
"""What is used of `numba.core` without being invited, and the parameters of functions."""
KERNELS = ("_cache", "_compiler.compile", "get_call_template", "get_overload")
"""What it uses of each kernel."""


def test_the_insides_of_numba_that_are_used_are_where_they_were() -> None:
    """For a newer numba `NEWEST` and pyproject.toml are changed when this passes with it, and all other tests."""
    kernel = numba.njit(lambda: 0.0)
    codegen = numba.core.registry.cpu_target.target_context.codegen()
    engine = codegen._engine
    library = codegen.create_library("empty")
    moved = [f"a kernel's {name}" for name in KERNELS if _inside(kernel, name) is None]
    moved += (
        [] if isinstance(engine._defined_symbols, set) else ["_engine._defined_symbols"]
    )
    moved += [
        f"CPUCodeLibrary.{name}"
        for name in ("_final_module", "_linking_libraries", "_shared_module")
        if name not in vars(library)
    ]
    for place, parameters in INSIDES.items():
        module, _, name = place.partition(":")
        inside = _inside(importlib.import_module(f"numba.core.{module}"), name)
        if inside is None or (
            parameters is not None and tuple(_parameters(inside)) != parameters
        ):
            moved.append(place)
    assert not moved, (
        f"numba {numba.__version__} moved what src/twinmatch/numba_insides.py uses"
    )


def _inside(whole: Any, path: str) -> Any:
    try:
        return operator.attrgetter(path)(whole)
    except AttributeError:
        return None


def _parameters(function: Any) -> list[str]:
    """Names of parameters, that of the object among them."""
    return list(inspect.signature(getattr(function, "__func__", function)).parameters)


@pytest.mark.parametrize("version", ["0.60.0", "0.69.0", "1.0.0"])
def test_another_numba_is_refused_with_a_sentence(version: str) -> None:
    check_version("0.61.0")
    check_version("0.68.1")
    with pytest.raises(
        NumbaError,
        match=rf"numba {version} is not among .* 0\.61 to 0\.68; install `numba==0\.68\.\*`",
    ):
        check_version(version)


def test_the_versions_are_those_of_the_package() -> None:
    requirements = metadata.requires("twinmatch") or []
    (numba_requirement,) = (text for text in requirements if text.startswith("numba"))
    specifiers = Requirement(numba_requirement).specifier
    for major, minor in (OLDEST, NEWEST):
        assert f"{major}.{minor}.0" in specifiers
    assert f"{OLDEST[0]}.{OLDEST[1] - 1}.0" not in specifiers
    assert f"{NEWEST[0]}.{NEWEST[1] + 1}.0" not in specifiers


NEWER = """
import sys, types
import numba
numba.__version__ = "0.99.0"
for name in [name for name in sys.modules if name.startswith("numba.core")]:
    sys.modules[name] = types.ModuleType(name)
from twinmatch.cli import main
sys.exit(main(["replay", "nothing_here"]))
"""


def test_a_command_says_so_before_it_misses_anything_of_numba() -> None:
    """One line, and not that something cannot be imported."""
    ended = subprocess.run(
        [sys.executable, "-c", NEWER], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 2, ended.stderr
    (line,) = ended.stderr.splitlines()
    assert line.startswith("twinmatch: numba 0.99.0 is not among the versions")


DOCUMENTED = {"cgutils"}
"""Modules of `numba.core` that numba's pages on extending it use."""
ONLY_THERE = "numba_insides.py"


def insides_used(path: Path) -> list[str]:
    """What a module imports from `numba.core` that is not documented."""
    used = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module == "numba.core":
            used += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            used += (
                [node.module] if (node.module or "").startswith("numba.core.") else []
            )
        elif isinstance(node, ast.Import):
            used += [a.name for a in node.names if a.name.startswith("numba.core")]
    return [name for name in used if name not in DOCUMENTED]


def test_one_module_uses_them() -> None:
    using = {
        path.name
        for path in (PROJECT / "src" / "twinmatch").rglob("*.py")
        if insides_used(path)
    }
    assert using == {ONLY_THERE}


def part_of(function: Callable[..., Any]) -> Any:
    """The part of kernels that a function becomes."""
    return compiled(inside=True)(function)


class Doubled:
    """A function that kernels know, and how often numba asks for its signature."""

    def __init__(self) -> None:
        self.arguments: list[Any] = []
        self.function = self._new()
        self.define(numba.float64)

    def _new(self) -> Any:
        def double(number: Any) -> Any:
            return number + number

        return double

    def define(self, kind: Any) -> None:
        """Say how numbers of a type are doubled."""

        def signature_of_double(_context: Any) -> Any:
            def result(number: Any) -> Any:
                self.arguments.append(number)
                return kind if number == kind else None

            return result

        def double(_context: Any, builder: Any, _signature: Any, numbers: Any) -> Any:
            add = builder.add if kind == numba.int64 else builder.fadd
            return add(numbers[0], numbers[0])

        type_callable(self.function)(signature_of_double)
        lower_builtin(self.function, kind)(double)

    def kernel(self) -> Callable[[Any], Any]:
        """The eightfold of a number, in three calls."""
        double = self.function

        def eightfold(number: Any) -> Any:
            return double(double(double(number)))

        return eightfold


def test_parts_look_for_the_definition_of_a_function_once() -> None:
    doubled = Doubled()
    part_of(doubled.kernel()).compile((numba.float64,))
    assert doubled.arguments == [numba.float64]
    part_of(doubled.kernel()).compile((numba.float64,))
    assert doubled.arguments == [numba.float64]


def test_a_definition_that_is_added_later_is_found() -> None:
    doubled = Doubled()
    part_of(doubled.kernel()).compile((numba.float64,))
    with pytest.raises(numba.TypingError):
        part_of(doubled.kernel()).compile((numba.int64,))
    doubled.define(numba.int64)
    part = part_of(doubled.kernel())
    part.compile((numba.int64,))
    assert part.nopython_signatures == [numba.int64(numba.int64)]


def test_kernels_of_others_are_compiled_as_numba_does_it() -> None:
    doubled = Doubled()
    part_of(doubled.kernel()).compile((numba.float64,))
    kernel = numba.njit(doubled.kernel())
    assert kernel(1.5) == 12.0
    assert len(doubled.arguments) > 3


def extractions(monkeypatch: pytest.MonkeyPatch, kernel: Any) -> int:
    """How many members of arrays and tuples are taken out of them where a kernel of pairs is compiled."""
    taken = []
    extract = ir.IRBuilder.extract_value

    def counted(builder: Any, *arguments: Any, **named: Any) -> Any:
        taken.append(arguments)
        return extract(builder, *arguments, **named)

    vector = numba.float64[::1]
    pair = numba.types.UniTuple(vector, 2)
    with monkeypatch.context() as context:
        context.setattr(ir.IRBuilder, "extract_value", counted)
        kernel.compile((pair,))
    return len(taken)


def first_of_second(pair: tuple[Any, Any]) -> Any:
    return pair[1][0]


def test_only_references_are_taken_out_of_arrays_to_count_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """numba takes out shape, strides, and all other numbers each time, too."""
    by_numba = extractions(
        monkeypatch,
        numba.njit(no_cpython_wrapper=True, no_cfunc_wrapper=True)(first_of_second),
    )
    part = part_of(first_of_second)
    assert extractions(monkeypatch, part) < by_numba / 2


def test_functions_of_numba_within_parts_have_no_entry_for_c(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    entries = []
    context = type(numba.core.registry.cpu_target.target_context)
    monkeypatch.setattr(
        context, "create_cfunc_wrapper", lambda *_: entries.append("entry")
    )

    def zeros_of_four_dimensions() -> Any:
        return np.zeros((1, 2, 3, 4))

    part_of(zeros_of_four_dimensions).compile(())
    assert not entries
    numba.njit(lambda: np.zeros((1, 2, 3, 4, 5)))()
    assert entries


def test_kernels_of_others_call_parts_with_all_that_these_call() -> None:
    @part_of
    def tripled(number: float) -> float:
        return 3.0 * number

    @part_of
    def row_of_tripled(number: float) -> Any:
        return np.full(2, tripled(number))

    @part_of
    def sum_of_tripled(number: float) -> Any:
        return row_of_tripled(number).sum() + tripled(number)

    def kernel(number: float) -> Any:
        return sum_of_tripled(number)

    assert numba.njit(kernel)(1.5) == 13.5


def test_a_part_that_is_called_in_several_ways_is_linked_once() -> None:
    """Its caller and the caller's caller call it: whichever way it is found by, it is there."""

    @part_of
    def tripled(number: float) -> float:
        return 3.0 * number

    @part_of
    def sixfold(number: float) -> Any:
        return 2.0 * tripled(number)

    def ninefold(number: float) -> Any:
        return tripled(number) + sixfold(number)

    part = part_of(ninefold)
    part.compile((numba.float64,))
    (alone,) = part.inspect_llvm().values()
    defined = [line for line in alone.splitlines() if line.startswith("define")]
    assert sum("ninefold" in line for line in defined) == 1
    assert not any("tripled" in line or "sixfold" in line for line in defined)
    assert numba.njit(lambda: part(2.0))() == 18.0
