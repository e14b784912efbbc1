"""LLVM's passes for kernels: what becomes of small pieces of code."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from llvmlite import binding

from twinmatch.optimiser import optimise, simplify_functions, target_machine

SUM_OF_FOUR = """
define double @sum_of_four(double* %values) {
entry:
  br label %loop
loop:
  %i = phi i64 [0, %entry], [%next, %loop]
  %total = phi double [0.0, %entry], [%after, %loop]
  %place = getelementptr double, double* %values, i64 %i
  %value = load double, double* %place
  %after = fadd double %total, %value
  %next = add i64 %i, 1
  %goes_on = icmp slt i64 %next, 4
  br i1 %goes_on, label %loop, label %end
end:
  ret double %after
}
"""
SIDE_BY_SIDE = """
define void @add_two(double* noalias %a, double* noalias %b) {
  %a1 = getelementptr double, double* %a, i64 1
  %b1 = getelementptr double, double* %b, i64 1
  %x0 = load double, double* %a
  %x1 = load double, double* %a1
  %y0 = load double, double* %b
  %y1 = load double, double* %b1
  %z0 = fadd double %x0, %y0
  %z1 = fadd double %x1, %y1
  store double %z0, double* %a
  store double %z1, double* %a1
  ret void
}
"""
OVER_SAMPLES = """
define void @double_all(double* noalias %x, i64 %count) {
entry:
  br label %loop
loop:
  %i = phi i64 [0, %entry], [%next, %loop]
  %place = getelementptr double, double* %x, i64 %i
  %value = load double, double* %place
  %twice = fadd double %value, %value
  store double %twice, double* %place
  %next = add i64 %i, 1
  %goes_on = icmp slt i64 %next, %count
  br i1 %goes_on, label %loop, label %end
end:
  ret void
}
"""
COUNTED_FOR_NOTHING = """
declare void @NRT_incref(i8*)
declare void @NRT_decref(i8*)
define double @first(i8* %array, double* %values) {
  call void @NRT_incref(i8* %array)
  %value = load double, double* %values
  call void @NRT_decref(i8* %array)
  ret double %value
}
"""


def product_of(size: int) -> str:
    """A function of so many products, and another one that calls it twice."""
    lines = [
        f"  %p{i + 1} = fmul double %p{i}, {1.0 + 1.0 / (i + 2):.17g}"
        for i in range(size)
    ]
    return "\n".join(
        [
            "define linkonce_odr double @product(double %p0) {",
            *lines,
            f"  ret double %p{size}",
            "}",
            "define double @entry(double %a, double %b) {",
            "  %c = call double @product(double %a)",
            "  %d = call double @product(double %b)",
            "  %sum = fadd double %c, %d",
            "  ret double %sum",
            "}",
        ]
    )


def module_of(code: str) -> Any:
    module = binding.parse_assembly(code)
    machine = target_machine()
    module.triple = machine.triple
    module.data_layout = str(machine.target_data)
    return module


def optimised(code: str) -> str:
    module = module_of(code)
    optimise(module)
    module.verify()
    return str(module)


def test_a_loop_over_a_few_numbers_stays_a_loop() -> None:
    assert optimised(SUM_OF_FOUR).count("fadd") == 1


@pytest.mark.parametrize("code", [SIDE_BY_SIDE, OVER_SAMPLES])
def test_sums_side_by_side_and_loops_over_samples_fill_the_vector_unit(
    code: str,
) -> None:
    assert " x double>" in optimised(code)


def test_a_loop_that_sums_keeps_its_order() -> None:
    """Sums of neighbours would have other bits."""
    of_many = SUM_OF_FOUR.replace("%next, 4", "%next, 4000")
    assert " x double>" not in optimised(of_many)


@pytest.mark.parametrize("change", [optimise, simplify_functions])
def test_references_that_cancel_out_are_not_counted(
    change: Callable[[Any], None],
) -> None:
    module = module_of(COUNTED_FOR_NOTHING)
    change(module)
    assert "call void @NRT" not in str(module)


def test_a_short_function_is_inlined_and_a_long_one_called() -> None:
    assert "call double @product" not in optimised(product_of(5))
    assert optimised(product_of(60)).count("call double @product") == 2


def test_functions_are_simplified_each_by_itself() -> None:
    code = """
    declare double @elsewhere(double)
    define double @callee(double %x) {
      %place = alloca double
      store double %x, double* %place
      %value = load double, double* %place
      %known = call double @elsewhere(double %value)
      ret double %known
    }
    define double @caller(double %x) {
      %result = call double @callee(double %x)
      ret double %result
    }
    """
    module = module_of(code)
    simplify_functions(module)
    simplified = str(module)
    assert "alloca" not in simplified
    assert "call double @callee" in simplified
