"""The Kirchhoff–Love shell: its energies and their derivatives, then strips and sheets against the heavy elastica."""

import dataclasses
import math

import numpy as np
import pytest
from clothbench_models import shell_kernels, strip_kernels, strip_trials
from clothbench_models.banded import factor, substitute, times
from clothbench_models.kirchhoff_love import KirchhoffLove
from clothbench_models.shell import Shell
from clothbench_models.splines import Spline
from clothbench_models.strip import Ends, Strip

from clothbench import ClothbenchError, Material, Obstacle, Scene
from clothbench.reference import lifted_strip
from clothbench.reference import mechanics as references
from clothbench.studies.mechanics import scenes as strips
from clothbench.studies.speed.timing import hanging_sheet
from clothbench.testing import scenes

RANDOM = np.random.default_rng(11)
G = references.G
ROOTS = np.sqrt([2.0, 0.3])  # of an orthotropic sheet, membrane and bending


def uneven() -> Spline:
    return Spline(np.sort(np.concatenate([[0.0, 1.0], np.random.default_rng(3).random(7)])))


@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_splines_are_those_of_scipy(derivative):
    from scipy.interpolate import BSpline

    spline, at = uneven(), np.linspace(0, 1, 57)
    every = BSpline(spline.knots, np.eye(spline.count), 3)(at, nu=derivative)
    assert spline.matrix(at, derivative) == pytest.approx(every, abs=1e-9)


def test_a_banded_system_is_solved():
    full = np.tril(np.triu(RANDOM.normal(size=(30, 30)), -5), 5)
    full = full + full.T + 25 * np.eye(30)
    band = np.zeros((30, 6))
    for j in range(30):
        band[j, : min(6, 30 - j)] = full[j : j + 6, j]
    x, right = RANDOM.normal(size=30), np.empty(30)
    times(band, x, right)
    assert right == pytest.approx(full @ x)
    assert factor(band)
    substitute(band, right)
    assert right == pytest.approx(x)
    assert not factor(-np.abs(band))


def directions(size: int) -> np.ndarray:
    return RANDOM.normal(size=(3, size))


def test_strip_forces_are_the_slope_of_its_energy():
    spline = uneven()
    c = np.stack([spline.greville, 0.1 * np.sin(5 * spline.greville)], axis=1) + RANDOM.normal(
        0, 0.01, (spline.count, 2)
    )
    _, d1, d2 = spline.tables
    weight, pull, soft, bend = spline.quadrature[1], RANDOM.normal(size=c.shape), 1e-2, 3.0
    still, force, band = np.zeros(weight.shape), np.empty(c.size), np.empty((c.size, 8))
    strip_kernels.assemble(c, d1, d2, weight, pull, soft, bend, still, still, force, band)
    for way in directions(c.size):
        step = 1e-6 * way.reshape(c.shape)
        up, down = (strip_kernels.energy(c + s * step, d1, d2, weight, pull, soft, bend) for s in (1, -1))
        assert (up - down) / 2e-6 == pytest.approx(-force @ way, rel=1e-6)


def strip_stiffness(c, spline, way):
    """Stiffness times a direction, and by differences of the forces, with the stresses that belong to the shape."""
    _, d1, d2 = spline.tables
    weight, pull = spline.quadrature[1], np.zeros_like(c)
    tension, moment, a, b = np.empty(weight.shape), np.empty(weight.shape), np.empty(2), np.empty(2)
    for e, q in np.ndindex(weight.shape):
        strain, kappa = strip_kernels.strains(c, e, d1[e, q], d2[e, q], a, b)
        tension[e, q], moment[e, q] = strain / 1e-2, kappa / 3.0
    forces, band, product = np.empty((3, c.size)), np.empty((c.size, 8)), np.empty(c.size)
    for row, s in enumerate((1, -1, 0)):
        moved = c + s * 1e-6 * way.reshape(c.shape)
        strip_kernels.assemble(moved, d1, d2, weight, pull, 1e-2, 3.0, tension, moment, forces[row], band)
    times(band, way, product)
    return product, (forces[1] - forces[0]) / 2e-6


def test_strip_stiffness_is_the_slope_of_its_forces():
    spline = uneven()
    c = np.stack([spline.greville, 0.1 * np.sin(5 * spline.greville)], axis=1) + RANDOM.normal(
        0, 0.01, (spline.count, 2)
    )
    for way in directions(c.size):
        told, found = strip_stiffness(c, spline, way)
        assert told == pytest.approx(found, abs=1e-6 * np.abs(found).max())


def bent_shell():
    shell = Shell(scenes.hanging(), (3, 3), 1e-2, 0.3)
    control = shell.start(1.0).control
    return shell, control + RANDOM.normal(0, 0.01, control.shape), RANDOM.normal(size=control.shape)


def test_shell_forces_are_the_slope_of_its_energy():
    shell, c, pull = bent_shell()
    force, band = np.empty(c.size), np.empty((c.size, shell.wide))
    shell_kernels.assemble(c, *shell.mesh, pull, 1e-2, 5.0, 0.3, ROOTS, np.zeros((len(shell.mesh[2]), 6)), force, band)
    for way in directions(c.size):
        step = 1e-6 * way.reshape(c.shape)
        up, down = (shell_kernels.energy(c + s * step, *shell.mesh, pull, 1e-2, 5.0, 0.3, ROOTS) for s in (1, -1))
        assert (up - down) / 2e-6 == pytest.approx(-force @ way, rel=1e-5)


def test_shell_stiffness_is_the_slope_of_its_forces():
    shell, c, pull = bent_shell()
    nodes, shape, weight = shell.mesh
    stress, g = np.empty((len(weight), 6)), np.empty((5, 3))
    normal, strain, gradient = np.empty(3), np.empty(6), np.empty((6, 5, 3))
    for q in range(len(weight)):
        shell_kernels.vectors(c, nodes[q], shape[q], g)
        shell_kernels.strains(g, normal, strain, gradient)
        shell_kernels.stresses(strain, 1e-2, 5.0, 0.3, ROOTS, stress[q])
    forces, band, product = np.empty((3, c.size)), np.empty((c.size, shell.wide)), np.empty(c.size)
    for way in directions(c.size):
        for row, s in enumerate((1, -1, 0)):
            moved = c + s * 1e-6 * way.reshape(c.shape)
            shell_kernels.assemble(moved, *shell.mesh, pull, 1e-2, 5.0, 0.3, ROOTS, stress, forces[row], band)
        times(band, way, product)
        found = (forces[1] - forces[0]) / 2e-6
        assert product == pytest.approx(found, abs=1e-6 * np.abs(found).max())


def test_moving_and_turning_costs_no_energy():
    shell, c, pull = bent_shell()
    turn, shift = scenes.turn_about((1.0, 2.0, 3.0), 1.1), np.array([0.3, -2.0, 0.7])
    here = shell_kernels.energy(c, *shell.mesh, 0 * pull, 1e-2, 5.0, 0.3, ROOTS)
    there = shell_kernels.energy(c @ turn.T + shift, *shell.mesh, 0 * pull, 1e-2, 5.0, 0.3, ROOTS)
    assert here > 0.1
    assert there == pytest.approx(here, rel=1e-9)


@pytest.mark.parametrize(
    ("shape", "eigen"), [("bowl", 1 + 0.3), ("saddle", 1 - 0.3), ("twist", 1 - 0.3)], ids=["bowl", "saddle", "twist"]
)
def test_plate_energies_of_bowl_saddle_and_twist(shape, eigen):
    """½ D (1 ± ν)(κ₁² + κ₂²) A of a barely bent plate, κ = (k, ±k); a twist has the saddle's."""
    shell, k = Shell(scenes.hanging(), (4, 4), 1e-2, 0.3), 1e-3
    u, v = (a.ravel() for a in np.meshgrid(shell.u.greville, shell.v.greville, indexing="ij"))
    z = {"bowl": (u**2 + v**2) / 2, "saddle": (u**2 - v**2) / 2, "twist": u * v}[shape] * k
    flat = np.stack([u, v, z], axis=1).reshape(shell.u.count, shell.v.count, 3)
    flat = np.stack([shell.v.through(shell.u.through(flat[..., c]).T).T for c in range(3)], axis=-1)
    i, j = np.meshgrid(np.arange(shell.u.count), np.arange(shell.v.count), indexing="ij")
    control = np.empty((shell.count, 3))
    control[shell.numbers(i, j)] = flat
    bend, area = 1e-3, scenes.WIDTH * scenes.HEIGHT
    found = shell_kernels.energy(control, *shell.mesh, 0 * control, 1e9, bend, 0.3, np.ones(2))
    assert found == pytest.approx(eigen * k**2 * area / bend, rel=1e-4)


def test_cloth_that_stretches_further_than_it_knows_is_refused():
    scene = scenes.hanging()
    soft, stiff = (Material(1e-5, stretch, stretch / 2) for stretch in (5.0, 1e9))
    with pytest.raises(ClothbenchError, match=r"stretch of 5 N/m is η_m = .* expected at most 0.01"):
        KirchhoffLove().of_material(soft, scene)
    assert KirchhoffLove().of_material(stiff, scene)[1] == KirchhoffLove.parameters["eta_m"].bounds[0]


def test_a_sheet_on_one_grip_is_skipped():
    scene = scenes.hanging()
    one = dataclasses.replace(scene, grip_material=scene.grip_material[:1], grip_position=scene.grip_position[:, :1])
    assert "turns freely" in KirchhoffLove().skip(one)
    assert KirchhoffLove().skip(scene) is None


@pytest.mark.parametrize("gamma", [0.05, 1.0, 100.0, 1e4])
def test_cantilever_is_the_heavy_elastica(gamma):
    reference = references.cantilever(gamma)
    away = []
    for elements in (64, 128):
        state = strip_trials.cantilever(Strip(1.0, 1e-6, elements, desk=False), gamma / G)
        away.append(np.abs(state.at(reference.s) - np.stack([reference.x, reference.z], axis=1)).max())
    assert away[1] < 1e-4
    assert away[1] < 0.2 * away[0] or away[1] < 1e-5  # what is left is the stretch by its own weight


@pytest.mark.data
def test_cantilever_is_on_the_published_master_curve(data_dir):
    from scipy.io import loadmat

    curve = loadmat(data_dir / "cantilever-master-curve" / "master_curve_data.mat")
    gamma, ratio = curve["master_x"].ravel(), curve["master_y"].ravel()
    for n in np.linspace(0, len(gamma) - 1, 15).astype(int):
        end = strip_trials.cantilever(Strip(1.0, 1e-7, 200, desk=False), gamma[n] / G).ends
        assert -end.z1 / end.x1 == pytest.approx(ratio[n], rel=0.01)


@pytest.mark.parametrize("eta", [1e2, 1e3, 1e4, 1e5, 1e6])
def test_a_free_fold_stands_as_high_as_the_heavy_elastica(eta):
    strip = Strip(1.2)
    state = strip_trials.free_fold(strip, eta)
    assert strip_trials.fold_height(state) == pytest.approx(
        references.fold_coefficients()[0] * strip.size(eta), rel=3e-3
    )


@pytest.mark.parametrize("eta", [2.6e3, 3.5e4])
def test_a_free_fold_s_loop_is_as_long_as_the_heavy_elastica_s(eta):
    strip = Strip()
    length = strip_trials.fold_length(strip_trials.free_fold(strip, eta))
    assert length == pytest.approx(references.fold_coefficients()[1] * strip.size(eta), rel=5e-3)


def test_where_a_fold_ends_does_not_matter():
    heights = [strip_trials.fold_height(strip_trials.free_fold(Strip(), 1e4, tip)) for tip in (0.0, 0.2)]
    assert heights[0] == pytest.approx(heights[1], rel=2e-3)


def test_a_thick_layer_raises_a_fold():
    strip, thick = Strip(), Strip(thickness=1e-3)
    thin, raised = (strip_trials.fold_height(strip_trials.free_fold(s, 1e4)) for s in (strip, thick))
    assert 0.1e-3 < raised - thin < 1e-3


@pytest.mark.parametrize("kind", strip_trials.TURNS)
@pytest.mark.parametrize("gamma", [10.0, 1000.0])
def test_hanging_loops_are_heavy_elasticas(kind, gamma):
    reference = lifted_strip.hanging_loop(gamma, *strip_trials.TURNS[kind])
    state = strip_trials.hanging_loop(Strip(1.0, 1e-6, desk=False), gamma / G, kind)
    assert state.at(reference.s) == pytest.approx(np.stack([reference.x, reference.z], axis=1), abs=1e-4)


def test_loops_of_weightless_cloth_hang_as_peirce_has_them():
    """0.4243, 0.3183 and 0.1337 of the strip's length below the clamp (Peirce 1930, from tables)."""
    for kind, length in (("pear", 0.4243), ("ring", 1 / math.pi), ("heart", 0.1337)):
        reference = lifted_strip.hanging_loop(0.01, *strip_trials.TURNS[kind])
        assert -reference.z[-1] == pytest.approx(length, abs=3e-4)


@pytest.mark.parametrize("eta", [1e2, 2.6e3, 3.5e4, 1.5e5])
@pytest.mark.parametrize("height", [0.04, 0.4])
def test_a_lifted_strip_is_the_heavy_elastica(eta, height):
    reference = lifted_strip.lift(1.0, lambda u: eta + 0 * u, height)
    state, u = strip_trials.lift(Strip(1.0, 1e-6), eta, height), np.linspace(0, 1, 200)
    assert state.at(u) == pytest.approx(reference.line(u), abs=2e-5)
    assert state.press == pytest.approx(reference.press, rel=1e-3)
    assert abs(state.pull) < 1e-6


def test_a_strip_held_beside_its_path_pulls_as_the_heavy_elastica_does():
    eta = 1e4
    free = lifted_strip.lift(1.0, lambda u: eta + 0 * u, 0.12)
    x, z, slope = free.pose
    for pose in ((x - 0.01, z, slope), (x + 0.005, z, slope + 0.3)):
        reference = lifted_strip.hold(1.0, lambda u: eta + 0 * u, pose, free)
        state = Strip(1.0, 1e-6).equilibrium(eta, Ends(0.0, 0.0, 0.0, *pose))
        assert state.pull == pytest.approx(reference.pull, rel=2e-3)
        assert state.press == pytest.approx(reference.press, rel=2e-3)


def test_every_stiffness_is_solved_from_the_flat_strip():
    random = np.random.default_rng(2)
    for eta, height in zip(10 ** random.uniform(2, 6, 25), random.uniform(0.005, 0.45, 25), strict=True):
        state = strip_trials.lift(Strip(), eta, height)
        assert state.ends.z1 == height
        assert state.control[:, 1].min() >= 0.0
        weight = state.reaction[:, 1].sum()
        assert weight == pytest.approx(G, rel=1e-9)


def test_the_sheet_agrees_with_the_strip():
    """A strip's equilibrium, drawn out to a sheet that has no cross contraction, is one of the sheet."""
    width, strip = 0.25, Strip(0.3, desk=False, elements=64)
    state = strip_trials.cantilever(strip, 2000.0)
    shell = Shell(scenes.hanging(), (64, 3), strip.eta_m, 0.0)
    shell.u = state.spline
    i, j = np.meshgrid(np.arange(shell.u.count), np.arange(shell.v.count), indexing="ij")
    control = np.empty((shell.count, 3))
    line = np.broadcast_to(state.control[:, None], (*i.shape, 2))
    control[shell.numbers(i, j)] = np.stack([line[..., 0], np.broadcast_to(shell.v.greville, i.shape), line[..., 1]], 2)
    pull = np.zeros((shell.count, 3))
    pull[shell.numbers(i, j), 2] = -G * np.outer(shell.u.shares, shell.v.shares)
    force, band = np.empty(control.size), np.empty((control.size, shell.wide))
    still = np.zeros((len(shell.mesh[2]), 6))
    shell_kernels.assemble(control, *shell.mesh, pull, strip.eta_m, 2000.0, 0.0, np.ones(2), still, force, band)
    free = np.unique(shell.numbers(i[2:], j[2:]))
    assert np.abs(force.reshape(-1, 3)[free]).max() < 1e-6 * G * strip.length * width


def test_all_iterations_are_counted_those_on_the_way_through_stiffer_cloth_included(monkeypatch):
    """Of several stages the last one's had counted alone."""
    counted, solve = [], shell_kernels.equilibrium

    def counting(*given):
        counted.append(solve(*given))
        return counted[-1]

    monkeypatch.setattr(shell_kernels, "equilibrium", counting)
    simulation = KirchhoffLove(resolution=5).prepare(hanging_sheet(5, 0.1))
    steps = simulation.run(simulation.parameters.defaults[None]).steps
    assert len(counted) > 2
    assert steps == [sum(iterations for _, iterations in counted)]


def test_bad_options_and_scenes_are_one_line():
    with pytest.raises(ClothbenchError, match="kirchhoff_love: elements is 8, expected a whole number ≥ 64"):
        KirchhoffLove(elements=8)
    with pytest.raises(ClothbenchError, match="nothing holds this sheet"):
        KirchhoffLove().prepare(scenes.free_fall())
    on_a_ball = dataclasses.replace(scenes.hanging(), obstacles=(Obstacle("sphere", radius=0.1),))
    with pytest.raises(ClothbenchError, match="on no disc or sphere"):
        KirchhoffLove().prepare(on_a_ball)
    on_rough_ground = dataclasses.replace(scenes.hanging(), obstacles=(Obstacle("plane", (0, 0, -9), friction=0.4),))
    with pytest.raises(ClothbenchError, match=r"rest on smooth ground only, and this scene's has a friction of 0\.4"):
        KirchhoffLove().prepare(on_rough_ground)
    with pytest.raises(ClothbenchError, match="its sheet is a whole rectangle"):
        KirchhoffLove().prepare(scenes.cut_and_short()[0])
    with pytest.raises(ClothbenchError, match="lets a folded sheet roll open on smooth ground"):
        KirchhoffLove().prepare(strips.folded(1e-5, 33))
    with pytest.raises(ClothbenchError, match="loop is 'bow'"):
        strip_trials.hanging_loop(Strip(desk=False), 1e3, "bow")
    with pytest.raises(ClothbenchError, match="height is 2 m"):
        KirchhoffLove().strip(1.0).lift(2, np.array([[1e4, 1e-5, 0.3]]))


def test_a_sheet_rests_on_the_ground():
    """Clamped level a little above the ground, a long sheet lies down on it: nothing below it, the end flat on it."""
    length, eta = 0.3, 1e4
    held = np.array([[u, v] for u in (0.0, 0.0125) for v in (0.0, 0.02, 0.04)])
    at = np.stack([held[:, 0], held[:, 1], np.full(6, 0.03)], axis=1)
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, length, 25), [0.0, 0.04], indexing="ij"))
    points = np.stack([u, v], axis=1)
    scene = Scene(
        width=length, height=0.04, areal_density=0.15, grip_time=np.array([0.0, 0.1]), grip_material=held,
        grip_position=np.stack([at, at]), times=np.array([0.0]), points=points, resolution=(25, 4),
        start=np.stack([points[:, 0], points[:, 1], np.full(50, 0.03)], axis=1), obstacles=(Obstacle("plane"),),
    )  # fmt: skip
    (line,) = KirchhoffLove().prepare(scene).run(np.array([[eta, 1e-5, 0.0]])).position[:, 0]
    assert line[:, 2].min() > -1e-9
    assert line[-16:, 2].max() < 1e-6
    assert line[0, 2] == pytest.approx(0.03, abs=1e-9)
