"""Round trips: a cloth is exported, loaded by the simulator that the file is for, led by recorded grips, and held
against the recording beside the rollout of a model of the house."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys

import numpy as np
import pytest
from clothbench_exporters import mjcf, newton_script, plain, ppf, usd
from clothbench_models.baraff_witkin import BaraffWitkin
from conftest import ROOT
from twins_at_work import apart, in_mujoco, in_newton

from clothbench import Material, Twin, read_recording, scene_of

CLOTH = Material(1e-4, 200.0, 100.0, 1e-6, 0.02)  # about that of the stiffer of two cloths held in two hands


@pytest.fixture(scope="module")
def held() -> tuple[Twin, np.ndarray]:
    """The first second of a recording that the finite-element reference made, and where its points were (T, N, 3) m."""
    recording = read_recording(ROOT / "suites" / "embedded" / "hold_nodes" / "stiff-hold-1.nc")
    scene = scene_of(recording)
    scene = dataclasses.replace(scene, times=scene.times[:31])
    return Twin("a cloth in two hands", scene, CLOTH, {"bending": (8e-5, 2e-4)}, "as planted"), recording.position[:31]


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
    far = float(np.nanmean(np.linalg.norm(seen - seen[:1], axis=-1)))
    print(f"{module}: {1e3 * apart(moved, seen):.2f} mm, own {1e3 * apart(own, seen):.2f} mm, moved {1e3 * far:.1f} mm")
    assert far > 0.03
    assert apart(moved, own) < 3e-3
    assert apart(moved, seen) < 1.25 * apart(own, seen) + 1e-3


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
    assert np.isfinite(np.load(tmp_path / "out.npz")["position"]).all()


def test_the_stage_is_whole_and_in_si(held, tmp_path):
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdShade

    file = tmp_path / "cloth.usda"
    file.write_text(usd.export(held[0]).text)
    stage = Usd.Stage.Open(str(file))
    assert (UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.GetStageUpAxis(stage)) == (1.0, "Z")
    mesh = stage.GetDefaultPrim()
    bound, _ = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial("physics")
    (thickness,) = mesh.GetAttribute("physics:thicknesses").Get()
    density = bound.GetPrim().GetAttribute("physics:density").Get()
    assert density * thickness == pytest.approx(held[0].scene.areal_density, rel=1e-5)
    assert bound.GetPrim().GetAttribute("physics:surfaceBendStiffness").Get() == pytest.approx(CLOTH.bending)


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


def test_what_a_target_cannot_hold_is_a_line_each(held):
    own = Material(0.0, np.inf, 20.0, 0.0, 0.0)
    twin = dataclasses.replace(held[0], material=own, others={"quadratic_drag.normal": (1.2, "1")})
    lines = mjcf.export(twin).cannot
    assert [line.partition(":")[0] for line in lines] == ["stretch", "bending", "shear", "quadratic_drag.normal"]
    assert "factor 125" in lines[2]
    assert plain.export(twin).cannot == ()


def test_ppf_has_stretch_over_density(held):
    import tomllib

    (profile,) = tomllib.loads(ppf.export(held[0]).text).values()
    assert profile["shell_young_modulus"] == pytest.approx(CLOTH.stretch / held[0].scene.areal_density)
    assert "bend" not in profile


def test_numbers_leave_with_units_and_intervals(held):
    document = json.loads(plain.export(held[0]).text)
    assert document["material"]["bending"] == {"value": 1e-4, "low": 8e-5, "high": 2e-4, "unit": "N·m"}
