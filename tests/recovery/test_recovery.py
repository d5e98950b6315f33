"""Plant parameters, find them: truth from a finer mesh or from the reference simulation, with noise."""

import dataclasses

import numpy as np
import pytest

from clothbench import PointCloud, Scene, scene_of
from clothbench.core.observation import Observation
from clothbench.core.parameters import Parameter, ParameterSpace
from clothbench.core.protocols import Evaluation
from clothbench.engine.suite import plan, suites_folder
from clothbench.estimation.calibrate import calibrate
from clothbench.estimation.trials import Trial, evaluate
from clothbench.plugins.discovery import catalogue
from clothbench.studies.calibration.cell import set_up

TRUTH = {"k1": 80.0, "k2": 2.0, "zeta": 0.1, "quadratic_drag.normal": 1.3, "quadratic_drag.tangential": 0.05}
NOISE = 1e-3  # m


def swing(amplitude: float, frequency: float) -> Scene:
    """Two corners of a 0.3 m sheet moved to and fro along its normal for 1.5 s."""
    clock = np.linspace(0, 1.5, 151)
    ramp = np.clip(clock / 0.4, 0, 1) ** 2
    y = amplitude * ramp * np.sin(2 * np.pi * frequency * clock)
    held = np.array([[0.0, 0.0], [0.3, 0.0]])
    path = np.stack([held[:, 0] + 0 * clock[:, None], np.repeat(y[:, None], 2, 1), np.zeros((151, 2))], axis=-1)
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 0.3, 7), np.linspace(0, 0.3, 7)))
    return Scene(0.3, 0.3, 0.2, clock, held, path, np.arange(0, 1.5, 1 / 30), np.stack([u, v], axis=1))


def observe(scene: Scene, random: np.random.Generator) -> Observation:
    """The scene simulated on a mesh of twice the fineness and half the step, with noise and 2 % of the nodes unseen."""
    plugins = catalogue()
    truth = plugins.make("models", "mass_spring", resolution=17, step_scale=0.5)
    simulation = truth.prepare(scene, [plugins.make("effects", "quadratic_drag")])
    position = simulation.run([[TRUTH[n] for n in simulation.parameters.names]]).position[0]
    visible = random.random(position.shape[:2]) > 0.02
    noisy = np.where(visible[..., None], position + random.normal(0, NOISE, position.shape), np.nan)
    return Observation(scene.times, noisy, visible, NOISE, scene.points)


def trials(random: np.random.Generator) -> list[Trial]:
    plugins = catalogue()
    model, metric = plugins.make("models", "mass_spring", resolution=9), plugins.make("metrics", "node_error")
    drag = [plugins.make("effects", "quadratic_drag")]
    scenes = {"slow": swing(0.06, 0.8), "quick": swing(0.03, 1.6)}
    return [Trial(n, observe(s, random), model.prepare(s, drag), metric) for n, s in scenes.items()]


@pytest.fixture(scope="module")
def fitted():
    random = np.random.default_rng(11)
    both = trials(random)
    space = both[0].simulation.parameters
    optimizer = catalogue().make("optimizers", "least_squares", space, seed=3, budget=150)
    return both, calibrate(both, optimizer, space)


def test_what_the_motion_shows_is_recovered(fitted):
    _, fit = fitted
    found = dict(zip(fit.space.names, fit.best, strict=True))
    assert found["quadratic_drag.normal"] == pytest.approx(TRUTH["quadratic_drag.normal"], rel=0.1)
    assert found["k1"] == pytest.approx(TRUTH["k1"], rel=0.35)  # the coarser mesh folds a little more stiffly
    assert not fit.at_bound[fit.space.names.index("quadratic_drag.normal")]


def test_the_error_comes_down_to_the_noise(fitted):
    both, fit = fitted
    start, _ = evaluate(both, fit.space.defaults[None])
    best, _ = evaluate(both, fit.best[None])
    floor = both[0].metric.floor(both[0].observation)
    assert best.value[0] < 1.6 * floor < start.value[0]


def test_the_drag_s_interval_holds_a_value_near_the_truth_and_is_no_mere_point(fitted):
    _, fit = fitted
    i = fit.space.names.index("quadratic_drag.normal")
    assert fit.low[i] < fit.best[i] < fit.high[i]
    assert 0.001 < fit.high[i] - fit.low[i] < 1.0


def test_bending_and_stretch_are_found_in_a_recording_of_the_reference_simulation():
    """A still swatch, truth from finite elements on another mesh; the parameters mean the same in both models."""
    config = {
        "model": "baraff_witkin",
        "optimizer": "least_squares",
        "metric": "node_error",
        "study": "calibration",
        "tracker": "markers",
        "budget": 60,
        "options": {"baraff_witkin": {"dt": 0.004, "tolerance": 0.01}},
        "scene": {"spacing": 0.0375},
        "seed": 0,
        "jobs": 1,
        "rerun": False,
        "out": "runs",
        "recordings": str(suites_folder() / "embedded" / "static_dynamic"),
        "suite": {
            "name": "recovery", "select": "fleece/static-*", "each": "fleece/static-2",
            "fixed": {"*": {"quadratic_drag": 5.0, "linear_drag": 5.0, "drag_decline": 5.0}},
        },
    }  # fmt: skip
    (cell,) = plan(config, catalogue())
    bench = set_up(cell, catalogue())
    optimizer = catalogue().make("optimizers", "least_squares", bench.space, seed=1, budget=60)
    fit = calibrate(bench.of_split("fit"), optimizer, bench.space)
    found = dict(zip(bench.space.names, fit.best, strict=True))
    for name, factor in (("bend", 3.0), ("stretch", 2.0)):
        truth = float(bench.recordings[0].notes[f"truth_{name}"])
        assert truth / factor < found[name] < truth * factor
    held, _ = evaluate(bench.of_split("held_out"), np.stack([bench.space.defaults, fit.best]))
    assert held.value[1] < held.value[0]


def test_least_squares_asks_for_no_second_jacobian_where_it_stands():
    """At an optimum a Jacobian (2 points) is followed by two rounds of four dampings; nothing is simulated twice."""
    space = ParameterSpace(
        tuple(Parameter(n, n, "1", (0.0, 1.0), "linear", 0.5, "a number", "a test") for n in ("a", "b"))
    )
    optimizer = catalogue().make("optimizers", "least_squares", space, seed=0, budget=60, starts=0, walks=1)
    asked = []
    while not optimizer.done:
        theta = optimizer.ask()
        asked.append(theta)
        off = np.hstack([theta - 0.5, np.ones((len(theta), 1))])
        optimizer.tell(theta, Evaluation(np.sum(off**2, axis=1), off))
    assert [len(batch) for batch in asked] == [1, 2, 4, 4]


def test_a_planted_drag_comes_back_from_clouds_whose_points_have_no_identity():
    """In each frame the points that were seen come in an order of its own."""
    random, plugins = np.random.default_rng(12), catalogue()
    scene = swing(0.06, 0.8)
    marked = observe(scene, random)
    cloud = np.array(marked.position)
    for places, there in zip(cloud, marked.visible, strict=True):
        places[there] = random.permutation(places[there])
    seen = Observation(marked.time, cloud, marked.visible, NOISE, marked.material)
    drag = [plugins.make("effects", "quadratic_drag")]
    simulation = plugins.make("models", "mass_spring", resolution=9).prepare(scene, drag)
    trial, space = Trial("cloud", seen, simulation, plugins.make("metrics", "chamfer")), simulation.parameters
    fit = calibrate([trial], plugins.make("optimizers", "least_squares", space, seed=3, budget=150), space)
    found = fit.best[space.names.index("quadratic_drag.normal")]
    assert found == pytest.approx(TRUTH["quadratic_drag.normal"], rel=0.1)
    best, start = (evaluate([trial], at[None])[0].value[0] for at in (fit.best, space.defaults))
    assert best < 1.6 * trial.metric.floor(seen) < start


def test_a_drag_coefficient_is_found_in_a_recording_of_clouds():
    """150 places a frame that are no nodes of the model, others in each frame, of which a tenth is not seen: simulated
    is a lattice, and no error comes down to the noise: the points of both lie between each other's.
    """
    plugins, random = catalogue(), np.random.default_rng(5)
    scene = swing(0.06, 0.8)
    places = random.uniform(0.0, 0.3, (600, 2))
    truth = plugins.make("models", "mass_spring", resolution=17, step_scale=0.5)
    drag = [plugins.make("effects", "quadratic_drag")]
    simulation = truth.prepare(dataclasses.replace(scene, points=places), drag)
    position = simulation.run([[TRUTH[n] for n in simulation.parameters.names]]).position[0]
    picked = np.stack([frame[random.permutation(600)[:150]] for frame in position])
    picked += random.normal(0, NOISE, picked.shape)
    picked[random.random(picked.shape[:2]) < 0.1] = np.nan
    picked[7] = np.nan
    recording = PointCloud(
        name="clouds", time=scene.times, position=picked, grip_time=scene.grip_time, grip_material=scene.grip_material,
        grip_position=scene.grip_position, cloth_width=0.3, cloth_height=0.3, areal_density=0.2, noise_sigma=NOISE,
    )  # fmt: skip
    seen = plugins.make("trackers", "cloud").track(recording)
    simulation = plugins.make("models", "mass_spring", resolution=9).prepare(scene_of(recording), drag)
    trial, space = Trial("clouds", seen, simulation, plugins.make("metrics", "chamfer")), simulation.parameters
    fit = calibrate([trial], plugins.make("optimizers", "least_squares", space, seed=3, budget=150), space)
    found = dict(zip(space.names, fit.best, strict=True))
    assert found["quadratic_drag.normal"] == pytest.approx(TRUTH["quadratic_drag.normal"], rel=0.1)
    assert found["k1"] == pytest.approx(TRUTH["k1"], rel=0.35)
