"""Kernels of effects alone: forces are minus the gradient of an energy, air takes energy, inertia is a mass tensor."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from clothbench import Scene
from clothbench.core.protocols import Effect
from clothbench.modelling.mesh import grid_triangles
from clothbench.modelling.sheet import own_sheet, sheet_of, wants_normals
from clothbench.plugins.discovery import catalogue
from clothbench.testing import scenes

SIZE, SHAPE = (0.2, 0.3), (4, 5)
DENSITY, AIR = 0.2, 1.2


def effect_named(name: str) -> Effect:
    return catalogue().make("effects", name)


def normals(x: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Area-weighted unit normals (3, n) of the nodes."""
    a, b, c = (x[:, triangles[:, k]].T for k in range(3))
    total = np.zeros((x.shape[1], 3))
    for k in range(3):
        np.add.at(total, triangles[:, k], np.cross(b - a, c - a))
    return (total / np.linalg.norm(total, axis=1, keepdims=True)).T


@pytest.fixture
def crumpled():
    """An uneven sheet of 4 × 5 nodes, crumpled and in motion: the sheet, x (3, 20) m, v (3, 20) m/s."""
    u, v = np.array([0.0, 0.06, 0.12, 0.2]), np.array([0.0, 0.07, 0.14, 0.22, 0.3])
    uv = np.stack([a.ravel() for a in np.meshgrid(u, v)], axis=1)
    area = np.full(20, SIZE[0] * SIZE[1] / 20)
    triangles = grid_triangles(SHAPE)
    sheet = own_sheet(sheet_of(uv, DENSITY * area, area, triangles, (0.0, 0.0, -9.81), AIR, held=(0, 3)))
    random = np.random.default_rng(11)
    x = np.stack([uv[:, 0], 0 * uv[:, 0], -uv[:, 1]]) + random.normal(0, 0.012, (3, 20))
    sheet.normal[:] = normals(x, triangles)
    sheet.grip[:] = x[:, [0, 3]]
    return sheet, x, random.normal(0, 0.5, (3, 20))


def push(effect, values, sheet, x, v, *, state=None, t=0.0, dt=1e-3, stage="force"):
    """What an effect adds: (3, n) N, or (6, n) kg for its inertia."""
    if state is None:
        state = np.zeros(effect.state_size(sheet) if hasattr(effect, "state_size") else 0)
    out = np.zeros((3 if stage == "force" else 6, x.shape[1]))
    getattr(effect, stage)(t, dt, np.ascontiguousarray(x), v, out, sheet, np.array(values, dtype=float), state)
    return out


# --- conservative ones ------------------------------------------------------------------------------------------------


def fibres(sheet, x):
    """∂x/∂u and ∂x/∂v of all triangles (F, 2, 3), and their strains (F, 2)."""
    w = np.einsum("fck,xfk->fcx", sheet.gradient, x[:, sheet.triangles])
    return w, np.linalg.norm(w, axis=-1) - 1


def curvature_vectors(sheet, x):
    """uu, vv, uv (F, 3, 3): the last axis is x, y, z."""
    return np.einsum("fck,xfk->fcx", sheet.curvature, x[:, sheet.patch])


def stiffening_energy(sheet, x, p):
    strain = np.maximum(fibres(sheet, x)[1], 0)
    beyond = np.maximum(strain - 0.1, 0)
    density = p[0] * (np.minimum(strain, 0.1) ** 3 / 3 + 0.01 * beyond + 0.1 * beyond**2)
    return (sheet.face_area[:, None] * density).sum()


def coupling_energy(sheet, x, p):
    return (sheet.face_area * p[0] * fibres(sheet, x)[1].prod(axis=1)).sum()


def bending_energy(sheet, x, p):
    square = (curvature_vectors(sheet, x) ** 2).sum(axis=-1)
    return (sheet.face_area * (p[0] * square[:, 0] + p[1] * square[:, 1])).sum() / 2


def curl_energy(sheet, x, p):
    w = fibres(sheet, x)[0]
    normal = np.cross(w[:, 0], w[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    kappa = np.einsum("fcx,fx->fc", curvature_vectors(sheet, x), normal)
    return -(sheet.face_area * (p[0] * kappa[:, 0] + p[1] * kappa[:, 1])).sum()


def crease_energy(sheet, x, p):
    """The mean of the hat over a triangle by the formula of Hermite and Genocchi: twice a divided difference of f,
    f″ = hat, at the three corners.
    """
    w = fibres(sheet, x)[0]
    normal = np.cross(w[:, 0], w[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    uu, vv, uv = np.einsum("fcx,fx->cf", curvature_vectors(sheet, x), normal)
    a, b = -np.sin(p[2]), np.cos(p[2])
    across = sheet.uv @ [a, b]
    s = (across - across.min() - p[1] * np.ptp(across))[sheet.triangles]
    h = 2 * np.ptp(s, axis=1).max()
    f = (np.abs(s + h) ** 3 - 2 * np.abs(s) ** 3 + np.abs(s - h) ** 3) / (12 * h * h)
    hat = 2 * (f / ((s - np.roll(s, 1, axis=1)) * (s - np.roll(s, 2, axis=1)))).sum(axis=1)
    return -(sheet.face_area * p[0] * hat * (a * a * uu + 2 * a * b * uv + b * b * vv)).sum()


ENERGIES = [
    ("stretch_stiffening", (2000.0,), stiffening_energy),
    ("poisson_coupling", (30.0,), coupling_energy),
    ("bending_anisotropy", (2e-4, 5e-5), bending_energy),
    ("rest_curvature", (3e-4, -2e-4), curl_energy),
    ("crease", (1e-5, 0.6, 0.5), crease_energy),
]


@pytest.mark.parametrize(("name", "values", "energy"), ENERGIES, ids=[name for name, *_ in ENERGIES])
def test_forces_are_minus_the_gradient_of_the_energy(crumpled, name, values, energy):
    sheet, x, v = crumpled
    found = push(effect_named(name), values, sheet, x, v)
    expected, step = np.zeros_like(x), 1e-6
    for c, e in np.ndindex(x.shape):
        move = np.zeros_like(x)
        move[c, e] = step
        expected[c, e] = -(energy(sheet, x + move, values) - energy(sheet, x - move, values)) / (2 * step)
    np.testing.assert_allclose(found, expected, atol=2e-6 * np.abs(expected).max())


INTERNAL = [
    ("stretch_stiffening", (2000.0,)),
    ("poisson_coupling", (30.0,)),
    ("bending_anisotropy", (2e-4, 5e-5)),
    ("rest_curvature", (3e-4, -2e-4)),
    ("crease", (1e-4, 0.6, 0.5)),
    ("bending_hysteresis", (1e-4, 10.0)),
    ("plastic_bending", (1e-4, 10.0)),
    ("viscoelasticity", (1e-4, 50.0, 0.1)),
]


@pytest.mark.parametrize(("name", "values"), INTERNAL, ids=[name for name, _ in INTERNAL])
def test_forces_inside_the_cloth_push_and_turn_nothing(crumpled, name, values):
    """Newton's third law; also for those with a memory, after a change of shape."""
    sheet, x, v = crumpled
    effect = effect_named(name)
    state = np.zeros(effect.state_size(sheet) if hasattr(effect, "state_size") else 0)
    push(effect, values, sheet, x + 0.01 * v, v, state=state)
    found = push(effect, values, sheet, x, v, state=state, t=0.02)
    assert np.abs(found).max() > 1e-4
    np.testing.assert_allclose(found.sum(axis=1), 0, atol=1e-12)
    np.testing.assert_allclose(np.cross(x.T, found.T).sum(axis=0), 0, atol=1e-12)


@pytest.mark.parametrize("name", ["bending_hysteresis", "plastic_bending", "viscoelasticity"])
def test_what_a_turned_sheet_remembers_turns_along(crumpled, name):
    """A rigid rotation neither rubs nor relaxes anything: the forces after it are the turned forces."""
    sheet, x, v = crumpled
    effect = effect_named(name)
    values = (1e-4, 50.0, 1e6) if name == "viscoelasticity" else (1e-4, 10.0)
    state = np.zeros(effect.state_size(sheet))
    push(effect, values, sheet, x + 0.01 * v, v, state=state)
    before = push(effect, values, sheet, x, v, state=state, t=0.02)
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    after = push(effect, values, sheet, turn @ x, v, state=state, t=0.04)
    np.testing.assert_allclose(after, turn @ before, atol=1e-7 * np.abs(before).max())


# --- air --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["linear_drag", "quadratic_drag"])
def test_drag_takes_energy_from_every_node(crumpled, name):
    sheet, x, v = crumpled
    effect = effect_named(name)
    assert ((push(effect, effect.parameters.defaults, sheet, x, v) * v).sum(axis=0) < 0).all()


def test_drag_that_levels_off_is_less_than_drag_by_what_the_speed_says(crumpled):
    sheet, x, v = crumpled
    full = push(effect_named("quadratic_drag"), (0.8, 0.0), sheet, x, v)
    less = push(effect_named("drag_crisis"), (0.8, 3.0), sheet, x, v)
    along = (v * sheet.normal).sum(axis=0)
    np.testing.assert_allclose(less, full / (1 + 3.0 * along**2), rtol=1e-12)


def test_lift_does_no_work_and_lies_in_the_plane_of_velocity_and_normal(crumpled):
    sheet, x, v = crumpled
    lift = push(effect_named("lift"), (1.2,), sheet, x, v)
    size = np.linalg.norm(lift, axis=0)
    np.testing.assert_allclose((lift * v).sum(axis=0), 0, atol=1e-12 * size.max())
    np.testing.assert_allclose((lift * np.cross(v.T, sheet.normal.T).T).sum(axis=0), 0, atol=1e-12 * size.max())
    sine = np.abs((v * sheet.normal).sum(axis=0)) / np.linalg.norm(v, axis=0)
    expected = 0.5 * AIR * sheet.area * 1.2 * (v**2).sum(axis=0) * sine * np.sqrt(1 - sine**2)
    np.testing.assert_allclose(size, expected, rtol=1e-9)
    assert ((lift * sheet.normal).sum(axis=0) * (v * sheet.normal).sum(axis=0) < 0).all()


def test_wind_is_drag_in_moving_air(crumpled):
    sheet, x, v = crumpled
    wind = np.array([0.7, -0.4, 0.3])
    blown = push(effect_named("steady_wind"), (1.1, 0.05, *wind), sheet, x, v)
    expected = push(effect_named("quadratic_drag"), (1.1, 0.05), sheet, x, v - wind[:, None])
    np.testing.assert_allclose(blown, expected, atol=1e-15)


def test_a_jet_blows_on_its_line_and_not_far_beside_it(crumpled):
    sheet, x, v = crumpled
    azimuth, centre = 0.6, x[:, 7]
    at_node = push(effect_named("local_jet"), (1.0, 1.5, azimuth, *centre, 0.01), sheet, x, v)
    wind = (1.5 * np.cos(azimuth), 1.5 * np.sin(azimuth), 0.0)
    everywhere = push(effect_named("steady_wind"), (1.0, 0.0, *wind), sheet, x, v)
    np.testing.assert_allclose(at_node[:, 7], everywhere[:, 7], rtol=1e-12)
    further = push(effect_named("local_jet"), (1.0, 1.5, azimuth, *(centre + 9 * np.array(wind)), 0.01), sheet, x, v)
    np.testing.assert_allclose(further[:, 7], at_node[:, 7], rtol=1e-9)
    still = push(effect_named("quadratic_drag"), (1.0, 0.0), sheet, x, v)
    np.testing.assert_allclose(at_node[:, 19], still[:, 19], rtol=1e-6)


@pytest.mark.parametrize("frequency", [0.35, 1.0, 3.0])
def test_air_that_follows_late_is_drag_and_added_mass_by_the_frequency(crumpled, frequency):
    """F = −A [(b + h (ωτ)²/(1 + (ωτ)²)) v_n + h τ/(1 + (ωτ)²) v̇_n] n once the beginning is forgotten."""
    sheet, x, _ = crumpled
    h, b, late, dt, turn = 0.7, 0.1, 0.15, 1e-3, 2 * np.pi * frequency
    effect = effect_named("air_memory")
    state, times = np.zeros(effect.state_size(sheet)), np.arange(0, 2.0 + 2 / frequency, dt)
    forces = [push(effect, (h, b, late), sheet, x, np.cos(turn * t) * sheet.normal, state=state, t=t) for t in times]
    along = -np.einsum("tcn,cn->tn", forces, sheet.normal)[times >= 2.0] / sheet.area
    known = np.stack([np.cos(turn * times), -turn * np.sin(turn * times)], axis=1)[times >= 2.0]
    drag, mass = np.linalg.lstsq(known, along, rcond=None)[0]
    fast = (turn * late) ** 2
    np.testing.assert_allclose(drag, b + h * fast / (1 + fast), rtol=0.01)
    np.testing.assert_allclose(mass, h * late / (1 + fast), rtol=0.01)


# --- mass -------------------------------------------------------------------------------------------------------------

INERTIA = [
    ("added_mass", (0.1,), 0.1 * 0.06),
    ("heavy_hem", (0.5, 0.02), 3 * 0.5 * 0.02 * 0.2),
    ("point_mass", (0.004, 0.43, 0.71), 3 * 0.004),
    ("total_mass", (1.2,), 3 * 0.2 * 0.2 * 0.06),
]


@pytest.mark.parametrize(("name", "values", "trace"), INERTIA, ids=[name for name, *_ in INERTIA])
def test_added_inertia_is_a_mass_tensor_of_the_right_size(crumpled, name, values, trace):
    sheet, x, v = crumpled
    xx, yy, zz, yz, xz, xy = push(effect_named(name), values, sheet, x, v, stage="inertia")
    tensors = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).transpose(2, 0, 1)
    assert np.linalg.eigvalsh(tensors).min() > -1e-15
    assert np.trace(tensors, axis1=1, axis2=2).sum() == pytest.approx(trace)


def test_less_mass_than_stated_still_leaves_some(crumpled):
    sheet, x, v = crumpled
    effect = effect_named("total_mass")
    less = push(effect, effect.parameters.low, sheet, x, v, stage="inertia")
    assert (sheet.mass + less[:3] > 0.5 * sheet.mass).all()


@pytest.mark.parametrize(("name", "values"), [("heavy_hem", (0.5, 0.031)), ("point_mass", (0.004, 0.43, 0.71))])
def test_what_hangs_on_the_cloth_weighs_what_it_should_where_it_should(crumpled, name, values):
    """Total and first moments, on an uneven mesh whose lines do not meet the strip or the point."""
    sheet, x, v = crumpled
    total, middle = (0.5 * 0.031 * 0.2, (0.1, 0.3 - 0.0155)) if name == "heavy_hem" else (0.004, (0.086, 0.213))
    weight = push(effect_named(name), values, sheet, x, v)
    assert np.abs(weight[:2]).max() == 0.0
    mass = weight[2] / -9.81
    assert mass.sum() == pytest.approx(total)
    np.testing.assert_allclose(mass @ sheet.uv / total, middle, rtol=1e-12)


def test_what_hangs_on_cut_cloth_hangs_on_cloth():
    """A hem weighs what its strip of a disc does, and a point off the cloth hangs from its rim with all its mass."""
    scene = dataclasses.replace(scenes.draped(), obstacles=(), resolution=(25, 25))
    sheet = catalogue().make("models", "baraff_witkin").prepare(scene).sheet
    radius, width = 0.12, 0.05
    away = radius - width  # of the strip's inner edge from the middle
    strip = radius**2 * np.arccos(away / radius) - away * np.sqrt(radius**2 - away**2)
    x = np.ascontiguousarray(np.column_stack([sheet.uv, np.zeros(len(sheet.uv))]).T)
    hem = push(effect_named("heavy_hem"), (0.5, width), sheet, x, 0 * x)[2] / -9.81
    assert hem.sum() == pytest.approx(0.5 * strip, rel=2e-4)  # the outline is a polygon
    button = push(effect_named("point_mass"), (0.004, 0.02, 0.05), sheet, x, 0 * x)[2] / -9.81
    assert button.min() >= 0.0
    assert button.sum() == pytest.approx(0.004)
    assert np.linalg.norm(sheet.uv[button > 0] - radius, axis=1).max() < 1.1 * radius


@pytest.mark.parametrize("outline", [None, [(0, 0), (0.3, 0), (0.3, 0.3), (0.15, 0.27), (0, 0.3)]])
@pytest.mark.parametrize("inset", [0.0, 0.012])
def test_a_point_mass_hangs_at_its_share_of_the_cloth_wherever_the_grips_lie(outline, inset):
    grips = np.array([[inset, inset], [0.3 - inset, inset]])
    at = np.column_stack([grips[:, 0], np.zeros(2), -grips[:, 1]])
    times = np.array([0.0, 1.0])
    scene = Scene(0.3, 0.3, 0.12, times, grips, np.stack([at, at]), times[:1], np.array([[0.1, 0.1]]),
                  resolution=(11, 11), outline=None if outline is None else np.array(outline, dtype=float))  # fmt: skip
    sheet = catalogue().make("models", "baraff_witkin").prepare(scene).sheet
    x = np.ascontiguousarray(np.column_stack([sheet.uv, np.zeros(len(sheet.uv))]).T)
    for place in ((0.5, 0.5), (0.9, 0.5), (0.5, 0.2)):
        share = push(effect_named("point_mass"), (0.004, *place), sheet, x, 0 * x)[2] / -9.81 / 0.004
        np.testing.assert_allclose(share @ sheet.uv, 0.3 * np.array(place), atol=1e-12)


def test_what_hangs_on_a_sheet_that_was_cut_shorter_hangs_on_what_is_left():
    cut, shorter = (
        catalogue().make("models", "baraff_witkin").prepare(scene).sheet for scene in scenes.cut_and_short()
    )
    hung = []
    for sheet in (cut, shorter):
        x = np.ascontiguousarray(np.column_stack([sheet.uv, np.zeros(len(sheet.uv))]).T)
        hung.append(push(effect_named("point_mass"), (0.004, 0.3, 0.7), sheet, x, 0 * x)[2] @ sheet.uv)
    np.testing.assert_allclose(hung[0], hung[1], rtol=1e-9)


def test_a_hem_runs_along_the_end_of_a_sheet_that_was_cut_shorter():
    cut, shorter = scenes.cut_and_short()
    for scene in (cut, shorter):
        sheet = catalogue().make("models", "baraff_witkin").prepare(scene).sheet
        x = np.ascontiguousarray(np.column_stack([sheet.uv, np.zeros(len(sheet.uv))]).T)
        hem = push(effect_named("heavy_hem"), (0.5, 0.02), sheet, x, 0 * x)[2] / -9.81
        assert hem.sum() == pytest.approx(0.5 * 0.02 * shorter.width, rel=1e-9)
        assert hem @ sheet.uv[:, 1] / hem.sum() == pytest.approx(shorter.height - 0.01, rel=0.02)


@pytest.mark.parametrize("height", [0.29, 0.287, 0.26])  # mesh lines lie at 0.275 and 0.25
@pytest.mark.parametrize("width", [0.004, 0.015, 0.04])
def test_a_hem_that_is_cut_between_mesh_lines_weighs_its_strip(height, width):
    outline = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, height], [0.0, height]])
    hem, middle = hem_along(outline, width)
    assert hem == pytest.approx(0.5 * width * 0.3, rel=1e-9)
    assert middle[0] == pytest.approx(0.15)
    assert middle[1] == pytest.approx(height - width / 2, abs=0.0125)  # by half a cell what hangs below all nodes


@pytest.mark.parametrize("width", [0.004, 0.015, 0.09])
def test_a_hem_of_any_outline_weighs_what_lies_that_low(width):
    """Two legs of uneven length, and a side that slants, whose hem is a triangle at its corner."""
    legs = [[0, 0], [0.3, 0], [0.3, 0.287], [0.22, 0.287], [0.22, 0.08], [0.08, 0.08], [0.08, 0.279], [0, 0.279]]
    area = 0.08 * (width + max(0.0, width - 0.008))
    assert hem_along(np.array(legs), width)[0] == pytest.approx(0.5 * area, rel=1e-9)
    slope = 0.1 / 0.3
    slanting = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.187], [0.0, 0.287]])
    assert hem_along(slanting, width)[0] == pytest.approx(0.5 * 0.5 * width**2 / slope, rel=1e-9)


def hem_along(outline, width):
    """Mass of a hem of 0.5 kg/m² on a sheet cut from 13 × 13 nodes over 0.3 m by 0.3 m [kg], and its centre (2,) m."""
    scene = dataclasses.replace(
        scenes.draped(), width=0.3, height=0.3, obstacles=(), resolution=(13, 13), outline=outline,
        points=np.array([[0.01, 0.01]]), start=np.zeros((1, 3)),
    )  # fmt: skip
    sheet = catalogue().make("models", "baraff_witkin").prepare(scene).sheet
    x = np.ascontiguousarray(np.column_stack([sheet.uv, np.zeros(len(sheet.uv))]).T)
    mass = push(effect_named("heavy_hem"), (0.5, width), sheet, x, 0 * x)[2] / -9.81
    assert mass.min() >= 0.0
    assert not mass[sheet.area == 0].any()
    return mass.sum(), mass @ sheet.uv / mass.sum()


def test_gravity_turns_about_x_then_y(crumpled):
    sheet, x, v = crumpled
    added = push(effect_named("gravity_tilt"), (0.1, -0.05), sheet, x, v) / sheet.mass
    about_x = np.array([[1, 0, 0], [0, np.cos(0.1), -np.sin(0.1)], [0, np.sin(0.1), np.cos(0.1)]])
    about_y = np.array([[np.cos(0.05), 0, -np.sin(0.05)], [0, 1, 0], [np.sin(0.05), 0, np.cos(0.05)]])
    expected = about_y @ about_x @ [0, 0, -9.81] + np.array([0, 0, 9.81])
    np.testing.assert_allclose(added, np.repeat(expected[:, None], 20, axis=1), atol=1e-12)


# --- what they read ---------------------------------------------------------------------------------------------------


def test_an_effect_that_says_so_reads_no_normals(crumpled):
    """Where nobody asks for normals a loop leaves them NaN, and the forces of all others must not notice."""
    sheet, x, v = crumpled
    blind = own_sheet(sheet, normals=False)
    blind.grip[:] = sheet.grip
    assert not wants_normals(blind)
    assert wants_normals(sheet)
    plugins, without = catalogue(), []
    for name in plugins.names("effects"):
        effect = plugins.make("effects", name)
        stages = [s for s in ("force", "inertia") if effect.place == "dynamics" and hasattr(effect, s)]
        if not stages or getattr(effect, "normals", True):
            continue
        without.append(name)
        amounts = effect.parameters.from_unit(np.full(len(effect.parameters), 0.5))
        for stage in stages:
            seen, unseen = (push(effect, amounts, s, x, v, t=0.1, stage=stage) for s in (sheet, blind))
            np.testing.assert_array_equal(seen, unseen)
            assert np.isfinite(unseen).all()
    assert "linear_drag" in without
    assert "quadratic_drag" not in without
