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
from typing import Any, Final

from llvmlite import binding, ir

from twinmatch.dynamics.code import Formulas, PlantFormulas
from twinmatch.dynamics.declarations import PlantError

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
_OPERATIONS: Final[dict[type[ast.operator], tuple[Callable[..., float], Callable[..., Any]]]] = {
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
    ir.VoidType(), [_POINTER] * 6 + [_DOUBLE, _POINTER, _POINTER, _INT.as_pointer(), _INT, _INT]
)

Values = dict[str, Any]


def compiled_object(formulas: PlantFormulas) -> bytes:
    """Machine code of a plant's functions for this processor.

    Raises:
        PlantError: an expression cannot be compiled; `derive` lets none through.
    """
    module = binding.parse_assembly(str(_module(formulas)))
    module.verify()
    machine = _target_machine()
    tuning = binding.create_pipeline_tuning_options(speed_level=3)
    tuning.slp_vectorization = True
    builder = binding.create_pass_builder(machine, tuning)
    builder.getModulePassManager().run(module, builder)
    return bytes(machine.emit_object(module))


def linked(code: bytes) -> tuple[Any, dict[str, int]]:
    """Machine code made runnable: its owner, and the address of every function while the owner lives."""
    engine = binding.create_mcjit_compiler(binding.parse_assembly(""), _target_machine())
    engine.add_object_file(binding.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine, {name: int(engine.get_function_address(name)) for name in FUNCTIONS}


def host() -> str:
    """The processor for which code is compiled, and the compiler."""
    features = binding.get_host_cpu_features().flatten()
    return f"{binding.get_host_cpu_name()} {features} LLVM {binding.llvm_version_info}"


def _target_machine() -> Any:
    """A new one: an engine owns its own."""
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding.Target.from_default_triple().create_target_machine(
        cpu=binding.get_host_cpu_name(),
        features=binding.get_host_cpu_features().flatten(),
        opt=3,
        reloc="pic",
        codemodel="default",
        jit=True,
    )


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
        function.store([value for part in parts for value in function.results(part, {})])
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
    stages, after = function.runge_kutta(lambda values: function.results(f.rates, values | begun))
    crossed = function.builder.select(function.crossed(begun, stages, after), _number(1.0), _number(0.0))
    function.store([*after, crossed])
    function.end()


def _write_tangents(module: ir.Module, f: PlantFormulas) -> None:
    """The step with its derivatives, without the terms that are always zero.

    If 1 stands after the states, a step that crosses a kink is not taken; otherwise 0 stands there then.
    """
    function = _Function(module, "tangents", _TANGENTS, f)
    builder = function.builder
    n = f.n_states
    m = f.n_inputs
    q = f.n_unknown
    columns, du, unknown_numbers, first, size = function.llvm.args[7:]
    slopes_at_stages: list[list[Any]] = []
    begun = _named("b", function.switches({}))

    def rates(values: Values) -> list[Any]:
        slopes = function.results(f.slopes, values | begun)
        slopes_at_stages.append(slopes)
        return slopes[n * q : n * q + n]

    stages, after = function.runge_kutta(rates)
    place = builder.gep(function.llvm.args[5], [_int(n)])
    asked = builder.fcmp_ordered("!=", builder.load(place), _number(0.0))
    with builder.if_then(builder.and_(asked, function.crossed(begun, stages, after)), likely=False):
        builder.ret_void()
    builder.store(_number(0.0), place)
    by_unknown = builder.alloca(_DOUBLE, max(4 * n * q, 1))
    for place, value in enumerate(value for stage in slopes_at_stages for value in stage[: n * q]):
        builder.store(value, builder.gep(by_unknown, [_int(place)]))
    x_slopes = [stage[n * q + n : n * q + n + n * n] for stage in slopes_at_stages]
    u_slopes = [stage[n * q + n + n * n :] for stage in slopes_at_stages]
    h = function.h
    half = builder.fmul(_number(0.5), function.h)
    sixth = builder.fdiv(h, _number(6.0))

    def rate(i: int, stage: int, of_x: Sequence[Any], of_u: Sequence[Any], unknown: Any) -> Any:
        terms = [(x_slopes[stage][i * n + k], of_x[k]) for k in range(n)]
        terms += [(u_slopes[stage][i * m + k], of_u[k]) for k in range(m)]
        products = [builder.fmul(slope, value) for slope, value in terms if not _is_zero(slope)]
        if unknown is not None and not all(_is_zero(v) for v in slopes_at_stages[stage][i * q : i * q + q]):
            place = builder.add(unknown, _int((stage * n + i) * q))
            products.append(builder.load(builder.gep(by_unknown, [place])))
        return functools.reduce(builder.fadd, products) if products else _number(0.0)

    def column(j: Any, unknown: Any) -> None:
        places = [builder.gep(columns, [builder.add(builder.mul(_int(i), size), j)]) for i in range(n)]
        of_u = [builder.load(builder.gep(du, [builder.add(builder.mul(_int(k), size), j)])) for k in range(m)]
        before = [builder.load(place) for place in places]
        slopes: list[list[Any]] = []
        stage_values = before
        for stage in range(4):
            slopes.append([rate(i, stage, stage_values, of_u, unknown) for i in range(n)])
            if stage < 3:
                stage_values = function.shifted(before, slopes[-1], half if stage < 2 else h)
        for place, value in zip(places, function.combined(before, slopes, sixth), strict=True):
            builder.store(value, place)

    with function.loop(_int(0), first) as j:
        column(j, builder.load(builder.gep(unknown_numbers, [j])))
    with function.loop(first, size) as j:
        column(j, None)
    function.store(after)
    function.end()


class _Function:
    """One function while it is written."""

    def __init__(self, module: ir.Module, name: str, kind: ir.FunctionType, f: PlantFormulas) -> None:
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
            on = self.builder.fcmp_ordered(">", self._evaluate(tree, known_values), _number(0.0))
            states.append(self.builder.select(on, _number(1.0), _number(0.0)))
            known_values[f"b{i}"] = states[-1]
        return states

    def crossed(self, begun: Values, stages: Sequence[Sequence[Any]], after: Sequence[Any]) -> Any:
        """Whether a switch is not as at the step's begin, at one of its stages or after it."""
        differs: Any = ir.Constant(ir.IntType(1), 0)
        for states in (after, *reversed(stages[1:])):
            for i, side in enumerate(self.switches(_named("x", states))):
                differs_here = self.builder.fcmp_ordered("!=", side, begun[f"b{i}"])
                differs = self.builder.or_(differs, differs_here)
        return differs

    def runge_kutta(self, rates: Callable[[Values], list[Any]]) -> tuple[list[list[Any]], list[Any]]:
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

    def combined(self, begun: Sequence[Any], slopes: Sequence[Sequence[Any]], sixth: Any) -> list[Any]:
        """Values after a Runge–Kutta step with the slopes of its stages."""
        b = self.builder
        ends = []
        for x, k1, k2, k3, k4 in zip(begun, *slopes, strict=True):
            total = b.fadd(b.fadd(k1, b.fmul(_number(2.0), k2)), b.fmul(_number(2.0), k3))
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

    def _evaluate(self, tree: ast.expr, known: Values) -> Any:  # noqa: PLR0911 (a case for each kind)
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
                name = function.attr if isinstance(function, ast.Attribute) else ast.unparse(function)
                return self._call({"abs": "fabs"}.get(name, name), [of(a) for a in arguments])
        raise PlantError(f"plant: the equations contain {ast.unparse(tree)}, which cannot be compiled")

    def _power(self, base: Any, exponent: Any) -> Any:
        """Whole constant powers are products; any other is the library's."""
        b = self.builder
        if not (isinstance(exponent, ir.Constant) and float(exponent.constant).is_integer()):
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
            raise PlantError(f"plant: the equations use {name}, which cannot be compiled")
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
