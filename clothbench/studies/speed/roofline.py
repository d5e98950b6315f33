"""What one core could do at most: the roofline of Williams, Waterman and Patterson 2009 (Roofline, section 3).

A model says what one node of one step takes (`work_per_node_step`): operations, roots and divisions apart from them,
and numbers that go to and from memory. How fast this core does each of these is measured, from vectors that stay in the
nearest cache; the slowest of them is the ceiling. A faster model has to do less, not the same more cleverly.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clothbench.core.kernels import apart_kernel

CHAIN = 32  # multiplications and additions that a number goes through from one load to its store
FIRST_ROUNDS, SECONDS, REPEATS = 64, 0.02, 5
NEAREST = 24_576  # bytes that any nearest cache holds


@dataclass(frozen=True)
class Work:
    """What a node of a step takes, as `clothbench.StatesItsWork` has it."""

    operations: float
    roots: float
    numbers: float


@dataclass(frozen=True)
class Core:
    """What one core does in a second, in one precision: operations, roots and divisions, bytes of the nearest cache."""

    operations: float
    roots: float
    bytes: float
    size: int  # bytes of a number

    def ceilings(self, work: Work) -> dict[str, float]:
        """Node-steps a second that each of them allows, by its name."""
        return {
            "memory": self.bytes / (work.numbers * self.size),
            "arithmetic": self.operations / work.operations,
            "roots": self.roots / work.roots if work.roots else np.inf,
        }


def measured_core(precision: str) -> Core:
    """This core in "double" or "single" precision, after warm-up, each rate the best of a few runs."""
    real = np.dtype(np.float64 if precision == "double" else np.float32)
    count = NEAREST // 3 // real.itemsize
    a, b, c = np.ones((3, count), real)
    x, y = real.type(0.999), real.type(0.001)
    return Core(
        operations=2 * CHAIN * count * _rate(lambda rounds: _multiply_add(a, x, y, rounds)),
        roots=2 * count * _rate(lambda rounds: _roots(a, rounds)),
        bytes=3 * count * real.itemsize * _rate(lambda rounds: _triad(a, b, c, x, rounds)),
        size=real.itemsize,
    )


def told(name: str, speed: float, core: Core, work: Work) -> str:
    """One line: how near a model comes to the ceiling, and what that is."""
    ceilings = core.ceilings(work)
    lowest = min(ceilings, key=lambda kind: ceilings[kind])
    rest = ", ".join(f"{kind} would allow {1e-6 * rate:.0f}" for kind, rate in ceilings.items() if kind != lowest)
    return (
        f"{name}: {1e-6 * speed:.0f} of {1e-6 * ceilings[lowest]:.0f} million node-steps/s that {lowest} allows one "
        f"core ({1e-9 * core.bytes:.0f} GB/s, {work.numbers * core.size:.0f} B a node-step); {rest}"
    )


def _rate(run: Callable[[int], None]) -> float:
    """Rounds a second, of the best of a few runs that are long enough to be timed."""
    rounds, best, repeats = FIRST_ROUNDS, 0.0, 0
    run(1)
    while repeats < REPEATS:
        start = time.perf_counter()
        run(rounds)
        seconds = time.perf_counter() - start
        if seconds < SECONDS:
            rounds *= 2
            continue
        best, repeats = max(best, rounds / seconds), repeats + 1
    return best


@apart_kernel
def _multiply_add(a, x, y, rounds):
    """a ← a·x + y, `CHAIN` times for every load."""
    for _ in range(rounds):
        for e in range(np.uint64(a.shape[0])):
            value = a[e]
            for _ in range(CHAIN):
                value = value * x + y
            a[e] = value


@apart_kernel
def _roots(a, rounds):
    """a ← 1/√(a + 1): a root and a division each."""
    one = a.dtype.type(1.0)
    for _ in range(rounds):
        for e in range(np.uint64(a.shape[0])):
            a[e] = one / np.sqrt(a[e] + one)


@apart_kernel
def _triad(a, b, c, x, rounds):
    """a ← b + x·c, and with b and c in turn, so that no round can be left out: two loads and a store each."""
    for _ in range(rounds):
        for e in range(np.uint64(a.shape[0])):
            a[e] = b[e] + x * c[e]
        b, a = a, b
