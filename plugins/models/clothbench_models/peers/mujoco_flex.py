"""MuJoCo: the sheet as a two-dimensional flex, stepped by its explicit Euler integrator.

What makes a step cheap (measured, one thread, 441 nodes):

- `elastic2d="stretch"`: a triangle membrane is MuJoCo's fastest sheet, 1.5 times faster than the same mesh
  as a net of edge springs (a one-dimensional flex). It has no bending, which speaks for the peer.
- Damping on each node's own degrees of freedom, taken explicitly (`eulerdamp` off), costs nothing; damping
  along the edges or of the elements takes 40 % of the speed.
- Every stage that the sheet does not need is off (a tenth), and `mj_step` loops in C.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from clothbench_models.peers import SheetRun, missing, node_mass, stable_stiffness

if TYPE_CHECKING:
    import mujoco

built_on = ("mujoco", "mujoco-core")

WARM_UP_STEPS = 100
DAMPING_RATE = 2.0  # mass-proportional [1/s]: lets the sheet come to rest within seconds
THICKNESS = 1e-3  # [m]; only its product with Young's modulus enters a membrane

UNUSED = (
    *("constraint", "equality", "frictionloss", "limit", "contact", "midphase", "island", "warmstart"),
    *("actuation", "clampctrl", "sensor", "refsafe", "eulerdamp"),
    "autoreset",  # it would hide a blow-up by starting afresh
)

SHEET = """
<mujoco>
  <option timestep="{dt}" integrator="Euler"><flag {flags}/></option>
  <worldbody>
    <flexcomp name="sheet" type="grid" dim="2" count="{side} {side} 1" spacing="{cell} {cell} {cell}"
              pos="0 0 {middle}" euler="90 0 0" mass="{mass}" radius="1e-3">
      <elasticity young="{young}" poisson="0.3" thickness="{thickness}" elastic2d="stretch"/>
      <contact contype="0" conaffinity="0" selfcollide="none"/>
      <pin id="{left} {right}"/>
    </flexcomp>
  </worldbody>
</mujoco>
"""


def skip_reason() -> str | None:
    """Why this peer cannot run here; None when it can."""
    return missing("mujoco", "mujoco")


def step_sheet(side: int, dt: float, steps: int, size: float = 0.30, areal_density: float = 0.2) -> SheetRun:
    """Time `steps` explicit steps of dt [s]; size in m, areal density in kg/m²."""
    import mujoco
    import numpy as np

    model = _build(side, dt, size, areal_density)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, WARM_UP_STEPS)
    start = time.perf_counter()
    mujoco.mj_step(model, data, steps)
    seconds = time.perf_counter() - start
    finite = bool(np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all())
    lowest = float(data.flexvert_xpos[:, 2].min())
    return SheetRun("mujoco-flex", mujoco.__version__, side**2, steps, seconds, lowest, finite)


def _build(side: int, dt: float, size: float, areal_density: float) -> mujoco.MjModel:
    """The compiled sheet in the x–z plane, its upper corners fixed at height 0."""
    import mujoco

    mass = node_mass(side, size, areal_density)
    xml = SHEET.format(
        dt=dt,
        flags=" ".join(f'{name}="disable"' for name in UNUSED),
        side=side,
        cell=size / (side - 1),
        middle=-size / 2,
        mass=mass * side**2,
        # A membrane of this modulus pulls on a node as springs of that stiffness along the mesh lines do.
        young=stable_stiffness(mass, dt) / THICKNESS,
        thickness=THICKNESS,
        left=side - 1,
        right=side**2 - 1,
    )
    with _without_false_alarm():
        model = mujoco.MjModel.from_xml_string(xml)
    model.dof_damping[:] = DAMPING_RATE * mass
    return model


@contextmanager
def _without_false_alarm() -> Iterator[None]:
    """Drop the compiler's warning that an undamped flex has no forces: it overlooks the membrane's.

    MuJoCo would print it and write it to a file in the working directory. Any other warning becomes Python's.
    """
    import mujoco

    def handle(message: str) -> None:
        if "no equality constraints or passive forces" not in message:
            warnings.warn(message, RuntimeWarning, stacklevel=2)

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(handle)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
