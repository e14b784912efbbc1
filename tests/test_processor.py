"""Code is compiled for a kind of processor of which there are many."""

from __future__ import annotations

import os
import subprocess
import sys

import numba
import pytest
from llvmlite import binding

from twinmatch.compiled import compiled
from twinmatch.dynamics.machine import target
from twinmatch.processor import COMMON, is_common, processor

LEVEL_THREE = [
    "avx",
    "avx2",
    "bmi",
    "bmi2",
    "f16c",
    "fma",
    "lzcnt",
    "movbe",
    "popcnt",
    "sse4.2",
    "xsave",
]
"""What distinguishes level 3 from those below, by LLVM's names (x86-64 psABI, table 3.1)."""
ASK = "import twinmatch.compiled, numba; print(numba.config.CPU_NAME)"


def test_a_processor_that_lacks_anything_is_not_of_the_kind() -> None:
    features = dict.fromkeys(LEVEL_THREE, True)
    assert is_common({**features, "avx512f": False})
    for name in LEVEL_THREE:
        assert not is_common({**features, name: False})
        assert not is_common({n: True for n in LEVEL_THREE if n != name})


def test_kernels_and_plants_are_compiled_for_the_kind_if_it_can_be() -> None:
    if not is_common(binding.get_host_cpu_features()):
        pytest.skip("this processor is of no common kind")
    assert processor() == (COMMON, "")
    assert numba.config.CPU_NAME == COMMON
    assert target().startswith(f"{COMMON}  LLVM")

    @compiled
    def doubled(x: float) -> float:
        return 2.0 * x

    assert doubled(1.5) == 3.0
    (kernel,) = doubled.overloads.values()
    assert kernel.library.codegen.magic_tuple()[1:] == (COMMON, "")


@pytest.mark.parametrize("name", ["generic", "x86-64-v2"])
def test_a_processor_that_numbas_settings_name_is_taken(name: str) -> None:
    environment = {**os.environ, "NUMBA_CPU_NAME": name}
    words = [sys.executable, "-c", ASK]
    asked = subprocess.run(
        words, env=environment, capture_output=True, text=True, check=True
    )
    assert asked.stdout.strip() == name
