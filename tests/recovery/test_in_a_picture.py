"""Parameters planted on a finer mesh come back from points in one camera's picture, to which all depth is lost."""

from __future__ import annotations

import dataclasses

import make_hold as hold
import numpy as np

from clothbench import FirstView, Observation, Scene
from clothbench.estimation.calibrate import calibrate
from clothbench.estimation.trials import Trial
from clothbench.plugins.discovery import catalogue

PLANTED = np.array([90.0, 0.8, 0.08])  # k1, k2 [N/m], ζ
NOISE = 3e-4  # m
MESH = (20, 10)
TIMES = np.arange(30) / 15.0  # s


def twin(planted: np.ndarray = PLANTED, motion: hold.Motion = hold.MOVES[1]) -> tuple[Scene, Observation]:
    """A robot's two grips and a mass-spring sheet on a mesh of twice the fineness and half the step, seen by
    the webcam with noise; the nodes are brought to the plane of the first frame, as trackers do.
    """
    camera, clock = hold.camera(), np.arange(220) / 100.0
    size = np.array([hold.WIDTH, hold.HEIGHT])
    u, v = (np.linspace(0.0, length, n) for length, n in zip(size, MESH, strict=True))
    points = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    scene = Scene(
        hold.WIDTH, hold.HEIGHT, 0.13, clock, np.array([[0.0, 0.0], [hold.WIDTH, 0.0]]), hold.hands(motion, clock),
        TIMES, points, resolution=(2 * MESH[0] - 1, 2 * MESH[1] - 1), camera=camera,
    )  # fmt: skip
    truth = catalogue().make("models", "mass_spring", step_scale=0.5).prepare(scene, [])
    position = truth.run(planted[None]).position[0]
    assert np.isfinite(position).all()
    random = np.random.default_rng(6)
    position += random.normal(0.0, NOISE, position.shape)
    flat = FirstView(camera, np.array([-hold.WIDTH / 2, 0.0, 0.0]), np.array([1.0, 0, 0]), np.array([0.0, 0, -1.0]))
    position = flat.lifted(camera.project(position)[0])
    visible = random.random(position.shape[:2]) > 0.1
    seen = np.where(visible[..., None], position, np.nan)
    return dataclasses.replace(scene, resolution=MESH), Observation(TIMES, seen, visible, NOISE, points, sight=camera)


def test_stretch_comes_back_from_a_picture():
    """k2 does not: flexion springs of twice the length resist otherwise. Nor does ζ, which this motion hardly asks."""
    scene, seen = twin()
    simulation = catalogue().make("models", "mass_spring").prepare(scene, [])
    trial = Trial("twin", seen, simulation, catalogue().make("metrics", "node_error", unit="cm"))
    space = simulation.parameters.bounded({"k1": (5.0, 400.0)})
    fit = calibrate([trial], catalogue().make("optimizers", "cma_es", space, seed=1, budget=240), space)
    assert fit.value.min() < 0.35  # cm
    assert 0.7 < fit.best[0] / PLANTED[0] < 1.3
    assert (fit.low < PLANTED).all()
    assert (fit.high > PLANTED)[0]
