"""Why an implicit step of `baraff_witkin` is solved by conjugate gradients: one such system, solved in every way.

The system is that of a sheet in full swing, in the textbook cloth that `clothbench bench` steps. A factorisation is
timed with its numbers alone where the library separates them from the pattern, which no step changes. `qdldl` and
`cvxopt` (CHOLMOD) take part where they are installed: they are nobody's dependency here.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from clothbench_models import implicit_grid
from clothbench_models.baraff_witkin_kernels import Membrane, Plate, elastic
from clothbench_models.resting_contact import STICKS
from clothbench_models.sheet_forces import TRIANGLES
from scipy import sparse
from scipy.sparse import linalg

from clothbench.plugins.discovery import catalogue
from clothbench.studies.speed import timing

SIDES = (21, 41, 65)
STEPS = {"2 ms": 2e-3, "8 ms": 8e-3, "1/60 s": 1 / 60}
TOLERANCE = 1e-4
MOMENT = 0.6  # s after which the sheet is caught
REACH = 2  # nodes that one row of the matrix sees to either side


@dataclass(eq=False)
class Step:
    """The system (M + C + K) δ = r of one step of dt s, as the time loop sets it up."""

    side: int
    dt: float
    delta: np.ndarray = field(init=False)
    free: np.ndarray = field(init=False)

    def __post_init__(self):
        before, x, simulation = caught(self.side)
        nu, n, theta = self.side, self.side**2, (timing.CLOTH.stretch, timing.CLOTH.stretch, timing.CLOTH.shear)
        gamma, speed = 2 * self.dt / 3, (x - before) / 2e-3
        lengths, over, shares = simulation.edges
        padded, stiffness = n + 2 * (nu + 1), shares * np.array(theta)[:, None]
        self.edges, self.shear, self.work = (np.zeros((rows, padded)) for rows in (10, TRIANGLES, 20))
        self.mass, self.bending = np.array(simulation.sheet.mass), simulation.bending
        force = self.mass * np.array(simulation.scene.gravity)[:, None]
        membrane = Membrane(lengths, over, stiffness, 0 * stiffness)
        plate = Plate(self.bending.offsets, self.bending.values, timing.CLOTH.bending, 0.0, np.zeros(2))
        elastic(
            x + gamma * speed,
            speed,
            force,
            nu,
            membrane,
            plate,
            0.0,
            gamma**2,
            gamma,
            self.edges,
            self.shear,
            self.work,
        )
        self.right, self.delta, self.spare = gamma * force, np.zeros((3, n)), np.zeros((4, 3, n))
        self.swept = np.zeros((3, n + 2 * implicit_grid.margin_of(nu)))
        self.inverse, self.none, self.bend = np.ones((6, n)), np.zeros((6, n)), gamma**2 * timing.CLOTH.bending
        self.touch = np.zeros(n, np.int64)
        self.touch[simulation.sheet.held] = STICKS
        self.free = np.tile(self.touch != STICKS, 3)
        self.rows = implicit_grid.empty_matrix(nu, n, TRIANGLES)
        self.assemble()

    def iterate(self, tolerance: float = TOLERANCE) -> int:
        """Conjugate gradients into `delta`; how many rounds."""
        r, normal, z, q = self.spare
        r[:] = self.right
        self.assemble()
        return implicit_grid.solve(
            self.delta, r, self.side, self.rows, self.bending.offsets, self.bending.values, self.bend, self.touch,
            normal, tolerance, 10_000, self.inverse, z, self.swept, q,
        )  # fmt: skip

    def assemble(self) -> None:
        implicit_grid.assemble(
            self.side, self.mass, self.none, False, self.edges, self.shear, self.bending.offsets, self.bending.values,
            self.bend, self.rows, self.work[:6],
        )  # fmt: skip

    def times(self, p: np.ndarray) -> np.ndarray:
        """(M + C + K) p for p (3, n)."""
        out, margin = np.zeros_like(p), implicit_grid.margin_of(self.side)
        swept = np.pad(p, ((0, 0), (margin, margin)))
        implicit_grid.multiply(self.rows, self.side, self.bending.offsets, self.bending.values, self.bend, swept, out)
        return out

    @functools.cached_property
    def matrix(self) -> sparse.csc_array:
        """What `times` does to the free coordinates; columns too far apart to meet are found at once."""
        nu, n, width = self.side, self.side**2, 2 * REACH + 1
        i, j = np.arange(n) % nu, np.arange(n) // nu
        near = (np.abs(i - i[:, None]) <= REACH) & (np.abs(j - j[:, None]) <= REACH)
        rows, columns, values = [], [], []
        for colour in range(width**2):
            lit = np.flatnonzero(i % width + width * (j % width) == colour)
            row, which = np.nonzero(near[:, lit])
            for c in range(3):
                p = np.zeros((3, n))
                p[c, lit] = 1.0
                answer = self.times(p)
                for k in range(3):
                    rows.append(k * n + row)
                    columns.append(c * n + lit[which])
                    values.append(answer[k, row])
        entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
        full = sparse.csc_array(entries, shape=(3 * n, 3 * n))[:, self.free][self.free]
        full.data[np.abs(full.data) < 1e-14 * np.abs(full.data).max()] = 0.0
        full.eliminate_zeros()
        # A coordinate after the other of each node: what belongs together lies together.
        order = np.argsort(np.tile(np.arange(n), 3)[self.free], kind="stable")
        self.order = order
        return full[:, order][order].tocsc()

    @property
    def load(self) -> np.ndarray:
        """The right-hand side in the order of `matrix`."""
        matrix = self.matrix
        return np.ascontiguousarray(self.right.ravel()[self.free][self.order]) if matrix.shape[0] else np.zeros(0)


@functools.cache
def caught(side: int):
    """The sheet at two moments 2 ms apart, (3, n) m, and its simulation."""
    model = catalogue().make("models", "baraff_witkin", dt=1e-3)
    scene = timing.swung_sheet(side, MOMENT)
    nodes = model.prepare(scene).sheet.uv
    simulation = model.prepare(timing.swung_sheet(side, MOMENT, nodes, np.array([MOMENT - 2e-3, MOMENT])))
    before, after = simulation.run(model.of_material(timing.CLOTH, scene)[None]).position[0]
    return np.ascontiguousarray(before.T), np.ascontiguousarray(after.T), simulation


step = functools.cache(Step)


def superlu(system: Step) -> Callable[[], np.ndarray]:
    matrix, load = system.matrix, system.load
    options = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    return lambda: linalg.splu(matrix, **options).solve(load)


def qdldl(system: Step) -> Callable[[], np.ndarray]:
    library = pytest.importorskip("qdldl")
    matrix, load = sparse.csc_matrix(system.matrix), system.load
    solver = library.Solver(matrix)

    def solve() -> np.ndarray:
        solver.update(matrix)
        return solver.solve(load)

    return solve


def cholmod(system: Step) -> Callable[[], np.ndarray]:
    library, pattern = pytest.importorskip("cvxopt"), sparse.coo_array(sparse.tril(system.matrix))
    from cvxopt import cholmod

    lower = library.spmatrix(pattern.data.tolist(), pattern.row.tolist(), pattern.col.tolist(), pattern.shape)
    load, factor = library.matrix(system.load), cholmod.symbolic(lower)

    def solve() -> np.ndarray:
        answer = +load
        cholmod.numeric(lower, factor)
        cholmod.solve(factor, answer)
        return np.array(answer).ravel()

    return solve


FACTORISATIONS = {"SuperLU": superlu, "QDLDL": qdldl, "CHOLMOD": cholmod}


def quickest(call: Callable[[], object], repeats: int = 7) -> float:
    """Seconds of the fastest of some calls after a first one."""
    call()
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - began)
    return min(seconds)


def test_the_matrix_is_what_the_kernels_multiply_by():
    system = step(21, 2e-3)
    p = np.random.default_rng(3).standard_normal((3, 21**2)) * (system.touch != STICKS)
    product = system.matrix @ p.ravel()[system.free][system.order]
    assert product == pytest.approx(system.times(p).ravel()[system.free][system.order], rel=1e-9, abs=1e-12)
    assert abs(system.matrix - system.matrix.T).max() < 1e-9 * abs(system.matrix).max()


@pytest.mark.parametrize("solver", FACTORISATIONS)
@pytest.mark.parametrize("dt", STEPS.values(), ids=STEPS)
def test_all_solvers_agree(dt, solver):
    system = step(21, dt)
    exact = FACTORISATIONS[solver](system)()
    system.iterate(1e-10)
    found = system.delta.ravel()[system.free][system.order]
    assert np.abs(found - exact).max() < 1e-6 * np.abs(exact).max()


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("dt", STEPS.values(), ids=STEPS)
def test_conjugate_gradients(benchmark, dt, side):
    benchmark.group = f"{side} × {side} nodes"
    system = step(side, dt)
    rounds = benchmark.pedantic(system.iterate, rounds=5, warmup_rounds=1)
    assert 0 < rounds < 10_000
    benchmark.extra_info["rounds"] = rounds


@pytest.mark.parametrize("solver", FACTORISATIONS)
@pytest.mark.parametrize("side", SIDES)
def test_factorisation(benchmark, side, solver):
    benchmark.group = f"{side} × {side} nodes"
    call = FACTORISATIONS[solver](step(side, 2e-3))
    assert np.isfinite(benchmark.pedantic(call, rounds=3, warmup_rounds=1)).all()


@pytest.mark.bench
@pytest.mark.parametrize("side", [21, 41])
def test_conjugate_gradients_beat_a_factorisation_at_the_default_step(side):
    system = step(side, 2e-3)
    assert quickest(superlu(system), 3) >= 8 * quickest(system.iterate)
