"""Newton: the sheet as particles and springs, stepped by SolverSemiImplicit on the CPU in single precision.

What makes a step cheap (measured, one thread, 441 nodes):

- Springs alone: the usual six a node (mesh lines, both diagonals, every second node for bending). Newton's
  cloth grid of triangles with bending edges is four times slower, triangles alone are twice as slow.
- Particle radius 0 and no triangle contact: no neighbour search (10 times).
- Many steps in one captured graph: no Python between the kernels (3 times).

Neither compiler settings (optimization level, no adjoints, fast math) nor the order of the springs mattered.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from clothbench_models.peers import SheetRun, missing, node_mass, stable_stiffness

if TYPE_CHECKING:
    import newton
    import numpy as np
    import warp as wp

GRAPH_STEPS = 50  # even, so that a graph ends in the state it began with
DAMPING_FRACTION = 0.01  # spring damping as a fraction of m/dt, far inside the stable range

# Neighbours a node is tied to (rows down, columns right).
SPRINGS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0))


def skip_reason() -> str | None:
    """Why this peer cannot run here; None when it can."""
    return missing("newton", "newton")


def step_sheet(side: int, dt: float, steps: int, size: float = 0.30, areal_density: float = 0.2) -> SheetRun:
    """Time `steps` explicit steps of dt [s]; size in m, areal density in kg/m²."""
    import warp as wp

    # Before warp starts, which importing newton may do: it would print a banner on standard output.
    wp.config.log_level = wp.LOG_WARNING
    import newton
    import numpy as np

    sheet = _Sheet(_build(side, dt, size, areal_density), dt)
    sheet.advance(2)  # compiles the kernels, which a capture must not do
    run = sheet.captured(steps)
    start = time.perf_counter()
    run()
    seconds = time.perf_counter() - start
    position, velocity = sheet.motion()
    finite = bool(np.isfinite(position).all() and np.isfinite(velocity).all())
    lowest = float(position[:, 2].min())
    return SheetRun("newton-semi-implicit", newton.__version__, side**2, steps, seconds, lowest, finite)


class _Sheet:
    """A model with its solver and the two states between which it steps."""

    def __init__(self, model: newton.Model, dt: float) -> None:
        import newton

        self.solver = newton.solvers.SolverSemiImplicit(model, enable_tri_contact=False)
        self.state, self.next = model.state(), model.state()
        self.dt = dt

    def advance(self, steps: int) -> None:
        """Launch the kernels of `steps` steps, or record them when called inside a capture."""
        for _ in range(steps):
            self.state.clear_forces()
            self.solver.step(self.state, self.next, None, None, self.dt)
            self.state, self.next = self.next, self.state

    def captured(self, steps: int) -> Callable[[], None]:
        """A call that replays exactly `steps` steps; one graph has been replayed to warm up."""
        import warp as wp

        whole, rest = divmod(steps, GRAPH_STEPS)
        block, tail = self._capture(GRAPH_STEPS), self._capture(rest)
        wp.capture_launch(block)

        def run() -> None:
            for _ in range(whole):
                wp.capture_launch(block)
            if rest:
                wp.capture_launch(tail)

        return run

    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions [m] and velocities [m/s] of the nodes, shape (N, 3) each."""
        position, velocity = self.state.particle_q, self.state.particle_qd
        assert position is not None
        assert velocity is not None
        return position.numpy(), velocity.numpy()

    def _capture(self, steps: int) -> wp.Graph:
        import warp as wp

        with wp.ScopedCapture(device="cpu") as capture:
            self.advance(steps)
        return capture.graph


def _build(side: int, dt: float, size: float, areal_density: float) -> newton.Model:
    """The sheet in the x–z plane, its upper corners fixed at height 0."""
    import newton
    import warp as wp

    builder = newton.ModelBuilder()
    cell, mass = size / (side - 1), node_mass(side, size, areal_density)
    held = (0, side - 1)
    for node in range(side**2):
        row, column = divmod(node, side)
        # A particle without mass does not move.
        builder.add_particle(
            wp.vec3(column * cell, 0.0, -row * cell), wp.vec3(), 0.0 if node in held else mass, radius=0.0
        )
    stiffness, damping = stable_stiffness(mass, dt), DAMPING_FRACTION * mass / dt
    for first, second in _springs(side):
        builder.add_spring(first, second, stiffness, damping, control=0.0)
    return builder.finalize(device="cpu")


def _springs(side: int) -> Iterator[tuple[int, int]]:
    """Pairs of nodes that a spring joins; nodes are counted row by row from the upper left corner."""
    for down, right in SPRINGS:
        for row in range(side - down):
            for column in range(max(0, -right), side - max(0, right)):
                yield row * side + column, (row + down) * side + column + right
