"""`kirchhoff_love`: an isogeometric Kirchhoff–Love shell in static equilibrium, on cubic B-splines.

The fabric takes part through three ratios only (Petrík, Smutný, Hlaváč, Automatic Material Properties Estimation for
the Physics-Based Robotic Garment Folding, eq. 1), with ρ the areal density, h the thickness, E Young's modulus:
η_m = (1 − ν²) ρ/(hE), η_b = 12 (1 − ν²) ρ/(h³E) = ρ/D, and Poisson's ratio ν. Formulation: Kiendl, Bletzinger,
Linhard, Wüchner 2009. What is asked of it in a general scene is a sheet (`shell`); a strip that bends in one plane is
the same shell with one direction left out (`strip`), and much quicker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from clothbench import ClothbenchError, Effect, Material, Parameter, ParameterSpace, Rollout, Scene
from clothbench.modelling import check_resolution, for_each, grid_shape
from clothbench_models.folding import FoldingStrip
from clothbench_models.orthotropy import BEND_RATIO, OPTION, STRETCH_RATIO, check_orthotropic, refuse_ratios
from clothbench_models.shell import Shell, ShellState, turned_over
from clothbench_models.strip import FEW

PETRIK = "Petrík et al., Automatic Material Properties Estimation for the Physics-Based Robotic Garment Folding, eq. 1"

PARAMETERS = ParameterSpace(
    (
        Parameter("eta_b", "η_b", "m^-4 s^2", (1e2, 1e6), "log", 1e4, "weight over bending stiffness, ρ/D", PETRIK),
        Parameter("eta_m", "η_m", "m^-2 s^2", (1e-6, 1e-2), "log", 1e-5, "weight over membrane stiffness", PETRIK),
        Parameter("nu", "ν", "1", (0.0, 0.49), "linear", 0.3, "Poisson's ratio", PETRIK),
    )
)
ORTHOTROPIC = PARAMETERS.joined(ParameterSpace((BEND_RATIO, STRETCH_RATIO)))


class KirchhoffLove:
    """Thin shell at rest under gravity, held by points, on at most one smooth plane; the module has equations, sources.

    resolution: of the sheet's mesh, nodes (ends of elements) along (u, v) or one number for the longer side, where the
    scene does not say; elements: of a strip's mesh (`strip`), at least 64; orthotropic: two parameters more for sheets,
    what warp has over weft in bending and in stretch (a strip bends along one of them, and has none).
    """

    name = "kirchhoff_love"
    version = 2
    kind = "static"
    parameters = PARAMETERS
    capabilities: ClassVar[frozenset[str]] = frozenset({"static", "contact", "fold"})
    repeatability = 1e-6  # m: where Newton's method ends

    def __init__(self, resolution: int | Sequence[int] = 13, elements: int = 200, orthotropic: bool = False):
        check_resolution(self.name, resolution)
        if not isinstance(elements, int) or elements < FEW:
            raise ClothbenchError(f"kirchhoff_love: elements is {elements!r}, expected a whole number ≥ {FEW}")
        self.resolution, self.elements = resolution, elements
        self.orthotropic = check_orthotropic(self.name, orthotropic)
        if orthotropic:
            self.parameters = ORTHOTROPIC

    def skip(self, scene: Scene) -> str | None:
        """Why it cannot simulate a scene: what does not rest in it, or is not known to it."""
        if not len(scene.grip_material):
            return "finds rest only, and nothing holds this sheet"
        if len(np.unique(scene.grip_material, axis=0)) == 1:
            return "finds rest only, and a sheet held at one point turns freely about it"
        if scene.outline is not None:
            return "its sheet is a whole rectangle, and this scene's is cut"
        if len(scene.obstacles) > 1 or any(o.shape != "plane" for o in scene.obstacles):
            return "rests on one plane at most, and on no disc or sphere"
        if scene.obstacles and scene.obstacles[0].friction > 0:
            return (
                f"finds rest on smooth ground only, and this scene's has a friction of {scene.obstacles[0].friction:g}"
            )
        if scene.obstacles and turned_over(scene):
            return "lets a folded sheet roll open on smooth ground, which costs nothing; `strip` folds strips"
        if scene.thickness > 0:
            return "its layers pass through each other, and this scene gives them a thickness"
        return None

    def prepare(self, scene: Scene, effects: Sequence[Effect] = ()) -> RestingSheet:
        if effects:
            raise ClothbenchError(f"model 'kirchhoff_love' takes no effects, found {effects[0].name!r}; leave it out")
        if reason := self.skip(scene):
            raise ClothbenchError(f"model 'kirchhoff_love' {reason}")
        nu, nv = grid_shape(scene, self.resolution)
        return RestingSheet(scene, (nu - 1, nv - 1), self.parameters)

    def of_material(self, material: Material, scene: Scene) -> np.ndarray:
        """η_b, η_m, ν (3,) and the ratios of an orthotropic sheet, of a textbook material: no cross contraction (shear:
        half the tensile stiffness).
        """
        if material.bending <= 0:
            raise ClothbenchError("kirchhoff_love: bending is 0, and cloth without bending stiffness has no η_b = ρ/D")
        low, high = PARAMETERS["eta_m"].bounds
        eta_m = scene.areal_density / material.stretch
        if eta_m > high:
            raise ClothbenchError(
                f"kirchhoff_love: a stretch of {material.stretch:g} N/m is η_m = {eta_m:g} m^-2 s^2, expected at most "
                f"{high:g}, as from {scene.areal_density / high:g} N/m on; softer cloth is for another model"
            )
        eta_m = max(eta_m, low)  # what stretches less hangs in the same shape
        if not self.orthotropic:
            refuse_ratios(self.name, material, OPTION)
        ratios = [material.bending_ratio, material.stretch_ratio] if self.orthotropic else []
        return np.array([scene.areal_density / material.bending, eta_m, 0.0, *ratios])

    def material_of(self, theta: np.ndarray, scene: Scene) -> Material:
        """ρ/η_b and ρ/η_m, less what cross contraction takes of the tensile stiffness."""
        eta_b, eta_m, poisson = (float(value) for value in theta[:3])
        stretch = (1 - poisson**2) * scene.areal_density / eta_m
        shear, ratios = stretch / (2 * (1 + poisson)), theta[3:5] if self.orthotropic else (1.0, 1.0)
        return Material(scene.areal_density / eta_b, stretch, shear, 0.0, 0.0, *map(float, ratios))

    def strip(self, length: float) -> FoldingStrip:
        """For the capability "fold": a strip `length` m long that is lifted off a desk."""
        return FoldingStrip(length, self.elements)


@dataclass(frozen=True, eq=False)
class RestingSheet:
    """One scene on one mesh, ready for batches of parameter sets."""

    scene: Scene
    elements: tuple[int, int]
    parameters: ParameterSpace = PARAMETERS
    threads: ClassVar[bool] = True

    def run(self, theta: np.ndarray) -> Rollout:
        """Rest for theta (B, P), frame by frame: the sheet is always where it would stay if the grips stopped."""
        theta = self.parameters.check(theta)
        scene, members = self.scene, len(theta)
        position = np.full((members, scene.times.size, len(scene.points), 3), np.nan)
        steps, lost = np.zeros(members, np.int64), [""] * members

        def simulate(b: int) -> None:
            steps[b], lost[b] = self._follow(theta[b], position[b])

        for_each(simulate, range(members))
        status = tuple("diverged" if reason else "ok" for reason in lost)
        nodes = (self.elements[0] + 1) * (self.elements[1] + 1)
        return Rollout(scene.times, position, status, steps, nodes, tuple(lost))

    def _follow(self, theta: np.ndarray, position: np.ndarray) -> tuple[int, str]:
        """Fill position (T, N, 3); Newton iterations in all, and why it ended before the last frame."""
        bend_ratio, stretch_ratio = theta[3:5] if len(theta) > 3 else (1.0, 1.0)
        shell = Shell(self.scene, self.elements, theta[1], theta[2], bend_ratio, stretch_ratio)
        state: ShellState | None = None
        before = np.empty(0)
        for t, grips in enumerate(self.scene.grips_at(self.scene.times)):
            if state is None or not np.array_equal(grips, before):
                state = shell.equilibrium(theta[0], grips, state)
                if state is None:
                    return shell.iterations, f"no equilibrium found at {self.scene.times[t]:g} s"
            position[t], before = shell.positions(state, self.scene.points), grips
        return shell.iterations, ""
