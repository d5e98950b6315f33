"""Round trips: a cloth is exported, loaded by the simulator that the file is for, led by recorded grips, and held
against the recording beside the rollout of a model of the house."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
from clothbench_exporters import mjcf, newton_script, plain, ppf, usd
from clothbench_exporters.mesh import grip_nodes, sheet_of_twin
from clothbench_models.baraff_witkin import BaraffWitkin
from conftest import ROOT
from twins_at_work import apart, in_mujoco, in_newton, off

from clothbench import ClothbenchError, Material, Obstacle, Recording, Scene, Twin, read_recording, scene_of
from clothbench.estimation.prior import hanging
from clothbench.twins.of_cell import FittedCell, twin_of_cell

CLOTH = Material(1e-4, 200.0, 100.0, 1e-6, 0.02)  # about that of the stiffer of two cloths held in two hands


@pytest.fixture(scope="module")
def held() -> tuple[Twin, Recording]:
    """A cloth, and a recording of it that the finite-element reference made, of which the first second is looked at."""
    recording = read_recording(ROOT / "suites" / "embedded" / "hold_nodes" / "stiff-hold-1.nc")
    scene = scene_of(recording)
    scene = dataclasses.replace(scene, times=scene.times[:31])
    return Twin("a cloth in two hands", scene, CLOTH, {"bending": (8e-5, 2e-4)}, "as planted"), recording


@pytest.mark.slow
@pytest.mark.parametrize(("module", "exporter", "drive"), [
    ("mujoco", mjcf, in_mujoco), ("newton", newton_script, in_newton)
])  # fmt: skip
def test_a_twin_follows_the_recording_as_our_own_model_does(held, module, exporter, drive, tmp_path):
    pytest.importorskip(module)
    twin, seen = held
    model = BaraffWitkin()
    own = model.prepare(twin.scene).run(model.of_material(CLOTH, twin.scene)[None]).position[0]
    file = tmp_path / f"cloth{exporter.suffix}"
    file.write_text(exporter.export(twin).text)
    moved = drive(file, twin.scene)
    far = off(np.repeat(seen.position[:1], 31, axis=0), seen)
    print(f"{module}: {1e3 * off(moved, seen):.2f} mm, own {1e3 * off(own, seen):.2f} mm, moved {1e3 * far:.1f} mm")
    assert far > 0.03
    assert apart(moved, own) < 3e-3
    assert off(moved, seen) < 1.25 * off(own, seen) + 1e-3


@pytest.mark.slow
def test_a_fit_in_mujoco_is_off_by_what_the_file_does_not_hold(clothbench, tmp_path):
    pytest.importorskip("mujoco")
    for name in ("fleece-waving-1.nc", "fleece-waving-2.nc"):  # fitted; held out
        shutil.copy(ROOT / "suites" / "embedded" / "static_dynamic" / name, tmp_path)
    done = clothbench(
        "run", "recordings=.", "model=baraff_witkin", "optimizer=least_squares", "metric=node_error", "budget=120",
        "+scene.resolution=[9,9]", "rerun=false", "jobs=1",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    (cell,) = (tmp_path / "runs" / "cells").glob("[0-9a-f]*")
    with contextlib.chdir(tmp_path):
        fit = FittedCell.of(tmp_path / "runs", cell.name)
    twin, model = twin_of_cell(fit), fit.model
    written = mjcf.export(twin)
    (file := tmp_path / "cloth.xml").write_text(written.text)
    for number in (1, 2):
        recording = read_recording(tmp_path / f"fleece-waving-{number}.nc")
        scene = dataclasses.replace(scene_of(recording), resolution=(9, 9))
        whole = np.array([fit.values[p.name] for p in model.parameters])
        less = model.of_material(written.material, scene)
        own, reduced = (model.prepare(scene).run(theta[None]).position[0] for theta in (whole, less))
        moved = in_mujoco(file, scene)
        off_by = {"own": off(own, recording), "less": off(reduced, recording), "mujoco": off(moved, recording)}
        print(recording.name, {name: f"{1e3 * value:.1f} mm" for name, value in off_by.items()})
        assert off_by["own"] < 0.01
        assert off_by["mujoco"] < 1.25 * off_by["less"] + 1e-3


@pytest.mark.slow
def test_newtons_script_runs_by_itself(held, tmp_path):
    pytest.importorskip("newton")
    file = tmp_path / "cloth.py"
    file.write_text(newton_script.export(held[0]).text)
    np.savez(
        tmp_path / "path.npz", time=np.array([0.0, 0.05]), position=np.repeat(held[0].scene.grip_position[:1], 2, 0)
    )
    done = subprocess.run(
        [sys.executable, file, "path.npz", "out.npz"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert "lowest node" in done.stdout
    done = subprocess.run([sys.executable, file, "-h"], capture_output=True, text=True, check=True)
    assert "usage: cloth.py [-h] [PATH.npz] [OUT.npz]" in done.stdout
    assert np.isfinite(np.load(tmp_path / "out.npz")["position"]).all()
    np.savez(tmp_path / "one.npz", time=np.array([0.0]), position=held[0].scene.grip_position[:1])
    np.savez(tmp_path / "flat.npz", time=np.array([0.0, 1.0]), position=np.zeros((2, 3)))
    for name, found in (("one.npz", "time is (1,)"), ("flat.npz", "position is (2, 3)"), ("no.npz", "FileNotFound")):
        done = subprocess.run([sys.executable, file, name], cwd=tmp_path, capture_output=True, text=True)
        assert (done.returncode, len(done.stderr.strip().splitlines())) == (1, 1), done.stderr
        assert found in done.stderr


def test_the_stage_is_whole_and_in_si(held, tmp_path):
    pytest.importorskip("pxr")
    from pxr import Sdf, Usd, UsdGeom, UsdPhysics, UsdShade

    file = tmp_path / "cloth.usda"
    file.write_text(usd.export(held[0]).text)
    stage = Usd.Stage.Open(str(file))
    assert (UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.GetStageUpAxis(stage)) == (1.0, "Z")
    mesh = stage.GetPrimAtPath("/World/Cloth")
    assert stage.GetDefaultPrim() == mesh.GetParent()
    assert UsdGeom.Mesh(mesh).GetDoubleSidedAttr().Get() is True
    points = np.array(UsdGeom.Mesh(mesh).GetPointsAttr().Get())
    np.testing.assert_allclose(UsdGeom.Mesh(mesh).GetExtentAttr().Get(), [points.min(axis=0), points.max(axis=0)])
    bound, _ = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial("physics")
    (thickness,) = mesh.GetAttribute("physics:thicknesses").Get()
    density = bound.GetPrim().GetAttribute("physics:density").Get()
    assert density * thickness == pytest.approx(held[0].scene.areal_density, rel=1e-5)
    assert bound.GetPrim().GetAttribute("physics:surfaceBendStiffness").Get() == pytest.approx(CLOTH.bending)
    for name in ("restBendAnglesDefault", "thicknesses:elementType"):
        assert mesh.GetAttribute(f"physics:{name}").GetVariability() == Sdf.VariabilityUniform
    gravity = UsdPhysics.Scene(stage.GetPrimAtPath("/World/PhysicsScene"))
    assert gravity.GetGravityMagnitudeAttr().Get() == pytest.approx(9.81)
    assert list(gravity.GetGravityDirectionAttr().Get()) == [0.0, 0.0, -1.0]


def test_the_stage_says_each_thing_once(held):
    pytest.importorskip("pxr")
    woven = dataclasses.replace(CLOTH, bending_ratio=4.0)
    lines = usd.export(dataclasses.replace(held[0], material=woven, others={"lift": (1.0, "1")})).cannot
    assert [line.partition(":")[0] for line in lines] == [
        "bending", "modulus", "hinges", "bending damping", "stretch damping", "lift"
    ]  # fmt: skip
    assert lines[-1] == "lift: the schema has no place for it; 1 is left out"


def test_newton_reads_the_usd_stage(held, tmp_path):
    pytest.importorskip("pxr")
    pytest.importorskip("newton_usd_schemas")
    newton = pytest.importorskip("newton")
    from pxr import Usd

    twin = held[0]
    file = tmp_path / "cloth.usda"
    file.write_text(usd.export(twin).text)
    builder = newton.ModelBuilder()
    with pytest.warns(newton.NewtonWarning, match="surfaceShearStiffness is not applied"):
        builder.add_usd(Usd.Stage.Open(str(file)))
    mass = twin.scene.areal_density * twin.scene.width * twin.scene.height
    assert sum(builder.particle_mass) == pytest.approx(mass, rel=1e-5)
    assert builder.tri_materials[0][0] == pytest.approx(CLOTH.stretch)  # μ, and the schema's stretch is taken for it
    assert builder.edge_bending_properties[-1][0] == pytest.approx(CLOTH.bending)
    assert len(builder.attachment_particle_body_particle) == 2


def test_newton_holds_what_the_usd_stage_attaches(held, tmp_path):
    pytest.importorskip("pxr")
    pytest.importorskip("newton_usd_schemas")
    newton = pytest.importorskip("newton")
    from pxr import Usd

    (file := tmp_path / "cloth.usda").write_text(usd.export(held[0]).text)
    builder = newton.ModelBuilder()
    with pytest.warns(newton.NewtonWarning, match="surfaceShearStiffness is not applied"):
        builder.add_usd(Usd.Stage.Open(str(file)))
    builder.add_body()  # Newton 1.8's SolverVBD wants a joint where there are bodies
    places, grips = after_a_while(newton, builder), held[0].scene.grip_position[0]
    apart = np.linalg.norm(places[:, None] - grips[None], axis=-1)
    assert apart.min(axis=0).max() < 3e-3
    assert places[:, 2].min() < grips[:, 2].min() - 0.1


def after_a_while(newton, builder) -> np.ndarray:
    """Where particles (n, 3) m are after a tenth of a second of SolverVBD, which attaches them to bodies."""
    builder.color()
    model = builder.finalize(device="cpu")
    solver = newton.solvers.SolverVBD(model, iterations=10)
    now, after, control = model.state(), model.state(), model.control()
    for _ in range(50):
        now.clear_forces()
        solver.step(now, after, control, None, 2e-3)
        now, after = after, now
    return now.particle_q.numpy()


def dropped(obstacle: Obstacle) -> Scene:
    """A sheet of 30 cm that falls onto what is 1 cm below it."""
    side = np.linspace(0, 0.3, 7)
    points = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    start = np.stack([points[:, 0] - 0.15, 0.15 - points[:, 1], np.full(len(points), 0.01)], axis=1)
    return Scene(
        width=0.3, height=0.3, areal_density=0.2, grip_time=np.array([0.0, 1.0]), grip_material=np.zeros((0, 2)),
        grip_position=np.zeros((2, 0, 3)), times=np.linspace(0, 0.15, 4), points=points, start=start,
        obstacles=(obstacle,),
    )  # fmt: skip


@pytest.mark.parametrize(("obstacle", "depth"), [
    (Obstacle("plane", friction=0.3), lambda x: x[..., 2]),
    (Obstacle("sphere", centre=(0.0, 0.0, -0.06), radius=0.06, friction=0.3),
     lambda x: np.linalg.norm(x - [0.0, 0.0, -0.06], axis=-1) - 0.06),
    (Obstacle("disc", radius=0.09, friction=0.3),
     lambda x: np.maximum(x[..., 2], np.linalg.norm(x[..., :2], axis=-1) - 0.09)),
])  # fmt: skip
def test_cloth_lies_on_exported_obstacles_as_it_does_in_our_own_model(obstacle, depth, tmp_path):
    pytest.importorskip("mujoco")
    twin = Twin("it falls", dropped(obstacle), CLOTH, {}, "as planted")
    model = BaraffWitkin(resolution=13)
    own = model.prepare(twin.scene).run(model.of_material(CLOTH, twin.scene)[None]).position[0]
    written = mjcf.export(twin)
    assert not any(line.startswith("obstacle") for line in written.cannot)
    (file := tmp_path / "cloth.xml").write_text(written.text)
    moved = in_mujoco(file, twin.scene, settle=0.0)
    print(f"{obstacle.shape}: {1e3 * apart(moved, own):.2f} mm apart, deepest {1e3 * depth(moved).min():.2f} mm")
    assert depth(moved).min() > -1e-3
    assert apart(moved[-1], own[-1]) < 0.015
    assert apart(moved[-1], moved[0]) > 0.008


def test_what_grips_carry_pushes_the_cloth(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    ball = Obstacle("sphere", centre=(0.15, 0.07, -0.15), radius=0.05, carried=True)
    scene = dataclasses.replace(hanging(0.3, 0.3, 0.2), obstacles=(ball,))
    (file := tmp_path / "cloth.xml").write_text(mjcf.export(Twin("it hangs", scene, CLOTH, {}, "")).text)
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for k in range(500):
        data.mocap_pos[-1] = [0.0, -1e-4 * k, 0.0]
        mujoco.mj_step(model, data)
    apart = np.linalg.norm(data.flexvert_xpos - np.array(ball.centre) - data.mocap_pos[-1], axis=1)
    assert apart.min() > ball.radius - 1e-3
    assert data.flexvert_xpos[:, 1].min() < -0.02


def test_a_cut_sheet_leaves_whole_with_what_clamps_it(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    round_ = 0.15 + 0.149 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    scene = dataclasses.replace(dropped(Obstacle("disc", radius=0.09, clamps=True)), outline=round_, start=None)
    written = mjcf.export(Twin("a drape", scene, CLOTH, {}, ""))
    assert any(line.startswith("outline") for line in written.cannot)
    model = mujoco.MjModel.from_xml_string(written.text)
    assert model.flex_vertnum[0] < 169
    assert model.body_mass.sum() == pytest.approx(0.2 * np.pi * 0.149**2, rel=0.02)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for _ in range(300):
        mujoco.mj_step(model, data)
    x = data.flexvert_xpos
    assert np.abs(x[np.linalg.norm(x[:, :2], axis=1) < 0.05, 2]).max() < 2e-3
    assert x[:, 2].min() < -0.01


def test_the_script_of_newton_refuses_a_cut_sheet_and_says_who_takes_it(held):
    pytest.importorskip("newton")
    scene = held[0].scene
    outline = np.array([[0.0, 0.0], [scene.width, 0.0], [scene.width, 0.2], [0.0, 0.2]])  # of 0.3 m; with both grips
    with pytest.raises(ClothbenchError, match=r"^newton: .* cut along an outline; export it --to mujoco or usd"):
        newton_script.export(dataclasses.replace(held[0], scene=dataclasses.replace(scene, outline=outline)))


def test_what_is_around_the_cloth_is_written_or_a_line(held):
    around = (Obstacle("plane"), Obstacle("sphere", radius=0.1, carried=True))
    outline = np.array([[0.0, 0.0], [held[0].scene.width, 0.0], [0.0, 0.2]])  # with both grips
    scene = dataclasses.replace(held[0].scene, obstacles=around, thickness=1e-3, outline=outline)
    twin = dataclasses.replace(held[0], scene=scene)
    lines = twin.unheld("a reader")
    assert [line.partition(":")[0] for line in lines] == ["obstacle 0", "obstacle 1", "thickness", "outline"]
    assert "carried sphere" in lines[1]
    assert set(twin.unheld("ppf-contact-solver")) <= set(ppf.export(twin).cannot)
    document = json.loads(plain.export(twin).text)
    assert document["gravity"] == {"value": list(scene.gravity), "unit": "m/s²"}
    assert document["air_density"]["value"] == scene.air_density
    assert document["grips"]["first_position"] == scene.grip_position[0].tolist()
    assert [o["shape"] for o in document["obstacles"]] == ["plane", "sphere"]
    assert document["obstacles"][0]["radius"] is None
    assert document["thickness"] == {"value": 1e-3, "unit": "m"}
    assert document["outline"]["material"] == outline.tolist()


def test_a_twin_begins_where_its_grips_do(held):
    scene, slack = held[0].scene, np.array([[0.0, 0, 1], [0.5, 0, 1], [0, -0.32, 1], [0.5, -0.32, 1]])
    times = np.array([-1.0, 0.0, 1.0])
    corners = np.array([[0.0, 0.0], [0.6, 0.0], [0.0, 0.4], [0.6, 0.4]])
    scene = dataclasses.replace(
        scene, width=0.6, height=0.4, grip_time=times, grip_material=corners,
        grip_position=np.stack([slack - [0.0, 0.1, 0.0], slack, slack]), times=times[1:], points=corners[:1] + 0.1,
        start=None, resolution=None,
    )  # fmt: skip
    for begins, velocity, start in ((-1.0, None, None), (0.0, np.zeros((1, 3)), np.array([[0.1, -0.1, 0.9]]))):
        twin = Twin("slack", dataclasses.replace(scene, velocity=velocity, start=start), CLOTH, {}, "")
        assert twin.scene.start_time == begins
        sheet, shape = sheet_of_twin(twin)
        first = twin.scene.grips_at(np.array([begins]))[0]
        np.testing.assert_allclose(shape[grip_nodes(twin, sheet)], first, atol=1e-12)
        assert json.loads(plain.export(twin).text)["grips"]["first_position"] == first.tolist()
    free = dropped(Obstacle("plane"))
    assert json.loads(plain.export(Twin("free", free, CLOTH, {}, "")).text)["grips"]["first_position"] == []


def test_what_a_target_cannot_hold_is_a_line_each(held):
    own = Material(0.0, np.inf, 20.0, 0.0, 0.0)
    twin = dataclasses.replace(held[0], material=own, others={"quadratic_drag.normal": (1.2, "1")})
    lines = mjcf.export(twin).cannot
    assert [line.partition(":")[0] for line in lines] == ["stretch", "bending", "shear", "quadratic_drag.normal"]
    assert "factor 125" in lines[2]
    assert plain.export(twin).cannot == ()
    limp = dataclasses.replace(own, stretch=100.0, shear=0.0, bending_ratio=2.0)  # nothing to stand for, and no factor
    assert "50 N/m stands for 0" in "\n".join(dataclasses.replace(twin, material=limp).isotropic("a reader")[1])


def test_a_shear_stiffness_without_end_is_not_replaced_without_a_line(held):
    own = Material(1e-5, 100.0, np.inf, 0.0, 0.0)
    found, lines = dataclasses.replace(held[0], material=own).isotropic("a reader", shears=True)
    assert found.shear == 50.0
    assert lines == ["shear: a reader holds a finite one: 50 N/m stands for inf"]


def test_what_does_nothing_is_not_lost_and_a_cameras_share_is_the_cameras(held):
    others = {"total_mass.ratio": (1.0, "1"), "clock_offset.offset": (0.02, "s")}
    twin = dataclasses.replace(
        held[0], others=others, nulls={"total_mass.ratio": 1.0}, places={"clock_offset.offset": "sensor"}
    )
    assert twin.unheld("a reader") == [
        "clock_offset.offset: 0.02 s belongs to the camera and not to the cloth; it is left out"
    ]
    none = dataclasses.replace(twin, others={"total_mass.ratio": (0.0, "1")})
    assert none.unheld("a reader") == ["total_mass.ratio: a reader has no place for it; 0 is left out"]


def test_a_file_says_which_damping_it_holds(held):
    """MuJoCo's one is the smaller, and none where the cloth has none of one kind."""
    both, one = (
        mjcf.export(dataclasses.replace(held[0], material=dataclasses.replace(CLOTH, bending_damping=late)))
        for late in (CLOTH.bending_damping, 0.0)
    )
    assert (both.material.bending_damping, both.material.stretch_damping) == pytest.approx((1e-8, 0.02))
    assert 'damping="0.0"' in one.text
    assert (one.material.bending_damping, one.material.stretch_damping) == (0.0, 0.0)
    assert [line.partition(":")[0] for line in one.cannot] == ["stretch damping"]


def test_a_name_of_several_lines_breaks_no_file(held):
    import tomllib

    twin = dataclasses.replace(held[0], name="one\ntwo 𝛂", provenance={"source": "a\nb = 1"})
    (name,) = tomllib.loads(ppf.export(twin).text)
    assert name == "one two 𝛂"
    assert all("\n" not in line for line in twin.about())


def test_ppf_has_the_material_as_its_source_makes_it(held):
    import tomllib

    woven = dataclasses.replace(CLOTH, shear=40.0, bending_ratio=4.0)
    written = ppf.export(dataclasses.replace(held[0], material=woven))
    (profile,) = tomllib.loads(written.text).values()
    density, young, poisson = (profile[f"shell_{n}"] for n in ("density", "young_modulus", "poisson_ratio"))
    assert density * young / 2 / (1 + poisson) == pytest.approx(woven.stretch)
    assert density * young * poisson / (1 + poisson) / (1 - 2 * poisson) == pytest.approx(woven.shear)
    assert 1.28e-5 * density * profile["bend"] == pytest.approx(woven.bending)
    assert [line.partition(":")[0] for line in written.cannot] == [
        "bending", "bend_warp, bend_weft", "deformation_damping", "bending_damping"
    ]  # fmt: skip
    assert written.material == dataclasses.replace(woven.alike, bending_damping=0.0, stretch_damping=0.0)
    warp, weft = (b / 1.28e-5 / density for b in woven.along("bending"))
    assert f"bend = {weft:.4g}, bend_warp = {warp - weft:.4g} and bend_weft = 0" in written.cannot[1]


def test_numbers_leave_with_units_and_intervals(held):
    document = json.loads(plain.export(held[0]).text)
    assert document["material"]["bending"] == {
        "value": 1e-4,
        "low": 8e-5,
        "high": 2e-4,
        "unit": "N·m",
        "determined": None,
    }
