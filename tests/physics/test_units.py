"""Units proved by mechanics: sound models come out at 1, a wrong unit as a factor, and the peers as they are."""

from __future__ import annotations

import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest
from clothbench_models.baraff_witkin import BaraffWitkin
from clothbench_models.inextensible import Inextensible
from clothbench_models.kirchhoff_love import KirchhoffLove
from clothbench_models.mass_spring import MassSpring
from clothbench_models.peers.mujoco_model import Mujoco
from clothbench_models.peers.newton_model import Newton

from clothbench import ClothbenchError, Material
from clothbench.cli.units import unit_rows
from clothbench.studies.mechanics import checks, trials, units
from clothbench.studies.mechanics.subject import CannotDo, parameters_for


def factors(make, probe, meshes=(9, 17), densities=(0.1, 0.3)) -> list[tuple[float, float]]:
    """Found over documented and over asked, mesh by mesh, density by density."""
    found = [units._measured(make(), probe(along, rho), along, rho) for along in meshes for rho in densities]
    return [(one.found / one.documented, one.found / one.asked) for one in found]


@pytest.mark.parametrize("probe", units.PROBES, ids=lambda probe: probe.__name__)
def test_a_sound_model_is_worth_what_it_says(probe):
    brakes = probe.__name__.endswith("damping")  # as do its steps by themselves
    np.testing.assert_allclose(factors(BaraffWitkin, probe, (9,)), 1.0, rtol=0.04 if brakes else 5e-3)


@pytest.mark.slow
def test_flexion_springs_and_their_dashpots_are_counted():
    """Of stiff ones, two along the border fewer than a whole sheet has, which a finer mesh makes less of."""
    for probe in (units.stretch, units.stretch_damping):
        np.testing.assert_allclose(factors(MassSpring, probe, (9,)), 1.0, rtol=0.05)
    probe, theta = units.stretch(17, 0.1), np.array([65.1, 39.0, 0.05])
    found = probe.found(MassSpring().prepare(probe.scene).run(theta[None]).position[0])
    assert found == pytest.approx(MassSpring().material_of(theta, probe.scene).stretch, rel=0.07)


def test_a_strip_that_does_not_bend_tells_no_bending_and_says_so():
    class Board(BaraffWitkin):
        def prepare(self, scene, effects=()):
            level = np.pad(scene.points, ((0, 0), (0, 1)))[None, None].repeat(len(scene.times), axis=1)
            return SimpleNamespace(run=lambda theta: SimpleNamespace(position=level, status=("ok",), reasons=()))

    told = units._measured(Board(), units.bending(9, 0.1), 9, 0.1)
    assert (told.found, told.reason) == (None, "the strip does not bend")


def test_a_unit_that_forgets_the_density_shows_as_a_factor_of_it():
    class Divided(BaraffWitkin):
        def of_material(self, material, scene):
            theta = super().of_material(material, scene)
            theta[1] /= scene.areal_density
            return theta

        def material_of(self, theta, scene):
            made = super().material_of(theta, scene)
            return dataclasses.replace(made, stretch=made.stretch * scene.areal_density)

    (light, _), (heavy, _) = factors(Divided, units.stretch, (9,))
    assert light == pytest.approx(10.0, rel=0.06)  # and then it hardly stretches, which is measured less well
    assert heavy == pytest.approx(1 / 0.3, rel=0.06)


def test_mass_shows_in_stiffness_and_no_row_claims_it_by_itself():
    class Heavy(BaraffWitkin):
        """Its nodes weigh twice what is stated."""

        def prepare(self, scene, effects=()):
            return super().prepare(dataclasses.replace(scene, areal_density=2 * scene.areal_density), effects)

    ((stretch, _),), ((fall, _),) = (factors(Heavy, probe, (9,), (0.1,)) for probe in (units.stretch, units.fall))
    assert stretch == pytest.approx(0.5, rel=0.02)
    assert fall == pytest.approx(1.0, rel=5e-3)
    assert "whatever the mass" in units._measured(Heavy(), units.fall(9, 0.1), 9, 0.1).formula


def test_what_a_model_cannot_be_told_is_a_reason_and_no_number():
    one = units._measured(KirchhoffLove(), units.fall(9, 0.1), 9, 0.1)
    assert (one.found, one.reason) == (None, "finds rest only, and nothing holds this sheet")
    one = units._measured(Inextensible(), units.stretch_damping(9, 0.1), 9, 0.1)
    assert (one.found, one.reason) == (None, "the model has no parameter for it")


def test_a_row_says_where_it_is_documented(clothbench):
    pytest.importorskip("mujoco")
    rows = [units._measured(Mujoco(), probe(9, 0.1), 9, 0.1) for probe in (units.stretch, units.fall)]
    assert "https://mujoco.readthedocs.io" in rows[0].source
    assert rows[1].source == ""  # of a fall nothing need be documented
    done = clothbench("units")
    assert done.returncode == 2
    assert "the following arguments are required: MODEL" in done.stderr


@pytest.mark.slow
def test_mujocos_units_hold_but_for_bending_at_the_margins():
    pytest.importorskip("mujoco")
    for probe in (units.stretch, units.shear, units.fall):
        np.testing.assert_allclose(factors(Mujoco, probe), 1.0, rtol=5e-3)
    bending = np.array(factors(Mujoco, units.bending))
    assert (np.abs(bending - 0.835) < 0.02).all()  # of a strip four cells wide; the same at both densities


def test_dampings_are_what_is_asked():
    """Newton's strip has twice its tri_kd, once along the pull and once against the change of area."""
    for make, library in ((Mujoco, "mujoco"), (Newton, "newton")):
        pytest.importorskip(library)
        for probe in (units.stretch_damping, units.bending_damping):
            (documented, asked), *_ = factors(make, probe, (9,), (0.1,))
            assert asked == pytest.approx(1.0, rel=0.1)
            if (make, probe) == (Newton, units.stretch_damping):
                assert documented == pytest.approx(2.0, rel=0.1)


@pytest.mark.slow
def test_what_is_documented_as_infinite_is_null_with_a_reason(monkeypatch):
    one = units._measured(Inextensible(), units.stretch(9, 0.1), 9, 0.1)
    monkeypatch.setattr("clothbench.cli.units.measured", lambda make: [one])
    (row,) = unit_rows("inextensible")
    assert (row["documented"], row["factor"], row["reason"]) == (None, None, "infinite: no ratio")
    json.dumps(row, allow_nan=False)


def test_a_target_that_does_not_run_here_is_shown_as_documented(clothbench):
    rows = unit_rows("ppf")
    assert {row["found"] for row in rows} == {None}
    assert all("CUDA" in row["reason"] and "f23b3565" in row["source"] for row in rows)
    shown = clothbench("units", "usd").stdout
    assert "surfaceBendStiffness [N·m]" in shown
    assert "not measured: a schema moves nothing" in shown
    with pytest.raises(ClothbenchError, match="found 'a=b', and 'ppf' is a target of export without options"):
        unit_rows("ppf", ["a=b"])
    with pytest.raises(ClothbenchError, match=r"found resolution=.*, and `units` has meshes of its own"):
        unit_rows("mass_spring", ["resolution=[5,5]"])
    with pytest.raises(ClothbenchError, match="'json' has no units of its own"):
        unit_rows("json")


@pytest.mark.slow
def test_newtons_hinges_are_no_rigidity_and_its_area_stiffness_no_lame_constant():
    pytest.importorskip("newton")
    for probe in (units.shear, units.fall):
        np.testing.assert_allclose(factors(Newton, probe), 1.0, rtol=5e-3)
    documented, asked = np.array(factors(Newton, units.stretch)).T
    np.testing.assert_allclose(documented, 0.75, rtol=5e-3)
    np.testing.assert_allclose(asked, 1.0, rtol=5e-3)
    documented, asked = np.array(factors(Newton, units.bending)).T
    assert documented[0] / documented[2] > 8  # documented as N·m/rad, it is worth less the finer the mesh
    np.testing.assert_allclose(asked[2:], 0.94, rtol=0.02)  # of 17 nodes


# --- viscosity must not brake a fall --------------------------------------------------------------------------------


def test_a_damped_sheet_falls_as_any_other():
    (trial,) = trials.free_fall_damped(9)
    assert trial.material.bending_damping > 0
    check = checks.check_named("free_fall_damped")
    theta, note = parameters_for(BaraffWitkin(), check, trial)
    assert (note, theta[3], theta[4]) == ("", trial.material.bending_damping, trial.material.stretch_damping)


def test_a_model_that_does_not_heed_viscosity_is_skipped():
    class Dry(BaraffWitkin):
        def of_material(self, material, scene):
            return super().of_material(Material(material.bending, material.stretch, material.shear), scene)

    with pytest.raises(CannotDo, match="no parameter for viscosity"):
        parameters_for(Dry(), checks.check_named("free_fall_damped"), trials.free_fall_damped(9)[0])
