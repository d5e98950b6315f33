"""The reference simulation against physics: it is the truth of the stand-in recordings."""

from __future__ import annotations

from dataclasses import replace

import make_static_dynamic as maker
import numpy as np
import pytest

from clothbench.recordings.nodes import read_recording
from clothbench.recordings.scenes import scene_of
from clothbench.reference import kernels
from clothbench.reference.mechanics import clamped_annulus_sag
from clothbench.reference.mesh import Mesh, build, ring, tracking_weights
from clothbench.reference.simulation import (
    AIR_DENSITY,
    Fabric,
    State,
    bowed,
    calmed,
    clamped,
    discretise,
    implicit_step,
    settle,
    simulate,
    stable_step,
    total_energy,
    undamped,
)

GRAVITY = 9.81
SATIN = Fabric("satin", 0.11, 600.0, 450.0, 80.0, 30.0, 1.2e-5, 1.5e-5, 5e-4, 4e-3, 0.10, 1.0, 0.03, 0.2, 0.5)
NOTHING_HELD = np.zeros(0, dtype=np.int64)


def free(t: np.ndarray) -> np.ndarray:
    return np.zeros((len(t), 0, 3))


def keep(places: np.ndarray):
    return lambda t: np.broadcast_to(places, (len(t), *places.shape)).copy()


def hanging(mesh: Mesh) -> np.ndarray:
    u, v = mesh.material.T
    return np.column_stack([u, 0.0 * u, -v])


def flat(mesh: Mesh) -> np.ndarray:
    u, v = mesh.material.T
    return np.column_stack([u, v, 0.0 * u])


def cylinder(mesh: Mesh, radius: float, direction: float) -> np.ndarray:
    """The sheet rolled, without strain, along the material direction given by its angle to the warp."""
    c, s = np.cos(direction), np.sin(direction)
    along, across = mesh.material @ [c, s], mesh.material @ [-s, c]
    return np.column_stack([radius * np.sin(along / radius), radius * np.cos(along / radius), across])


def still(shape: np.ndarray) -> State:
    return State(shape.copy(), np.zeros_like(shape))


@pytest.mark.parametrize(
    ("energy", "force"),
    [
        (kernels.membrane_energy, kernels.membrane_force),
        (kernels.bending_energy, kernels.bending_force),
    ],
)
def test_forces_are_minus_the_gradient_of_their_energy(energy, force):
    mesh = build(0.3, 0.3, 6, 7)
    sheet, random = discretise(SATIN, mesh), np.random.default_rng(1)
    x = hanging(mesh) + random.normal(0.0, 0.01, (len(mesh.material), 3))
    found, rest, expected = np.zeros_like(x), np.zeros_like(x), np.zeros_like(x)
    force(sheet, x, rest, found)
    for at in np.ndindex(x.shape):
        moved = np.zeros_like(x)
        moved[at] = 1e-6
        expected[at] = -(energy(sheet, x + moved) - energy(sheet, x - moved)) / 2e-6
    np.testing.assert_allclose(found, expected, atol=1e-6 * abs(found).max())


@pytest.mark.parametrize("force", [kernels.membrane_force, kernels.bending_force, kernels.drag_force])
def test_damping_and_drag_only_take_energy(force):
    mesh = build(0.3, 0.3, 6, 7)
    sheet, random = discretise(SATIN, mesh), np.random.default_rng(2)
    x = hanging(mesh) + random.normal(0.0, 0.005, (len(mesh.material), 3))
    v = random.normal(0.0, 1.0, x.shape)
    moving, resting = np.zeros_like(x), np.zeros_like(x)
    force(sheet, x, v, moving)
    force(sheet, x, np.zeros_like(x), resting)
    assert ((moving - resting) * v).sum() < 0.0
    if force is not kernels.drag_force:
        np.testing.assert_allclose((moving - resting).sum(axis=0), 0.0, atol=1e-12 * abs(moving).max())


def test_rigid_motion_costs_nothing():
    mesh = build(0.3, 0.3, 6, 7)
    sheet = discretise(SATIN, mesh)
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    shape = hanging(mesh) @ turn.T + [1.0, 2.0, 3.0]
    assert kernels.membrane_energy(sheet, shape) < 1e-20
    assert kernels.bending_energy(sheet, shape) < 1e-20


@pytest.mark.parametrize("direction", [0.0, 0.4, np.pi / 4, 1.1, np.pi / 2])
def test_a_cylinder_stores_half_d_curvature_squared(direction):
    """In any direction; the last row at a hem has no hinge, so a finite sheet falls a little short."""
    mesh, radius = build(0.3, 0.3, 56, 64), 0.2
    stored = kernels.bending_energy(discretise(SATIN, mesh), cylinder(mesh, radius, direction))
    assert stored == pytest.approx(0.5 * SATIN.bending_rigidity / radius**2 * 0.09, rel=0.03)


@pytest.mark.parametrize("stretch", [(1.02, 1.0, 0.0), (1.0, 1.03, 0.0), (1.01, 0.99, 0.02)])
def test_uniform_strain_stores_the_written_energy(stretch):
    mesh = build(0.3, 0.2, 5, 4)
    a, b, g = stretch
    u, v = mesh.material.T
    e1, e2, shear = 0.5 * (a**2 - 1.0), 0.5 * (g**2 + b**2 - 1.0), a * g
    expected = 0.5 * (SATIN.warp_stiffness * e1**2 + SATIN.weft_stiffness * e2**2)
    expected += SATIN.coupling * e1 * e2 + 0.5 * SATIN.shear_stiffness * shear**2
    shape = np.column_stack([a * u + g * v, b * v, 0.0 * u])
    stored = kernels.membrane_energy(discretise(SATIN, mesh), shape)
    assert stored == pytest.approx(0.06 * expected, rel=1e-12)


def test_free_fall_is_exact():
    mesh, fabric = build(0.3, 0.3, 6, 7), undamped(SATIN)
    times = np.array([0.0, 0.1, 0.3])
    frames, _ = simulate(discretise(fabric, mesh), still(flat(mesh)), NOTHING_HELD, free, times, 1e-4)
    fallen = flat(mesh) - 0.5 * GRAVITY * times[:, None, None] ** 2 * [0.0, 0.0, 1.0]
    np.testing.assert_allclose(frames, fallen, atol=1e-10)


def test_falling_sheet_reaches_the_terminal_speed():
    mesh, fabric = build(0.3, 0.3, 6, 7), replace(undamped(SATIN), normal_drag=1.1)
    sheet = discretise(fabric, mesh)
    _, end = simulate(sheet, still(flat(mesh)), NOTHING_HELD, free, np.array([0.0, 2.0]), 1e-4)
    terminal = np.sqrt(2.0 * fabric.areal_density * GRAVITY / (AIR_DENSITY * 1.1))
    np.testing.assert_allclose(end.velocity[:, 2], -terminal, rtol=1e-3)


def test_drag_declines_and_grows_linearly_along_the_sheet_as_written():
    """f = −A (k_N v²/(1 + k_f v²) n + k_T v_t) of a flat sheet moved as a whole (Bhat et al. 2003, section 3)."""
    mesh = build(0.3, 0.3, 6, 7)
    fabric = replace(undamped(SATIN), normal_drag=2 * 1.5 / AIR_DENSITY, linear_drag=0.8, drag_decline=0.7)
    v, force = np.array([0.3, -0.4, 2.0]), np.zeros((len(mesh.material), 3))
    kernels.drag_force(discretise(fabric, mesh), flat(mesh), np.broadcast_to(v, force.shape).copy(), force)
    expected = -0.09 * np.array([0.8 * 0.3, -0.8 * 0.4, 1.5 * 4.0 / (1 + 0.7 * 4.0)])
    np.testing.assert_allclose(force.sum(axis=0), expected, rtol=1e-12)


def pulled_aside(step_share: float, implicit: bool) -> np.ndarray:
    """A strongly damped sheet in free flight, stretched at first: where its nodes are after 20 ms, (N, 3) m."""
    mesh = build(0.3, 0.3, 6, 7)
    fabric = replace(undamped(SATIN), stretch_damping=0.02, shear_damping=0.05)
    state = still(hanging(mesh) * [1.05, 1.0, 0.97])
    step = (implicit_step(fabric, mesh) if implicit else stable_step(fabric, mesh)) * step_share
    sheet, times = discretise(fabric, mesh), np.array([0.0, 0.02])
    return simulate(sheet, state, NOTHING_HELD, free, times, step, implicit)[0][1]


def test_implicit_damping_converges_to_the_explicit_one():
    truth = pulled_aside(1.0, implicit=False)
    coarse, fine = (abs(pulled_aside(share, implicit=True) - truth).max() for share in (0.5, 0.125))
    assert fine < 1e-4  # m, of some millimetres
    assert fine < 0.3 * coarse


def test_a_calmed_fabric_differs_in_damping_only():
    mesh = build(0.3, 0.3, 6, 7)
    calm = calmed(replace(SATIN, stretch_damping=0.5, shear_damping=0.5, bending_damping=0.5), mesh)
    assert undamped(calm) == undamped(SATIN)
    assert stable_step(calm, mesh) > 0.3 * stable_step(undamped(SATIN), mesh)


def swing(columns: int, rows: int, duration: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Undamped small swing of a hanging sheet: times [s], way [m], energy drift over the energy put in."""
    mesh = build(0.297, 0.297, columns, rows)
    fabric = undamped(replace(SATIN, bending_rigidity=1e-7))
    sheet, step = discretise(fabric, mesh), stable_step(fabric, mesh)
    held = np.arange(columns + 1)
    rest = settle(sheet, hanging(mesh), held, keep(hanging(mesh)[held]), step, at_rest=1e-5)
    state = still(rest)
    v = mesh.material[:, 1]
    state.position[:, 1] += 0.004 * (v / v.max()) * (0.6 + 0.4 * v / v.max())
    start, times = total_energy(sheet, state), np.arange(0.0, duration, 0.01)
    lift = start - total_energy(sheet, still(rest))
    frames, end = simulate(sheet, state, held, keep(rest[held]), times, step)
    weight = v * sheet.mass
    return times, frames[:, :, 1] @ weight / weight.sum(), (total_energy(sheet, end) - start) / lift


def frequency(times: np.ndarray, way: np.ndarray) -> float:
    """Mean frequency between the first and the last upward zero crossing [Hz]."""
    up = np.flatnonzero((way[:-1] < 0.0) & (way[1:] >= 0.0))
    crossing = times[up] - way[up] * (times[up + 1] - times[up]) / (way[up + 1] - way[up])
    return (len(crossing) - 1) / (crossing[-1] - crossing[0])


def test_hanging_sheet_swings_at_its_frequency_and_keeps_its_energy():
    """ω₁ = (2.4048/2) √(g/L) of a hanging chain, and of a sheet held along its whole top edge."""
    times, way, drift = swing(12, 14, 5.0)
    expected = 0.5 * 2.404826 * np.sqrt(GRAVITY / 0.297) / (2.0 * np.pi)
    assert frequency(times, way) == pytest.approx(expected, rel=0.01)
    assert abs(drift) < 0.01


@pytest.mark.slow
def test_cantilever_sags_as_a_heavy_beam():
    """A small load: sag = L Γ/8 with Γ = ρgL³/D. The strip is free to curl across, and then a plate of
    Poisson ratio ν bends with D(1 − ν²): ν = −1/3 here, so the sag is between 1 and 9/8 of the beam's."""
    length, columns = 0.10, 24
    mesh = build(length, 0.025, columns, 7)
    fabric = replace(undamped(SATIN), bending_rigidity=4e-3)
    sheet, step = discretise(fabric, mesh), stable_step(fabric, mesh)
    shape = flat(mesh)
    held = np.flatnonzero(mesh.material[:, 0] < length / columns + 1e-9)
    rest = settle(sheet, shape, held, keep(shape[held]), step, at_rest=1e-5)
    free_length = length - 0.5 * length / columns  # the first joint turns for the half edge before it
    sag = -rest[mesh.material[:, 0] > length - 1e-9, 2].mean()
    beam = free_length**4 * fabric.areal_density * GRAVITY / (8.0 * fabric.bending_rigidity)
    assert 0.97 < sag / beam < 9.0 / 8.0 + 0.03


def test_the_bow_has_no_strain_and_the_right_ends():
    mesh = build(0.3, 0.3, 28, 32)
    shape = bowed(mesh, 0.3, 0.21)
    corners = shape[[0, 28]]
    np.testing.assert_allclose(corners, [[-0.105, 0.0, 0.0], [0.105, 0.0, 0.0]], atol=1e-9)
    edges = np.linalg.norm(np.diff(shape[:29], axis=0), axis=1)
    np.testing.assert_allclose(edges, 0.3 / 28, rtol=1e-3)


def test_tracked_points_are_read_to_a_fraction_of_the_noise():
    mesh, radius = build(0.3, 0.3, 28, 32), 0.03  # the mesh of the check for convergence
    read = tracking_weights(mesh, maker.markers()) @ cylinder(mesh, radius, 0.0)
    u, v = maker.markers().T
    exact = np.column_stack([radius * np.sin(u / radius), radius * np.cos(u / radius), v])
    assert abs(read - exact).max() < 0.05e-3


def test_what_the_tracker_sees_is_settled_by_the_name_alone():
    truth, grips = np.zeros((50, 81, 3)), np.zeros((100, 2, 3))
    first, again = (maker.measure("satin/waving-1", truth, grips) for _ in range(2))
    np.testing.assert_array_equal(first[0], again[0])
    assert np.nanstd(first[0]) == pytest.approx(maker.MARKER_NOISE, rel=0.05)
    assert np.isnan(first[0]).any(axis=2).mean() == pytest.approx(maker.DROPOUT, rel=0.3)
    assert (maker.measure("linen/waving-1", truth, grips)[1] != first[1]).any()


def test_every_motion_starts_smoothly_and_never_pulls_the_cloth_taut():
    t = np.linspace(0.0, 3.0, 3001)
    for trial in maker.TRIALS:
        offset = trial.offset(t)
        assert abs(offset[:10]).max() < 1e-5
        if not trial.is_skirt:
            places = maker.hold(trial.separation) + offset
            assert np.linalg.norm(places[:, 1] - places[:, 0], axis=1).max() < 0.96 * maker.SIDE


@pytest.mark.parametrize("fabric", maker.FABRICS)
def test_the_stand_ins_are_the_fabrics_of_the_paper_s_tables(fabric):
    made, truth = maker.fabric_of(fabric, "waving")
    assert made.bending_rigidity == truth["bend"] == maker.TABLE_3[fabric][0]
    assert made.stretch_damping * made.warp_stiffness == pytest.approx(truth["stretch_damping"])
    assert 0.5 * AIR_DENSITY * made.normal_drag == pytest.approx(truth["quadratic_drag"])
    assert maker.fabric_of(fabric, "static")[1]["stretch"] == maker.TABLE_1[fabric][1]


def test_a_skirt_hangs_from_its_gathered_waist():
    u = np.linspace(0.0, maker.SKIRT[0], 200)
    for gathered in (1.0, 0.92):
        length = np.linalg.norm(np.diff(maker.waist(u, gathered), axis=0), axis=1).sum()
        assert length == pytest.approx(gathered * maker.SKIRT[0], rel=1e-4)


def on_a_ball(depth, velocity, carried=(0.0, 0.0, 0.0), friction=0.3, step=1e-3):
    """Force [N] of a sphere of 10 cm on three nodes of a sheet, the first `depth` m inside on its top, and its mass."""
    sheet, x, v = discretise(SATIN, build(0.1, 0.1, 4, 4)), np.full((3, 3), 9.0), np.zeros((3, 3))
    x[0], v[0] = [0.0, 0.0, 0.1 - depth], velocity
    force, now = np.zeros((3, 3)), np.zeros((1, 3))
    spheres = np.array([[0.0, 0.0, 0.0, 0.1, friction]])
    kernels.contact_force(spheres, now, now - step * np.array(carried), step, sheet, x, v, force)
    assert not force[1:].any()
    return force[0], sheet.mass[0]


def test_the_penalty_pushes_out_and_rubs_as_coulomb_says():
    force, mass = on_a_ball(1e-4, (0.5, 0.0, 0.0))
    press = mass * 200.0**2 * 1e-4
    np.testing.assert_allclose(force, [-0.3 * press, 0.0, press], rtol=1e-12)
    force, mass = on_a_ball(1e-4, (0.5, 0.0, 0.0), carried=(0.5, 0.0, 0.0))  # moves along
    np.testing.assert_allclose(force, [0.0, 0.0, press], atol=1e-12 * press)
    force, mass = on_a_ball(1e-4, (1e-6, 0.0, 0.0))  # nearly at rest: half of what would stop it, not all that rubs
    np.testing.assert_allclose(force[0], -0.5 * mass * 1e-6 / 1e-3, rtol=1e-9)
    assert not on_a_ball(-1e-6, (0.0, 0.0, -1.0))[0].any()
    assert not on_a_ball(1e-4, (0.0, 0.0, 1.0))[0].any()  # it leaves, and nothing holds it
    deeper = on_a_ball(0.05, (0.0, 0.0, 0.0))[0]
    np.testing.assert_allclose(deeper, [0.0, 0.0, mass * 200.0**2 * kernels.DEEP], rtol=1e-12)


@pytest.mark.parametrize("fabric", maker.FABRICS)
def test_a_skirt_lies_on_the_hips_that_skip_with_it(fabric):
    """The markers are as deep in them as edges of 21 mm between nodes on the surface may be, and their noise."""
    recording = read_recording(maker.BODY / f"{fabric}-waving-body.nc")
    scene = scene_of(recording)
    moved = scene.grips_at(scene.times).mean(axis=1) - scene.grips_at(scene.times[:1]).mean(axis=1)
    assert np.linalg.norm(moved, axis=1).max() > 0.03
    for hip in scene.obstacles:
        away = np.linalg.norm(recording.position - hip.centre - moved[:, None], axis=2)
        assert np.nanmin(away) > hip.radius - 4 * maker.MARKER_NOISE - 0.5e-3
        assert np.nanmean(away < hip.radius + 2e-3) > 0.05


def test_the_recordings_are_what_the_script_makes():
    """One static trial made anew; bit for bit on one machine, to the tracker's resolution on any."""
    stored = read_recording(maker.FOLDER / "linen-static-1.nc")
    made = maker.record("linen", maker.TRIALS[0])
    np.testing.assert_allclose(made.position, stored.position, atol=2e-5)
    assert np.abs(made.video.frame.astype(int) - stored.video.frame).mean() < 0.1
    np.testing.assert_allclose(made.grip_position, stored.grip_position, atol=2e-5)
    assert made.notes == stored.notes


# --- rings, and bending that differs by direction --------------------------------------------------------------------


def rolled(mesh: Mesh, axis: int, radius: float) -> np.ndarray:
    """The sheet rolled along u (0) or v (1), towards u × v where the radius is above 0."""
    along, across = mesh.material[:, axis], mesh.material[:, 1 - axis]
    place = np.empty((len(along), 3))
    place[:, axis], place[:, 1 - axis] = radius * np.sin(along / radius), across
    place[:, 2] = radius * (1 - np.cos(along / radius))
    return place


def test_bending_may_differ_between_warp_and_weft():
    mesh = build(0.1, 0.1, 40, 46)
    alike = kernels.bending_energy(discretise(SATIN, mesh), rolled(mesh, 0, 0.05))
    ribbed = discretise(replace(SATIN, weft_bending=3.0), mesh)
    assert kernels.bending_energy(ribbed, rolled(mesh, 0, 0.05)) == pytest.approx(alike, rel=0.03)
    assert kernels.bending_energy(ribbed, rolled(mesh, 1, 0.05)) == pytest.approx(3 * alike, rel=0.03)


def test_a_sheet_that_curls_by_itself_costs_nothing_in_its_own_curvature():
    mesh = build(0.1, 0.1, 20, 23)
    curled = discretise(replace(SATIN, rest_curvature=20.0), mesh)
    flat_energy = kernels.bending_energy(curled, rolled(mesh, 0, 1e6))
    assert kernels.bending_energy(curled, rolled(mesh, 0, 0.05)) < 0.01 * flat_energy
    assert kernels.bending_energy(curled, rolled(mesh, 0, -0.05)) == pytest.approx(4 * flat_energy, rel=0.02)


@pytest.mark.slow
def test_a_ring_has_its_area_and_a_clamp_that_holds_the_slope():
    mesh, held = ring(0.09, 0.15, 0.006)
    assert mesh.area.min() > 0.5 * mesh.area.mean()
    below = 0.006 * np.sqrt(3) / 2
    assert mesh.area.sum() == pytest.approx(np.pi * (0.15**2 - (0.09 - below) ** 2), rel=0.002)
    load = 0.15 * 0.02 / 1.5e-5  # so little weight that the sag is a tenth of a millimetre
    fabric = Fabric("plain", 0.15, 60.0, 50.0, 5.0, 10.0, 1.5e-5)
    sheet = clamped(discretise(fabric, mesh, (0.0, 0.0, -0.02)), held)
    start = np.column_stack([mesh.material, 0 * mesh.material[:, 0]])
    place = settle(sheet, start, held, keep(start[held]), stable_step(fabric, mesh), at_rest=1e-6)
    sag = -place[np.hypot(*mesh.material.T) > 0.1499, 2].mean()
    # Hinges on this lattice make a plate whose cross contraction is −1/3 (see `hinges`).
    assert sag == pytest.approx(clamped_annulus_sag(0.09, 0.15, load, poisson=-1 / 3), rel=0.06)
