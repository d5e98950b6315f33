"""`mass_spring_verlet` against mechanics: forces from an energy, mesh independence, stability, and known motions."""

import numpy as np
import pytest
from clothbench_models.mass_spring_kernels import add_pairwise, elastic_forces
from clothbench_models.mass_spring_verlet import MassSpringVerlet
from clothbench_models.spring_grid import SpringGrid
from scipy.linalg import eigh
from scipy.optimize import curve_fit

from clothbench import ClothbenchError, Scene
from clothbench.core.protocols import Material

G = 9.81
FAMILIES = (
    MassSpringVerlet()
    .prepare(
        Scene(
            0.1,
            0.1,
            0.2,
            np.array([0.0, 1.0]),
            np.zeros((0, 2)),
            np.zeros((2, 0, 3)),
            np.array([0.0]),
            np.zeros((1, 2)),
        )
    )
    .families
)
STIFFNESS = np.array([60.0, 7, 3, 2, 50, 6, 4, 1, 20, 5, 2, 3])  # H1…H4, V1…V4, D1…D4


def grid_of(nu, nv, width, height):
    return SpringGrid.of((np.linspace(0, width, nu), np.linspace(0, height, nv)), (width, height), 0.2, FAMILIES)


def energy(grid, k, x):
    """Σ k/2 (l − L)² over all springs [J]."""
    total = 0.0
    for f, (_, _, which) in enumerate(grid.families):
        e = np.flatnonzero(grid.share[f])
        length = np.linalg.norm(x[:, e + grid.strides[f]] - x[:, e], axis=0)
        total += 0.5 * np.sum(k[which] * grid.share[f, e] * (length - grid.rest[f, e]) ** 2)
    return total


def forces(grid, k, x):
    out, begin = np.zeros_like(x), int(grid.strides.max())
    g = np.zeros((len(grid.strides), 3, begin + x.shape[1]))
    for f, (_, _, which) in enumerate(grid.families):
        elastic_forces(x, grid.strides[f], grid.rest[f], k[which] * grid.share[f], g[f], begin)
        add_pairwise(out, g[f], begin, grid.strides[f])
    return out


def flat(grid):
    return np.stack([grid.uv[:, 0], 0 * grid.uv[:, 0], -grid.uv[:, 1]])


def hung(width, height, times, shape, moved=None, points=None):
    """A scene with the top edge held at the nodes; `moved(t) -> (K, 3)` shifts all grips together."""
    held = np.column_stack([np.linspace(0, width, shape[0]), np.zeros(shape[0])])
    clock = np.linspace(0.0, times[-1], 400)
    at = np.stack([held[:, 0], 0 * held[:, 0], -held[:, 1]], axis=1)
    path = at[None] + (moved(clock)[:, None] if moved else np.zeros((400, 1, 3)))
    points = np.array([(width / 2, height)]) if points is None else points
    return Scene(width, height, 0.2, clock, held, path, times, points, resolution=shape)


def test_there_are_sixteen_families_of_springs():
    """Figure 2 of the paper, and its mirror image for the other diagonal; small grids have those that fit."""
    assert len(FAMILIES) == 16
    assert {(di, dj) for di, dj, _ in FAMILIES} == {
        (a * k, b * k) for k in (1, 2, 3, 4) for a, b in ((1, 0), (0, 1), (1, 1), (-1, 1))
    }
    assert len(grid_of(3, 3, 0.1, 0.1).families) == 8


@pytest.mark.parametrize("shape", [(7, 6), (3, 4)])
def test_forces_are_minus_the_gradient_of_the_energy(shape):
    grid = grid_of(*shape, 0.2, 0.25)
    x = flat(grid) + np.random.default_rng(5).normal(0, 0.01, (3, len(grid.mass)))
    found, step = forces(grid, STIFFNESS, x), 1e-6
    for c, e in np.ndindex(x.shape):
        up, down = x.copy(), x.copy()
        up[c, e] += step
        down[c, e] -= step
        expected = -(energy(grid, STIFFNESS, up) - energy(grid, STIFFNESS, down)) / (2 * step)
        assert found[c, e] == pytest.approx(expected, rel=1e-5, abs=1e-7)


@pytest.mark.parametrize("which", range(12))
def test_membrane_stiffness_is_that_of_the_formula_and_the_mesh_only_moves_the_border(which):
    """C11 = Σ k² (H_k + D_k) in warp strain; k − 1 cells at the border lack long springs, ever less of the sheet."""
    k = which % 4 + 1
    expected = 0.0 if which // 4 == 1 else k**2
    misses = []
    for n in (17, 33, 65):
        grid = grid_of(n, n, 0.3, 0.3)
        x = flat(grid) * np.array([[1.001], [1], [1]])
        misses.append(expected - energy(grid, np.eye(12)[which], x) * 2 / 0.3e-3**2)
    assert abs(misses[-1]) <= 0.01 * expected + 2.2 * expected * (k - 1) / 64
    if k > 1 and expected:
        assert misses[1] / misses[2] == pytest.approx(2.0, rel=0.1)


def test_the_step_bound_lies_just_below_the_stiffest_mode():
    grid = grid_of(6, 7, 0.2, 0.25)
    x, step = flat(grid), 1e-7
    columns = []
    for c, e in np.ndindex(x.shape):
        moved = x.copy()
        moved[c, e] += step
        columns.append(-(forces(grid, STIFFNESS, moved) - forces(grid, STIFFNESS, x)).ravel() / step)
    stiffness = np.array(columns)
    largest = eigh((stiffness + stiffness.T) / 2, np.diag(np.tile(grid.mass, 3)), eigvals_only=True)[-1]
    scene = hung(0.2, 0.25, np.array([0.0, 1.0]), (6, 7))
    simulation = MassSpringVerlet().prepare(scene)
    bound = simulation.stable_step(np.array([[*STIFFNESS, 0.0]]))[0]
    assert 0.75 < bound * np.sqrt(largest) / 2 <= 1.0
    assert simulation.stable_step(np.array([[*STIFFNESS, 100.0]]))[0] < bound


def test_free_fall_is_exact_and_loss_gives_its_terminal_speed():
    """v = g/c (1 − e^(−ct)) with the loss c, which the scheme takes to first order in the step."""
    times = np.linspace(0.0, 0.5, 6)
    uv = np.array([[0.1, 0.1], [0.0, 0.2]])
    scene = Scene(0.2, 0.2, 0.2, times[[0, -1]], np.zeros((0, 2)), np.zeros((2, 0, 3)), times, uv, resolution=(5, 5))
    whole, half = (
        MassSpringVerlet(step_scale=scale).prepare(scene).run([[*STIFFNESS, 0.0], [*STIFFNESS, 5.0]]).position[..., 2]
        for scale in (1.0, 0.5)
    )
    free = whole[0] - whole[0, 0]
    np.testing.assert_allclose(free, np.broadcast_to(-0.5 * G * times[:, None] ** 2, free.shape), atol=5e-6)
    lost = -G / 5 * (times - (1 - np.exp(-5 * times)) / 5)
    errors = [(z[1, -1, 0] - z[1, 0, 0]) / lost[-1] - 1 for z in (whole, half)]
    assert abs(errors[0]) < 0.003
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.05)


def test_a_hanging_sheet_swings_as_the_bessel_function_says():
    """ω₁ = (2.4048/2) √(g/L): a heavy hanging chain (D. Bernoulli 1733)."""
    times, length = np.arange(0.5, 4.0, 0.01), 0.297

    def pull(t):
        pulse = 1e-3 * np.exp(-(((t - 0.2) / 0.06) ** 2))
        return np.stack([0 * t, pulse, 0 * t], axis=1)

    scene = hung(length / 4, length, times, (5, 17), pull)
    theta = MassSpringVerlet().of_material(Material(0.0, 1500.0, 300.0), scene)
    y = MassSpringVerlet().prepare(scene).run([theta]).position[0, :, 0, 1]
    second = 5.5201 / 2.4048

    def modes(t, f, a, b, c, d):
        w = 2 * np.pi * f * t
        return a * np.sin(w) + b * np.cos(w) + c * np.sin(second * w) + d * np.cos(second * w)

    best, _ = curve_fit(modes, times, y / np.abs(y).max(), p0=[1.1, 0.5, 0.5, 0.1, 0.1], maxfev=20000)
    assert best[0] == pytest.approx(2.4048 / 2 * np.sqrt(G / length) / (2 * np.pi), rel=0.01)


def test_a_strip_of_a_material_stretches_by_its_own_weight():
    """The lower end sinks by ρ g L²/(2 E)."""
    scene = hung(0.05, 0.4, np.array([0.0, 0.1]), (4, 25))
    theta = MassSpringVerlet().of_material(Material(0.0, 300.0, 80.0), scene)
    z = MassSpringVerlet().prepare(scene).run([theta]).position[0, -1, 0, 2]
    assert -0.4 - z == pytest.approx(0.2 * G * 0.16 / (2 * 300.0), rel=0.05)


def test_it_has_no_bending_rigidity_to_offer():
    with pytest.raises(ClothbenchError, match="no small-strain bending"):
        MassSpringVerlet().of_material(Material(1e-6, 300.0, 80.0), hung(0.1, 0.1, np.array([0.0, 0.1]), (5, 5)))
