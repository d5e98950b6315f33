"""Stretch and bending of all triangles at once: rows of a regular grid and triangles of any mesh give the same."""

from __future__ import annotations

import numpy as np
import pytest
from clothbench_effects.bending_hysteresis import decay

from clothbench.modelling.mesh import grid_triangles
from clothbench.modelling.sheet import sheet_of
from clothbench.plugins.discovery import catalogue

EFFECTS = {
    "bending_hysteresis": (1e-3, 5.0),
    "plastic_bending": (1e-4, 20.0),
    "viscoelasticity": (1e-4, 50.0, 0.01),
    "rest_curvature": (3e-4, -2e-4),
    "crease": (1e-5, 0.6, 0.5),
    "bending_anisotropy": (2e-4, 5e-5),
    "poisson_coupling": (30.0,),
    "stretch_stiffening": (2000.0,),
}
SHAPES = [(2, 2), (2, 5), (5, 2), (3, 3), (4, 7), (13, 6)]


def lines(shape, even, random):
    """Grid lines along u and v [m], 0.02 apart, or between 0.01 and 0.03."""
    return [np.cumsum(np.full(k, 0.02) if even else random.uniform(0.01, 0.03, k)) for k in shape]


def two_sheets(shape, even=True, held=()):
    """The same sheet twice, known as a grid and with its triangles in disorder; and its nodes (3, n) m, crumpled."""
    random = np.random.default_rng(3)
    uv = np.stack([a.ravel() for a in np.meshgrid(*lines(shape, even, random))], axis=1)
    ones, triangles = np.ones(len(uv)), grid_triangles(shape)
    sheets = [
        sheet_of(uv, ones, ones, rows, (0, 0, 0), 1.2, held)
        for rows in (triangles, np.roll(random.permutation(triangles), 1, axis=1))
    ]
    x = np.stack([uv[:, 0], uv[:, 1], 0 * uv[:, 0]]) + random.normal(0, 0.004, (3, len(uv)))
    return sheets, x


def forces(name, sheet, shapes):
    """What an effect adds at some shapes, one after the other, the first two at the same time: (steps, 3, n) N."""
    effect, out = catalogue().make("effects", name), np.zeros((len(shapes), *shapes[0].shape))
    state = np.zeros(effect.state_size(sheet) if hasattr(effect, "state_size") else 0)
    for step, x in enumerate(shapes):
        still = np.zeros_like(x)
        t = 2e-3 * max(0, step - 1)
        effect.force(t, 2e-3, np.ascontiguousarray(x), still, out[step], sheet, np.array(EFFECTS[name]), state)
    return out


def moved(x, steps=6):
    random = np.random.default_rng(8)
    return [x + random.normal(0, 0.002, x.shape) for _ in range(steps)]


@pytest.mark.parametrize("even", [True, False], ids=["even", "uneven"])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("name", EFFECTS)
def test_a_grid_and_its_triangles_in_disorder_push_and_remember_alike(name, shape, even):
    (grid, mesh), x = two_sheets(shape, even)
    assert (grid.columns, mesh.columns) == (shape[0], 0)
    found, expected = (forces(name, sheet, moved(x)) for sheet in (grid, mesh))
    # Two triangles have no neighbours but each other, and with that the curvature across their common edge only.
    bends_to_nothing = shape[0] == 2 and shape[1] == 2 and name in ("rest_curvature", "bending_anisotropy")
    assert (np.abs(expected[-1]).max() > 1e-9) != bends_to_nothing
    scale = 1.0 if bends_to_nothing else np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * scale)


@pytest.mark.parametrize("along", ["u", "v", "corner"])
@pytest.mark.parametrize("name", EFFECTS)
def test_a_grid_and_its_triangles_in_disorder_leave_a_clamp_alike(name, along):
    nodes = np.arange(42).reshape(6, 7)
    held = {"u": nodes[:, 1:3], "v": nodes[3:5], "corner": nodes[3:, 4:]}[along].ravel()
    (grid, mesh), x = two_sheets((7, 6), even=False, held=held)
    free, _ = two_sheets((7, 6), even=False)
    assert (grid.columns, mesh.columns) == (7, 0)
    found, expected, without = (forces(name, sheet, moved(x)) for sheet in (grid, mesh, free[0]))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    bends = name not in ("poisson_coupling", "stretch_stiffening")
    assert (np.abs(found - without).max() > 1e-3 * np.abs(found).max()) == bends


@pytest.mark.parametrize("collapsed", ["to a point", "to a line"])
@pytest.mark.parametrize("name", EFFECTS)
def test_collapsed_triangles_do_no_harm(name, collapsed):
    (grid, mesh), x = two_sheets((4, 4))
    flat = x.copy()
    flat[:, 5] = x[:, 6]
    flat[:, 10] = x[:, 6] if collapsed == "to a point" else 2 * x[:, 6] - x[:, 1]
    shapes = [x, flat, flat, x]
    found, expected = (forces(name, sheet, shapes) for sheet in (grid, mesh))
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("change", ["slanting lines", "descending", "other diagonals", "no grid"])
def test_what_is_no_grid_of_straight_lines_is_not_taken_for_one(change):
    uv = np.stack([a.ravel() for a in np.meshgrid(np.arange(4.0), np.arange(5.0))], axis=1)
    triangles = grid_triangles((4, 5))
    if change == "slanting lines":
        uv[:, 0] += 0.1 * uv[:, 1]
    elif change == "descending":
        uv[:, 1] *= -1
    elif change == "other diagonals":
        triangles[0], triangles[1] = (0, 1, 4), (1, 5, 4)
    else:
        triangles = triangles[:-1]
    sheet = sheet_of(uv, np.ones(20), np.ones(20), triangles, (0, 0, 0), 1.2)
    assert sheet.columns == 0
    np.testing.assert_array_equal(sheet.slots[0], sheet.face_area)


def test_slots_of_a_grid_hold_its_area():
    (grid, mesh), _ = two_sheets((13, 6), even=False)
    assert grid.slots[0].sum() == pytest.approx(mesh.face_area.sum(), rel=1e-12)


def test_the_exponential_without_branches_is_one():
    y = np.concatenate([[0.0], np.logspace(-15, 4, 2000), np.linspace(0.0, 60.0, 2000)])
    found = np.array([decay(each) for each in y])
    np.testing.assert_allclose(found, np.expm1(-y), rtol=2e-12, atol=0)
    assert decay(0.0) == 0.0
