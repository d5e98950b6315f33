"""Compiled code that does not count who refers to an array, and what is asked of it for that.

numba frees an array when nobody refers to it any more. A function that is compiled without counting must make no array
(numba refuses that itself), take none from a function that counts, which nobody would ever free, and return none, which
others would free while it is in use. So it is looked at when its types are known.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from numba import types
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import AnalysisPass, register_pass
from numba.core.errors import NumbaTypeError
from numba.core.typed_passes import NopythonTypeInference


class CheckedCompiler(Compiler):
    """numba's compiler, which holds functions that do not count references to what that takes."""

    def define_pipelines(self) -> Any:
        pipelines = super().define_pipelines()
        if not self.state.flags.nrt:
            # What numba builds in is compiled once for all that have a context in common, as the first of them is.
            self.state.targetctx.cached_internal_func = {}
            for pipeline in pipelines:
                pipeline.add_pass_after(_HandedOver, NopythonTypeInference)
                pipeline.finalize()
        return pipelines


@register_pass(mutates_CFG=False, analysis_only=True)
class _HandedOver(AnalysisPass):
    _name = "handed_over"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        if (fault := next(_faults(state), None)) is not None:
            raise NumbaTypeError(
                f"{state.func_id.func_name}: {fault}, which a function that counts no references must not; take "
                "allocates=False away, or have it fill arrays that it is given"
            )
        return False


def _faults(state: Any) -> Iterator[str]:
    if state.func_id.is_generator or any(isinstance(kind, types.Generator) for kind in state.typemap.values()):
        yield "is, or goes through, a generator"
    if _holds(state, state.return_type):
        yield "returns arrays"
    for callee, returned in _calls(state):
        if isinstance(callee, types.Dispatcher) and _counts(callee) is None:
            yield f"calls {callee}, which clothbench's decorators have not made"
        elif isinstance(callee, types.Dispatcher | types.FunctionType) and _holds(state, returned):
            yield f"takes arrays from {callee}"


def _calls(state: Any) -> Iterator[tuple[Any, Any]]:
    """The type of what is called and of what it returns, of each call."""
    for block in state.func_ir.blocks.values():
        for call in block.find_exprs("call"):
            if (given := state.calltypes[call]) is not None:
                yield state.typemap[call.func.name], given.return_type


def _counts(callee: types.Dispatcher) -> bool | None:
    """Whether a compiled function counts references; None where it would do as the first that calls it."""
    return getattr(callee.dispatcher, "targetoptions", {}).get("_nrt")


def _holds(state: Any, kind: Any) -> bool:
    """Whether a value of this type refers to memory that is counted."""
    return bool(state.targetctx.data_model_manager[kind].contains_nrt_meminfo())
