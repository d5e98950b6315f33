"""`mujoco`: MJCF that MuJoCo loads as it is, with the sheet as a two-dimensional flex.

Every node is a body that slides along x, y and z, with the mass of the cloth that it stands for; grips are mocap
bodies, to be moved through `data.mocap_pos`, to which held nodes are connected (a flex takes no mocap body itself).
The numbers of the elastic shell are those of the model `mujoco`, which `clothbench units mujoco` holds against
mechanics. Keyframe 0 is the shape from which the sheet settles. Obstacles are geoms that do not move, or those of the
mocap body "carried"; the sheet touches these and whatever else is added, but not itself.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from clothbench import Export, Obstacle, Twin, catalogue
from clothbench_exporters.mesh import clamped_nodes, grip_nodes, margin, sheet_of_twin

suffix = ".xml"
STEP = 1e-3  # s; longer ones cost a swing more energy than air does
YIELDS = 4 * STEP  # s, how late a contact is: MuJoCo wants at least two steps
DEEP = 1.0  # m, half the height of the cylinder that stands for a disc without end
FILE = """<!--
{head}
Grips are the mocap bodies grip_0 …: set data.mocap_pos. Begin with mj_resetDataKeyframe(model, data, 0).{told}
-->
<mujoco model="cloth">
  <option timestep="{step}" integrator="discrete" solver="Newton" gravity="{gravity}">
    <flag eulerdamp="disable"/>
  </option>
  <worldbody>
{bodies}
  </worldbody>
  <deformable>
    <flex name="cloth" dim="2" radius="5e-4" body="{names}" element="{triangles}">
      <elasticity young="{young!r}" poisson="{poisson!r}" thickness="{thickness!r}" damping="{damping!r}"
                  elastic2d="both"/>
      <contact selfcollide="none" friction="0 0 0" solref="{yields!r} 1"/>
    </flex>
  </deformable>
  <equality>
{connections}
  </equality>
  <keyframe>
    <key name="start" qpos="{qpos}" mpos="{mpos}"/>
  </keyframe>
</mujoco>
"""
FREE = """    <body name="node_{i}" pos="{at}">
      <inertial pos="0 0 0" mass="{mass!r}" diaginertia="{inertia}"/>{slides}
    </body>"""
CONNECTED = (
    """    <connect body1="{name}" body2="node_{i}" anchor="0 0 0" solref="{late} 1" solimp="0.99 0.999 1e-3"/>"""
)
HELD = """    <body name="{name}" pos="{at}" mocap="true"/>"""
CARRIED = """    <body name="carried" mocap="true">
{geoms}
    </body>"""
CARRIED_TOLD = """
The last mocap body, carried, moves as the mean of the grips does: set it to how far that has gone."""
GEOM = """    <geom {shape} friction="{friction!r} 0 0" priority="1" solref="{yields!r} 1"/>"""
SLIDES = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))


def skip_reason() -> str | None:
    return None


def export(twin: Twin) -> Export:
    """The file, and what an isotropic shell has no parameter for."""
    material, lines = twin.isotropic("MuJoCo")
    sheet, start = sheet_of_twin(twin)
    theta = catalogue().make("models", "mujoco").of_material(material, twin.scene)
    dampings = material.bending_damping / material.bending, material.stretch_damping / material.stretch
    late = min(dampings) and float(theta[3])  # the model's own is never 0
    lines += _damping(dampings, late) + twin.unheld("MuJoCo", ("obstacles", "outline")) + margin(twin)
    rest = np.hstack([sheet.uv, np.zeros((len(sheet.uv), 1))])
    held = {f"grip_{g}": node for g, node in enumerate(grip_nodes(twin, sheet).tolist())}
    held |= {f"clamp_{k}": node for k, node in enumerate(clamped_nodes(twin, sheet).tolist())}
    standing, carried = ([_geom(o) for o in twin.scene.obstacles if o.carried == moves] for moves in (False, True))
    bodies = standing + [HELD.format(name=name, at=_words(rest[node])) for name, node in held.items()]
    bodies += [CARRIED.format(geoms="\n".join(carried))] if carried else []
    bodies += [
        FREE.format(i=i, at=_words(rest[i]), mass=float(sheet.mass[i]), inertia=_words(np.full(3, _inertia(sheet, i))),
                    slides=SLIDES)
        for i in range(len(rest))
    ]  # fmt: skip
    ties = [CONNECTED.format(name=name, i=node, late=2 * STEP) for name, node in held.items()]
    places = [*start[list(held.values())], *([np.zeros(3)] if carried else [])]
    text = FILE.format(
        head="\n".join(line.replace("--", "—") for line in (*twin.about(), *lines)), step=STEP,
        gravity=_words(np.array(twin.scene.gravity)), bodies="\n".join(bodies), connections="\n".join(ties),
        names=" ".join(f"node_{i}" for i in range(len(rest))),
        triangles=_words(sheet.triangles), young=float(theta[0]), poisson=float(theta[1]), thickness=float(theta[2]),
        damping=late, qpos=_words(start - rest), mpos=_words(np.array(places)),
        yields=YIELDS, told=CARRIED_TOLD if carried else "",
    )  # fmt: skip
    damped = {"bending_damping": late * material.bending, "stretch_damping": late * material.stretch}
    return Export(text, tuple(lines), dataclasses.replace(material, **damped))


def _geom(obstacle: Obstacle) -> str:
    """An obstacle, with its friction for whatever touches it."""
    centre, normal = np.array(obstacle.centre), np.array(obstacle.normal)
    shape = {
        "plane": f'type="plane" size="0 0 1" pos="{_words(centre)}" zaxis="{_words(normal)}"',
        "disc": f'type="cylinder" size="{obstacle.radius!r} {DEEP!r}" pos="{_words(centre - DEEP * normal)}" '
        f'zaxis="{_words(normal)}"',
        "sphere": f'type="sphere" size="{obstacle.radius!r}" pos="{_words(centre)}"',
    }[obstacle.shape]
    return GEOM.format(shape=shape, friction=float(obstacle.friction), yields=YIELDS)


def _damping(dampings: tuple[float, float], late: float) -> list[str]:
    """A line on what one damping [s] for all makes of the material's two."""
    return [
        f"{name} damping: MuJoCo has one β for all: {late:.3g} s stands for {own:.3g} s (factor {late / own:.3g})"
        for name, own in zip(("bending", "stretch"), dampings, strict=True)
        if own > 0 and abs(late / own - 1) > 0.02
    ]


def _inertia(sheet, i: int) -> float:
    """Of a node's body, which never turns: MuJoCo wants one above 0."""
    return float(sheet.mass[i]) * 1e-6


def _words(numbers: np.ndarray) -> str:
    return " ".join(map(repr, np.asarray(numbers).ravel().tolist()))
