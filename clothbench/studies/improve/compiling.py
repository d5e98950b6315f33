"""What candidates are made of, compiled by a process of its own before it is asked for.

The first run on a machine compiles for a minute or more, on one core: the model's time loop, then each effect's part as
it is tried. What lies on disk by then only has to be read.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from typing import Any

from clothbench.core.kernels import lies_on_disk
from clothbench.core.parallel import thread_count
from clothbench.core.protocols import Effect
from clothbench.modelling.curves import SHEET_HOOKS
from clothbench.modelling.kernels import ready
from clothbench.plugins.discovery import catalogue
from clothbench.studies.improve.problem import Problem

YIELDS = 10  # by how much the process is nicer than others: who simulates goes first


@contextlib.contextmanager
def compiled_ahead(problem: Problem, names: Sequence[str]) -> Iterator[None]:
    """Meanwhile a process of its own compiles these effects, one after the other, if any of them has to be and there is
    a core for it. It ends with what is done meanwhile, if not before.
    """
    missing = [name for name in names if not known(problem, name)]
    if not missing or thread_count() < 2:
        yield
        return
    code = f"from {__name__} import compile_effects; compile_effects({os.getpid()}, {missing!r})"
    nothing = subprocess.DEVNULL
    with subprocess.Popen([sys.executable, "-c", code], stdin=nothing, stdout=nothing, stderr=nothing) as process:
        try:
            yield
        finally:
            process.kill()


def known(problem: Problem, name: str) -> bool:
    """Whether all that an effect is made of lies on disk; what cannot be made is told where it is tried."""
    try:
        return all(map(lies_on_disk, kernels_of(problem.make("effects", name))))
    except Exception:  # a stranger's effect may do anything
        return True


def kernels_of(effect: Effect) -> list[Any]:
    """What of an effect time loops call."""
    found = [getattr(effect, hook, None) for hook in SHEET_HOOKS["dynamics"]]
    return [kernel for kernel in found if hasattr(kernel, "py_func")]


def compile_effects(parent: int, names: Sequence[str]) -> None:
    """Compile effects as time loops take them, as long as the process `parent` lives."""
    if hasattr(os, "nice"):
        os.nice(YIELDS)
    for name in names:
        if hasattr(os, "getppid") and os.getppid() != parent:
            return
        with contextlib.suppress(Exception):  # it is told where it is tried
            effect: Effect = catalogue().make("effects", name)
            for kernel in kernels_of(effect):
                ready(kernel, name)
