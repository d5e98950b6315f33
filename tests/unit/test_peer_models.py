"""MuJoCo and Newton as models: they swing as theory says, take effects, and are skipped where they are absent."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from clothbench_models.peers.mujoco_model import Mujoco
from clothbench_models.peers.newton_model import Newton, unit_bending
from conftest import swinging_recording

from clothbench import ClothbenchError, Obstacle, write_recording
from clothbench.cli.listings import plugin_rows, print_plugins
from clothbench.core.protocols import Material
from clothbench.core.scene import Scene, minimum_jerk
from clothbench.engine.cells import Source, plugin_versions
from clothbench.engine.run import run_cell
from clothbench.engine.store import Store
from clothbench.modelling.mesh import grid_triangles
from clothbench.modelling.sheet import sheet_of
from clothbench.plugins.discovery import catalogue
from clothbench.studies.calibration.cell import CalibrationCell
from clothbench.studies.speed.bench import _models
from clothbench.testing import check_model, scenes

MODELS = {"mujoco": Mujoco, "newton": Newton}
IMPLICIT = {"mujoco": {"integrator": "discrete", "dt": 4e-3}, "newton": {"solver": "vbd", "iterations": 5}}
INSTALL = {name: f"pip install clothbench[{name}]" for name in MODELS}
LENGTH, DENSITY = 0.297, 0.12  # m, kg/m²


@pytest.fixture(params=MODELS)
def name(request):
    pytest.importorskip(request.param)
    return request.param


@pytest.fixture
def absent(monkeypatch):
    """As if neither were installed."""
    for module in MODELS:
        monkeypatch.setitem(sys.modules, module, None)


def hanging_strip(span: float) -> Scene:
    """A sheet held along its upper edge, which is pulled 5 mm aside within 0.3 s and then left."""
    held = np.stack([np.linspace(0, 0.1, 4), np.zeros(4)], axis=1)
    stamps = np.linspace(0.0, 0.3, 31)
    aside = 0.005 * minimum_jerk(stamps / 0.3)[:, None, None] * [0.0, 1.0, 0.0]
    return Scene(
        width=0.1, height=LENGTH, areal_density=DENSITY, resolution=(4, 13), grip_time=stamps, grip_material=held,
        grip_position=np.stack([held[:, 0], 0 * held[:, 0], 0 * held[:, 0]], axis=1) + aside,
        times=np.linspace(0.0, span, round(100 * span) + 1), points=np.array([[0.05, LENGTH]]),
    )  # fmt: skip


def frequency(time: np.ndarray, aside: np.ndarray) -> float:
    """Of the slowest mode [Hz]: least squares on two damped cosines, the second near the second mode (2.3 times)."""
    from scipy.optimize import least_squares

    def motion(p):
        slow, fast = (2 * np.pi * f * time for f in (p[0], p[1]))
        one = np.exp(-p[2] * time) * (p[3] * np.cos(slow) + p[4] * np.sin(slow))
        return p[8] + one + np.exp(-p[5] * time) * (p[6] * np.cos(fast) + p[7] * np.sin(fast))

    trials = ([f, 2.3 * f, 0.1, 5e-3, 0.0, 0.3, 1e-3, 0.0, 5e-3] for f in (0.7, 0.8, 0.95, 1.1))
    fits = [least_squares(lambda p: motion(p) - aside, first) for first in trials]
    return abs(min(fits, key=lambda fit: fit.cost).x[0])


def swing(model, effects=(), **values: float) -> float:
    scene = hanging_strip(3.0)
    simulation = model.prepare(scene, effects)
    theta = simulation.parameters.defaults
    theta[: len(model.parameters)] = model.of_material(Material(1e-7, 100.0, 50.0), scene)
    for parameter, value in values.items():
        theta[simulation.parameters.names.index(parameter.replace("__", "."))] = value
    rollout = simulation.run(theta)
    assert rollout.status == ("ok",)
    late = scene.times > 0.4
    return frequency(scene.times[late] - 0.4, rollout.position[0, late, 0, 1])


def test_a_hanging_sheet_swings_at_the_first_mode_of_a_chain(name):
    expected = 2.4048 / 2 * np.sqrt(9.81 / LENGTH) / (2 * np.pi)  # 1.10 Hz
    assert swing(MODELS[name]()) == pytest.approx(expected, rel=0.02)


def test_added_mass_slows_the_swing_by_what_it_weighs(name):
    model, effect = MODELS[name](), catalogue().make("effects", "added_mass")
    bare, heavy = swing(model), swing(model, [effect], added_mass__areal_density=DENSITY)
    assert heavy / bare == pytest.approx(1 / np.sqrt(2), rel=0.02)


def test_free_fall_is_exact_to_the_order_of_the_step(name):
    scene = scenes.free_fall()
    for options in ({}, IMPLICIT[name]):
        model = MODELS[name](**options)
        rollout = model.prepare(scene).run(model.parameters.defaults)
        fallen = rollout.position[0, :, :, 2].mean(axis=1)
        expected = -9.81 / 2 * scene.times**2
        steps = 2 * 9.81 * 0.2 * 4e-3
        np.testing.assert_allclose(fallen - fallen[0], expected, atol=steps)


def test_the_implicit_variant_goes_the_same_way_in_few_steps(name):
    scene = scenes.swinging()
    explicit, implicit = MODELS[name](), MODELS[name](**IMPLICIT[name])
    assert (explicit.kind, implicit.kind) == ("explicit", "implicit")
    rollout = implicit.prepare(scene).run(implicit.parameters.defaults)
    assert rollout.status == ("ok",)
    shared = np.abs(scene.points[:, None] - scene.grip_material[None]).max(axis=2) < 1e-9
    points, grips = np.nonzero(shared)
    away = rollout.position[0][:, points] - scene.grips_at(scene.times)[:, grips]
    assert np.abs(away).max() < 1e-9
    below = scene.grips_at(scene.times)[:, :, 2].min(axis=1) - rollout.position[0, :, :-2, 2].mean(axis=1)
    assert (below > 0.05).all()


def test_the_implicit_variant_refuses_effects_that_add_mass(name):
    effects = [catalogue().make("effects", "added_mass")]
    with pytest.raises(ClothbenchError, match="takes no effects that add mass, as 'added_mass' does"):
        MODELS[name](**IMPLICIT[name]).prepare(scenes.hanging(), effects)


def test_a_batch_has_a_member_that_diverges_beside_one_that_does_not(name):
    model, scene = MODELS[name](dt=1.2e-3), scenes.swinging()
    theta = np.tile(model.parameters.defaults, (2, 1))
    theta[1, 0] = model.parameters.high[0]
    theta[0, 0] = model.parameters.low[0]
    rollout = model.prepare(scene).run(theta)
    assert rollout.status == ("ok", "diverged")
    assert rollout.reasons[1].startswith("the sheet left all bounds")
    assert np.isnan(rollout.position[1, -1]).all()


def test_a_step_that_is_given_is_scaled_too(name):
    model = MODELS[name](dt=1e-4, step_scale=0.5, resolution=5)
    scene = scenes.hanging()
    assert model.prepare(scene).engine(model.parameters.defaults).dt == 5e-5


def test_a_lighter_sheet_is_taken_in_shorter_steps(name):
    """By the root of what an effect leaves of the mass, where little is damped; a heavier one in the same."""
    model = MODELS[name](resolution=5)
    simulation = model.prepare(scenes.hanging(), [catalogue().make("effects", "total_mass")])
    theta = model.parameters.low
    steps = {ratio: simulation.engine(np.append(theta, ratio)).dt for ratio in (0.7, 1.0, 1.5)}
    assert steps[1.5] == steps[1.0]
    assert steps[0.7] == pytest.approx(np.sqrt(0.7) * steps[1.0], rel=0.05)


@pytest.mark.parametrize("option", [{"dt": 0.0}, {"step_scale": 2.0}, {"step_scale": None}, {"resolution": 2}], ids=str)
def test_a_wrong_option_is_refused_in_one_line(option):
    for make in MODELS.values():
        with pytest.raises(ClothbenchError, match=next(iter(option))):
            make(**option)


def test_an_unknown_way_of_stepping_is_refused_with_the_known_ones():
    with pytest.raises(ClothbenchError, match="'RK4', expected one of Euler, discrete"):
        Mujoco(integrator="RK4")
    with pytest.raises(ClothbenchError, match="'pbd', expected one of semi_implicit, vbd"):
        Newton(solver="pbd")
    with pytest.raises(ClothbenchError, match=r"\['vbd'\], expected one of semi_implicit, vbd"):
        Newton(solver=["vbd"])


@pytest.mark.parametrize("iterations", [None, 0.5, 2.7, 0])
def test_sweeps_are_whole(iterations):
    with pytest.raises(ClothbenchError, match=f"iterations is {iterations}, expected a"):
        Newton(iterations=iterations)


def test_contact_is_a_reason_to_skip_a_scene(name):
    scene = dataclasses.replace(scenes.hanging(), obstacles=(Obstacle("plane"),))
    assert "contacts" in MODELS[name]().skip(scene)
    assert MODELS[name]().skip(scenes.hanging()) is None
    with pytest.raises(ClothbenchError, match="contacts"):
        MODELS[name]().prepare(scene)


def test_a_cut_sheet_is_refused(name):
    scene = scenes.hanging()
    scene = dataclasses.replace(scene, outline=np.array([[0, 0], [scene.width, 0], [0, scene.height]]))
    with pytest.raises(ClothbenchError, match="whole rectangles"):
        MODELS[name]().prepare(scene)


def test_a_material_with_a_shear_of_its_own_is_refused():
    for make in MODELS.values():
        with pytest.raises(ClothbenchError, match="no parameter for 20 N/m beside 100 N/m"):
            make().of_material(Material(1e-6, 100.0, 20.0), scenes.hanging())


def test_a_limp_material_is_refused_where_no_parameter_makes_it():
    limp = Material(0.0, 100.0, 50.0, bending_damping=1e-8)
    for make in MODELS.values():
        with pytest.raises(ClothbenchError, match=r"no parameter for a bending.* of .*; state a bending"):
            make().of_material(limp, scenes.hanging())


@pytest.mark.parametrize("solver", ["semi_implicit", "vbd"])
def test_what_a_mesh_makes_of_limp_and_of_stiff_hinges_is_told_alike(solver):
    newton, scene = Newton(solver=solver), scenes.hanging()
    limp = Material(0.0, 100.0, 50.0)
    assert newton.material_of(newton.of_material(limp, scene), scene).bending == 0.0
    braked = Material(1e-6, 100.0, 50.0, bending_damping=2e-8)
    said = newton.material_of(newton.of_material(braked, scene), scene)
    assert (said.bending, said.bending_damping) == pytest.approx((1e-6, 2e-8))


def test_the_shell_has_the_rigidities_that_it_was_asked_for():
    young, poisson, thickness, _ = Mujoco().of_material(Material(1e-5, 100.0, 50.0), scenes.hanging())
    assert poisson == 0.0
    assert young * thickness == pytest.approx(100.0)
    assert young * thickness**3 / 12 == pytest.approx(1e-5)


def test_what_a_hinge_stiffness_is_worth_depends_on_the_mesh():
    def bending(count: int, solver: str) -> float:
        lines = np.linspace(0.0, 0.3, count)
        uv = np.stack(np.meshgrid(lines, lines), axis=-1).reshape(-1, 2)
        ones = np.ones(len(uv))
        return unit_bending(sheet_of(uv, ones, ones, grid_triangles((count, count)), (0, 0, -9.81), 1.2), solver)

    # With cells of size h, D ~ h edge_ke and D ~ h³ edge_ke, but for the cells at the border.
    assert bending(11, "vbd") / bending(21, "vbd") == pytest.approx(2.0, rel=0.1)
    assert bending(11, "semi_implicit") / bending(21, "semi_implicit") == pytest.approx(8.0, rel=0.1)


# --- where they are not installed -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MODELS)
def test_an_absent_library_skips_the_cell_and_names_the_remedy(name, absent, tmp_path):
    path = tmp_path / "swing.nc"
    recording = swinging_recording()
    write_recording(recording, path)
    source = Source(str(path), "swing", recording.hash, "fit")
    cell = CalibrationCell("small", "paper", (source,), name, (), "ga", "node_error", "markers", budget=4)
    assert run_cell(cell, tmp_path / "out") == "skipped"
    (row,) = Store(tmp_path / "out").rows()
    assert (row["status"], row["reason"]) == ("skipped", INSTALL[name])
    with pytest.raises(ClothbenchError) as fault:
        MODELS[name]().prepare(scenes.hanging())
    assert str(fault.value) == INSTALL[name]


def test_an_absent_library_is_listed_as_such_and_not_as_broken(absent, capsys):
    rows = [r for r in plugin_rows() if r["name"] in MODELS and r["kind"] != "exporter"]
    assert {(r["kind"], r["name"], r["missing"], r["broken"]) for r in rows} == {
        (kind, name, reason, None) for kind in ("model", "peer") for name, reason in INSTALL.items()
    }
    assert all(r["parameters"] for r in rows if r["kind"] == "model")
    print_plugins(rows)
    shown = " ".join(capsys.readouterr().out.split())
    assert f"not installed: model mujoco: {INSTALL['mujoco']}" in shown
    assert "broken" not in shown


def test_the_bench_and_the_kit_pass_over_an_absent_library(absent, capsys):
    assert not {plugin.name for plugin in _models()} & set(MODELS)
    assert f"mujoco: skipped: {INSTALL['mujoco']}" in capsys.readouterr().err
    assert {outcome.skipped for outcome in check_model(Newton)} == {INSTALL["newton"]}


def test_a_cell_is_another_one_with_another_version_of_the_library(monkeypatch):
    pytest.importorskip("mujoco")
    used = [("models", "mujoco")]
    here = plugin_versions(used, catalogue())["models/mujoco"]
    monkeypatch.setattr(Mujoco, "built_on", ("no_such_library",))
    assert ", mujoco " in here
    assert plugin_versions(used, catalogue())["models/mujoco"].endswith("no_such_library not installed")


def test_naming_the_models_imports_neither_library():
    code = """
import sys
from clothbench.plugins.discovery import catalogue
for name in ("mujoco", "newton"):
    model = catalogue().make("models", name)
    model.parameters, model.skip_reason()
print({"mujoco", "newton", "warp"} & set(sys.modules))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_a_run_prints_nothing_and_leaves_no_file(name, tmp_path):
    code = f"""
from clothbench.plugins.discovery import catalogue
from clothbench.testing import scenes
model = catalogue().make("models", {name!r}, dt=0.05)
print(model.prepare(scenes.hanging()).run(model.parameters.defaults).status)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert done.stdout.strip() == "('diverged',)"
    assert list(tmp_path.iterdir()) == []
