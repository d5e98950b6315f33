"""Bending against plate theory: energies of cylinder, twist and saddle, beside those of the formulas not taken here."""

import dataclasses

import numpy as np
import pytest
from clothbench_models.bending import bending_matrix
from clothbench_models.sheet_forces import add_diagonals

from clothbench.modelling import grid_lines
from clothbench.modelling.mesh import grid_triangles
from clothbench.modelling.sheet import sheet_of
from clothbench.plugins.discovery import catalogue
from clothbench.studies.mechanics import measures, trials

WIDE, HIGH = 0.2, 0.15  # m
TURN = np.pi / 6
SHAPES = {  # curvatures κ_uu, κ_vv, κ_uv of w = ½ κ_uu u² + ½ κ_vv v² + κ_uv u v
    "cylinder along u": (1.0, 0.0, 0.0),
    "cylinder along v": (0.0, 1.0, 0.0),
    "cylinder along a diagonal": (0.5, 0.5, 0.5),
    "cylinder across it": (0.5, 0.5, -0.5),
    "cylinder at 30 degrees": (np.cos(TURN) ** 2, np.sin(TURN) ** 2, np.cos(TURN) * np.sin(TURN)),
    "twist": (0.0, 0.0, 1.0),
    "saddle": (1.0, -1.0, 0.0),
    "bowl": (1.0, 1.0, 0.0),
}
every_shape = pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)


def sheet(shape, lines=None):
    """A sheet of `shape` nodes, on even lines where none are given."""
    lines = lines or (np.linspace(0, WIDE, shape[0]), np.linspace(0, HIGH, shape[1]))
    uv = np.stack([a.ravel() for a in np.meshgrid(*lines)], axis=1)
    return sheet_of(uv, np.ones(len(uv)), np.ones(len(uv)), grid_triangles(shape), (0, 0, 0), 1.2)


def bent(sheet, curvatures):
    """Deflection (n,) m."""
    (u, v), (uu, vv, uv) = sheet.uv.T, curvatures
    return uu * u**2 / 2 + vv * v**2 / 2 + uv * u * v


def energy(sheet, w):
    """½ xᵀK x for D = 1 N·m of the sheet bent by w (n,) m."""
    matrix, x, f = bending_matrix(sheet), np.stack([sheet.uv[:, 0], sheet.uv[:, 1], w]), np.zeros((3, len(w)))
    add_diagonals(matrix.offsets, matrix.values, x, 1.0, f)
    return (f * x).sum() / 2


def plate(curvatures, area=WIDE * HIGH):
    """Energy of a plate of 1 N·m without cross contraction, ½ ∫ κ_uu² + κ_vv² + 2 κ_uv² [J]."""
    uu, vv, uv = curvatures
    return area * (uu**2 + vv**2 + 2 * uv**2) / 2


# --- quadratic shapes -------------------------------------------------------------------------------------------------


@every_shape
@pytest.mark.parametrize("nodes", [(9, 7), (9, 13), (33, 25)], ids=["square", "oblong", "fine"])
def test_quadratic_shapes_cost_what_a_plate_costs_but_for_half_a_cell_at_free_borders(shape, nodes):
    """There the bending across the border is what costs least, none: κ_uu is lost at two borders and κ_vv at the other
    two, in triangles that make up half a cell's width each. All else is exact: with finer cells the ratio goes to 1."""
    grid, (uu, vv, uv) = sheet(nodes), shape
    lost = (uu**2 / (nodes[0] - 1) + vv**2 / (nodes[1] - 1)) / (uu**2 + vv**2 + 2 * uv**2)
    assert energy(grid, bent(grid, shape)) / plate(shape) == pytest.approx(1 - lost, rel=1e-7)


@every_shape
def test_inside_every_triangle_sees_the_curvatures(shape):
    grid = sheet((9, 13))
    inside = (grid.patch[:, 3:] != grid.triangles).all(axis=1)
    assert inside.sum() == 2 * 8 * 12 - (2 * (8 + 12) - 2)  # the triangles in two corners have two free sides
    seen = np.einsum("fik,fk->fi", grid.curvature, bent(grid, shape)[grid.patch])
    np.testing.assert_allclose(seen[inside], np.broadcast_to(shape, (inside.sum(), 3)), atol=1e-9)


@every_shape
def test_lines_moved_onto_grips_change_little(shape):
    """Twist stays exact; cells of unequal size see a cylinder a few percent wrong, each in its own row."""
    lines = grid_lines(WIDE, 25, np.array([0.021, 0.19])), grid_lines(HIGH, 19, np.array([0.005]))
    assert max(np.diff(lines[1])) / min(np.diff(lines[1])) > 1.7
    even, uneven = sheet((25, 19)), sheet((25, 19), lines)
    ratio = energy(uneven, bent(uneven, shape)) / energy(even, bent(even, shape))
    assert ratio == pytest.approx(1.0, abs=1e-7 if shape == SHAPES["twist"] else 0.03)


def test_rigid_motions_cost_nothing():
    grid = sheet((9, 7), (grid_lines(WIDE, 9, np.array([0.01])), np.linspace(0, HIGH, 7)))
    matrix = bending_matrix(grid)
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    x, f = turn[:, :2] @ grid.uv.T + np.array([[1.0], [2.0], [3.0]]), np.zeros((3, len(grid.uv)))
    add_diagonals(matrix.offsets, matrix.values, x, 1.0, f)
    np.testing.assert_allclose(f, 0, atol=1e-12 * np.abs(matrix.values).max())


def test_a_wave_without_curvature_at_the_borders_costs_what_it_should_to_second_order():
    errors = []
    for cells in (8, 16, 32):
        grid = sheet((cells + 1, cells + 1))
        p, q = np.pi / WIDE, 2 * np.pi / HIGH
        w = np.sin(p * grid.uv[:, 0]) * np.sin(q * grid.uv[:, 1])
        errors.append(energy(grid, w) / (WIDE * HIGH * (p**2 + q**2) ** 2 / 8) - 1)
    assert abs(errors[-1]) < 0.01
    assert errors[0] / errors[1] == pytest.approx(4, abs=0.5)
    assert errors[1] / errors[2] == pytest.approx(4, abs=0.2)


@pytest.mark.parametrize("name", ["baraff_witkin", "inextensible"])
def test_a_small_cantilever_sags_as_from_its_clamp_s_edge(name):
    """Folds at the nodes, and half of one at the clamp, are the trapezoidal rule for ρ g s³/2D over the length: its
    error h²/12·3ρgL²/2D is (h/L)² of the sag ρgL⁴/8D."""
    for along in (9, 17, 33):
        trial = trials.cantilever_small(along)[0]
        model = catalogue().make("models", name)
        position = model.prepare(trial.scene).run(model.of_material(trial.material, trial.scene)[None]).position[0]
        error = trial.measure(trial.scene, position) / trial.reference - 1
        assert error * (along - 2) ** 2 == pytest.approx(1.0, abs=0.04)
        assert measures.rigidity(trial.scene, position) == pytest.approx(trial.material.bending, rel=1e-4)


@pytest.mark.parametrize("cut", [0, 3], ids=["whole", "cut"])
def test_three_corners_of_a_cell_are_no_clamp_and_four_are(cut):
    nodes, triangles = np.arange(36).reshape(6, 6), grid_triangles((6, 6))
    triangles, uv = triangles[: len(triangles) - cut], sheet((6, 6)).uv

    def curvature(held):
        return sheet_of(uv, np.ones(36), np.ones(36), triangles, (0, 0, 0), 1.2, held).curvature

    three, fourth = (nodes[2, 2], nodes[2, 3], nodes[3, 3]), nodes[3, 2]
    np.testing.assert_array_equal(curvature(three), curvature(()))
    clamped, free = curvature((*three, fourth)), curvature(())
    assert np.abs(clamped - free).max() > 0.3 * np.abs(free).max()


@pytest.mark.parametrize(("cells", "error"), [(5, 0.083), (10, 0.041), (20, 0.021)])
def test_couples_on_a_strip_clamped_at_two_columns_approach_its_edge_with_first_order(cells, error):
    """Without weight, and with a couple M everywhere, its curvature is M/D: the tip is M L²/2D off."""
    along, across, couple = np.arange(cells + 2) * 0.05 / cells, np.arange(3) * 0.05 / cells, 1e-4
    uv = np.stack([a.ravel() for a in np.meshgrid(along, across)], axis=1)
    held = np.flatnonzero(uv[:, 0] <= along[1])
    triangles = grid_triangles((len(along), 3))
    grid = sheet_of(uv, np.ones(len(uv)), np.ones(len(uv)), triangles, (0, 0, 0), 1.2, held)
    bends, pushes = np.zeros((len(uv), len(uv))), np.zeros(len(uv))
    for patch, weights, area in zip(grid.patch, grid.curvature, grid.face_area, strict=True):
        for share, row in zip((1, 1, 2), weights, strict=True):
            np.add.at(bends, np.ix_(patch, patch), share * area * np.outer(row, row))
        np.add.at(pushes, patch, couple * area * weights[0])
    columns = (uv[:, :1] == along[2:]).astype(float)  # bent to a cylinder
    tip = np.linalg.solve(columns.T @ bends @ columns, columns.T @ pushes)[-1]
    assert tip / (couple * 0.05**2 / 2) - 1 == pytest.approx(error, abs=1e-3)


@pytest.mark.parametrize("inset", [0.2, 0.45])
@pytest.mark.parametrize("name", ["baraff_witkin", "inextensible"])
def test_cloth_beside_clamps_that_lie_within_the_hems_bends_too(name, inset):
    """Clamped by points a part of a cell within the side hems: the outer rows of the mesh lie there, too."""
    (trial,) = trials.cantilever_small(17)
    cell = trial.scene.height / (trial.scene.resolution[1] - 1)
    within, at = trial.scene.grip_material.copy(), trial.scene.grip_position.copy()
    within[:, 1] = np.clip(within[:, 1], inset * cell, trial.scene.height - inset * cell)
    assert np.ptp(at[0, :, 1]) == pytest.approx(trial.scene.height)
    at[:, :, 1] += np.sign((at[0, -1] - at[0, 0])[1]) * (within - trial.scene.grip_material)[:, 1]
    scene = dataclasses.replace(trial.scene, grip_material=within, grip_position=at)
    model = catalogue().make("models", name)
    theta = model.of_material(trial.material, scene)[None]
    position = model.prepare(scene).run(theta).position[0]
    assert trial.measure(scene, position) == pytest.approx(trial.reference, rel=0.03)


# --- what is not taken here -------------------------------------------------------------------------------------------


def hinges(grid):
    """Every inner edge as (a, b, c, d): its ends and the far corners of the triangles on both sides."""
    beyond = {}
    for corners in grid.triangles:
        for k in range(3):
            a, b, c = np.roll(corners, -k)
            beyond.setdefault((min(a, b), max(a, b)), []).append(c)
    return [(a, b, *far) for (a, b), far in beyond.items() if len(far) == 2]


def area(p, q, r):
    return abs(np.linalg.det([q - p, r - p])) / 2


def cotangent(corner, p, q):
    """Of the angle at a corner."""
    return (p - corner) @ (q - corner) / (2 * area(corner, p, q))


def hinge_energy(grid, w):
    """½ D Σ 3 l²/(A₁ + A₂) θ² over single hinges (Grinspun et al. 2003), with the angle θ of small deflections w."""
    total = 0.0
    for a, b, c, d in hinges(grid):
        p, q = grid.uv[a], grid.uv[b]
        length, angle = np.linalg.norm(q - p), 0.0
        for far in (c, d):
            share = (grid.uv[far] - p) @ (q - p) / length**2
            away = np.linalg.norm(grid.uv[far] - p - share * (q - p))
            angle += (w[far] - (1 - share) * w[a] - share * w[b]) / away
        total += 3 * length**2 / (area(p, q, grid.uv[c]) + area(p, q, grid.uv[d])) * angle**2 / 2
    return total


def edge_laplacian_energy(grid, w):
    """½ D Σ 3/(A₁ + A₂) (k·w)², the cotangent Laplacian on edges (Bergou et al. 2006, section 3)."""
    total = 0.0
    for edge in hinges(grid):
        a, b, c, d = (grid.uv[i] for i in edge)
        one, two, three, four = cotangent(a, b, c), cotangent(a, b, d), cotangent(b, a, c), cotangent(b, a, d)
        k = np.array([three + four, one + two, -one - three, -two - four])
        total += 3 / (area(a, b, c) + area(a, b, d)) * (k @ w[list(edge)]) ** 2 / 2
    return total


def node_laplacian_energy(grid, w):
    """½ D ∫ (Δw)², the cotangent Laplacian on nodes; per area of the inner nodes, times the sheet's."""
    pull, weight = np.zeros(len(w)), np.zeros(len(w))
    for corners, gradient, size in zip(grid.triangles, grid.gradient, grid.face_area, strict=True):
        pull[corners] += size * gradient.T @ gradient @ w[corners]
        weight[corners] += size / 3
    u, v = grid.uv.T
    inner = (u > 1e-9) & (u < WIDE - 1e-9) & (v > 1e-9) & (v < HIGH - 1e-9)
    return (pull**2 / weight)[inner].sum() / 2 * WIDE * HIGH / weight[inner].sum()


@every_shape
def test_single_hinges_and_bergou_s_edges_are_one_and_the_same(shape):
    grid = sheet((9, 7))
    w = bent(grid, shape) + 1e-3 * np.random.default_rng(2).normal(size=len(grid.uv))
    assert hinge_energy(grid, w) == pytest.approx(edge_laplacian_energy(grid, w), rel=1e-9)


def test_on_this_grid_they_are_three_to_nine_times_too_stiff_depending_on_the_direction():
    grid = sheet((33, 25))  # square cells
    ratio = {name: hinge_energy(grid, bent(grid, shape)) / plate(shape) for name, shape in SHAPES.items()}
    for name in ("cylinder along u", "cylinder along v", "cylinder across it", "saddle", "bowl"):
        assert ratio[name] == pytest.approx(3, rel=0.05), name
    for name in ("cylinder along a diagonal", "twist"):
        assert ratio[name] == pytest.approx(9, rel=0.05), name


def test_a_laplacian_on_nodes_is_blind_to_twist_and_saddle():
    grid = sheet((9, 7))
    ratio = {name: node_laplacian_energy(grid, bent(grid, shape)) / plate(shape) for name, shape in SHAPES.items()}
    assert [ratio["twist"], ratio["saddle"]] == pytest.approx([0, 0], abs=1e-9)
    assert [ratio[name] for name in SHAPES if "cylinder" in name] == pytest.approx([1] * 5)
    assert ratio["bowl"] == pytest.approx(2)
