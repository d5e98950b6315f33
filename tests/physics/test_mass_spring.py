"""`mass_spring` against mechanics: its forces are the gradient of an energy, and it meets analytic references."""

import dataclasses

import numpy as np
import pytest
from clothbench_effects.added_mass import AddedMass
from clothbench_effects.clock_offset import ClockOffset
from clothbench_effects.gravity_tilt import GravityTilt
from clothbench_effects.linear_drag import LinearDrag
from clothbench_effects.point_mass import PointMass
from clothbench_effects.quadratic_drag import QuadraticDrag
from clothbench_models.mass_spring import MassSpring
from clothbench_models.mass_spring_kernels import (
    FASTEST_KEEPS,
    add_pairwise,
    chebyshev,
    damped_up_to,
    elastic_forces_and_axes,
    relax,
    spring_forces,
)
from clothbench_models.spring_grid import FAMILIES, SpringGrid
from scipy.optimize import curve_fit

from clothbench import ClothbenchError, Scene
from clothbench.core.protocols import Material

G = 9.81


def sheet(
    width, height, times, *, grips=(), moved=None, points=((0.0, 0.0),), density=0.2, shape=None, gravity=(0, 0, -G)
):
    """A scene with the given material points held; `moved(t) -> (K, 3)` shifts all of them together."""
    held = np.array(grips, dtype=float).reshape(-1, 2)
    clock = np.linspace(0.0, times[-1], 400)
    at = np.stack([held[:, 0], 0 * held[:, 0], -held[:, 1]], axis=1)
    path = at[None] + (moved(clock)[:, None] if moved else np.zeros((400, 1, 3)))
    return Scene(width, height, density, clock, held, path, times, np.array(points), gravity=gravity, resolution=shape)


def top_edge(width, count):
    return [(u, 0.0) for u in np.linspace(0.0, width, count)]


# --- forces ---------------------------------------------------------------------------------------------------------


def energy(grid: SpringGrid, k: np.ndarray, x: np.ndarray) -> float:
    """Σ k/2 (l − L)² over all springs [J]."""
    total = 0.0
    for f in range(len(FAMILIES)):
        e = np.flatnonzero(grid.share[f])
        length = np.linalg.norm(x[:, e + grid.strides[f]] - x[:, e], axis=0)
        total += 0.5 * np.sum(k[f] * grid.share[f, e] * (length - grid.rest[f, e]) ** 2)
    return total


def forces(grid: SpringGrid, k: np.ndarray, c: float, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    out, begin = np.zeros_like(x), int(grid.strides.max())
    g = np.zeros((len(grid.strides), 3, begin + x.shape[1]))
    for f in range(len(FAMILIES)):
        spring_forces(x, v, grid.strides[f], grid.rest[f], k[f] * grid.share[f], c * grid.share[f], g[f], begin)
        add_pairwise(out, g[f], begin, grid.strides[f])
    return out


@pytest.mark.parametrize(
    "lines", [np.linspace(0, 0.3, 6), np.array([0.0, 0.04, 0.1, 0.14, 0.2, 0.3])], ids=["even", "uneven"]
)
def test_the_largest_eigenvalue_is_that_of_the_whole_matrix(lines):
    """By the second differences of the energy of a flat sheet; a step that is just too long for it diverges."""
    grid = SpringGrid.of((lines, np.linspace(0, 0.25, 5)), (lines[-1], 0.25), 0.2)
    flat, step = np.vstack([grid.uv.T, np.zeros(len(grid.mass))]), 1e-5
    for which, bound in enumerate(grid.largest_eigenvalues):
        k = np.array([float(of == which) for _, _, of in grid.families])
        count = 2 * len(grid.mass)
        matrix = np.zeros((count, count))
        for column in range(count):
            away = np.zeros((3, len(grid.mass)))
            away[column // len(grid.mass), column % len(grid.mass)] = step
            change = forces(grid, k, 0.0, flat + away, 0 * flat) - forces(grid, k, 0.0, flat - away, 0 * flat)
            matrix[:, column] = -change[:2].ravel() / (2 * step)
        root = np.tile(grid.mass, 2) ** -0.5
        true = np.linalg.eigvalsh(root[:, None] * matrix * root).max()
        assert true <= bound < 1.003 * true


@pytest.mark.parametrize(("a", "b"), [(0.01, 0.01), (0.02, 0.01), (0.01, 0.03)])
def test_diagonals_have_the_moduli_that_the_grid_states(a, b):
    """By the energy of a flat sheet, evenly strained, all of whose cells are a × b; the structural springs add 1."""
    u, v = np.arange(31) * a, np.arange(31) * b
    grid, strain = SpringGrid.of((u, v), (u[-1], v[-1]), 0.1), 1e-5
    k, square = np.array([1.0, 1.0, 1.0, 1.0, 0.0, 0.0]), (a * a + b * b) ** 2

    def modulus(*rows):
        x = np.eye(2) + strain * np.array(rows)
        x = np.vstack([x @ grid.uv.T, np.zeros(len(grid.mass))])
        return 2 * energy(grid, k, x) / (u[-1] * v[-1] * strain**2)

    assert modulus([1, 0], [0, 0]) == pytest.approx(1 + 4 * a**4 / square, rel=1e-3)
    assert modulus([0, 0], [0, 1]) == pytest.approx(1 + 4 * b**4 / square, rel=1e-3)
    assert modulus([0, 0.5], [0.5, 0]) == pytest.approx(4 * (a * b) ** 2 / square, rel=1e-3)


@pytest.fixture(scope="module")
def crumpled():
    lines = (np.array([0.0, 0.04, 0.1, 0.14, 0.2]), np.linspace(0, 0.3, 6))
    grid = SpringGrid.of(lines, (0.2, 0.3), 0.2)
    random = np.random.default_rng(5)
    flat = np.stack([grid.uv[:, 0], 0 * grid.uv[:, 0], -grid.uv[:, 1]])
    return grid, flat + random.normal(0, 0.01, flat.shape), random.normal(0, 0.3, flat.shape)


def test_forces_are_minus_the_gradient_of_the_energy(crumpled):
    grid, x, v = crumpled
    k = np.array([60.0, 60.0, 60.0, 60.0, 2.0, 2.0])
    found = forces(grid, k, 0.0, x, 0 * v)
    step = 1e-6
    for c, e in np.ndindex(x.shape):
        up, down = x.copy(), x.copy()
        up[c, e] += step
        down[c, e] -= step
        expected = -(energy(grid, k, up) - energy(grid, k, down)) / (2 * step)
        assert found[c, e] == pytest.approx(expected, rel=1e-5, abs=1e-7)


def test_dampers_take_energy_and_keep_both_momenta(crumpled):
    grid, x, v = crumpled
    found = forces(grid, np.zeros(6), 0.01, x, v)
    assert (found * v).sum() < 0
    np.testing.assert_allclose(found.sum(axis=1), 0, atol=1e-12)
    np.testing.assert_allclose(np.cross(x.T, found.T).sum(axis=0), 0, atol=1e-12)
    spin = np.cross([0.1, 0.2, 0.3], x.T).T  # a rigid rotation stretches nothing
    np.testing.assert_allclose(forces(grid, np.zeros(6), 0.01, x, spin), 0, atol=1e-12)


@pytest.mark.parametrize("stages", [2, 3, 5, 8])
def test_damping_in_stages_is_a_polynomial_of_the_matrix_of_dashpots(crumpled, stages):
    """(1 + T_s(w₀ + w₁ A))/(1 + T_s(w₀)) by eigenvalues, to the fastest rate that it holds for; one node is carried."""
    grid, x, v = crumpled
    n, c = x.shape[1], 0.03
    matrix = np.stack([forces(grid, np.zeros(6), c, x, e.reshape(3, n)).ravel() for e in np.eye(3 * n)], axis=1)
    inverse = np.where(np.arange(n) == 4, 0.0, 1 / grid.mass)
    rates, modes = np.linalg.eig(np.tile(inverse, 3)[:, None] * matrix)  # not symmetric, as that node pulls others
    step, (centre, slope) = damped_up_to(stages) / -rates.real.min(), chebyshev(stages)

    def factor(rate):
        at = centre + slope * step * rate
        cosine = np.where(at > 1, np.cosh(stages * np.arccosh(at.clip(1))), np.cos(stages * np.arccos(at.clip(-1, 1))))
        return (1 + cosine) * FASTEST_KEEPS / 2

    expected = (modes @ (factor(rates.real) * np.linalg.solve(modes, v.ravel()))).real

    begin, found = int(grid.strides.max()), v.copy()
    g, axes, work = np.zeros((6, 3, begin + n)), np.zeros((6, 3, begin + n)), np.zeros((2, 3, begin + n + begin))
    for f in range(6):
        damping = np.sqrt(c * grid.share[f])
        elastic_forces_and_axes(x, grid.strides[f], grid.rest[f], grid.share[f], damping, g[f], axes[f], begin)
    force, bare, kick = np.zeros((3, n)), (False, np.zeros((8, 0))), np.full(n, step)
    relax(found, force, force, grid.strides, axes, inverse, *bare, kick, stages, centre, slope, work, begin)
    np.testing.assert_allclose(found.ravel(), expected, atol=1e-9 * np.abs(v).max())
    np.testing.assert_allclose(found[:, 4], v[:, 4], rtol=1e-12)
    slow, fast = np.array([-1e-4, -1e-3]) / step, np.linspace(-2.5, -damped_up_to(stages), 1000) / step
    np.testing.assert_allclose((factor(slow) - 1) / (step * slow), 1, atol=2e-3)
    assert factor(fast).min() > -1e-9
    assert factor(fast).max() < FASTEST_KEEPS + 1e-9


def test_mass_and_stiffness_do_not_depend_on_the_mesh():
    for n in (5, 9, 17):
        lines = (np.linspace(0, 0.3, n), np.linspace(0, 0.3, n))
        grid = SpringGrid.of(lines, (0.3, 0.3), 0.2)
        assert grid.mass.sum() == pytest.approx(0.2 * 0.09)
        # Per width, in pure warp strain: k1 from the straight springs and as much again from the diagonals.
        stretched = np.stack([grid.uv[:, 0] * 1.001, 0 * grid.uv[:, 0], -grid.uv[:, 1]])
        stiffness = energy(grid, np.array([1.0, 1, 1, 1, 0, 0]), stretched) * 2 / (0.3e-3**2)
        assert stiffness == pytest.approx(2.0, rel=0.01)


# --- motion ---------------------------------------------------------------------------------------------------------


def test_free_fall_is_exact():
    times = np.linspace(0.0, 0.5, 6)
    scene = sheet(0.2, 0.2, times, points=((0.1, 0.1), (0.0, 0.2)), shape=(5, 5))
    z = MassSpring().prepare(scene).run([[60.0, 1.0, 0.1]]).position[0, :, :, 2]
    # leapfrog samples a parabola with an error of g·dt²/8 between two steps
    np.testing.assert_allclose(z - z[0], np.broadcast_to(-0.5 * G * times[:, None] ** 2, z.shape), atol=3e-6)


def swing_frequency(effects=(), phi=(), length=0.297, nodes=17) -> float:
    """Frequency [Hz] of the small free swing, in vacuum, of a sheet held along its top edge and pulled once."""
    times = np.arange(1.0, 6.0, 0.01)

    def pull(t):
        pulse = 1e-3 * np.exp(-(((t - 0.4) / 0.15) ** 2))  # so gentle that higher modes than two hardly show
        return np.stack([0 * t, pulse, 0 * t], axis=1)

    width = length / 4
    across = (nodes - 1) // 4 + 1
    scene = sheet(
        width,
        length,
        times,
        grips=top_edge(width, across),
        moved=pull,
        points=((width / 2, length),),
        shape=(across, nodes),
    )
    theta = [[1000.0, 0.01, 0.001, *phi]]
    y = MassSpring().prepare(scene, effects).run(theta).position[0, :, 0, 1]
    # The pulse excites the first modes; fit the lowest two, whose ratio is that of the Bessel zeros.
    second = 5.5201 / 2.4048

    def modes(t, f, a, b, c, d, slow, quick):
        w = 2 * np.pi * f * t
        first = (a * np.sin(w) + b * np.cos(w)) * np.exp(-slow * t)
        return first + (c * np.sin(second * w) + d * np.cos(second * w)) * np.exp(-quick * t)

    amplitude = np.abs(y).max()
    best, _ = curve_fit(modes, times, y / amplitude, p0=[1.1, 0.5, 0.5, 0.1, 0.1, 0.01, 0.1], maxfev=20000)
    return float(best[0])


def test_a_hanging_sheet_swings_as_the_bessel_function_says():
    """ω₁ = (2.4048/2) √(g/L): a heavy hanging chain (D. Bernoulli 1733)."""
    expected = 2.4048 / 2 * np.sqrt(G / 0.297) / (2 * np.pi)
    assert swing_frequency() == pytest.approx(expected, rel=0.01)


def test_added_mass_slows_the_swing():
    """ω = ω₁ / √(1 + m_a/ρ) for a motion along the normal."""
    ratio = swing_frequency((AddedMass(),), (0.1,)) / swing_frequency()
    assert ratio == pytest.approx(1 / np.sqrt(1 + 0.1 / 0.2), rel=0.01)


@pytest.mark.parametrize("coefficient", [0.5, 1.2])
def test_a_falling_sheet_reaches_its_terminal_speed(coefficient):
    """v = √(2ρg/(ρ_air C_N)) for a sheet that falls flat."""
    times = np.array([0.0, 3.0, 3.5])
    flat = np.stack(np.meshgrid(np.linspace(0, 0.2, 5), np.linspace(0, 0.2, 5)), axis=-1).reshape(-1, 2)
    start = np.column_stack([flat, np.zeros(25)])  # lying level, while gravity points down
    scene = Scene(0.2, 0.2, 0.1, np.array([0.0, 1.0]), np.zeros((0, 2)), np.zeros((2, 0, 3)), times, flat,
                  resolution=(5, 5), start=start)  # fmt: skip
    position = MassSpring().prepare(scene, [QuadraticDrag()]).run([[60.0, 1.0, 0.1, coefficient, 0.0]]).position
    speed = -(position[0, 2, :, 2] - position[0, 1, :, 2]) / 0.5
    np.testing.assert_allclose(speed, np.sqrt(2 * 0.1 * G / (1.2 * coefficient)), rtol=1e-3)


def test_a_hanging_strip_stretches_by_its_own_weight():
    """Elastic line under its own weight: the lower end sinks by ρ g L²/(2 E), E the strip's stiffness per width."""
    scene = sheet(0.05, 0.4, np.array([0.0, 0.5]), grips=top_edge(0.05, 4), points=((0.025, 0.4),), shape=(4, 25))
    k1 = 300.0
    z = MassSpring().prepare(scene).run([[k1, 0.01, 0.5]]).position[0, -1, 0, 2]
    # C11 = 2 k1 and C12 = k1 of the lattice, free to narrow: E = C11 − C12²/C11 = 1.5 k1.
    assert -0.4 - z == pytest.approx(0.2 * G * 0.16 / (2 * 1.5 * k1), rel=0.03)


def test_damping_neither_moves_the_sheet_at_rest_nor_makes_it_settle_longer():
    """Slack between its corners, so that it has to fall into a fold before it hangs still."""
    clock, held = np.linspace(0.0, 1e-3, 2), np.array([(0.0, 0.0), (0.3, 0.0)])
    grips = np.tile([(0.0, 0.0, 0.0), (0.2, 0.0, 0.0)], (2, 1, 1))
    scene = Scene(0.3, 0.3, 0.2, clock, held, grips, clock, np.array([(0.15, 0.1), (0.15, 0.3)]), gravity=(0, 0, -G))
    simulation = MassSpring(resolution=9).prepare(scene)
    gentle, strong = (simulation.run(np.array([[100.0, 5.0, zeta]])) for zeta in (0.05, 0.8))
    np.testing.assert_allclose(strong.position[0, 0], gentle.position[0, 0], atol=2e-4)
    stretched = 1e-3 / simulation.stages_and_step(np.array([[100.0, 5.0, 0.8]]))[1][0]
    assert strong.steps[0] <= gentle.steps[0] + 2 * stretched


@pytest.mark.slow
@pytest.mark.parametrize("effects", [(), (AddedMass(),)], ids=["alone", "heavier"])
@pytest.mark.parametrize("zeta", [0.6, 1.0])
def test_damping_in_stages_moves_the_sheet_as_one_that_lags_by_short_steps(zeta, effects):
    def sway(t):
        return np.stack([0 * t, 0.03 * np.sin(6 * t) ** 2, 0 * t], axis=1)

    scene = sheet(
        0.2, 0.3, np.linspace(0.0, 1.5, 16), grips=top_edge(0.2, 5), moved=sway, points=[(0.1, 0.15), (0.0, 0.3)],
        shape=(9, 13),
    )  # fmt: skip
    theta = np.array([[200.0, 5.0, zeta, *[0.4] * len(effects)]])
    simulation = MassSpring().prepare(scene, effects)
    stages, step = simulation.stages_and_step(theta)
    assert stages[0] > 1
    assert step[0] > 3 * simulation.stable_step(theta)[0]
    lagging = MassSpring(dt=simulation.stable_step(theta)[0] / 20).prepare(scene, effects).run(theta)
    whole, short = (MassSpring(step_scale=scale).prepare(scene, effects).run(theta) for scale in (1.0, 0.125))
    far, near = (np.abs(rollout.position - lagging.position).max() for rollout in (whole, short))
    assert np.ptp(lagging.position[0, :, :, 1]) > 0.02
    assert far < 1.2e-4
    assert near < 0.4 * far
    single = MassSpring(precision="single").prepare(scene, effects).run(theta)
    np.testing.assert_allclose(single.position, whole.position, atol=2e-5)


@pytest.mark.parametrize("zeta", [0.15, 0.3, 0.45, 0.7])
def test_an_effect_of_no_amount_changes_no_step(zeta):
    scene = sheet(0.2, 0.3, np.linspace(0.0, 0.5, 6), grips=top_edge(0.2, 5), points=[(0.1, 0.15)], shape=(9, 13))
    theta = [200.0, 5.0, zeta]
    bare = MassSpring().prepare(scene)
    steps = bare.stages_and_step(np.array([theta]))
    for effects in ([LinearDrag()], [LinearDrag(), AddedMass()]):
        with_null = MassSpring().prepare(scene, effects)
        np.testing.assert_array_equal(with_null.stages_and_step(np.array([[*theta, *[0.0] * len(effects)]])), steps)


def test_more_damping_takes_more_stages_and_as_many_as_a_stated_step_needs():
    scene = sheet(0.2, 0.3, np.linspace(0.0, 0.5, 6), grips=top_edge(0.2, 5), points=[(0.1, 0.15)], shape=(9, 13))
    simulation = MassSpring().prepare(scene)
    theta = np.array([[200.0, 5.0, zeta] for zeta in np.linspace(0.01, 1.0, 200)])
    stages, step = simulation.stages_and_step(theta)
    assert stages[0] == 1
    assert stages[-1] > 2
    assert (np.diff(stages) >= 0).all()
    stated = simulation.stages_for(theta, step[-1] * 0.9)
    assert stated[0] == 1
    assert (np.diff(stated) >= 0).all()
    assert stated[-1] <= stages[-1]
    assert MassSpring(dt=step[-1] * 0.9).prepare(scene).run(theta[-1:]).status == ("ok",)


def test_sheets_side_by_side_are_damped_as_each_alone():
    scene = sheet(0.2, 0.3, np.linspace(0.0, 0.5, 6), grips=top_edge(0.2, 5), points=[(0.1, 0.3)], shape=(9, 13))
    simulation = MassSpring().prepare(scene)
    theta = np.array([[200.0, k2, zeta] for k2 in (2.0, 5.0) for zeta in (0.3, 0.65, 0.7, 0.75, 0.95)])
    together = simulation.run(theta).position
    for k, alone in enumerate(theta):
        np.testing.assert_array_equal(simulation.run(alone[None]).position[0], together[k])


def test_an_undamped_swing_keeps_its_energy():
    times = np.arange(0.0, 10.0, 0.001)  # fine enough to see the speed of the stiff modes as well
    u, v = np.meshgrid(np.linspace(0, 0.1, 5), np.linspace(0, 0.3, 13))
    points = np.column_stack([u.ravel(), v.ravel()])
    edge = top_edge(0.1, 5)

    def step_aside(t):
        s = np.clip(t / 0.3, 0, 1)
        return np.stack([0 * t, 0.02 * s**3 * (10 - 15 * s + 6 * s**2), 0 * t], axis=1)

    scene = sheet(0.1, 0.3, times, grips=edge, moved=step_aside, points=points, shape=(5, 13))
    simulation = MassSpring().prepare(scene)
    x = simulation.run([[100.0, 1.0, 0.0]]).position[0]
    speed = np.gradient(x, times, axis=0)
    grid = simulation.grid
    kinetic = 0.5 * (grid.mass * (speed**2).sum(axis=-1)).sum(axis=1)
    potential = G * (grid.mass * x[..., 2]).sum(axis=1)
    k = np.array([100.0, 100, 100, 100, 1, 1])
    total = kinetic + potential + np.array([energy(grid, k, frame.T) for frame in x])
    swing = np.ptp(kinetic[500:])
    early, late = total[500:1500].mean(), total[-1000:].mean()
    assert abs(late - early) < 0.001 * swing


def test_a_clock_offset_is_a_shift_in_time():
    def sway(t):
        return np.stack([0 * t, 0.02 * np.sin(4 * t) ** 2, 0 * t], axis=1)

    times = np.linspace(0.2, 1.0, 41)
    edge = top_edge(0.2, 2)
    late = sheet(0.2, 0.2, times, grips=edge, moved=sway, points=((0.1, 0.2),), shape=(5, 5))
    early = sheet(0.2, 0.2, times - 0.06, grips=edge, moved=sway, points=((0.1, 0.2),), shape=(5, 5))
    theta = [60.0, 1.0, 0.1]
    shifted = MassSpring().prepare(late, [ClockOffset()]).run([[*theta, 0.06]]).position
    plain = MassSpring().prepare(early).run([theta]).position
    assert np.abs(shifted - plain).max() < 2e-4  # the grips' 400 stamps differ a little between the two scenes


@pytest.mark.parametrize(
    ("effects", "amounts"),
    [((), ()), ((LinearDrag(), QuadraticDrag()), (0.2, 1.0, 0.05)), ((AddedMass(),), (1.0,))],
    ids=["springs alone", "forces", "inertia"],
)
def test_single_precision_agrees_while_the_motion_is_smooth(effects, amounts):
    def sway(t):
        return np.stack([0 * t, 0.03 * np.sin(5 * t) ** 2, 0 * t], axis=1)

    scene = sheet(
        0.2,
        0.2,
        np.linspace(0, 1, 11),
        grips=top_edge(0.2, 5),
        moved=sway,
        points=((0.1, 0.2), (0.0, 0.1)),
        shape=(5, 5),
    )
    double, single = (
        MassSpring(precision=p).prepare(scene, effects).run([[60.0, 5.0, 0.3, *amounts]]).position
        for p in ("double", "single")
    )
    assert np.abs(double - single).max() < 5e-5


@pytest.mark.parametrize("effects", [(), (GravityTilt(),)], ids=["alone", "tilted"])
def test_a_sheet_comes_to_rest_in_double_whatever_it_moves_in(effects):
    """In single precision rounding keeps soft modes moving: let go below a speed above that, it hung 0.2 mm aside."""
    scene = sheet(0.2, 0.2, np.array([0.0, 0.01]), grips=[(0.0, 0.0)], points=((0.1, 0.2), (0.1, 0.0)), shape=(9, 9))
    theta = [200.0, 0.05, 0.05, *(0.1, 0.0)[: 2 * len(effects)]]
    double, single = (
        MassSpring(precision=p).prepare(scene, effects).run([theta]).position[0, 0] for p in ("double", "single")
    )
    assert np.abs(double - single).max() < 1e-6


# --- options and materials ------------------------------------------------------------------------------------------


def longest(simulation, theta) -> tuple[float, np.ndarray]:
    """Largest strain of a structural or shear spring at the end of a run seen at the nodes; and where those are."""
    grid, x = simulation.grid, simulation.run(theta).position[0, -1].T
    strains = []
    for f in range(4):
        e = np.flatnonzero(grid.share[f])
        strains.append(np.linalg.norm(x[:, e + grid.strides[f]] - x[:, e], axis=0) / grid.rest[f, e] - 1)
    return float(np.concatenate(strains).max()), x


def test_the_strain_limit_holds():
    """Under a load that stretches it by 30 % without."""
    shape = (7, 13)
    u, v = np.meshgrid(np.linspace(0, 0.15, 7), np.linspace(0, 0.3, 13))
    scene = sheet(0.15, 0.3, np.array([0.0, 0.1, 0.5]), grips=top_edge(0.15, 7), shape=shape,
                  points=np.column_stack([u.ravel(), v.ravel()]))  # fmt: skip
    theta = [[1.1, 0.01, 0.3]]
    free, _ = longest(MassSpring().prepare(scene), theta)
    held, x = longest(MassSpring(strain_limit=0.1).prepare(scene), theta)
    assert free > 0.3
    assert 0.095 < held < 0.105
    np.testing.assert_allclose(x[0], 0.15 - x[0].reshape(13, 7)[:, ::-1].ravel(), atol=2e-3)  # as good as symmetric


def test_the_strain_limit_keeps_the_momentum_of_a_mass_on_the_sheet():
    """A loose sheet that spins, 10 g on its edge: ends of springs that were too long move by their inverse masses."""
    shape, spin, weight, times = (7, 7), 20.0, 0.01, np.linspace(0.0, 0.5, 6)
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 0.3, 7), np.linspace(0, 0.3, 7)))
    scene = sheet(0.3, 0.3, times, points=np.column_stack([u, v]), shape=shape, gravity=(0, 0, 0))
    x, y = u - 0.15, 0.15 - v
    velocity = spin * np.column_stack([-y, x, 0 * x])
    scene = dataclasses.replace(scene, start=np.column_stack([x, y, 0 * x]), velocity=velocity)
    simulation = MassSpring(strain_limit=0.05).prepare(scene, [PointMass()])
    moved = simulation.run([[20.0, 0.1, 0.05, weight, 1.0, 0.5]]).position[0]
    mass = simulation.sheet.mass.copy()
    mass[3 * 7 + 6] += weight
    centre = np.einsum("n,tnc->tc", mass, moved) / mass.sum()
    began = mass @ velocity / mass.sum()
    np.testing.assert_allclose(np.diff(centre, axis=0) / 0.1, np.tile(began, (5, 1)), atol=1e-6)


def test_a_strain_limit_that_is_not_reached_changes_nothing():
    scene = sheet(0.2, 0.2, np.array([0.0, 0.3]), grips=[(0.0, 0.0)], shape=(5, 5))
    plain, limited = (MassSpring(strain_limit=s).prepare(scene).run([[300.0, 1.0, 0.1]]).position for s in (None, 0.5))
    np.testing.assert_array_equal(plain, limited)


def test_a_material_gives_the_parameters_of_a_strip_that_may_narrow():
    theta = MassSpring().of_material(
        Material(bending=0.0, stretch=450.0, shear=100.0), sheet(0.05, 0.4, np.array([0.0]))
    )
    assert theta[0] == pytest.approx(300.0, rel=2e-4)  # what `test_a_hanging_strip_stretches_by_its_own_weight` takes
    assert theta[2] == 0.0
    with pytest.raises(ClothbenchError, match="no small-strain bending"):
        MassSpring().of_material(Material(1e-6, 450.0, 100.0), sheet(0.05, 0.4, np.array([0.0])))


def test_flexion_springs_hold_a_strip_together_with_the_others():
    """Of two cells' length, they are worth 4 k2 along both threads."""
    model, scene = MassSpring(), sheet(0.05, 0.4, np.array([0.0]))
    whole = 2 * 65.1 + 4 * 39.0
    said = model.material_of(np.array([65.1, 39.0, 0.1]), scene)
    assert (said.stretch, said.shear) == (pytest.approx(whole - 65.1**2 / whole), 65.1)
    asked = Material(0.0, 90.0, 50.0, stretch_damping=0.02)
    again = model.material_of(model.of_material(asked, scene), scene)
    assert (again.stretch, again.stretch_damping) == (pytest.approx(90.0), pytest.approx(0.02))
    with pytest.raises(ClothbenchError, match="a stretch of more than 0"):
        model.of_material(Material(0.0, 0.03, 0.01), scene)


def test_step_scale_multiplies_a_stated_step_too():
    scene = sheet(0.2, 0.2, np.array([0.0, 0.1]), grips=top_edge(0.2, 5), shape=(5, 5))
    steps = [
        MassSpring(dt=1e-4, step_scale=scale).prepare(scene).run([[60.0, 1.0, 0.05]]).steps[0] for scale in (1.0, 0.5)
    ]
    assert steps[1] == pytest.approx(2 * steps[0], rel=0.05)
