"""Newton: the sheet as a net of springs, stepped by SolverSemiImplicit on the CPU in single precision.

The usual six springs a node: mesh lines, both diagonals, every second node for bending. Not what Newton calls
cloth (see `newton_cloth`, which does the stepping and tells what makes it cheap), but the fastest sheet that
its solver steps, and the same net as `mass_spring`'s. The order of the springs did not matter.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from clothbench_models.peers import SheetRun, stable_stiffness
from clothbench_models.peers.newton_cloth import DAMPING_FRACTION, built_on, skip_reason, time_sheet

if TYPE_CHECKING:
    import newton

__all__ = ["built_on", "skip_reason", "step_sheet"]

# Neighbours a node is tied to (rows down, columns right).
SPRINGS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0))


def step_sheet(side: int, dt: float, steps: int, size: float = 0.30, areal_density: float = 0.2) -> SheetRun:
    """Time `steps` explicit steps of dt [s]; size in m, areal density in kg/m²."""
    return time_sheet("newton-springs", _add_net, side, dt, steps, size, areal_density)


def _add_net(builder: newton.ModelBuilder, side: int, cell: float, mass: float, dt: float) -> None:
    """Particles row by row, and the springs between them."""
    import warp as wp

    for node in range(side**2):
        row, column = divmod(node, side)
        builder.add_particle(wp.vec3(column * cell, 0.0, -row * cell), wp.vec3(), mass, radius=0.0)
    stiffness, damping = stable_stiffness(mass, dt), DAMPING_FRACTION * mass / dt
    for first, second in springs(side):
        builder.add_spring(first, second, stiffness, damping, control=0.0)


def springs(side: int) -> Iterator[tuple[int, int]]:
    """Pairs of nodes that a spring joins; nodes are counted row by row from the upper left corner."""
    for down, right in SPRINGS:
        for row in range(side - down):
            for column in range(max(0, -right), side - max(0, right)):
                yield row * side + column, (row + down) * side + column + right
