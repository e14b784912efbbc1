"""Compilation of a plant's formulas into a few functions over plain arrays, called by their addresses.

LLVM, which numba brings along, compiles them without numba: a tenth of a second instead of many, and the
kernels that call them are compiled once for all plants. No `fastmath`: sums keep their order.
"""

from __future__ import annotations

import ast
import functools
import math
import operator
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from typing import Any, Final, NamedTuple

from llvmlite import binding, ir

from twinmatch.dynamics.code import Formulas, PlantFormulas
from twinmatch.dynamics.declarations import PlantError
from twinmatch.optimiser import target_machine
from twinmatch.processor import processor

FUNCTIONS: Final = (
    "constants",
    "switches",
    "step",
    "tangents",
    "slopes",
    "outputs",
    "output_slopes",
    "start",
    "quantities",
)
"""Names of the functions of every plant. Each takes pointers to states x, inputs u, disturbances d,
parameters and constants p, switches b, and to its results. `step` and `tangents` take a duration after these,
`tangents` also the derivatives of the states (n × k), of the inputs (m × k), the unknowns of the first of
these columns, their number, and k."""
_INTRINSICS: Final = ("sqrt", "exp", "log", "sin", "cos", "fabs", "pow")
_LIBRARY: Final = (
    "tan",
    "asin",
    "acos",
    "atan",
    "atan2",
    "sinh",
    "cosh",
    "tanh",
    "asinh",
    "acosh",
    "atanh",
    "erf",
    "erfc",
)
_OPERATIONS: Final[
    dict[type[ast.operator], tuple[Callable[..., float], Callable[..., Any]]]
] = {
    ast.Add: (operator.add, ir.IRBuilder.fadd),
    ast.Sub: (operator.sub, ir.IRBuilder.fsub),
    ast.Mult: (operator.mul, ir.IRBuilder.fmul),
    ast.Div: (operator.truediv, ir.IRBuilder.fdiv),
}
_DOUBLE = ir.DoubleType()
_INT = ir.IntType(64)
_POINTER = _DOUBLE.as_pointer()
_PLAIN = ir.FunctionType(ir.VoidType(), [_POINTER] * 6)
_STEP = ir.FunctionType(ir.VoidType(), [_POINTER] * 6 + [_DOUBLE])
_TANGENTS = ir.FunctionType(
    ir.VoidType(),
    [_POINTER] * 6 + [_DOUBLE, _POINTER, _POINTER, _INT.as_pointer(), _INT, _INT],
)

Values = dict[str, Any]


def compiled_object(formulas: PlantFormulas) -> bytes:
    """Machine code of a plant's functions, for `processor()`.

    Raises:
        PlantError: an expression cannot be compiled; `derive` lets none through.
    """
    module = binding.parse_assembly(str(_module(formulas)))
    module.verify()
    machine = target_machine()
    # Higher levels and vectors take two to four times as long, and give the same bits no sooner.
    tuning = binding.create_pipeline_tuning_options(speed_level=1)
    tuning.loop_vectorization = False
    builder = binding.create_pass_builder(machine, tuning)
    builder.getModulePassManager().run(module, builder)
    return bytes(machine.emit_object(module))


def linked(code: bytes) -> tuple[Any, dict[str, int]]:
    """Machine code made runnable: its owner, and the address of every function while the owner lives."""
    engine = binding.create_mcjit_compiler(binding.parse_assembly(""), target_machine())
    engine.add_object_file(binding.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine, {name: int(engine.get_function_address(name)) for name in FUNCTIONS}


def target() -> str:
    """The processor for which code is compiled, and the compiler, in a text."""
    name, features = processor()
    return f"{name} {features} LLVM {binding.llvm_version_info}"


def _module(f: PlantFormulas) -> ir.Module:
    module = ir.Module("plant")
    for name, parts in (
        ("constants", [f.constants]),
        ("slopes", [f.slopes]),
        ("outputs", [f.outputs]),
        ("output_slopes", [f.output_slopes]),
        ("start", [f.start, f.start_slopes]),
        ("quantities", [f.quantities]),
    ):
        function = _Function(module, name, _PLAIN, f)
        function.store(
            [value for part in parts for value in function.results(part, {})]
        )
        function.end()
    function = _Function(module, "switches", _PLAIN, f)
    function.store(function.switches({}))
    function.end()
    _write_step(module, f)
    _write_tangents(module, f)
    return module


def _write_step(module: ir.Module, f: PlantFormulas) -> None:
    """One Runge–Kutta step, with the switches as at its begin; after the states, 1 if it crosses a kink.

    The stages are checked, too: beyond a kink the equations of this branch may be invalid.
    """
    function = _Function(module, "step", _STEP, f)
    begun = _named("b", function.switches({}))
    stages, after = function.runge_kutta(
        lambda values: function.results(f.rates, values | begun)
    )
    crossed = function.builder.select(
        function.crossed(begun, stages, after), _number(1.0), _number(0.0)
    )
    function.store([*after, crossed])
    function.end()


def _write_tangents(module: ir.Module, f: PlantFormulas) -> None:
    """The step with its derivatives, without the terms that are always zero.

    If 1 stands after the states, a step that crosses a kink is not taken; otherwise 0 stands there then.
    """
    function = _Function(module, "tangents", _TANGENTS, f)
    builder = function.builder
    unknown_numbers, first, size = function.llvm.args[9:]
    begun = _named("b", function.switches({}))
    slopes: list[_StageSlopes] = []

    def rates(values: Values) -> list[Any]:
        stage = _StageSlopes(f, function.results(f.slopes, values | begun))
        slopes.append(stage)
        return stage.rates

    stages, after = function.runge_kutta(rates)
    place = builder.gep(function.llvm.args[5], [_int(f.n_states)])
    asked = builder.fcmp_ordered("!=", builder.load(place), _number(0.0))
    with builder.if_then(
        builder.and_(asked, function.crossed(begun, stages, after)), likely=False
    ):
        builder.ret_void()
    builder.store(_number(0.0), place)
    columns = _TangentColumns(function, f, slopes)
    with function.loop(_int(0), first) as j:
        columns.write(j, builder.load(builder.gep(unknown_numbers, [j])))
    with function.loop(first, size) as j:
        columns.write(j, None)
    function.store(after)
    function.end()


class _StageSlopes(NamedTuple):
    """The rates and their derivatives at one stage of a step, in the order of `PlantFormulas.slopes`."""

    formulas: PlantFormulas
    values: list[Any]

    @property
    def all_by_unknowns(self) -> list[Any]:
        """Those of all rates by the unknowns."""
        return self.values[: self.formulas.n_states * self.formulas.n_unknown]

    @property
    def rates(self) -> list[Any]:
        """The rates themselves."""
        first = len(self.all_by_unknowns)
        return self.values[first : first + self.formulas.n_states]

    def by_unknowns(self, i: int) -> list[Any]:
        """Those of rate i by the unknowns."""
        q = self.formulas.n_unknown
        return self.values[i * q : i * q + q]

    def by_states(self, i: int) -> list[Any]:
        """Those of rate i by the states."""
        n = self.formulas.n_states
        first = len(self.all_by_unknowns) + n + i * n
        return self.values[first : first + n]

    def by_inputs(self, i: int) -> list[Any]:
        """Those of rate i by the inputs."""
        n = self.formulas.n_states
        m = self.formulas.n_inputs
        first = len(self.all_by_unknowns) + n + n * n + i * m
        return self.values[first : first + m]


class _TangentColumns:
    """Writes how one column of tangents moves over a step: by the derivatives at its four stages."""

    def __init__(
        self, function: _Function, f: PlantFormulas, slopes: Sequence[_StageSlopes]
    ) -> None:
        self._function = function
        self._builder = function.builder
        self._formulas = f
        self._slopes = slopes
        self._columns, self._du, _, _, self._size = function.llvm.args[7:]
        self._by_unknowns = self._stored_by_unknowns()
        self._half = self._builder.fmul(_number(0.5), function.h)
        self._sixth = self._builder.fdiv(function.h, _number(6.0))

    def _stored_by_unknowns(self) -> Any:
        """Memory with the derivatives by unknowns, in which a column finds its own by a number."""
        values = list(
            chain.from_iterable(stage.all_by_unknowns for stage in self._slopes)
        )
        memory = self._builder.alloca(_DOUBLE, max(len(values), 1))
        for place, value in enumerate(values):
            self._builder.store(value, self._builder.gep(memory, [_int(place)]))
        return memory

    def write(self, j: Any, unknown: Any) -> None:
        """Write it for column j, which is that of an unknown, given by its number; None: of none."""
        function = self._function
        builder = self._builder
        places = [
            self._element(self._columns, i, j) for i in range(self._formulas.n_states)
        ]
        of_u = [
            builder.load(self._element(self._du, k, j))
            for k in range(self._formulas.n_inputs)
        ]
        before = [builder.load(place) for place in places]
        rates: list[list[Any]] = []
        of_x = before
        for stage in range(len(self._slopes)):
            rates.append(
                [self._rate(i, stage, of_x, of_u, unknown) for i in range(len(before))]
            )
            if stage + 1 < len(self._slopes):
                of_x = function.shifted(
                    before, rates[-1], self._half if stage < 2 else function.h
                )
        for place, value in zip(
            places, function.combined(before, rates, self._sixth), strict=True
        ):
            builder.store(value, place)

    def _element(self, matrix: Any, row: int, j: Any) -> Any:
        """The place of an element of a matrix with `size` columns."""
        builder = self._builder
        return builder.gep(matrix, [builder.add(builder.mul(_int(row), self._size), j)])

    def _rate(
        self, i: int, stage: int, of_x: Sequence[Any], of_u: Sequence[Any], unknown: Any
    ) -> Any:
        """How tangent i changes at a stage, where those of states and inputs are `of_x` and `of_u`."""
        builder = self._builder
        slopes = self._slopes[stage]
        terms = list(zip(slopes.by_states(i), of_x, strict=True))
        terms += zip(slopes.by_inputs(i), of_u, strict=True)
        products = [
            builder.fmul(slope, value) for slope, value in terms if not _is_zero(slope)
        ]
        if unknown is not None and not all(map(_is_zero, slopes.by_unknowns(i))):
            first = (stage * self._formulas.n_states + i) * self._formulas.n_unknown
            place = builder.add(unknown, _int(first))
            products.append(builder.load(builder.gep(self._by_unknowns, [place])))
        return functools.reduce(builder.fadd, products) if products else _number(0.0)


class _Function:
    """One function while it is written."""

    def __init__(
        self, module: ir.Module, name: str, kind: ir.FunctionType, f: PlantFormulas
    ) -> None:
        self.llvm = ir.Function(module, kind, name)
        self.builder = ir.IRBuilder(self.llvm.append_basic_block())
        self._formulas = f
        for argument in self.llvm.args:
            if isinstance(argument.type, ir.PointerType):
                argument.add_attribute("noalias")
        x, u, d, p, b, self._out = self.llvm.args[:6]
        after = self.builder.gep(p, [_int(f.n_parameters)])
        self._arrays = {"x": x, "y": x, "u": u, "d": d, "p": p, "c": after, "b": b}
        self._loaded: Values = {}

    @property
    def h(self) -> Any:
        return self.llvm.args[6]

    def value(self, name: str) -> Any:
        """A value of one of the arrays that the function is given."""
        if name not in self._loaded:
            place = self.builder.gep(self._arrays[name[0]], [_int(int(name[1:]))])
            self._loaded[name] = self.builder.load(place)
        return self._loaded[name]

    def results(self, formulas: Formulas, values: Values) -> list[Any]:
        """The results of formulas; `values` are those that are not in the given arrays."""
        known_values = dict(values)
        for name, tree in formulas.common:
            known_values[name] = self._evaluate(tree, known_values)
        return [self._evaluate(tree, known_values) for tree in formulas.results]

    def switches(self, values: Values) -> list[Any]:
        """The switches in order: a condition may use earlier ones."""
        known_values = dict(values)
        states = []
        for i, tree in enumerate(self._formulas.switches.results):
            on = self.builder.fcmp_ordered(
                ">", self._evaluate(tree, known_values), _number(0.0)
            )
            states.append(self.builder.select(on, _number(1.0), _number(0.0)))
            known_values[f"b{i}"] = states[-1]
        return states

    def crossed(
        self, begun: Values, stages: Sequence[Sequence[Any]], after: Sequence[Any]
    ) -> Any:
        """Whether a switch is not as at the step's begin, at one of its stages or after it."""
        differs: Any = ir.Constant(ir.IntType(1), 0)
        for states in (after, *reversed(stages[1:])):
            for i, side in enumerate(self.switches(_named("x", states))):
                differs_here = self.builder.fcmp_ordered("!=", side, begun[f"b{i}"])
                differs = self.builder.or_(differs, differs_here)
        return differs

    def runge_kutta(
        self, rates: Callable[[Values], list[Any]]
    ) -> tuple[list[list[Any]], list[Any]]:
        """The states at the four stages of a step, and after it."""
        n = self._formulas.n_states
        builder = self.builder
        begun = [self.value(f"x{i}") for i in range(n)]
        half = builder.fmul(_number(0.5), self.h)
        stages = [begun]
        slopes = []
        for length in (half, half, self.h, None):
            slopes.append(rates(_named("x", stages[-1])))
            if length is not None:
                stages.append(self.shifted(begun, slopes[-1], length))
        return stages, self.combined(begun, slopes, builder.fdiv(self.h, _number(6.0)))

    def shifted(self, begun: Sequence[Any], slopes: Sequence[Any], h: Any) -> list[Any]:
        """Values moved along slopes."""
        b = self.builder
        return [b.fadd(x, b.fmul(h, k)) for x, k in zip(begun, slopes, strict=True)]

    def combined(
        self, begun: Sequence[Any], slopes: Sequence[Sequence[Any]], sixth: Any
    ) -> list[Any]:
        """Values after a Runge–Kutta step with the slopes of its stages."""
        b = self.builder
        ends = []
        for x, k1, k2, k3, k4 in zip(begun, *slopes, strict=True):
            total = b.fadd(
                b.fadd(k1, b.fmul(_number(2.0), k2)), b.fmul(_number(2.0), k3)
            )
            ends.append(b.fadd(x, b.fmul(sixth, b.fadd(total, k4))))
        return ends

    def store(self, values: Sequence[Any]) -> None:
        """Write the function's results."""
        for place, value in enumerate(values):
            self.builder.store(value, self.builder.gep(self._out, [_int(place)]))

    def end(self) -> None:
        """End the function."""
        self.builder.ret_void()

    @contextmanager
    def loop(self, begin: Any, end: Any) -> Iterator[Any]:
        """A loop over integers from `begin` to before `end`."""
        b = self.builder
        before, head, body, after = b.block, *(b.append_basic_block() for _ in range(3))
        b.branch(head)
        b.position_at_end(head)
        j = b.phi(_INT)
        j.add_incoming(begin, before)
        b.cbranch(b.icmp_signed("<", j, end), body, after)
        b.position_at_end(body)
        yield j
        j.add_incoming(b.add(j, _int(1)), b.block)
        b.branch(head)
        b.position_at_end(after)

    def _evaluate(self, tree: ast.expr, known: Values) -> Any:  # noqa: PLR0911
        """The value of an expression; kinks are switches by now, so there are no conditions."""
        b = self.builder

        def of(part: ast.expr) -> Any:
            return self._evaluate(part, known)

        match tree:
            case ast.Constant(value=int() | float() as value):
                return _number(float(value))
            case ast.Attribute(attr=name):  # pi, e
                return _number(float(getattr(math, name)))
            case ast.Name(id=name):
                return known[name] if name in known else self.value(name)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return _negative(b, of(operand))
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return self._power(of(left), of(right))
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATIONS:
                return _fold(b, op, of(left), of(right))
            case ast.Call(func=function, args=arguments):
                name = (
                    function.attr
                    if isinstance(function, ast.Attribute)
                    else ast.unparse(function)
                )
                return self._call(
                    {"abs": "fabs"}.get(name, name), [of(a) for a in arguments]
                )
        raise PlantError(
            f"plant: the equations contain {ast.unparse(tree)}, which cannot be compiled"
        )

    def _power(self, base: Any, exponent: Any) -> Any:
        """Whole constant powers are products; any other is the library's."""
        b = self.builder
        if not (
            isinstance(exponent, ir.Constant) and float(exponent.constant).is_integer()
        ):
            return self._call("pow", [base, exponent])
        remaining = abs(int(exponent.constant))
        result = None
        value = base
        while remaining:
            if remaining & 1:
                result = value if result is None else b.fmul(result, value)
            remaining >>= 1
            if remaining:
                value = b.fmul(value, value)
        result = _number(1.0) if result is None else result
        return b.fdiv(_number(1.0), result) if exponent.constant < 0 else result

    def _call(self, name: str, arguments: list[Any]) -> Any:
        module = self.llvm.module
        if name in _INTRINSICS:
            function = module.declare_intrinsic(f"llvm.{name}", [_DOUBLE])
        elif name in _LIBRARY:
            kind = ir.FunctionType(_DOUBLE, [_DOUBLE] * len(arguments))
            function = module.globals.get(name) or ir.Function(module, kind, name)
        else:
            raise PlantError(
                f"plant: the equations use {name}, which cannot be compiled"
            )
        return self.builder.call(function, arguments)


def _fold(b: ir.IRBuilder, op: ast.operator, left: Any, right: Any) -> Any:
    """A sum, difference, product or quotient; of two constants a constant."""
    of_numbers, of_values = _OPERATIONS[type(op)]
    if isinstance(left, ir.Constant) and isinstance(right, ir.Constant):
        return _number(of_numbers(left.constant, right.constant))
    return of_values(b, left, right)


def _negative(b: ir.IRBuilder, value: Any) -> Any:
    return _number(-value.constant) if isinstance(value, ir.Constant) else b.fneg(value)


def _is_zero(value: Any) -> bool:
    return isinstance(value, ir.Constant) and value.constant == 0.0


def _named(kind: str, values: Sequence[Any]) -> Values:
    return {f"{kind}{i}": value for i, value in enumerate(values)}


def _number(value: float) -> ir.Constant:
    return ir.Constant(_DOUBLE, value)


def _int(value: int) -> ir.Constant:
    return ir.Constant(_INT, value)
