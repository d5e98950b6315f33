"""Plant parameters and find them with the implicit models: truth from a mesh of twice the fineness and another scheme
or another model, with noise and gaps."""

import numpy as np
import pytest

from clothbench import Scene
from clothbench.core.observation import Observation
from clothbench.estimation.calibrate import Fit, calibrate
from clothbench.estimation.trials import Trial, evaluate
from clothbench.plugins.discovery import catalogue

NOISE = 1e-3  # m
BEND = 1e-3  # N·m
ELASTIC = {"bend": BEND, "bend_damping": 1e-6, "stretch_damping": 0.05, "shear_damping": 0.05}
CLOTH = ELASTIC | {"stretch": 150.0, "shear": 40.0, "quadratic_drag": 1.1, "linear_drag": 0.04, "drag_decline": 0.05}
STIFF = ELASTIC | {"stretch": 5000.0, "shear": 2000.0, "quadratic_drag": 0.0, "linear_drag": 0.0, "drag_decline": 0.0}


def swing(amplitude: float, frequency: float, grips: int) -> Scene:
    """Some points of the upper edge of a 0.3 m sheet moved to and fro along its normal for 1.2 s."""
    clock = np.linspace(0, 1.2, 121)
    y = amplitude * np.clip(clock / 0.3, 0, 1) ** 2 * np.sin(2 * np.pi * frequency * clock)
    held = np.stack([np.linspace(0, 0.3, grips), np.zeros(grips)], axis=1)
    path = np.stack([held[:, 0] + 0 * y[:, None], 0 * held[:, 0] + y[:, None], np.zeros((121, grips))], axis=-1)
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 0.3, 7), np.linspace(0, 0.3, 7)))
    return Scene(0.3, 0.3, 0.2, clock, held, path, np.arange(0, 1.2, 1 / 25), np.stack([u, v], axis=1))


SCENES = {"corners": swing(0.06, 1.0, 2), "edge": swing(0.05, 1.2, 5)}


def observe(scene: Scene, truth: dict[str, float], random: np.random.Generator) -> Observation:
    """`baraff_witkin` by Runge–Kutta steps on 17 × 17 nodes, with noise and 2 % of the nodes unseen."""
    plugins = catalogue()
    effects = [plugins.make("effects", "linear_drag")] if "linear_drag.coefficient" in truth else []
    simulation = plugins.make("models", "baraff_witkin", resolution=17, integrator="rk45").prepare(scene, effects)
    position = simulation.run([[truth[n] for n in simulation.parameters.names]]).position[0]
    visible = random.random(position.shape[:2]) > 0.02
    noisy = np.where(visible[..., None], position + random.normal(0, NOISE, position.shape), np.nan)
    return Observation(scene.times, noisy, visible, NOISE, scene.points)


def refit(name: str, truth: dict[str, float], budget: int) -> tuple[list[Trial], Fit]:
    """The model's parameters, on 9 × 9 nodes and by default steps, from what was seen."""
    random, plugins = np.random.default_rng(11), catalogue()
    model, metric = plugins.make("models", name, resolution=9), plugins.make("metrics", "node_error")
    trials = [Trial(n, observe(s, truth, random), model.prepare(s), metric) for n, s in SCENES.items()]
    space = trials[0].simulation.parameters
    return trials, calibrate(trials, plugins.make("optimizers", "least_squares", space, seed=3, budget=budget), space)


def errors(trials: list[Trial], fit: Fit) -> tuple[float, float, float]:
    """With the default parameters and with those found, and what noise alone makes [mm]."""
    values, _ = evaluate(trials, np.stack([fit.space.defaults, fit.best]))
    return *values.value, trials[0].metric.floor(trials[0].observation)


def test_baraff_witkin_finds_bending_and_drag():
    trials, fit = refit("baraff_witkin", CLOTH, budget=110)
    found = dict(zip(fit.space.names, fit.best, strict=True))
    assert found["bend"] == pytest.approx(CLOTH["bend"], rel=0.2)  # a coarse mesh's free border bends too easily
    assert found["quadratic_drag"] == pytest.approx(CLOTH["quadratic_drag"], rel=0.1)
    assert found["stretch"] == pytest.approx(CLOTH["stretch"], rel=0.3)
    assert found["shear"] == pytest.approx(CLOTH["shear"], rel=0.3)
    drag = fit.space.names.index("quadratic_drag")
    assert fit.low[drag] < CLOTH["quadratic_drag"] < fit.high[drag]
    start, best, floor = errors(trials, fit)
    assert best < 1.15 * floor < 0.3 * start


def test_inextensible_finds_bending_and_damping_in_a_stiff_sheet_of_triangles():
    """Whose drag is linear in the velocity, as α is."""
    trials, fit = refit("inextensible", STIFF | {"linear_drag.coefficient": 0.8}, budget=60)
    found = dict(zip(fit.space.names, fit.best, strict=True))
    assert found["theta"] == pytest.approx(BEND, rel=0.2)
    assert found["alpha"] == pytest.approx(0.8, rel=0.05)
    assert found["beta"] < 1e-5  # the truth is 1e-6: too little to be seen
    alpha = fit.space.names.index("alpha")
    assert fit.low[alpha] < 0.8 < fit.high[alpha]
    start, best, floor = errors(trials, fit)
    assert best < 1.15 * floor < 0.3 * start
