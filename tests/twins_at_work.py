"""Twins driven in the simulators that they were written for: along recorded grips, to the recorded points and times."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np

from clothbench import Interpolator, Observation, Recording, Scene

SETTLE = 2.0  # s


def grids(rest: np.ndarray, points: np.ndarray) -> Interpolator:
    """From nodes at rest (n, 2) m on a grid to material points (N, 2) m."""
    u, v = (np.unique(np.round(rest[:, k], 9)) for k in range(2))
    return Interpolator.on_lines(points, u, v)


def in_mujoco(file: Path, scene: Scene, settle: float = SETTLE) -> np.ndarray:
    """Load the file as it is, settle, lead the mocap bodies; positions (T, N, 3) m at the scene's times and points."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    rest = model.body_pos[model.flex_vertbodyid[: model.flex_vertnum[0]]][:, :2]
    look = grids(rest, scene.points)
    step, seen = model.opt.timestep, []
    t = scene.start_time - settle
    while len(seen) < len(scene.times):
        if t >= scene.times[len(seen)] - step / 2:
            seen.append(look(data.flexvert_xpos.copy()))
            continue
        data.mocap_pos[: len(scene.grip_material)] = scene.grips_at(np.array([t + step]))[0]
        if t < scene.start_time:
            data.qvel[:] *= 1 - 8 * step
        mujoco.mj_step(model, data)
        t += step
    return np.array(seen)


def in_newton(file: Path, scene: Scene) -> np.ndarray:
    """Run the script's own loop; positions (T, N, 3) m at the scene's times and points."""
    spec = importlib.util.spec_from_file_location("exported_cloth", file)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    clock = np.arange(scene.start_time, scene.times[-1] + 0.01, 0.005)
    nodes = script.run(clock, scene.grips_at(clock), scene.times)
    return grids(script.REST[:, :2], scene.points)(nodes)


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """Mean distance of points [m]."""
    return float(np.nanmean(np.linalg.norm(one - other, axis=-1)))


def off(position: np.ndarray, recording: Recording) -> float:
    """Mean distance [m] of points (T, N, 3) m from where a recording has them in its first T frames; of one that a
    single camera saw across the lines of sight, as along them nothing was measured.
    """
    time, seen = recording.time[: len(position)], recording.position[: len(position)]
    visible = np.isfinite(seen).all(axis=-1)
    watched = Observation(time, seen, visible, recording.noise_sigma, recording.material, sight=recording.sight)
    return float(np.linalg.norm(watched.differences(position)[visible], axis=-1).mean())
