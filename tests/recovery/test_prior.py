"""A class of fabrics as a prior: bounds and start of a search come from it, and what was planted is found in them."""

from __future__ import annotations

import json

import numpy as np
import pytest
from clothbench_models.baraff_witkin import BaraffWitkin
from clothbench_models.mass_spring import MassSpring
from conftest import swinging_recording

from clothbench import ClothbenchError, Recording, catalogue, scene_of, write_recording
from clothbench.cli.improve import settings_of
from clothbench.engine.store import Store
from clothbench.engine.suite import plan
from clothbench.estimation.prior import hanging, prior_of
from clothbench.reference import mechanics as references
from clothbench.reference.presets import preset
from clothbench.studies.improve.prepare import prepare
from clothbench.studies.mechanics import scenes

PLANTED, DENSITY, LENGTH = 2.25e-5, 0.35, 0.063  # N·m, kg/m², m


def cantilever() -> Recording:
    """A strip that hangs as the heavy elastica does (no model has a part in it), seen four times, 0.3 mm of noise."""
    load = DENSITY * references.G * LENGTH**3 / PLANTED
    scene = scenes.clamped(LENGTH, 13, load)
    curve = references.cantilever(load)
    s = (scene.points[:, 0] - scene.points[1, 0]) / LENGTH
    x, z = (LENGTH * np.interp(np.maximum(s, 0), curve.s, along) for along in (curve.x, curve.z))
    level = np.where(s < 0, s * LENGTH, x) + scene.points[1, 0]
    line = np.stack([level, scene.points[:, 1], z], axis=1)
    noise = np.random.default_rng(3).normal(0, 3e-4, (4, *line.shape))
    return Recording(
        name="overhang", time=np.linspace(0.0, 0.3, 4), material=scene.points, position=line + noise,
        grip_time=np.array([0.0, 0.3]), grip_material=scene.grip_material, grip_position=scene.grip_position,
        cloth_width=scene.width, cloth_height=scene.height, areal_density=DENSITY, noise_sigma=3e-4, fabric="jeans",
        motion="overhang", split="fit",
    )  # fmt: skip


@pytest.fixture
def fitted(clothbench, tmp_path):
    """The parameters by name that a search finds, given a prior."""
    write_recording(cantilever(), tmp_path / "overhang.nc")

    def call(prior: str, *more: str) -> dict:
        done = clothbench(
            "run", "recording=overhang.nc", "model=baraff_witkin", "optimizer=nelder_mead", "metric=node_error",
            "budget=30", "rerun=false", "jobs=1", "scene.resolution=[13,5]", f"prior={prior}", f"out={prior}", *more
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return {row["name"]: row for row in Store(tmp_path / prior).table("parameters")}

    return call


def test_planted_denim_is_found_from_the_middle_of_denim(fitted):
    found, denim = fitted("denim"), preset("denim")
    bend = found["bend"]
    assert (bend["lower"], bend["upper"]) == pytest.approx((denim.bending.low, denim.bending.high))
    assert bend["start"] == pytest.approx(denim.bending.value, rel=1e-6)
    assert found["shear"]["start"] == pytest.approx(denim.numbers["shear"].value, rel=1e-6)
    assert found["quadratic_drag"]["upper"] == 10.0  # of which fabrics say nothing
    assert bend["value"] == pytest.approx(PLANTED, rel=0.1)
    assert not bend["at_bound"]


@pytest.mark.slow
def test_a_wrong_class_shows_at_its_bound_and_bounds_overrule_it(fitted):
    assert fitted("sheer")["bend"]["at_bound"]
    mine = fitted("wool", "+bounds.bend=[1e-6,1e-3]")["bend"]
    assert (mine["lower"], mine["upper"]) == (1e-6, 1e-3)
    assert mine["value"] == pytest.approx(PLANTED, rel=0.1)


def test_a_model_is_told_what_it_can_be():
    scene = hanging(0.3, 0.3, 0.3)
    assert set(prior_of(preset("denim"), BaraffWitkin(), scene).bounds) == {"bend", "stretch", "shear"}
    springs = prior_of(preset("denim"), MassSpring(), scene)
    assert set(springs.bounds) == {"k1"}  # which has no bending rigidity
    assert springs.bounds["k1"][0] < springs.start["k1"] < springs.bounds["k1"][1]


def test_a_class_that_nobody_measured_is_one_line(clothbench, tmp_path):
    write_recording(cantilever(), tmp_path / "overhang.nc")
    done = clothbench(
        "run", "recording=overhang.nc", "model=baraff_witkin", "optimizer=ga", "metric=node_error", "prior=silk"
    )
    assert done.returncode == 2
    assert done.stderr.strip().startswith("clothbench: no preset 'silk': there is no measured fabric of that class")
    with pytest.raises(ClothbenchError, match="no preset 'silk'"):
        preset("silk")


def test_improve_and_suggest_search_where_a_class_says(clothbench, tmp_path):
    write_recording(swinging_recording("sway"), tmp_path / "rec" / "sway.nc")
    words = ["model=mass_spring", "resolution=5", "prior=denim"]
    (cell,) = plan(settings_of([*words, f"recordings={tmp_path / 'rec'}", f"out={tmp_path}"]), catalogue())
    known = prior_of(preset("denim"), MassSpring(), scene_of(swinging_recording("sway"), resolution=(5, 5)))
    assert cell.bounds == known.bounds
    assert cell.begins == known.start
    (k1,) = (p for p in prepare(cell, catalogue()).space(()) if p.name == "k1")
    assert (k1.bounds, k1.default) == (pytest.approx(known.bounds["k1"]), pytest.approx(known.start["k1"]))
    (own,) = plan(settings_of([*words, "bounds.k1=[1,2]", f"recordings={tmp_path / 'rec'}"]), catalogue())
    assert own.bounds["k1"] == (1.0, 2.0)
    done = clothbench(
        "suggest", "rec", *words, "base=", "durations=0.4", "draws=0", "best=1", "grips=as recorded", "--json"
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)["parameters"]["k1"]
    assert known.bounds["k1"][0] <= found["low"] <= found["high"] <= known.bounds["k1"][1]
    wrong = clothbench("improve", "recordings=rec", "sailing=fast")
    assert "prior=VALUE" in wrong.stderr
    assert "metric=VALUE" not in wrong.stderr
