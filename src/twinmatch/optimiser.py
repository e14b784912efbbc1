"""What LLVM does with compiled code: the machine it is for, and the passes over kernels.

Parts of kernels are simplified before they are linked, and the kernels optimised.

Sums keep their order on all levels, so none of these settings moves a bit of a result.
"""

from __future__ import annotations

from typing import Any, Final

from llvmlite import binding

from twinmatch.processor import processor

_LARGEST_INLINED: Final = 100
"""LLVM's cost of a function above which its calls stay calls, in place of 250: most parts are called from several
places."""


def target_machine() -> Any:
    """A new machine that LLVM compiles for, of the kind of `processor()`: an engine owns its own."""
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    name, features = processor()
    return binding.Target.from_default_triple().create_target_machine(
        cpu=name,
        features=features,
        opt=3,
        reloc="pic",
        codemodel="default",
        jit=True,
    )


def simplify_functions(module: Any) -> None:
    """Simplify the functions of a module, each by itself, so that the kernels that share them do not have to.

    LLVM's first level is enough, as what they are linked into is optimised at the highest. References to arrays that
    cancel out are taken out.
    """
    builder = _builder(speed_level=1)
    passes = builder.getFunctionPassManager()
    passes.add_refprune_pass()
    for function in module.functions:
        if not function.is_declaration:
            passes.run(function, builder)


def optimise(module: Any) -> None:
    """Optimise a kernel with all that it calls, once, and take out the references that cancel out then."""
    builder = _builder(speed_level=3)
    passes = builder.getModulePassManager()
    passes.add_refprune_pass()
    passes.run(module, builder)


def _builder(speed_level: int) -> Any:
    """What makes passes of one of LLVM's levels.

    Loops over samples fill the vector unit, and so do sums that stand side by side. No loop is unrolled: most are
    over a few states or unknowns, and would take more code and no less time.
    """
    tuning = binding.create_pipeline_tuning_options(speed_level=speed_level)
    tuning.loop_vectorization = True
    tuning.slp_vectorization = True
    tuning.loop_interleaving = False
    tuning.loop_unrolling = False
    tuning.inlining_threshold = _LARGEST_INLINED
    return binding.create_pass_builder(target_machine(), tuning)
