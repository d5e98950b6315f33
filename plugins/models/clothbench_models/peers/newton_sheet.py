"""The inside of `newton`: one sheet stepped by a Newton solver on the CPU. Imports Warp and Newton.

Steps are recorded in graphs and replayed, without any Python between them; what changes from step to step (held
nodes, nodal forces, damping while settling) is done by two small kernels in the graph. Positions are kept relative to
where the sheet begins, for the sake of single precision.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from clothbench.modelling import Sheet, bear_inertia

wp.config.log_level = wp.LOG_WARNING  # before Newton starts Warp, which would print on standard output
import newton  # noqa: E402

GRAPHS = (64, 8, 2, 1)  # steps in one graph; the odd one copies its last state back
PATH = 2048  # steps of a path at most
PROBE, PROBE_STEP = 1e-5, 1e-6  # m and s, to measure stiffness and damping
ITERATIONS = 60


@wp.kernel
def lead(
    hold: wp.array(dtype=int),  # type: ignore[valid-type]
    path: wp.array2d(dtype=wp.vec3),  # type: ignore[valid-type]
    speed: wp.array2d(dtype=wp.vec3),  # type: ignore[valid-type]
    counter: wp.array(dtype=int),  # type: ignore[valid-type]
    keep: wp.array(dtype=float),  # type: ignore[valid-type]
    pushed: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    q: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    qd: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    f: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
):
    """Before a step: held nodes onto their path, velocities damped, forces laid on."""
    i = wp.tid()
    grip = hold[i]
    f[i] = pushed[i]
    if grip >= 0:
        q[i] = path[counter[0], grip]
        qd[i] = speed[counter[0], grip]
    else:
        qd[i] = qd[i] * keep[0]


@wp.kernel
def count(counter: wp.array(dtype=int), stride: wp.array(dtype=int)):  # type: ignore[valid-type]
    """One step further along the path; a stride of 0 stays at its first point."""
    counter[0] = counter[0] + stride[0]


@dataclass(frozen=True)
class Cloth:
    """What Newton is told. material: tri_ke, tri_ka, tri_kd, edge_ke and edge_kd of `add_cloth_mesh`; solver:
    "semi_implicit" or "vbd", the latter with so many iterations.
    """

    material: tuple[float, ...]
    solver: str
    iterations: int


class NewtonSheet:
    """A sheet, its solver, and the two states between which it steps."""

    def __init__(self, sheet: Sheet, cloth: Cloth, held: np.ndarray, dt: float):
        self.dt, self.held, self.cloth = dt, held, cloth
        self.mass = np.array(sheet.mass)
        self.model = _model(sheet, cloth, held)
        self.solver = _solver(self.model, cloth)
        self.state: Any = self.model.state()
        self.next: Any = self.model.state()
        nodes, grips = len(sheet.uv), max(1, len(held))
        hold: np.ndarray = np.full(nodes, -1, np.int32)
        hold[held] = np.arange(len(held))
        self.hold: Any = wp.array(hold, dtype=int, device="cpu")
        self.path, self.speed = (wp.zeros((PATH, grips), dtype=wp.vec3, device="cpu") for _ in range(2))
        self.counter, self.stride = (wp.zeros(1, dtype=int, device="cpu") for _ in range(2))
        self.keep = wp.ones(1, dtype=float, device="cpu")
        self.pushed = wp.zeros(nodes, dtype=wp.vec3, device="cpu")
        self.added: np.ndarray | None = None
        self.is_pushed = False
        self.graphs: dict[int, Any] = {}
        self.origin = np.zeros(3)

    # --- what `Engine` asks for ---------------------------------------------------------------------------------

    def place(self, position: np.ndarray, velocity: np.ndarray) -> None:
        self.origin = position.mean(axis=0)
        self.state.particle_q.numpy()[:] = position - self.origin
        self.state.particle_qd.numpy()[:] = velocity
        self._still()

    def damp(self, rate: float) -> None:
        self.keep.numpy()[0] = 1.0 - rate * self.dt

    def stay(self, steps: int) -> None:
        self._still()
        self._replay(steps)

    def follow(self, path: np.ndarray) -> None:
        steps, path = len(path) - 1, path - self.origin
        if steps == 0:
            self.state.particle_q.numpy()[self.held] = path[0]
            self._still()
            return
        # The explicit solver asks for forces at the beginning of a step, the implicit one at its end.
        shift = 1 if self.cloth.solver == "vbd" else 0
        grips = len(self.held)
        for first in range(0, steps, PATH):
            part = path[first : first + PATH + 1]
            done = len(part) - 1
            self.path.numpy()[:done, :grips] = part[shift : shift + done]
            self.speed.numpy()[:done, :grips] = np.diff(part, axis=0) / self.dt
            self.counter.numpy()[0], self.stride.numpy()[0] = 0, 1
            self._replay(done)
        self.state.particle_q.numpy()[self.held] = path[-1]

    def push(self, force: np.ndarray, mass: np.ndarray | None) -> None:
        self.pushed.numpy()[:] = force.T
        self.added, self.is_pushed = mass, True

    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        q, qd = self.state.particle_q.numpy(), self.state.particle_qd.numpy()
        return q.astype(np.float64) + self.origin, qd.astype(np.float64)

    # --- steps --------------------------------------------------------------------------------------------------

    def _still(self) -> None:
        """The held nodes stay where they are."""
        grips = len(self.held)
        self.path.numpy()[0, :grips] = self.state.particle_q.numpy()[self.held]
        self.speed.numpy()[0] = 0.0
        self.counter.numpy()[0] = self.stride.numpy()[0] = 0

    def _replay(self, steps: int) -> None:
        before = self.motion() if self.added is not None else None
        for size in GRAPHS:
            whole, steps = divmod(steps, size)
            for _ in range(whole):
                wp.capture_launch(self._graph(size))
        if before is not None and self.added is not None:
            self._bear(self.added, *before)
        if self.is_pushed:
            self.pushed.numpy()[:] = 0.0
            self.added, self.is_pushed = None, False

    def _bear(self, added: np.ndarray, position: np.ndarray, velocity: np.ndarray) -> None:
        """After one explicit step: the change of velocity that nodes with added masses would have seen."""
        q, qd = self.state.particle_q.numpy(), self.state.particle_qd.numpy()
        heavier = np.array(added.any(axis=0))
        heavier[self.held] = False
        gained = np.ascontiguousarray((self.mass[:, None] * (qd - velocity)).T)
        bear_inertia(gained, self.mass, added)
        speed = velocity + gained.T / self.mass[:, None]
        qd[heavier] = speed[heavier]
        q[heavier] = (position - self.origin + self.dt * speed)[heavier]

    def _graph(self, size: int) -> Any:
        if size not in self.graphs:
            if not self.graphs:
                self._warm_up()
            with wp.ScopedCapture(device="cpu") as capture:
                self._record(size)
            self.graphs[size] = capture.graph
        return self.graphs[size]

    def _warm_up(self) -> None:
        """One step that compiles the kernels, which a capture must not do; then all is as it was."""
        arrays = (self.state.particle_q, self.state.particle_qd, self.counter)
        before = [a.numpy().copy() for a in arrays]
        self._record(1)
        for array, old in zip(arrays, before, strict=True):
            array.numpy()[:] = old

    def _record(self, steps: int) -> None:
        for _ in range(steps):
            state = self.state
            wp.launch(
                lead, dim=len(self.mass), device="cpu",
                inputs=[self.hold, self.path, self.speed, self.counter, self.keep, self.pushed],
                outputs=[state.particle_q, state.particle_qd, state.particle_f],
            )  # fmt: skip
            wp.launch(count, dim=1, device="cpu", inputs=[self.counter, self.stride])
            self.solver.step(state, self.next, None, None, self.dt)
            self.state, self.next = self.next, self.state
        if steps % 2:
            wp.copy(self.next.particle_q, self.state.particle_q)
            wp.copy(self.next.particle_qd, self.state.particle_qd)
            self.state, self.next = self.next, self.state


def stiffest(sheet: Sheet, cloth: Cloth) -> tuple[float, float]:
    """Largest ω² [1/s²] and damping rate [1/s] of the flat sheet, by the power method on Newton's own forces."""
    model = _model(sheet, cloth, np.zeros(0, np.int64))
    model.set_gravity((0.0, 0.0, 0.0))
    solver = _solver(model, cloth)
    state: Any = model.state()
    after: Any = model.state()
    flat = state.particle_q.numpy().copy()
    found = []
    for moved, size in ((state.particle_q, PROBE), (state.particle_qd, 1e-2)):
        shape, value = np.random.default_rng(0).standard_normal(flat.shape), 0.0
        for _ in range(ITERATIONS):
            shape *= size / np.abs(shape).max()
            state.particle_q.numpy()[:], state.particle_qd.numpy()[:] = flat, 0.0
            moved.numpy()[:] += shape.astype(np.float32)
            before = state.particle_qd.numpy().copy()
            state.clear_forces()
            solver.step(state, after, None, None, PROBE_STEP)
            push = (before.astype(float) - after.particle_qd.numpy()) / PROBE_STEP
            value = float(np.linalg.norm(push) / np.linalg.norm(shape))
            if not value > 0:
                break
            shape = push
        found.append(value)
    return found[0], found[1]


def _model(sheet: Sheet, cloth: Cloth, held: np.ndarray) -> newton.Model:
    builder = newton.ModelBuilder()
    upright: Any = wp.quat_identity()
    tri_ke, tri_ka, tri_kd, edge_ke, edge_kd = cloth.material
    vertices = np.hstack([sheet.uv, np.zeros((len(sheet.uv), 1))])
    builder.add_cloth_mesh(
        pos=wp.vec3(), rot=upright, scale=1.0, vel=wp.vec3(),
        vertices=[wp.vec3(*v) for v in vertices.tolist()], indices=sheet.triangles.ravel().tolist(), density=0.0,
        tri_ke=tri_ke, tri_ka=tri_ka, tri_kd=tri_kd, tri_drag=0.0, tri_lift=0.0,
        edge_ke=edge_ke, edge_kd=edge_kd, particle_radius=0.0,
    )  # fmt: skip
    for i, mass in enumerate(sheet.mass.tolist()):
        builder.particle_mass[i] = mass
    for i in held.tolist():
        builder.particle_mass[i] = 0.0  # moves as it is told
    if cloth.solver == "vbd":
        builder.color(include_bending=True)
    model = builder.finalize(device="cpu")
    model.set_gravity(tuple(sheet.gravity.tolist()))
    return model


def _solver(model: newton.Model, cloth: Cloth) -> Any:
    if cloth.solver == "vbd":
        return newton.solvers.SolverVBD(model, iterations=cloth.iterations, particle_enable_tile_solve=False)
    return newton.solvers.SolverSemiImplicit(model, enable_tri_contact=False)
