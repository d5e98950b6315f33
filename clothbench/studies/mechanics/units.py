"""What a model's parameters are worth, measured by mechanics: bending by a cantilever, stretch by a hanging strip,
shear by a strip that hangs in its own plane between two held sides, weight over mass by a free fall, viscosities by how
a free strip stops to swing; on two meshes, at two densities.

A unit that its documentation states wrongly shows as a factor, and as one that changes with mesh or density. How cloth
moves and rests tells stiffness over mass only: twice the mass that is stated shows as half of all three stiffnesses.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clothbench import ClothbenchError, Material, Parameter, ParameterSpace, Scene, Stated
from clothbench.core.optional import DocumentsUnits, KnowsMaterials, SaysMaterials, why_skipped
from clothbench.reference import mechanics as references
from clothbench.studies.mechanics import measures, scenes

MESHES, DENSITIES = (9, 17), (0.1, 0.3)  # nodes along the strip; kg/m²
LOAD = 10.0  # Γ of the cantilever
HANGING, SLIDING, FALLING = 0.3, 0.2, 0.3  # m, length of a hanging strip and width of a sliding one; s of fall
STRAIN = 0.005  # of the hanging strip at its upper edge, and of the sliding one at its sides
LIMP = 1e-4  # N·m, of strips that are stretched: so stiff that they stay flat
RINGING, SWINGS, LOOKS, RATIO = 0.1, 2, 48, 0.1  # m, length of a strip that rings; periods; frames; damping ratio
FREE_BEAM, SLOPE = 4.730041, 0.01  # first root of cos x · cosh x = 1; of a bent strip, small enough to be linear


@dataclass(frozen=True)
class Measured:
    """One quantity of one parameter set: asked, what the translation was asked for; documented, what documentation
    makes of the parameters; found, by mechanics (None where it could not be measured, with the reason); in `unit`.
    """

    quantity: str
    unit: str
    formula: str
    source: str
    along: int
    density: float
    asked: float
    documented: float | None
    found: float | None
    reason: str = ""


@dataclass(frozen=True, eq=False)
class Probe:
    """A scene, the cloth in it, and how a quantity is read off the sheet at its end."""

    quantity: str
    unit: str
    scene: Scene
    material: Material
    found: Callable[[np.ndarray], float]

    @property
    def moves(self) -> bool:
        """Whether it is seen in how the sheet moves, and not in how it rests."""
        return len(self.scene.times) > 2 or self.quantity == "fall"

    @property
    def asked(self) -> float:
        return 1.0 if self.quantity == "fall" else float(getattr(self.material, self.quantity))


def bending(along: int, density: float) -> Probe:
    """A cantilever whose Γ is 10: the moments of its weight over its curvatures, wherever a model's clamp begins."""
    rigidity = 1e-4 * density / scenes.DENSITY
    length = scenes.tip_length(1e-4, LOAD)
    scene = dataclasses.replace(scenes.clamped(length, along, LOAD), areal_density=density)

    def found(x: np.ndarray) -> float:
        return measures.rigidity(scene, x)

    return Probe("bending", "N·m", scene, Material(rigidity, 1000.0, 500.0), found)


def stretch(along: int, density: float) -> Probe:
    """A strip that hangs from its upper edge gets longer by ρgL²/2K."""
    weight = density * references.G
    stiffness = weight * HANGING / STRAIN
    across = scenes.nodes_across(along)
    held = np.stack([np.linspace(0, HANGING / 4, across), np.zeros(across)], axis=1)
    points = scenes._nodes(HANGING / 4, HANGING, across, along)
    scene = _still(HANGING / 4, HANGING, (across, along), held, points, density)

    def found(x: np.ndarray) -> float:
        end = np.isclose(points[:, 1], HANGING)
        return weight * HANGING**2 / 2 / (-x[-1, end, 2].mean() - HANGING)

    return Probe("stretch", "N/m", scene, Material(LIMP, stiffness, stiffness / 2), found)


def shear(along: int, density: float) -> Probe:
    """A sheet held along its two upright sides, four times as high as wide, sags by ρgW²/8G half-way up."""
    weight = density * references.G
    modulus = weight * SLIDING / 2 / STRAIN
    across, height = scenes.nodes_across(along), 4 * SLIDING
    sides = scenes._nodes(SLIDING, height, 2, along)
    points = scenes._nodes(SLIDING, height, across, along)
    scene = _still(SLIDING, height, (across, along), sides, points, density)

    def found(x: np.ndarray) -> float:
        middle = np.isclose(points[:, 0], SLIDING / 2) & np.isclose(points[:, 1], height / 2)
        return weight * SLIDING**2 / 8 / float((-x[-1, middle, 2] - points[middle, 1]).mean())

    return Probe("shear", "N/m", scene, Material(LIMP, 2 * modulus, modulus), found)


def fall(along: int, density: float) -> Probe:
    """What falls freely falls by gt²/2 whatever its mass: the ratio of the two, with viscosity on."""
    scene = dataclasses.replace(scenes.level(0.2, along, np.array([0.0, FALLING])), areal_density=density)
    cloth = Material(1e-5, 300.0, 150.0, 1e-7, 0.03)
    return Probe("fall", "1", scene, cloth, lambda x: measures.drop(scene, x) / references.fall(FALLING))


def stretch_damping(along: int, density: float) -> Probe:
    """A free strip that was pulled goes on as cos(ku), k = π/L: K k² = ρω²."""
    k, stiffness = math.pi / RINGING, 5.0 * density
    omega = k * math.sqrt(stiffness / density)
    cloth = Material(1e-2 * density, stiffness, stiffness / 2, 0.0, 2 * RATIO / omega * stiffness)
    mode = np.outer(np.cos(k * _ringing_points(along)[:, 0]), [STRAIN / k, 0.0, 0.0])
    scene = _let_go(along, density, mode, omega)
    return Probe("stretch_damping", "N·s/m", scene, cloth, lambda x: stiffness * _lag(scene, mode, x))


def bending_damping(along: int, density: float) -> Probe:
    """A free strip that was bent goes on as the first mode of a free beam, kL = 4.73: D k⁴ = ρω²."""
    k, rigidity = FREE_BEAM / RINGING, 1e-3 * density
    omega = k**2 * math.sqrt(rigidity / density)
    cloth = Material(rigidity, 100.0 * density, 50.0 * density, 2 * RATIO / omega * rigidity, 0.0)
    u = k * _ringing_points(along)[:, 0]
    part = (math.cosh(FREE_BEAM) - math.cos(FREE_BEAM)) / (math.sinh(FREE_BEAM) - math.sin(FREE_BEAM))
    mode = np.outer(np.cosh(u) + np.cos(u) - part * (np.sinh(u) + np.sin(u)), [0.0, 0.0, SLOPE / k])
    scene = _let_go(along, density, mode, omega)
    return Probe("bending_damping", "N·m·s", scene, cloth, lambda x: rigidity * _lag(scene, mode, x))


PROBES = (bending, stretch, shear, fall, stretch_damping, bending_damping)


def _let_go(along: int, density: float, mode: np.ndarray, omega: float) -> Scene:
    """A strip without weight that nothing holds, let go at rest in the shape of a mode (N, 3) m of ω [rad/s]."""
    points, times = _ringing_points(along), np.linspace(0.0, 2 * math.pi * SWINGS / omega, LOOKS + 1)
    return Scene(
        width=RINGING, height=RINGING / 4, areal_density=density, grip_time=np.array([0.0, 1.0]),
        grip_material=np.zeros((0, 2)), grip_position=np.zeros((2, 0, 3)), times=times, points=points,
        gravity=(0.0, 0.0, 0.0), resolution=(along, scenes.nodes_across(along)), start=_flat(points) + mode,
        velocity=np.zeros_like(mode),
    )  # fmt: skip


def _lag(scene: Scene, mode: np.ndarray, x: np.ndarray) -> float:
    """Viscosity over stiffness [s], 2δ/(ω² + δ²) of a mode that goes on as q = e^(−δt) cos(ωt + φ): of three frames τ
    apart q₊ = 2e^(−δτ) cos(ωτ) q − e^(−2δτ) q₋. Whether the mesh is too stiff or too soft does not come into it.
    """
    q, tau = ((x - _flat(scene.points)) * mode).sum(axis=(1, 2)), scene.times[1]
    (turned, lost), *_ = np.linalg.lstsq(np.stack([q[1:-1], -q[:-2]], axis=1), q[2:])
    delta, omega = -math.log(lost) / 2 / tau, math.acos(turned / 2 / math.sqrt(lost)) / tau
    return 2 * delta / (omega**2 + delta**2)


def _flat(points: np.ndarray) -> np.ndarray:
    return np.pad(points, ((0, 0), (0, 1)))


def _ringing_points(along: int) -> np.ndarray:
    return scenes._nodes(RINGING, RINGING / 4, along, scenes.nodes_across(along))


def _still(width: float, height: float, shape, held: np.ndarray, points: np.ndarray, density: float) -> Scene:
    """A sheet that hangs flat in the plane y = 0, to be looked at when it is at rest."""
    at = np.stack([held[:, 0], 0 * held[:, 0], -held[:, 1]], axis=1)
    start = np.stack([points[:, 0], 0 * points[:, 0], -points[:, 1]], axis=1)
    return Scene(
        width=width, height=height, areal_density=density, grip_time=np.array([0.0, 0.1]), grip_material=held,
        grip_position=np.stack([at, at]), times=np.array([0.0, 0.1]), points=points, resolution=shape, start=start,
    )  # fmt: skip


def measured(
    make: Callable[[], Any], meshes: Sequence[int] = MESHES, densities: Sequence[float] = DENSITIES
) -> list[Measured]:
    """Every quantity of a model that says how it is told a material, mesh by mesh, density by density."""
    model = make()
    if not isinstance(model, KnowsMaterials):
        raise ClothbenchError(
            f"model {model.name!r} does not say which of its parameters make a material (of_material)"
        )
    return [
        _measured(make(), probe(along, density), along, density)
        for probe in PROBES
        for along in meshes
        for density in densities
    ]


def _measured(model: Any, probe: Probe, along: int, density: float) -> Measured:
    blank = Measured(probe.quantity, probe.unit, "", "", along, density, probe.asked, None, None)
    if reason := why_skipped(model, probe.scene):
        return dataclasses.replace(blank, reason=reason)
    if probe.moves and "dynamic" not in model.capabilities:
        return dataclasses.replace(blank, reason="the model finds rest only")
    try:
        theta = _told(model, probe)
    except ClothbenchError as fault:
        return dataclasses.replace(blank, reason=str(fault))
    stated = _stated(model, probe, theta)
    blank = dataclasses.replace(blank, formula=stated.formula, source=stated.source, documented=stated.worth(theta))
    rollout = model.prepare(probe.scene).run(theta[None])
    if rollout.status[0] != "ok":
        return dataclasses.replace(blank, reason=rollout.reasons[0] if rollout.reasons else rollout.status[0])
    try:
        return dataclasses.replace(blank, found=probe.found(rollout.position[0]))
    except (ClothbenchError, ValueError) as fault:
        return dataclasses.replace(blank, reason=str(fault).splitlines()[0])


def _told(model: Any, probe: Probe) -> np.ndarray:
    """The model's parameters (P,) for a probe's cloth, without bending where it knows none and none is asked for."""
    cloth, scene = probe.material, probe.scene
    try:
        theta = model.of_material(cloth, scene)
    except ClothbenchError:
        if probe.quantity.startswith("bending"):
            raise
        cloth = dataclasses.replace(cloth, bending=0.0, bending_damping=0.0)
        theta = model.of_material(cloth, scene)
    if not probe.quantity.endswith("_damping") or not np.array_equal(
        theta, model.of_material(_dry(probe, cloth), scene)
    ):
        return np.asarray(theta)
    late = max(cloth.stretch_damping / cloth.stretch, cloth.bending_damping / cloth.bending if cloth.bending else 0.0)
    cloth = dataclasses.replace(cloth, bending_damping=late * cloth.bending, stretch_damping=late * cloth.stretch)
    theta = model.of_material(cloth, scene)  # of a model that has one damping for both
    if np.array_equal(theta, model.of_material(_dry(probe, cloth), scene)):
        raise ClothbenchError("the model has no parameter for it")
    return np.asarray(theta)


def _dry(probe: Probe, cloth: Material) -> Material:
    """The cloth without the viscosity that is looked for."""
    return dataclasses.replace(cloth, **{probe.quantity: 0.0})


def _stated(model: Any, probe: Probe, theta: np.ndarray) -> Stated:
    """What documentation says of a quantity; where there is none, what the model itself says."""
    if probe.quantity == "fall":
        return Stated("fall", "g t²/2, whatever the mass", lambda theta: 1.0, "")
    for stated in model.documented if isinstance(model, DocumentsUnits) else ():
        if stated.quantity == probe.quantity:
            return stated
    if not isinstance(model, SaysMaterials):
        return Stated(probe.quantity, "not said", lambda theta: math.nan, "")

    def worth(values: np.ndarray) -> float:
        return float(getattr(model.material_of(values, probe.scene), probe.quantity))

    moved: list[Parameter] = []
    space: ParameterSpace = model.parameters  # type: ignore[attr-defined]  # every model has them
    for k, p in enumerate(space):
        other = theta.copy()
        other[k] = 1.01 * theta[k] or 1e-9
        if worth(other) != worth(theta):
            moved.append(p)
    formula = ", ".join(f"{p.name} [{p.unit}]" for p in moved) or "none"
    return Stated(probe.quantity, formula, worth, "; ".join(dict.fromkeys(p.source for p in moved)))
