"""`mujoco`: MuJoCo's two-dimensional flex as a cloth model, with membrane and bending (`elastic2d="both"`).

Saint Venant–Kirchhoff triangles and the quadratic bending of Bergou et al. 2006, both from one isotropic elastic
shell: what it holds against stretching is E h/(1 − ν²), against bending E h³/(12 (1 − ν²)). The parameters are the
attributes of MuJoCo's element `flex/elasticity` (XML reference of MuJoCo 4.0), in its units.

Two integrators. `Euler` is explicit: symplectic, its step limited by the stiffest mode, which is measured on
MuJoCo's own forces. `discrete` is the one with which MuJoCo 4 takes flex elasticity implicitly (`implicit` and
`implicitfast` refuse it): steps of milliseconds, which it pays for with numerical damping of the swing.

Held nodes have an inertia of 1e200 kg: no force moves them, and they go where their velocity takes them, which
both integrators and the damping see as they should.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from clothbench import ClothbenchError, Effect, Material, Parameter, ParameterSpace, Scene, Stated, check_choice
from clothbench.modelling import BoundEffects, bear_inertia, check_number, check_resolution, grid_shape
from clothbench_models.orthotropy import refuse_ratios
from clothbench_models.peers import missing
from clothbench_models.peers.external import ExternalSimulation, reason_to_skip, refuse_mass

if TYPE_CHECKING:
    import mujoco

SOURCE = "MuJoCo 4.0 XML reference, flexcomp/elasticity"
INTEGRATORS = ("Euler", "discrete")
IMPLICIT_STEP = 1e-3  # s; longer ones cost the swing more energy than air does
SAFETY = 0.8  # share of the largest stable step that is used
IMMOVABLE = 1e200  # kg
PROBE = 1e-7  # m, how far nodes are moved to measure a stiffness
ITERATIONS = 60  # of the power method: within a few per cent, which SAFETY covers

# What the sheet does not need and what would hide a blow-up.
UNUSED = ("contact", "midphase", "limit", "frictionloss", "actuation", "sensor", "eulerdamp", "autoreset", "island")
UNUSED_EXPLICIT = ("constraint", "equality", "warmstart")

XML = """
<mujoco>
  <option timestep="{dt!r}" integrator="{integrator}" solver="Newton" gravity="{gravity}"><flag {flags}/></option>
  <worldbody>
    <flexcomp name="sheet" type="direct" dim="2" mass="1" radius="1e-3" point="{points}" element="{triangles}">
      <elasticity young="{young!r}" poisson="{poisson!r}" thickness="{thickness!r}" damping="{damping!r}"
                  elastic2d="both"/>
      <contact contype="0" conaffinity="0" selfcollide="none"/>
    </flexcomp>
  </worldbody>
</mujoco>
"""

PARAMETERS = ParameterSpace(
    (
        Parameter("young", "E", "Pa", (1e4, 2e6), "log", 1e5, "Young's modulus of the shell", SOURCE),
        Parameter("poisson", "ν", "1", (0.0, 0.49), "linear", 0.3, "Poisson's ratio of the shell", SOURCE),
        Parameter("thickness", "h", "m", (2e-4, 2e-3), "log", 1e-3, "thickness of the shell", SOURCE),
        Parameter("damping", "β", "s", (1e-6, 1e-3), "log", 1e-4, "Rayleigh damping: damping over stiffness", SOURCE),
    )
)

PAGE = "MuJoCo 4.0, https://mujoco.readthedocs.io/en/stable/XMLreference.html#flexcomp-elasticity"
DOCUMENTED = (
    Stated("bending", "young [Pa] · thickness³ [m³] / 12(1 − poisson²)",
           lambda p: float(p[0] * p[2] ** 3 / 12 / (1 - p[1] ** 2)), PAGE),
    Stated("stretch", "young [Pa] · thickness [m]", lambda p: float(p[0] * p[2]), PAGE),
    Stated("shear", "young [Pa] · thickness [m] / 2(1 + poisson)", lambda p: float(p[0] * p[2] / 2 / (1 + p[1])),
           PAGE),
    Stated("stretch_damping", "damping [s] times stretch", lambda p: float(p[3] * p[0] * p[2]), PAGE),
    Stated("bending_damping", "damping [s] times bending",
           lambda p: float(p[3] * p[0] * p[2] ** 3 / 12 / (1 - p[1] ** 2)), PAGE),
)  # fmt: skip


class Mujoco:
    """MuJoCo's flex sheet; see the module for its physics.

    integrator: "Euler" or "discrete"; resolution: nodes along (u, v) or one number for the longer side, where the
    scene does not say; dt: time step [s], or None for the largest stable one times 0.8 ("Euler") or 1 ms
    ("discrete"); step_scale: multiplies that step.
    """

    name = "mujoco"
    version = 3
    parameters = PARAMETERS
    capabilities = frozenset({"dynamic", "static", "effects", "moving_start"})
    documented = DOCUMENTED
    built_on = ("mujoco", "mujoco-core")
    bench_options: tuple[dict[str, str], ...] = ()  # `clothbench bench` measures the peer of the same name

    def __init__(
        self, integrator: str = "Euler", resolution: int | Sequence[int] = 13, dt: float | None = None,
        step_scale: float = 1.0,
    ):  # fmt: skip
        check_choice("mujoco", "integrator", integrator, INTEGRATORS)
        check_resolution("mujoco", resolution)
        check_number("mujoco", "dt", dt, 0.0)
        check_number("mujoco", "step_scale", step_scale, 0.0, 1.2, optional=False)
        self.integrator, self.resolution, self.dt, self.step_scale = integrator, resolution, dt, step_scale
        self.kind = "explicit" if integrator == "Euler" else "implicit"

    @staticmethod
    def skip_reason() -> str | None:
        """What to install; None when MuJoCo is there."""
        return missing("mujoco", "mujoco")

    def skip(self, scene: Scene) -> str | None:
        return reason_to_skip("mujoco", scene)

    def of_material(self, material: Material, scene: Scene) -> np.ndarray:
        """E h and E h³/12 are the material's stretch and bending; ν = 0, with which shear is half the stretch.

        One β damps all: the smaller of what the material states for bending and for stretch, so that neither is
        held back more than it should be; where one of them is not held back at all, the least that a search takes.
        """
        refuse_ratios("mujoco", material)
        if material.bending == 0:
            raise ClothbenchError(
                "mujoco: a shell bends as its thickness says, it has no parameter for a bending of 0; state a bending"
            )
        thickness = math.sqrt(12 * material.bending / material.stretch)
        if not math.isclose(material.shear, material.stretch / 2, rel_tol=1e-3):
            raise ClothbenchError(
                "mujoco: an isotropic shell without cross contraction has shear = stretch/2, it has no parameter for "
                f"{material.shear:g} N/m beside {material.stretch:g} N/m"
            )
        lates = [material.bending_damping / material.bending, material.stretch_damping / material.stretch]
        late = max(min(lates), self.parameters["damping"].bounds[0])
        return np.array([material.stretch / thickness, 0.0, thickness, late])

    def material_of(self, theta: np.ndarray, scene: Scene) -> Material:
        """E h free to narrow, E h³/12(1 − ν²), E h/2(1 + ν), and β times each as damping."""
        young, poisson, thickness, late = (float(value) for value in theta[:4])
        stretch, bending = young * thickness, young * thickness**3 / 12 / (1 - poisson**2)
        return Material(bending, stretch, stretch / (2 * (1 + poisson)), late * bending, late * stretch)

    def prepare(self, scene: Scene, effects: Sequence[Effect] = ()) -> MujocoSimulation:
        if reason := self.skip(scene):
            raise ClothbenchError(reason)
        joined = BoundEffects(self.parameters, tuple(effects))
        if self.integrator != "Euler":
            refuse_mass(joined, f"mujoco with integrator={self.integrator}")
        shape = grid_shape(scene, self.resolution)
        return MujocoSimulation(scene, shape, joined, self.integrator, self.dt, self.step_scale)


@dataclass(frozen=True, eq=False)
class MujocoSimulation(ExternalSimulation):
    """One scene ready for MuJoCo."""

    integrator: str
    dt: float | None
    step_scale: float

    @contextmanager
    def library(self) -> Iterator[None]:
        """Drop MuJoCo's warnings, which it would write to a file: a blow-up is told by its status."""
        import mujoco

        before = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(lambda message: None)
        try:
            yield
        finally:
            mujoco.set_mju_user_warning(before)

    def engine(self, theta: np.ndarray) -> _Flex:
        model = self._compiled(theta)
        if self.dt is not None:
            dt = self.dt * self.step_scale
        elif self.integrator == "Euler":
            dt = self.step_scale * self._stable_step(model, theta)
        else:
            dt = IMPLICIT_STEP * self.step_scale
        return _Flex(model, self.rest, self.sheet.held, dt)

    @cached_property
    def rest(self) -> np.ndarray:
        """The flat sheet (n, 3) m, in which MuJoCo's mesh is defined."""
        return np.hstack([self.sheet.uv, np.zeros((self.nodes, 1))])

    def _compiled(self, theta: np.ndarray) -> mujoco.MjModel:
        """MuJoCo's model of the sheet, each node with the mass that it stands for."""
        import mujoco

        unused = UNUSED + (UNUSED_EXPLICIT if self.integrator == "Euler" else ())
        young, poisson, thickness, damping = theta[:4].tolist()
        model = mujoco.MjModel.from_xml_string(
            XML.format(
                dt=IMPLICIT_STEP, integrator=self.integrator, gravity=_words(np.array(self.scene.gravity)),
                flags=" ".join(f'{name}="disable"' for name in unused),
                points=_words(self.rest), triangles=_words(self.sheet.triangles),
                young=young, poisson=poisson, thickness=thickness, damping=damping,
            )
        )  # fmt: skip
        if not np.isfinite(model.flex_stiffness).all():
            raise ClothbenchError(
                f"mujoco: gives triangles as small as {self.sheet.face_area.min():.1e} m² a stiffness that is not a "
                "number; use a coarser mesh"
            )
        model.body_mass[1:] = self.sheet.mass
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model

    def _stable_step(self, model: mujoco.MjModel, theta: np.ndarray) -> float:
        """A stable step [s] of symplectic Euler with a lagging damping force β K v."""
        light = self.effects.lightest(theta[None])[0]
        omega = math.sqrt((self._stiffest(model) + self.stiffest_effect(theta[None])[0]) / light)
        half = theta[3] * omega / 2
        held = self.restrained_step(theta[None], np.array([omega**2]), np.array([2 * half * omega]))[0]
        return min(SAFETY * (2 / omega) * (math.sqrt(1 + half**2) - half), held)

    def _stiffest(self, model: mujoco.MjModel) -> float:
        """The largest ω² [1/s²] of the flat sheet, by the power method on MuJoCo's elastic forces."""
        import mujoco

        data = mujoco.MjData(model)
        mass = np.repeat(self.sheet.mass, 3)
        shape = np.random.default_rng(0).standard_normal(model.nv)
        size = 1.0
        for _ in range(ITERATIONS):
            data.qpos[:] = PROBE * shape / np.abs(shape).max()
            before = np.linalg.norm(data.qpos)
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            shape = -data.qfrc_passive / mass
            size = float(np.linalg.norm(shape) / before)
        return size


class _Flex:
    """One MuJoCo sheet, with its nodes as bodies that slide along x, y and z from where they lie at rest."""

    def __init__(self, model: mujoco.MjModel, rest: np.ndarray, held: np.ndarray, dt: float):
        import mujoco

        self.model, self.rest, self.held, self.dt = model, rest, held, dt
        self.mass = model.body_mass[1:].copy()
        model.opt.timestep = dt
        model.dof_armature.reshape(-1, 3)[held] = IMMOVABLE
        self.data = mujoco.MjData(model)
        mujoco.mj_setConst(model, self.data)
        model.stat.meaninertia = float(self.mass.mean())  # the scale of a tolerance
        # Views of MuJoCo's memory, (n, 3); what is held is written through them at every step.
        self.offset, self.velocity = self.data.qpos.reshape(-1, 3), self.data.qvel.reshape(-1, 3)
        self.applied = self.data.qfrc_applied.reshape(-1, 3)
        self.pushed: tuple[np.ndarray, np.ndarray | None] | None = None

    def place(self, position: np.ndarray, velocity: np.ndarray) -> None:
        self.offset[:] = position - self.rest
        self.velocity[:] = velocity
        self.data.qacc_warmstart[:] = 0.0

    def damp(self, rate: float) -> None:
        self.model.dof_damping[:] = rate * np.repeat(self.mass, 3)

    def stay(self, steps: int) -> None:
        import mujoco

        mujoco.mj_step(self.model, self.data, steps)

    def follow(self, path: np.ndarray) -> None:
        import mujoco

        offset = path - self.rest[self.held]
        speed = np.diff(offset, axis=0) / self.dt
        for k in range(len(speed)):
            self.offset[self.held], self.velocity[self.held] = offset[k], speed[k]
            if self.pushed is None:
                mujoco.mj_step(self.model, self.data)
            else:
                self._step_pushed(*self.pushed)
        self.offset[self.held] = offset[-1]

    def push(self, force: np.ndarray, mass: np.ndarray | None) -> None:
        self.pushed = (force, mass)

    def _step_pushed(self, force: np.ndarray, mass: np.ndarray | None) -> None:
        """One step with nodal forces; added masses make of the total force what the bare nodes are to feel.

        MuJoCo's total is known between the two halves of its step: exact for the explicit integrator.
        """
        import mujoco

        data, self.pushed = self.data, None
        mujoco.mj_step1(self.model, data)
        self.applied[:] = force.T
        if mass is not None:
            own = (data.qfrc_passive - data.qfrc_bias).reshape(-1, 3).T
            total = np.ascontiguousarray(own + force)
            bear_inertia(total, self.mass, mass)
            self.applied[:] = (total - own).T
        mujoco.mj_step2(self.model, data)
        self.applied[:] = 0.0

    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        return self.offset + self.rest, self.velocity


def _words(numbers: np.ndarray) -> str:
    return " ".join(map(repr, numbers.ravel().tolist()))
