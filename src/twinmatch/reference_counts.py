"""How compiled kernels count references to arrays.

numba counts them in steps that are atomic, as threads could share an array: a twentieth of the time of a replay. Here
each call from Python makes counters of its own for its arrays, and a kernel starts no threads, so only the thread that
called it counts them.
"""

from __future__ import annotations

from typing import Final

from llvmlite import ir

COUNTING: Final = ("NRT_incref", "NRT_decref")
"""Names by which compiled code counts one reference more to an array, and one less."""


def counting_module() -> ir.Module:
    """How references to an array are counted within one thread; behind the last one the array is freed.

    Like numba's, these functions are not inlined: its optimiser looks for calls of them that cancel out.
    """
    module = ir.Module("counting")
    count_type = ir.IntType(64)
    array_type = ir.IntType(8).as_pointer()
    of_array = ir.FunctionType(ir.VoidType(), [array_type])
    free = ir.Function(module, of_array, "NRT_MemInfo_call_dtor")
    for name, change in zip(COUNTING, (1, -1), strict=True):
        function = ir.Function(module, of_array, name)
        function.attributes.add("noinline")
        (array,) = function.args
        builder = ir.IRBuilder(function.append_basic_block())
        is_counted = builder.icmp_unsigned("!=", array, ir.Constant(array_type, None))
        with builder.if_then(is_counted):
            # the count is the first number of what numba keeps of an array
            place = builder.bitcast(array, count_type.as_pointer())
            count = builder.add(builder.load(place), ir.Constant(count_type, change))
            builder.store(count, place)
            if change < 0:
                is_last = builder.icmp_unsigned("==", count, ir.Constant(count_type, 0))
                with builder.if_then(is_last):
                    builder.call(free, [array])
        builder.ret_void()
    return module
