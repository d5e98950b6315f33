"""`newton`: a Python script that builds the sheet as Newton's cloth and runs it, with Newton and NumPy alone.

Steps are the explicit ones of SolverSemiImplicit, which `clothbench units newton` finds to bend as asked: SolverVBD
with steps of milliseconds does not (`solver=vbd` there). The numbers are those of the model `newton` on this very mesh,
for what a hinge's stiffness is worth depends on the mesh.
"""

from __future__ import annotations

import dataclasses
import json

import numpy as np

from clothbench import ClothbenchError, Export, Twin, catalogue
from clothbench.modelling import grid_shape
from clothbench_exporters.mesh import NODES, grip_nodes, sheet_of_twin

suffix = ".py"
SETTLE = 2.0  # s
TEMPLATE = '''"""
@HEAD@

    python FILE.py [PATH.npz [OUT.npz]]

PATH.npz has time (K,) s and position (K, G, 3) m of the grips; without it the cloth hangs for a second. OUT.npz gets
time (T,) s and position (T, N, 3) m of the nodes, which lie at `REST` when flat.
"""

import argparse
import json

if __name__ == "__main__":  # before Warp is loaded, which takes seconds
    parser = argparse.ArgumentParser(description="Run the cloth in Newton, its grips led along a path.")
    parser.add_argument("path", nargs="?", metavar="PATH.npz", help="time (K,) s and position (K, G, 3) m of the grips "
                        "(default: they hold still for a second)")
    parser.add_argument("out", nargs="?", metavar="OUT.npz", help="where time (T,) s and position (T, N, 3) m go")
    asked = parser.parse_args()

import numpy as np
import warp as wp

wp.config.log_level = wp.LOG_WARNING
import newton

DATA = json.loads("""@DATA@""")
REST, START = np.array(DATA["rest"]), np.array(DATA["start"])  # m
TRIANGLES, MASS = np.array(DATA["triangles"]), np.array(DATA["mass"])  # kg
GRIPS = np.array(DATA["grips"], dtype=int)  # node held by each grip
STEP, SETTLE = DATA["step"], DATA["settle"]  # s


def build():
    """The model and its solver; held nodes have no mass and stay where they are put."""
    builder = newton.ModelBuilder()
    builder.add_cloth_mesh(
        pos=wp.vec3(), rot=wp.quat_identity(), scale=1.0, vel=wp.vec3(), vertices=[wp.vec3(*x) for x in REST],
        indices=TRIANGLES.ravel().tolist(), density=0.0, particle_radius=0.0, tri_drag=0.0, tri_lift=0.0,
        **DATA["material"],
    )
    for i, mass in enumerate(MASS):
        builder.particle_mass[i] = 0.0 if i in GRIPS else float(mass)
    model = builder.finalize(device="cpu")
    model.set_gravity(tuple(DATA["gravity"]))
    return model, newton.solvers.SolverSemiImplicit(model, enable_tri_contact=False)


def held(time, path, t):
    """Where the grips are at t s, (G, 3) m."""
    k = int(np.clip(np.searchsorted(time, t) - 1, 0, len(time) - 2))
    share = np.clip((t - time[k]) / (time[k + 1] - time[k]), 0.0, 1.0)
    return (1 - share) * path[k] + share * path[k + 1]


def run(time, path, times):
    """Lead the grips along path (K, G, 3) m, stamped time (K,) s, after settling in its first pose; positions of all
    nodes at `times` (T,) s as an array (T, N, 3) m."""
    model, solver = build()
    now, after = model.state(), model.state()
    origin = START.mean(axis=0)  # single precision: keep numbers small
    now.particle_q.numpy()[:] = START - origin
    out, t = [], float(time[0]) - SETTLE
    while len(out) < len(times):
        if t > times[len(out)] - STEP / 2:
            out.append(now.particle_q.numpy() + origin)
            continue
        if len(GRIPS):
            there, next = (held(time, path, at) - origin for at in (t, t + STEP))
            now.particle_q.numpy()[GRIPS], now.particle_qd.numpy()[GRIPS] = there, (next - there) / STEP
        now.clear_forces()
        solver.step(now, after, None, None, STEP)
        now, after = after, now
        if t < time[0]:
            now.particle_qd.numpy()[:] *= 1 - 8 * STEP  # comes to rest before the motion
        t += STEP
    return np.array(out)


def read(file):
    """The path of the grips in a file: time (K,) s and position (K, G, 3) m; what is none of that ends the script."""
    try:
        with np.load(file) as motion:
            time, path = (np.asarray(motion[name], dtype=float) for name in ("time", "position"))
    except Exception as fault:  # whatever a file may hold
        raise SystemExit(f"{file}: {type(fault).__name__}, expected an .npz with time (K,) s and position (K, G, 3) m")
    if time.ndim != 1 or len(time) < 2 or not (np.isfinite(time).all() and (np.diff(time) > 0).all()):
        raise SystemExit(f"{file}: time is {time.shape}, expected (K,) s, two stamps at least, each after the last")
    if path.shape != (len(time), len(GRIPS), 3) or not np.isfinite(path).all():
        raise SystemExit(f"{file}: position is {path.shape}, expected {(len(time), len(GRIPS), 3)} m, all of it known")
    return time, path


if __name__ == "__main__":
    if asked.path:
        time, path = read(asked.path)
    else:
        time, path = np.array([0.0, 1.0]), np.stack([START[GRIPS], START[GRIPS]])
    times = np.arange(time[0], time[-1] + 1e-9, 0.02)
    position = run(time, path, times)
    print(f"lowest node at the end: {position[-1, :, 2].min():.4f} m")
    if asked.out:
        np.savez(asked.out, time=times, position=position)
'''


def skip_reason() -> str | None:
    return catalogue().load("models", "newton").skip_reason()  # which knows the longest stable step


def export(twin: Twin) -> Export:
    """The script, and what an isotropic membrane has no parameter for; a sheet that is cut along an outline is a
    ClothbenchError, for the model `newton` knows the longest stable step of whole ones only.
    """
    if twin.scene.outline is not None:
        raise ClothbenchError(
            "newton: the script is made for whole rectangles, and this cloth is cut along an outline; export it --to "
            "mujoco or usd, which hold the cut"
        )
    material, lines = twin.isotropic("Newton")
    if material.stretch_damping > 0:
        lines.append(
            f"stretch damping: Newton's tri_kd brakes turns as well; {material.stretch_damping:.3g} N·s/m is left out"
        )
        material = dataclasses.replace(material, stretch_damping=0.0)
    lines += twin.unheld("Newton")
    twin = dataclasses.replace(twin, scene=dataclasses.replace(twin.scene, obstacles=(), thickness=0.0))
    sheet, start = sheet_of_twin(twin)
    model = catalogue().make("models", "newton", resolution=grid_shape(twin.scene, NODES))
    theta = model.of_material(material, twin.scene)
    step = model.prepare(twin.scene).engine(theta).dt
    flat = np.hstack([sheet.uv, np.zeros((len(sheet.uv), 1))])
    data = {
        "material": dict(zip(model.parameters.names, theta.tolist(), strict=True)), "rest": flat.tolist(),
        "start": start.tolist(), "triangles": sheet.triangles.tolist(), "mass": sheet.mass.tolist(),
        "grips": grip_nodes(twin, sheet).tolist(), "gravity": list(map(float, twin.scene.gravity)), "step": step,
        "settle": SETTLE,
    }  # fmt: skip
    head = "\n".join(line.replace("\\", "/").replace('"""', "'''") for line in (*twin.about(), *lines))
    return Export(TEMPLATE.replace("@HEAD@", head).replace("@DATA@", json.dumps(data)), tuple(lines), material)
