"""Warp and weft with stiffnesses of their own: plates and strips against mechanics, along either thread; what leaves
for another simulator; and that a ratio of 1 is the model as it was."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from clothbench_exporters import mjcf, plain
from clothbench_models.baraff_witkin import BaraffWitkin
from clothbench_models.bending import ThreadBending, bending_matrix
from clothbench_models.kirchhoff_love import KirchhoffLove
from clothbench_models.mass_spring_verlet import MassSpringVerlet
from clothbench_models.sheet_forces import add_diagonals
from effect_scenes import hanging
from implicit_scenes import DENSITY, G, lattice, simulate

from clothbench import ClothbenchError, Material, Scene, Twin, catalogue
from clothbench.estimation.prior import prior_of
from clothbench.modelling.mesh import grid_triangles
from clothbench.modelling.sheet import sheet_of
from clothbench.reference.presets import preset
from clothbench.studies.mechanics import trials
from clothbench.testing import scenes
from clothbench.twins.of_preset import twin_of_preset

RATIO = 4.0  # warp over weft, so that the one has twice the mean and the other half of it
SIZE, NODES = (0.2, 0.15), (33, 25)


def along_weft(scene: Scene) -> Scene:
    """The same strip, cut the other way (turned by a quarter): what was warp is weft."""

    def turned(material: np.ndarray) -> np.ndarray:
        return np.stack([material[:, 1], scene.width - material[:, 0]], axis=1)

    return dataclasses.replace(
        scene, width=scene.height, height=scene.width, resolution=scene.resolution[::-1],
        grip_material=turned(scene.grip_material), points=turned(scene.points),
    )  # fmt: skip


# --- bending ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("curvatures", "rigidity"),
    [((1.0, 0.0, 0.0), 2.0), ((0.0, 1.0, 0.0), 0.5), ((0.0, 0.0, 1.0), 2.0), ((1.0, -1.0, 0.5), 2.5 + 0.5)],
    ids=["along the warp", "along the weft", "twist", "all at once"],
)
def test_an_orthotropic_plate_costs_what_its_rigidities_say(curvatures, rigidity):
    """½ A (D_u κ_uu² + D_v κ_vv² + 2 √(D_u D_v) κ_uv²), less half a cell at free borders (`test_bending`)."""
    uv = lattice(*SIZE, NODES)
    sheet = sheet_of(uv, np.ones(len(uv)), np.ones(len(uv)), grid_triangles(NODES), (0, 0, 0), 1.2)
    (u, v), (uu, vv, twist) = uv.T, curvatures
    x = np.stack([u, v, uu * u**2 / 2 + vv * v**2 / 2 + twist * u * v])
    matrix, f = ThreadBending.of(sheet).matrix(RATIO), np.zeros((3, len(uv)))
    add_diagonals(matrix.offsets, matrix.values, x, 1.0, f)
    lost = (2.0 * uu**2 / (NODES[0] - 1) + 0.5 * vv**2 / (NODES[1] - 1)) / rigidity
    assert (f * x).sum() == pytest.approx((1 - lost) * rigidity * SIZE[0] * SIZE[1], rel=1e-7)


def test_with_a_ratio_of_one_it_is_the_plate_that_bends_alike():
    uv = lattice(*SIZE, (9, 7))
    sheet = sheet_of(uv, np.ones(63), np.ones(63), grid_triangles((9, 7)), (0, 0, 0), 1.2)
    alike, matrix = bending_matrix(sheet), ThreadBending.of(sheet).matrix(1.0)
    np.testing.assert_array_equal(alike.offsets, matrix.offsets)
    np.testing.assert_allclose(alike.values, matrix.values, rtol=1e-12, atol=1e-10 * alike.values.max())


@pytest.mark.parametrize(
    ("name", "along", "within"),
    [("baraff_witkin", 17, 0.005), ("inextensible", 17, 0.005), ("kirchhoff_love", 97, 0.015)],
)
def test_a_cantilever_tells_the_rigidity_of_its_own_thread(name, along, within):
    """ρ g L⁴/(8 D_warp) and ρ g L⁴/(8 D_weft) at the tip. (A spline may bend between the two held columns, which the
    shell's mesh has to make small.)"""
    (trial,) = trials.cantilever_small(along)
    material = dataclasses.replace(trial.material, bending_ratio=RATIO)
    model = catalogue().make("models", name, orthotropic=True)
    for scene, softer in ((trial.scene, 0.5), (along_weft(trial.scene), 2.0)):
        position = simulate(model, scene, *model.of_material(material, scene))
        assert trial.measure(trial.scene, position) == pytest.approx(softer * trial.reference, rel=within), scene.width


# --- stretch ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", [BaraffWitkin(orthotropic=True), KirchhoffLove(orthotropic=True)], ids=["bw", "kl"])
def test_a_hanging_strip_tells_the_stiffness_of_its_own_thread(model):
    """Its lower half gets ρ g L²/(8 k_warp) or ρ g L²/(8 k_weft) longer (the upper one is held point by point)."""
    material = Material(1e-6, 300.0, 150.0, stretch_ratio=RATIO)
    weft = hanging(0.05, 0.2, np.array([0.0, 0.1]), [(0.025, 0.1), (0.025, 0.2)], (5, 17))
    for scene, stretch in ((weft, 150.0), (along_weft(weft), 600.0)):
        middle, end = simulate(model, scene, *model.of_material(material, scene))[0]
        longer = np.linalg.norm(end - middle) - 0.1
        assert longer == pytest.approx(DENSITY * G * 0.2**2 / (8 * stretch), rel=0.01)


# --- materials --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", [BaraffWitkin(orthotropic=True), KirchhoffLove(orthotropic=True), MassSpringVerlet()])
def test_a_material_with_two_directions_goes_in_and_comes_out(model):
    bending = 0.0 if model.name == "mass_spring_verlet" else 2e-6
    told = Material(bending, 300.0, 150.0, bending_ratio=3.0 if bending else 1.0, stretch_ratio=1.5)
    said = model.material_of(model.of_material(told, scenes.hanging()), scenes.hanging())
    close = 0.01 if model.name == "mass_spring_verlet" else 1e-9  # whose longer springs are as soft as they go, not 0
    assert dataclasses.astuple(said) == pytest.approx(dataclasses.astuple(told), rel=close)


@pytest.mark.parametrize("name", ["baraff_witkin", "inextensible"])
def test_viscosity_of_bending_goes_in_and_comes_out(name):
    model, told = catalogue().make("models", name), Material(1e-5, 300.0, 150.0, bending_damping=2e-7)
    theta = model.of_material(told, scenes.hanging())
    (k,) = (k for k, p in enumerate(model.parameters) if p.unit == "N·m·s")
    assert theta[k] == pytest.approx(2e-7)
    assert model.material_of(theta, scenes.hanging()).bending_damping == pytest.approx(2e-7)


@pytest.mark.parametrize("name", ["baraff_witkin", "inextensible", "kirchhoff_love", "mass_spring"])
def test_a_sheet_that_is_alike_along_both_says_so(name):
    material = Material(0.0 if name == "mass_spring" else 1e-6, 300.0, 150.0, 0.0, 0.0, 2.0)
    with pytest.raises(ClothbenchError, match=f"{name}: has one bending stiffness for warp and weft, found a material"):
        catalogue().make("models", name).of_material(material, scenes.hanging())
    if name != "mass_spring":
        with pytest.raises(ClothbenchError, match=f"{name}: orthotropic is 'yes', expected true or false"):
            catalogue().make("models", name, orthotropic="yes")


def test_a_twin_carries_both_and_says_what_a_target_makes_of_them():
    denim = twin_of_preset("denim")
    warp, weft = (preset("denim").numbers[f"bending_{thread}"].value for thread in ("warp", "weft"))
    assert denim.material.along("bending") == pytest.approx((warp, weft))
    assert f'"value": {denim.material.bending_ratio}' in plain.export(denim).text
    (line,) = (line for line in mjcf.export(denim).cannot if line.startswith("bending"))
    assert f"stands for {warp:.4g} along the warp and {weft:.4g} along the weft" in line
    assert f"bending ratio: {warp / weft:.4g}, warp over weft" in "\n".join(denim.about())
    pulled = tuple(preset("denim").numbers[f"stretch_{thread}"].value for thread in ("warp", "weft"))
    assert denim.material.along("stretch") == pytest.approx(pulled, rel=1e-3)
    assert f'"value": {denim.material.stretch_ratio}' in plain.export(denim).text
    (line,) = (line for line in mjcf.export(denim).cannot if line.startswith("stretch:"))
    assert "stands for 447.2 along the warp and 2091 along the weft" in line  # of a mean of three digits
    alike = Twin("a cloth", denim.scene, denim.material.alike, {}, "none")
    assert not [line for line in (*alike.about(), *mjcf.export(alike).cannot) if "warp" in line]


def test_a_class_of_fabrics_says_where_the_ratio_begins():
    denim, scene = preset("denim"), scenes.hanging()
    prior = prior_of(denim, BaraffWitkin(orthotropic=True), scene)
    assert prior.start["bend_ratio"] == pytest.approx(denim.material.bending_ratio)
    assert "bend_ratio" not in prior.bounds
    assert prior.start["stretch_ratio"] == pytest.approx(denim.material.stretch_ratio)
    assert "stretch_ratio" not in prior_of(preset("knit"), BaraffWitkin(orthotropic=True), scene).start
    alike = prior_of(denim, BaraffWitkin(), scene)
    assert {name: prior.bounds[name] for name in alike.bounds} == alike.bounds
