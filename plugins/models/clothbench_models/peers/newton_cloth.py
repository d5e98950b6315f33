"""Newton: the sheet as Newton's own cloth, stepped by SolverSemiImplicit on the CPU in single precision.

The cloth grid that `add_cloth_grid` makes: membrane triangles, and a bending element on every inner edge, as
costly as the triangles. `newton_springs` is a sheet without either, four times as fast.

What makes a step cheap (measured, one thread, 441 nodes):

- Particle radius 0 and no triangle contact: no neighbour search (10 times).
- Many steps in one captured graph: no Python between the kernels (3 times).

Neither compiler settings (optimization level, no adjoints, fast math) nor the order of the elements mattered.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from clothbench_models.peers import SheetRun, missing, node_mass, stable_stiffness

if TYPE_CHECKING:
    import newton
    import numpy as np
    import warp as wp

    Build = Callable[[newton.ModelBuilder, int, float, float, float], None]

built_on = ("newton",)

GRAPH_STEPS = 50  # even, so that a graph ends in the state it began with
DAMPING_FRACTION = 0.01  # damping along the sheet as a fraction of m/dt, far inside the stable range
BENDING_FRACTION = 0.02  # how much a cell resists bending, as a fraction of how much it resists stretching


def skip_reason() -> str | None:
    """Why this peer cannot run here; None when it can."""
    return missing("newton", "newton")


def step_sheet(side: int, dt: float, steps: int, size: float = 0.30, areal_density: float = 0.2) -> SheetRun:
    """Time `steps` explicit steps of dt [s]; size in m, areal density in kg/m²."""
    return time_sheet("newton-cloth", _add_cloth, side, dt, steps, size, areal_density)


def time_sheet(peer: str, add: Build, side: int, dt: float, steps: int, size: float, areal_density: float) -> SheetRun:
    """Time `steps` steps of the sheet that `add` builds from side, cell [m], node mass [kg] and dt [s]."""
    import warp as wp

    # Before warp starts, which importing newton may do: it would print a banner on standard output.
    wp.config.log_level = wp.LOG_WARNING
    import newton
    import numpy as np

    sheet = Sheet(add, side, dt, size, areal_density)
    sheet.advance(2)  # compiles the kernels, which a capture must not do
    run = sheet.captured(steps)
    start = time.perf_counter()
    run()
    seconds = time.perf_counter() - start
    position, velocity = sheet.motion()
    finite = bool(np.isfinite(position).all() and np.isfinite(velocity).all())
    lowest = float(position[:, 2].min())
    return SheetRun(peer, newton.__version__, side**2, steps, seconds, lowest, finite)


class Sheet:
    """A sheet in the x–z plane held at its upper corners, its solver, and the two states it steps between.

    Nodes are counted row by row from the upper left corner.
    """

    def __init__(self, add: Build, side: int, dt: float, size: float, areal_density: float) -> None:
        import newton

        builder = newton.ModelBuilder()
        add(builder, side, size / (side - 1), node_mass(side, size, areal_density), dt)
        for corner in (0, side - 1):
            builder.particle_mass[corner] = 0.0  # a particle without mass does not move
        model = builder.finalize(device="cpu")
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


def _add_cloth(builder: newton.ModelBuilder, side: int, cell: float, mass: float, dt: float) -> None:
    """Newton's cloth grid; equal membrane constants add up to Young's modulus (Poisson's ratio 0)."""
    import warp as wp

    stiffness = stable_stiffness(mass, dt)
    rows_go_down: Any = wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), -math.pi / 2)
    builder.add_cloth_grid(
        pos=wp.vec3(),
        rot=rows_go_down,
        vel=wp.vec3(),
        dim_x=side - 1,
        dim_y=side - 1,
        cell_x=cell,
        cell_y=cell,
        mass=mass,
        tri_ke=stiffness / 2,
        tri_ka=stiffness / 2,
        tri_kd=DAMPING_FRACTION * mass / dt,
        # Newton multiplies it by the angle and by the edge's length twice to get a force.
        edge_ke=BENDING_FRACTION * stiffness / cell,
        edge_kd=0.0,
        particle_radius=0.0,
    )
