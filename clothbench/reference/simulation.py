"""Reference simulation of a sheet of cloth held at material points; it makes the stand-in recordings.

Orthotropic St. Venant–Kirchhoff membrane on constant-strain triangles, discrete-shell hinges calibrated to a
bending rigidity, Kelvin–Voigt damping of both, mass-proportional damping, air drag, lumped mass, velocity Verlet, or
where the membrane's damping is too stiff for it, leapfrog with that damping implicit. Spheres that the grips carry keep
nodes out by a penalty and rub them; there is no other contact. World frame, z up, SI units. It uses none of
clothbench's models.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from itertools import pairwise

import numpy as np

from clothbench.core.scene import arc
from clothbench.reference.kernels import Sheet, advance, advance_damped, bending_energy, membrane_energy, total_force
from clothbench.reference.mesh import Mesh, hinges, lumped_mass, slopes

AIR_DENSITY = 1.2  # kg/m³, 20 °C
NO_SPHERES = np.zeros((0, 5))

# The grips' places at given times: (K,) s -> (K, G, 3) m.
GripPath = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Fabric:
    """The truth of a stand-in fabric, SI units."""

    name: str
    areal_density: float  # kg/m²
    warp_stiffness: float  # c11, N/m
    weft_stiffness: float  # c22, N/m
    coupling: float  # c12, N/m
    shear_stiffness: float  # G, N/m
    bending_rigidity: float  # D of a cylinder in any direction, or of one bent along u, N m
    stretch_damping: float = 0.0  # β of c11, c22, c12, s
    shear_damping: float = 0.0  # β of G, s
    bending_damping: float = 0.0  # β of D, s
    mass_damping: float = 0.0  # 1/s
    normal_drag: float = 0.0  # C_N
    tangential_drag: float = 0.0  # C_T, both faces together
    linear_drag: float = 0.0  # k_T, tangential, kg/(m² s)
    drag_decline: float = 0.0  # k_f, s²/m²
    weft_bending: float = 1.0  # D of a cylinder bent along v over that of one bent along u, below 9
    rest_curvature: float = 0.0  # 1/m, along u, of the sheet without load; towards (u × v) above 0


@dataclass
class State:
    """Positions [m] and velocities [m/s], both (N, 3)."""

    position: np.ndarray
    velocity: np.ndarray

    def copy(self) -> State:
        return State(self.position.copy(), self.velocity.copy())


def discretise(fabric: Fabric, mesh: Mesh, gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)) -> Sheet:
    """The fabric on the mesh, as the kernels want it."""
    hinge, shape = hinges(mesh)
    rigidity, rest = bending_by_direction(fabric, mesh, hinge)
    membrane = (fabric.warp_stiffness, fabric.weft_stiffness, fabric.coupling, fabric.shear_stiffness)
    damping = (fabric.stretch_damping, fabric.shear_damping, fabric.bending_damping, fabric.mass_damping)
    quadratic = 0.5 * AIR_DENSITY * np.array([fabric.normal_drag, fabric.tangential_drag])
    return Sheet(
        triangle=np.ascontiguousarray(mesh.triangle),
        slope=np.ascontiguousarray(slopes(mesh)),
        area=mesh.area,
        hinge=hinge,
        hinge_stiffness=rigidity * shape,
        hinge_rest=rest,
        mass=lumped_mass(mesh, fabric.areal_density),
        stiffness=np.array(membrane),
        damping=np.array(damping),
        drag=np.array([*quadratic, fabric.linear_drag, fabric.drag_decline]),
        gravity=np.array(gravity),
        wind=np.zeros(3),
    )


def bending_by_direction(fabric: Fabric, mesh: Mesh, hinge: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bending rigidity [N m] and rest angle [rad] of each hinge (H,).

    A hinge whose normal lies at φ to u turns by θ = h (κ_nn − κ_tt/3) (see `mesh.hinges`). On the lattice, normals at
    ±30° and 90°, hinges of a D at 90° and b D at ±30° make D_v = a D and D_u = (a + 8 b)/9 D; between these directions
    the rigidity goes as a second harmonic.
    """
    edge = mesh.material[hinge[:, 1]] - mesh.material[hinge[:, 0]]
    length = np.linalg.norm(edge, axis=1)
    along = np.square(edge[:, 1] / length)  # cos² φ: the normal is the edge turned by 90°
    at_90, at_30 = fabric.weft_bending, (9.0 - fabric.weft_bending) / 8.0
    share = at_90 + (at_30 - at_90) * along / 0.75
    sides = _sides(mesh.material[hinge])
    # Turned over where the first of its two triangles is the right one.
    height = -np.sign(sides[:, 0]) * np.abs(sides).mean(axis=1) / length
    return fabric.bending_rigidity * share, fabric.rest_curvature * height * (along - (1.0 - along) / 3.0)


def clamped(sheet: Sheet, held: np.ndarray) -> Sheet:
    """The sheet whose nodes `held` are clamped: an edge between two of them has a half only that can bend, which turns
    by half as much at the same curvature, at half the cost.
    """
    still = np.isin(sheet.hinge[:, :2], held).all(axis=1)
    stiffer, less = np.where(still, 2.0, 1.0), np.where(still, 0.5, 1.0)
    return sheet._replace(hinge_stiffness=stiffer * sheet.hinge_stiffness, hinge_rest=less * sheet.hinge_rest)


def _sides(corner: np.ndarray) -> np.ndarray:
    """Twice the signed areas (H, 2) m² of the two triangles of hinges (H, 4, 2): edge start, end, opposite nodes."""
    edge = corner[:, 1] - corner[:, 0]
    opposite = corner[:, 2:] - corner[:, :1]
    return edge[:, :1] * opposite[..., 1] - edge[:, 1:] * opposite[..., 0]


def fastest_waves(fabric: Fabric, mesh: Mesh) -> np.ndarray:
    """ω [1/s] of the fastest membrane and bending waves that the lowest triangle (height h) can carry, (2,).

    (2/h) √(c/ρ) and (2/h)² √(D/ρ).
    """
    corner = mesh.material[mesh.triangle]
    longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    wave = 2.0 / (2.0 * mesh.area / longest).min()
    stiffest = max(fabric.warp_stiffness, fabric.weft_stiffness, fabric.shear_stiffness) + fabric.coupling
    rigidity = max(1.0, fabric.weft_bending) * fabric.bending_rigidity
    return wave * np.sqrt(np.array([stiffest, rigidity * wave**2]) / fabric.areal_density)


def stable_step(fabric: Fabric, mesh: Mesh, safety: float = 0.8) -> float:
    """Time step [s] of explicit steps: the limit of a central difference is 2/ω; damping with the ratio ζ = βω/2
    shortens it to (√(1+ζ²) − ζ) 2/ω.
    """
    fastest = fastest_waves(fabric, mesh)
    stiffest = max(fabric.warp_stiffness, fabric.weft_stiffness, fabric.shear_stiffness) + fabric.coupling
    sheared = fabric.shear_damping * fabric.shear_stiffness / stiffest
    ratio = 0.5 * fastest * [fabric.stretch_damping + sheared, fabric.bending_damping]
    return safety * float((2.0 / fastest * (np.sqrt(1.0 + ratio**2) - ratio)).min())


def implicit_step(fabric: Fabric, mesh: Mesh) -> float:
    """Time step [s] where the membrane's damping is implicit: that of the same fabric without it."""
    return stable_step(replace(fabric, stretch_damping=0.0, shear_damping=0.0), mesh, 0.6)


def calmed(fabric: Fabric, mesh: Mesh) -> Fabric:
    """The fabric with no more inner damping than explicit steps bear: it rests in the same shape, and sooner."""
    most = 1.0 / fastest_waves(fabric, mesh)
    return replace(
        fabric, stretch_damping=min(fabric.stretch_damping, most[0]), shear_damping=min(fabric.shear_damping, most[0]),
        bending_damping=min(fabric.bending_damping, most[1]),
    )  # fmt: skip


def simulate(
    sheet: Sheet, state: State, held: np.ndarray, grips: GripPath, times: np.ndarray, step: float,
    implicit: bool = False, spheres: np.ndarray = NO_SPHERES,
) -> tuple[np.ndarray, State]:  # fmt: skip
    """Positions at `times` (T, N, 3) [m] and the last state; no step is longer than `step` [s].

    implicit: the membrane's damping, for steps of `implicit_step`; spheres: as `contact_force` takes them.
    """
    now, march = state.copy(), advance_damped if implicit else advance
    force = np.empty_like(now.position)
    total_force(sheet, now.position, now.velocity, force)
    frames = [now.position.copy()]
    for start, end in pairwise(times):
        count = int(np.ceil((end - start) / step - 1e-9))
        path = np.ascontiguousarray(grips(np.linspace(start, end, count + 1)))
        march(sheet, now.position, now.velocity, force, held, path, (end - start) / count, spheres)
        if not np.isfinite(now.position).all():
            raise FloatingPointError(f"diverged before t = {end:g} s; take a shorter step than {step:g} s")
        frames.append(now.position.copy())
    return np.stack(frames), now


def settle(
    sheet: Sheet, start: np.ndarray, held: np.ndarray, grips: GripPath, step: float, at_rest: float = 2e-4,
    spheres: np.ndarray = NO_SPHERES,
) -> np.ndarray:  # fmt: skip
    """Shape (N, 3) [m] of the sheet hung up at `start` once no node is faster than `at_rest` [m/s].

    Strongly damped (α = 8/s, near critical for a 0.3 m sheet's first swing); grips may move in the first 1 s.
    """
    damped = sheet._replace(damping=np.array([*sheet.damping[:3], 8.0]))
    state, clock, chunk = State(start.copy(), np.zeros_like(start)), 0.0, 0.25
    while clock < 20.0:
        _, state = simulate(damped, state, held, grips, np.array([clock, clock + chunk]), step, spheres=spheres)
        clock += chunk
        if clock >= 1.0 and np.linalg.norm(state.velocity, axis=1).max() < at_rest:
            return state.position
    raise RuntimeError(f"the sheet has not come to rest within {clock:g} s")


def total_energy(sheet: Sheet, state: State) -> float:
    """Kinetic, membrane, bending and weight energy together [J]."""
    kinetic = 0.5 * (sheet.mass[:, None] * state.velocity**2).sum()
    weight = -(sheet.mass[:, None] * sheet.gravity * state.position).sum()
    return kinetic + weight + membrane_energy(sheet, state.position) + bending_energy(sheet, state.position)


def undamped(fabric: Fabric) -> Fabric:
    """The same fabric in vacuum and without any loss."""
    losses = [field.name for field in fields(fabric) if field.name.endswith(("damping", "drag", "decline"))]
    return Fabric(**{**asdict(fabric), **dict.fromkeys(losses, 0.0)})


def bowed(mesh: Mesh, width: float, separation: float) -> np.ndarray:
    """The flat sheet bent into an upright arc, its sides `separation` [m] apart: no strain, one clear branch.

    Corners at (∓separation/2, 0, 0), the arc bulging towards +y, v downwards; positions (N, 3) [m].
    """
    along, across = arc(mesh.material[:, 0], width, separation)
    return np.column_stack([along, across, -mesh.material[:, 1]])
