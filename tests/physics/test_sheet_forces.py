"""Forces of triangles and cells against finite differences of energies written down here, and the matrix of an implicit
step against finite differences of the forces."""

import numpy as np
import pytest
from clothbench_models.baraff_witkin import triangle_edges
from clothbench_models.baraff_witkin_kernels import Membrane, Plate, elastic
from clothbench_models.bending import bending_matrix
from clothbench_models.implicit_grid import assemble, empty_matrix, hold_back, invert_blocks, margin_of, multiply, solve
from clothbench_models.resting_contact import FREE, SLIDES, STICKS
from clothbench_models.sheet_forces import CELLS, TRIANGLES

from clothbench.modelling.mesh import grid_triangles
from clothbench.modelling.sheet import sheet_of

LINES = np.array([0.0, 0.03, 0.1, 0.14, 0.2]), np.array([0.0, 0.05, 0.09, 0.16, 0.2, 0.26])  # m
NU, NV = len(LINES[0]), len(LINES[1])
UV = np.stack([a.ravel() for a in np.meshgrid(*LINES)], axis=1)
N = len(UV)
MASS = np.random.default_rng(3).uniform(0.5e-3, 1.5e-3, N)
SHEET = sheet_of(UV, MASS, np.ones(N), grid_triangles((NU, NV)), (0, 0, 0), 1.2)
BENDING = bending_matrix(SHEET)
ROWS = pytest.mark.parametrize("rows", [TRIANGLES, CELLS], ids=["triangles", "cells"])


@pytest.fixture
def crumpled():
    """Positions (3, N) m and velocities m/s: edges up to half as long again and half as short."""
    random = np.random.default_rng(5)
    flat = np.stack([UV[:, 0], 0 * UV[:, 0], -UV[:, 1]])
    return flat + random.normal(0, 0.01, flat.shape), random.normal(0, 0.3, flat.shape)


class Sheet:
    """The forces of one cloth, and the matrix that they keep for an implicit step.

    stiffness: stretch N/m, shear N/m, bending N·m; damping: of the same, times s; scales: how much of the stiffness
    and of the damping goes into the matrix.
    """

    def __init__(self, rows, stiffness, damping, scales=(0.0, 0.0), stiffer=0.0):
        self.rows, self.scales, self.stiffer = rows, scales, stiffer
        lengths, over, share = triangle_edges(LINES, (LINES[0][-1], LINES[1][-1]))
        share[2] *= 2 if rows == CELLS else 1  # a cell is two triangles
        self.rest = lengths, over
        self.stiffness, self.damping = (share * np.array([[a], [a], [b]]) for a, b, _ in (stiffness, damping))
        self.bend, self.bend_damping = stiffness[2], damping[2]

    def forces(self, x, v):
        padded = N + 2 * (NU + 1)
        self.edges, self.shear = np.zeros((10, padded)), np.zeros((self.rows, padded))
        self.work, f = np.zeros((20, padded)), np.zeros((3, N))
        membrane = Membrane(*self.rest, self.stiffness, self.damping)
        plate = Plate(BENDING.offsets, BENDING.values, self.bend, self.bend_damping, np.zeros(2))
        elastic(x, v, f, NU, membrane, plate, self.stiffer, *self.scales, self.edges, self.shear, self.work)
        return f

    @property
    def bend_scale(self):
        return self.scales[0] * self.bend + self.scales[1] * self.bend_damping

    def rows_of_matrix(self, x, v, extra=None):
        self.forces(x, v)
        rows, none = empty_matrix(NU, N, self.rows), np.zeros((6, N))
        assemble(NU, MASS, none if extra is None else extra, extra is not None, self.edges, self.shear,
                 BENDING.offsets, BENDING.values, self.bend_scale, rows, self.work[:6])  # fmt: skip
        return rows

    def matrix(self, x, v, extra=None):
        """The whole of it (3 N, 3 N), column by column."""
        rows, out, margin = self.rows_of_matrix(x, v, extra), np.empty((3 * N, 3 * N)), margin_of(NU)
        for k, column in enumerate(np.eye(3 * N).reshape(-1, 3, N)):
            q, p = np.empty((3, N)), np.pad(column, ((0, 0), (margin, margin)))
            square = multiply(rows, NU, BENDING.offsets, BENDING.values, self.bend_scale, p, q)
            assert square == pytest.approx((column * q).sum(), rel=1e-12)
            out[:, k] = q.ravel()
        return out


def difference(function, x, step=1e-6):
    """Central differences of a function of x (3, N) by every coordinate, along the last axis."""
    steps = step * np.eye(x.size).reshape(-1, *x.shape)
    return np.stack([(np.ravel(function(x + h)) - np.ravel(function(x - h))) / (2 * step) for h in steps], axis=-1)


# --- energies, written down once more -------------------------------------------------------------------------------


def slopes(x, corners):
    """w_u and w_v (M, 3) over pieces whose corners are (M, 3) nodes: the linear map from (u, v) to x."""
    a, b, c = corners.T
    sides = np.stack([UV[b] - UV[a], UV[c] - UV[a]], axis=-1)
    moved = np.stack([x[:, b] - x[:, a], x[:, c] - x[:, a]], axis=-1).transpose(1, 0, 2)
    return (moved @ np.linalg.inv(sides)).transpose(2, 0, 1), np.abs(np.linalg.det(sides)) / 2


def cell_slopes(x):
    """w_u and w_v at the middles of the cells, from the means of opposite edges."""
    a = (np.arange(NV - 1)[:, None] * NU + np.arange(NU - 1)).ravel()
    b, c, d = a + 1, a + NU, a + NU + 1
    wide, high = (UV[b] - UV[a])[:, 0], (UV[c] - UV[a])[:, 1]
    along_u, along_v = (x[:, b] - x[:, a] + x[:, d] - x[:, c]) / 2, (x[:, c] - x[:, a] + x[:, d] - x[:, b]) / 2
    return (along_u / wide).T, (along_v / high).T, wide * high


def conditions(x, rows):
    """√a C of stretch (2 F,) and of shear, such that energies are k/2 Σ C² (Baraff and Witkin 1998, 4.2 and 4.3)."""
    (wu, wv), area = slopes(x, SHEET.triangles)
    stretch = np.sqrt(area) * np.stack([np.linalg.norm(wu, axis=1) - 1, np.linalg.norm(wv, axis=1) - 1])
    if rows == CELLS:
        wu, wv, area = cell_slopes(x)
    return stretch.ravel(), np.sqrt(area) * (wu * wv).sum(axis=1)


def energy(x, rows, stretch, shear):
    c, s = conditions(x, rows)
    return (stretch * c @ c + shear * s @ s) / 2


def dissipation(x, v, rows, stretch, shear):
    """½ Σ k_d Ċ²; its derivative by the velocities is what dampers take."""
    ahead, behind = (conditions(x + sign * 1e-6 * v, rows) for sign in (1, -1))
    rates = [(a - b) / 2e-6 for a, b in zip(ahead, behind, strict=True)]
    return (stretch * rates[0] @ rates[0] + shear * rates[1] @ rates[1]) / 2


# --- forces ---------------------------------------------------------------------------------------------------------


@ROWS
@pytest.mark.parametrize(("stretch", "shear"), [(60.0, 0.0), (0.0, 20.0), (60.0, 20.0)])
def test_forces_are_minus_the_gradient_of_the_energy(crumpled, rows, stretch, shear):
    x, v = crumpled
    found = Sheet(rows, (stretch, shear, 0.0), (0, 0, 0)).forces(x, v)
    expected = -difference(lambda y: energy(y, rows, stretch, shear), x)
    np.testing.assert_allclose(found.ravel(), expected[0], rtol=1e-6, atol=1e-7)


@ROWS
@pytest.mark.parametrize(("stretch", "shear"), [(0.02, 0.0), (0.0, 0.03)])
def test_dampers_pull_as_the_conditions_change(crumpled, rows, stretch, shear):
    """f = −k_d ∂C/∂x Ċ (Baraff and Witkin 1998, eq. 11)."""
    x, v = crumpled
    found = Sheet(rows, (0, 0, 0), (stretch, shear, 0.0)).forces(x, v)
    expected = -difference(lambda w: dissipation(x, w, rows, stretch, shear), v, 0.1)
    np.testing.assert_allclose(found.ravel(), expected[0], rtol=1e-5, atol=1e-8)


@ROWS
@pytest.mark.parametrize("damping", [(0.02, 0, 0), (0, 0.03, 0), (0, 0, 1e-5)], ids=["stretch", "shear", "bending"])
def test_dampers_take_energy_and_keep_the_momenta(crumpled, rows, damping):
    """Bending's damper is linear in velocities as its energy is in positions: a rigid spin of a bent sheet wakes it."""
    x, v = crumpled
    sheet = Sheet(rows, (0, 0, 0), damping)
    found = sheet.forces(x, v)
    assert (found * v).sum() < -1e-6
    np.testing.assert_allclose(found.sum(axis=1), 0, atol=1e-12)
    if damping[2] == 0:
        np.testing.assert_allclose(np.cross(x.T, found.T).sum(axis=0), 0, atol=1e-12)
        spin = np.cross([0.1, 0.2, 0.3], x.T).T.copy()
        np.testing.assert_allclose(sheet.forces(x, spin), 0, atol=1e-12)


def test_a_sheet_moved_and_turned_as_a_whole_bears_no_force():
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    x = turn[:, :2] @ UV.T + np.array([[1.0], [2.0], [3.0]])
    for rows in (TRIANGLES, CELLS):
        np.testing.assert_allclose(Sheet(rows, (1000.0, 500.0, 1e-3), (0, 0, 0)).forces(x, 0 * x), 0, atol=1e-10)


# --- the matrix of an implicit step ---------------------------------------------------------------------------------

GAMMA = 2e-3  # s
SCALES = GAMMA**2, GAMMA
ALL = (60.0, 20.0, 1e-3), (0.02, 0.03, 1e-6)


def mass_matrix():
    return np.diag(np.tile(MASS, 3))


def test_the_matrix_of_stretch_and_bending_is_exact_under_tension(crumpled):
    """M − γ² ∂f/∂x of a bulging sheet whose edges are all too long."""
    flat = np.stack([UV[:, 0], 0 * UV[:, 0], -UV[:, 1]])
    x = 1.6 * flat + 0.2 * (crumpled[0] - flat)
    sheet = Sheet(TRIANGLES, (60.0, 0.0, 1e-3), (0, 0, 0), SCALES)
    found = sheet.matrix(x, 0 * x)
    assert (conditions(x, TRIANGLES)[0] > 0).all()
    expected = mass_matrix() - GAMMA**2 * difference(lambda y: sheet.forces(y, 0 * y), x)
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())


@ROWS
def test_the_matrix_of_shear_is_exact_where_nothing_is_sheared(rows):
    """The rest of it, C ∂²C, is left out: what could make the matrix indefinite (Choi and Ko 2002, section 4.2)."""
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    x = turn[:, :2] @ np.stack([1.1 * UV[:, 0] + UV[:, 0] ** 2, 1.05 * UV[:, 1] + 2 * UV[:, 1] ** 2])
    assert np.abs(conditions(x, rows)[1]).max() < 1e-12
    sheet = Sheet(rows, ALL[0], (0, 0, 0), SCALES)
    found = sheet.matrix(x, 0 * x)
    expected = mass_matrix() - GAMMA**2 * difference(lambda y: sheet.forces(y, 0 * y), x)
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())


@ROWS
def test_the_matrix_of_damping_is_exact(crumpled, rows):
    """M − γ ∂f/∂v in any shape; that dampers turn with the sheet, a term of the first order in v, is left out."""
    x, v = crumpled
    sheet = Sheet(rows, *ALL, (0.0, GAMMA))
    found = sheet.matrix(x, v)
    expected = mass_matrix() - GAMMA * difference(lambda w: sheet.forces(x, w), v, 0.1)
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())


@ROWS
def test_the_matrix_is_symmetric_and_positive_even_where_the_true_one_is_not(crumpled, rows):
    x, v = crumpled
    sheet = Sheet(rows, (6000.0, 2000.0, 0.0), (0.02, 0.03, 0.0), SCALES)
    found = sheet.matrix(x, v)
    np.testing.assert_allclose(found, found.T, atol=1e-15)
    assert np.linalg.eigvalsh(found)[0] > 0.99 * MASS.min()
    true = mass_matrix() - GAMMA**2 * difference(lambda y: sheet.forces(y, 0 * y), x)
    assert np.linalg.eigvalsh((true + true.T) / 2)[0] < 0


def test_what_effects_add_to_the_stretch_stiffens_the_matrix_and_not_the_forces(crumpled):
    x, v = crumpled
    plain, stiffer = Sheet(TRIANGLES, *ALL, SCALES), Sheet(TRIANGLES, *ALL, SCALES, stiffer=0.5)
    np.testing.assert_array_equal(plain.forces(x, v), stiffer.forces(x, v))
    added = stiffer.matrix(x, v) - plain.matrix(x, v)
    along = Sheet(TRIANGLES, (0, 0, 0), (30.0, 0.0, 0.0), (0.0, GAMMA**2)).matrix(x, v) - mass_matrix()
    np.testing.assert_allclose(added, along, atol=1e-12)


def heavier():
    """Mass tensors (6, N) kg of air that goes along with the sheet's normals."""
    n = np.random.default_rng(8).normal(size=(3, N))
    n /= np.linalg.norm(n, axis=0)
    return 1e-3 * np.stack([n[0] ** 2, n[1] ** 2, n[2] ** 2, n[1] * n[2], n[0] * n[2], n[0] * n[1]])


# --- the solver -----------------------------------------------------------------------------------------------------


def contacts():
    """What the nodes can do, some held and some sliding, with the normals (3, N) of their obstacles."""
    touch = np.full(N, FREE)
    touch[[0, NU - 1]], touch[[7, 12, 13]] = STICKS, SLIDES
    normal = np.random.default_rng(9).normal(size=(3, N))
    return touch, normal / np.linalg.norm(normal, axis=0)


def test_held_nodes_lose_everything_and_sliding_ones_what_goes_into_the_obstacle():
    touch, normal = contacts()
    before = np.random.default_rng(4).normal(size=(3, N))
    after = before.copy()
    hold_back(after, touch, normal)
    assert (after[:, touch == STICKS] == 0).all()
    np.testing.assert_array_equal(after[:, touch == FREE], before[:, touch == FREE])
    slides = touch == SLIDES
    np.testing.assert_allclose((after * normal).sum(axis=0)[slides], 0, atol=1e-15)
    np.testing.assert_allclose(np.cross(after.T, normal.T)[slides], np.cross(before.T, normal.T)[slides], atol=1e-15)


def within(touch, normal):
    """(3 N, M) an orthonormal basis of all motions that the contacts allow."""
    allowed = np.eye(3 * N).reshape(-1, 3, N).copy()
    for column in allowed:
        hold_back(column, touch, normal)
    left, sizes, _ = np.linalg.svd(allowed.reshape(3 * N, -1))
    return left[:, sizes > 0.5]


@ROWS
@pytest.mark.parametrize("extra", [None, heavier()], ids=["bare", "with air"])
def test_the_nodes_own_blocks_are_inverted_within_what_nodes_can_follow(crumpled, rows, extra):
    sheet, (touch, normal), inverse = Sheet(rows, *ALL, SCALES), contacts(), np.full((6, N), np.nan)
    whole = sheet.matrix(*crumpled, extra).reshape(3, N, 3, N)
    invert_blocks(NU, sheet.rows_of_matrix(*crumpled, extra), touch, normal, inverse)
    for i in range(N):
        xx, yy, zz, yz, xz, xy = inverse[:, i]
        found, full = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), np.linalg.inv(whole[:, i, :, i])
        along = normal[:, i] if touch[i] == SLIDES else np.zeros(3)
        follows = (touch[i] != STICKS) * (np.eye(3) - np.outer(along, along))
        np.testing.assert_allclose(found, follows @ full @ follows, rtol=1e-9, atol=1e-9 * np.abs(full).max())


@ROWS
@pytest.mark.parametrize("extra", [None, heavier()], ids=["bare", "with air"])
@pytest.mark.parametrize("held", [False, True], ids=["free", "among obstacles"])
def test_the_solver_solves_within_what_nodes_can_follow(crumpled, rows, extra, held):
    touch, normal = contacts() if held else (np.full(N, FREE), np.zeros((3, N)))
    sheet = Sheet(rows, *ALL, SCALES)
    whole, matrix = sheet.matrix(*crumpled, extra), sheet.rows_of_matrix(*crumpled, extra)
    right = np.random.default_rng(6).normal(size=(3, N))
    delta, r, inverse, (z, q) = np.empty((3, N)), right.copy(), np.empty((6, N)), np.empty((2, 3, N))
    rounds = solve(
        delta, r, NU, matrix, BENDING.offsets, BENDING.values, sheet.bend_scale, touch, normal, 1e-11, 500,
        inverse, z, np.empty((3, N + 2 * margin_of(NU))), q,
    )  # fmt: skip
    assert 5 < rounds < 100
    basis = within(touch, normal)
    assert basis.shape[1] == 3 * N - (2 * 3 + 3 if held else 0)
    expected = basis @ np.linalg.solve(basis.T @ whole @ basis, basis.T @ right.ravel())
    np.testing.assert_allclose(delta.ravel(), expected, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(basis.T @ r.ravel(), 0, atol=1e-9 * np.abs(right).max())
