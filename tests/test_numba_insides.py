"""What is used of numba without being documented: it is where it was, and nowhere else than in one module."""

from __future__ import annotations

import ast
import importlib
import inspect
import operator
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

import numba
import pytest
from packaging.requirements import Requirement

from tests.support.places import PROJECT
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
    "caching:IndexDataCacheFile._load_index": ("self",),
    "codegen:JITCPUCodegen._library_class": None,
    "codegen:JITCPUCodegen.set_env": ("self", "env_name", "env"),
    "codegen:JITCodeLibrary._ensure_finalized": ("self",),
    "codegen:JITCodeLibrary._finalize_dynamic_globals": ("self",),
    "codegen:JITCodeLibrary._finalize_final_module": ("self",),
    "codegen:JITCodeLibrary._finalized": None,
    "codegen:JITCodeLibrary._optimize_final_module": ("self",),
    "codegen:JITCodeLibrary._optimize_functions": ("self", "ll_module"),
    "codegen:JITCodeLibrary.enable_object_caching": ("self",),
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
    "environment:Environment._memo": None,
    "environment:lookup_environment": ("env_name",),
    "funcdesc:PythonFunctionDescriptor.llvm_cpython_wrapper_name": None,
    "registry:cpu_target.target_context.codegen": ("self",),
    "runtime:rtsys.initialize": ("self", "ctx"),
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
        for name in ("_final_module", "_shared_module")
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


@pytest.mark.parametrize("version", ["0.59.1", "0.69.0", "1.0.0"])
def test_another_numba_is_refused_with_a_sentence(version: str) -> None:
    check_version("0.60.0")
    check_version("0.68.1")
    with pytest.raises(
        NumbaError,
        match=rf"numba {version} is not among .* 0\.60 to 0\.68; install `numba==0\.68\.\*`",
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
