"""What fabrics are like: no number without its spread, unit and source, and the same as the data say."""

from __future__ import annotations

import json
import math
import re

import bending_classes
import make_presets
import numpy as np
import pytest

from clothbench import catalogue
from clothbench.cli.presets import preset_rows
from clothbench.reference.presets import presets
from clothbench.twins.of_preset import twin_of_preset


def test_every_number_has_a_spread_a_unit_and_a_source():
    rows = preset_rows(None)
    assert {row["preset"] for row in rows} == set(presets())
    for row in rows:
        assert row["low"] <= row["value"] <= row["high"], row
        assert row["low"] < row["high"], row
        assert row["unit"]
        assert len(row["source"]) > 10
    for one in presets().values():
        assert {"areal_density", "bending_warp", "bending_weft", "stretch", "shear"} <= set(one.numbers)


def test_a_fitted_class_says_by_what_and_of_what():
    """The interval of a fit holds what its stand-in was made with."""
    made = {"linen": (0.0008, 0.0045), "fleece": (0.0001,)}
    for name, truths in made.items():
        bending = presets()[name].bending
        assert all(bending.low <= truth <= bending.high for truth in truths)
        assert bending.source.startswith(f"fitted by baraff_witkin to {name}/static-2")
        assert "Bhat et al. 2003" in bending.source


def test_the_stretch_of_one_fabric_lies_between_its_threads_and_says_so():
    stretch = presets()["denim"].numbers["stretch"]
    warp, weft = map(float, re.findall(r"(\d+) along", stretch.source))
    assert stretch.low < warp < weft < stretch.high
    assert stretch.value == pytest.approx(math.sqrt(warp * weft), rel=5e-3)
    each = [presets()["denim"].numbers[f"stretch_{thread}"] for thread in ("warp", "weft")]
    assert [one.value for one in each] == [warp, weft]
    assert all("the first direction is taken for the warp" in one.source for one in each)
    assert presets()["denim"].material.stretch_ratio == pytest.approx(warp / weft)
    assert presets()["knit"].material.stretch_ratio == 1.0  # several fabrics, whose threads are not told apart


def test_a_fabric_bends_under_its_own_weight_not_under_that_of_the_one_beside_it():
    density, stiffness = np.array([0.1, 0.09, 0.2]), np.array([1e-5, 0.9e-5, 1e-5])
    near = bending_classes.lengths_near(0.1, density, stiffness)
    assert near == pytest.approx(1e3 * (1e-4 / 9.81) ** (1 / 3) * np.ones(2), rel=1e-3)


def test_they_are_printed_with_their_sources(clothbench):
    done = clothbench("presets", "wool")
    assert (done.returncode, done.stderr) == (0, "")
    assert "1.46e-05 … 4.11e-05" in done.stdout
    assert len(json.loads(clothbench("presets", "--json").stdout)) == len(preset_rows(None))
    assert clothbench("presets", "Wool").stdout == done.stdout
    unknown = clothbench("presets", "silk")
    assert unknown.returncode == 2
    assert unknown.stderr.strip().endswith(f"there are: {', '.join(presets())}")


def test_a_preset_leaves_for_a_simulator():
    text = catalogue().load("exporters", "json").export(twin_of_preset("denim")).text
    bending = json.loads(text)["material"]["bending"]
    assert bending["low"] < bending["value"] < bending["high"]
    assert json.loads(text)["interval"] == "range of the class"
    assert "along the warp and" in catalogue().load("exporters", "ppf").export(twin_of_preset("denim")).text


def rolled(cells: int, curvature: float) -> tuple[np.ndarray, np.ndarray]:
    """A square of 1 m rolled about v, (n, 3) m, and its triangles: two to a cell, all cut along the same diagonal."""
    u, v = np.meshgrid(np.linspace(0, 1, cells + 1), np.linspace(0, 1, cells + 1), indexing="ij")
    turned = curvature * u.ravel()
    nodes = np.stack([np.sin(turned) / curvature, v.ravel(), (1 - np.cos(turned)) / curvature], axis=1)
    number = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    one = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:]], axis=-1).reshape(-1, 3)
    two = np.stack([number[:-1, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1).reshape(-1, 3)
    return nodes, np.concatenate([one, two])


def test_a_hinge_of_arcsim_resists_as_a_plate_of_a_quarter():
    """Its energy k l²/2A · θ²/4 of all hinges, beside ½Dκ² of the plate."""
    curvature, stiffness, hinges = 0.1, 3.0, {}
    nodes, triangles = rolled(32, curvature)
    corners = nodes[triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(cross, axis=1)
    energy = 0.0
    for f, nodes_of in enumerate(triangles.tolist()):
        for k in range(3):
            edge = frozenset((nodes_of[k], nodes_of[k - 1]))
            if (other := hinges.setdefault(edge, f)) != f:
                angle = math.asin(np.linalg.norm(np.cross(cross[f], cross[other])) / size[f] / size[other])
                length = math.dist(*nodes[list(edge)])
                energy += stiffness * length**2 / (size[f] + size[other]) * angle**2 / 4  # 2A of both
    assert energy == pytest.approx(make_presets.rigidity(stiffness) * curvature**2 / 2, rel=0.04)


def test_a_strip_and_a_sheared_sheet_of_arcsim():
    """From its energy, c11 to c33 doubled: second derivatives at rest, of a strip with its width free."""
    c11, c12, c22, c33 = 205.0, 62.0, 1014.0, 53.0

    def energy(f: np.ndarray) -> float:
        green = (f.T @ f - np.eye(2)) / 2
        u, v, uv = green[0, 0], green[1, 1], green[0, 1]
        return 2 * (c11 * u * u / 2 + c22 * v * v / 2 + c12 * u * v + c33 * uv * uv)

    h = 1e-4
    narrow = np.linspace(-h, h, 20001)
    least = min(energy(np.diag([1 + h, 1 + n])) for n in narrow)
    assert 2 * least / h**2 == pytest.approx(make_presets.strip(c11, c12, c22), rel=1e-3)
    sheared = energy(np.array([[1.0, h], [0.0, 1.0]]))
    assert 2 * sheared / h**2 == pytest.approx(make_presets.shear_modulus(c33), rel=1e-3)


@pytest.mark.data
def test_the_numbers_are_those_of_the_data(data_dir):
    for name in ("wang2011-arcsim-materials", "cantilever-618-fabrics", "knit-uniaxial-gatech"):
        if not (data_dir / name).is_dir():
            pytest.skip(f"{name} is not in {data_dir}")
    assert make_presets.presets(data_dir) == json.loads(make_presets.TARGET.read_text())
