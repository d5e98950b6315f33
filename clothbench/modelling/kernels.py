"""Kernels of effects: compiled for the time loops of all models, which know them by one signature."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable

from numba import types
from numba.core.errors import NumbaError

from clothbench.core.errors import ClothbenchError
from clothbench.core.kernels import kernel
from clothbench.modelling.sheet import ROWS, SHEET, VECTOR

SIGNATURE = types.void(types.float64, types.float64, ROWS, ROWS, ROWS, SHEET, VECTOR, VECTOR)
EFFECT = types.FunctionType(SIGNATURE)


def effect_kernel(function: Callable | None = None, /, *, allocates: bool = True) -> Callable:
    """Compile an effect's `force` or `inertia` for the time loops of all models (see `clothbench.Effect`).

    `function(t, dt, x, v, f, sheet, p, state)` adds to f in place: forces (3, n), or for `inertia` masses (6, n).
    Compiled when a model first takes it (`ready`), so that nobody waits for effects that he does not use, and cached
    on disk. allocates: as of `kernel`; one that makes no arrays and says so is faster.
    """
    return kernel(function, allocates=allocates)


def ready(kernel: Callable, name: str) -> Callable:
    """An effect's kernel compiled for the time loops; `name` tells an author which one cannot be."""
    try:
        kernel.compile(SIGNATURE)  # type: ignore[attr-defined]
    except NumbaError as error:
        told = re.sub(r"\x1b\[[0-9;]*m", "", str(error))  # colours, where numba finds a library for them
        reason = textwrap.shorten(told.partition("\n")[2] or told, 300)
        if not getattr(kernel, "targetoptions", {}).get("_nrt", True):
            reason += " (it says allocates=False: that is for kernels that make no arrays, nor have numba make any)"
        raise ClothbenchError(f"{name} cannot be compiled by numba: {reason}") from error
    return kernel


@effect_kernel(allocates=False)
def no_effect(t, dt, x, v, f, sheet, p, state):
    """Fills the slots of a time loop that has no effect there."""
