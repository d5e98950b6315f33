"""Effects of the material, against analytic strips: stretched, bent to a cylinder, held, curled."""

from __future__ import annotations

import numpy as np
import pytest
from clothbench_models.mass_spring import MassSpring
from effect_scenes import (
    STIFF,
    STRETCH,
    G,
    cloth,
    effect_named,
    hanging,
    on_every_model,
    run,
)
from scipy.optimize import curve_fit

from clothbench import Material, Scene
from clothbench.core.optional import Remembers
from clothbench.modelling import own_sheet
from clothbench.modelling.mesh import grid_triangles
from clothbench.modelling.sheet import sheet_of
from clothbench.plugins.discovery import catalogue

# --- kernels alone, on a strip bent to a cylinder ---------------------------------------------------------------------

LENGTH, WIDTH = 0.2, 0.1


@pytest.fixture(scope="module")
def strip():
    uv = np.stack([a.ravel() for a in np.meshgrid(np.linspace(0, LENGTH, 41), np.linspace(0, WIDTH, 21))], axis=1)
    area = np.full(len(uv), LENGTH * WIDTH / len(uv))
    return sheet_of(uv, 0.2 * area, area, grid_triangles((41, 21)), (0.0, 0.0, 0.0), 1.2)


def bent(sheet, kappa, direction="u"):
    """Positions (3, n) m on a cylinder of curvature κ 1/m about the weft or the warp."""
    u, v = sheet.uv.T
    s, other = (u, v) if direction == "u" else (v, u)
    arc = (s, 0 * s) if kappa == 0 else (np.sin(kappa * s) / kappa, (1 - np.cos(kappa * s)) / kappa)
    return np.stack([arc[0], other, arc[1]] if direction == "u" else [other, arc[0], arc[1]])


class Press:
    """An effect on a sheet that is led through given shapes; adds up the work that it takes."""

    def __init__(self, sheet, name, values):
        self.sheet, self.effect, self.values = sheet, effect_named(name), np.array(values, dtype=float)
        self.state, self.t = np.zeros(self.effect.state_size(sheet) if isinstance(self.effect, Remembers) else 0), 0.0
        self.x, self.f, self.work = None, None, 0.0

    def to(self, x, dt=1e-3):
        force = np.zeros_like(x)
        self.effect.force(self.t, dt, x, np.zeros_like(x), force, self.sheet, self.values, self.state)
        if self.x is not None:
            self.work -= 0.5 * ((force + self.f) * (x - self.x)).sum()
        self.x, self.f, self.t = x, force, self.t + dt
        return force


@pytest.mark.parametrize(
    ("name", "values"),
    [("bending_hysteresis", (1e-3, 5.0)), ("plastic_bending", (1e-5, 5.0)), ("viscoelasticity", (1e-5, 0.0, 0.1)),
     ("bending_anisotropy", (2e-5, 0.0))],
)  # fmt: skip
def test_at_its_limit_an_effect_is_stiffness_and_no_more(strip, name, values):
    """Bent to and fro it takes work that comes back; before, unless it has no memory, it does not."""
    limit = next(iter(effect_named(name).limits(np.array(values)).values()))
    lost = []
    for phi in (values, limit):
        press, most = Press(strip, name, phi), 0.0
        for kappa in np.concatenate([np.linspace(0, 20, 201), np.linspace(20, 0, 201)[1:]]):
            press.to(bent(strip, kappa))
            most = max(most, press.work)
        lost.append(press.work / most)
    assert abs(lost[1]) < 1e-3
    assert name == "bending_anisotropy" or lost[0] > 0.1


@pytest.mark.parametrize("direction", ["u", "v"])
@pytest.mark.parametrize("scale", [5.0, 30.0])
def test_bending_to_and_fro_costs_the_area_of_dahls_loop(strip, direction, scale):
    """∮ M dκ = 4 M_c (κ_m − κ₀ tanh(κ_m/κ₀)) between ±κ_m, per area."""
    couple, top = 2e-4, 10.0
    press = Press(strip, "bending_hysteresis", (couple, scale))
    crest = 100 + 400 * np.array([3, 4])  # from one crest to the next; the loop has closed by then
    for k, phase in enumerate(2 * np.pi / 400 * np.arange(crest[1] + 1)):
        press.to(bent(strip, top * np.sin(phase), direction))
        if k == crest[0]:
            before = press.work
    axis = "uv".index(direction)
    counted = strip.face_area[(np.abs(strip.curvature[:, axis]) > 1e-9).any(axis=1)].sum()
    expected = 4 * couple * (top - scale * np.tanh(top / scale))
    assert 0.9 * LENGTH * WIDTH < counted <= LENGTH * WIDTH  # at a free end nothing bends a triangle
    assert (press.work - before) / counted == pytest.approx(expected, rel=0.01)


def test_friction_does_not_depend_on_the_pace(strip):
    slow, quick = (Press(strip, "bending_hysteresis", (2e-4, 10.0)) for _ in range(2))
    for kappa in np.linspace(0, 8, 33):
        slow.to(bent(strip, kappa), dt=0.1)
    for kappa in np.linspace(0, 8, 9):
        quick.to(bent(strip, kappa), dt=1e-3)
    np.testing.assert_allclose(quick.f, slow.f, atol=1e-3 * np.abs(slow.f).max())


@pytest.mark.parametrize("direction", ["u", "v"])
def test_below_yield_bending_is_given_back_and_above_it_costs_the_area_of_the_loop(strip, direction):
    """∮ M dκ = 4 R κ_y (κ_m − κ_y) between ±κ_m, per area; nothing where κ_m < κ_y."""
    rigidity, limit = 1e-5, 6.0
    axis = "uv".index(direction)
    counted = strip.face_area[(np.abs(strip.curvature[:, axis]) > 1e-9).any(axis=1)].sum()
    for top, expected in ((5.0, 0.0), (10.0, 4 * rigidity * limit * (10.0 - limit))):
        press = Press(strip, "plastic_bending", (rigidity, limit))
        for k, phase in enumerate(2 * np.pi / 400 * np.arange(1101)):
            press.to(bent(strip, top * np.sin(phase), direction))
            if k == 700:
                before = press.work
        scale = 4 * rigidity * limit * limit
        assert (press.work - before) / counted == pytest.approx(expected, rel=0.01, abs=1e-3 * scale)


@pytest.mark.parametrize(("limit", "top"), [(3.0, 10.0), (1.5, 12.0)])
def test_a_strip_bent_beyond_yield_rests_at_the_curvature_that_stays(strip, limit, top):
    """Where the model's own D and what yielded balance: R (κ_m − κ_y)/(R + D), or R κ_y/D where that yields again."""
    rigidity, own = 4e-5, 1e-5
    press = Press(strip, "plastic_bending", (rigidity, limit))
    for kappa in (0.0, 5.0, top):
        press.to(bent(strip, kappa))
    stays = bent(strip, min(rigidity * (top - limit) / (rigidity + own), rigidity * limit / own))
    elastic = np.zeros_like(stays)
    effect_named("bending_anisotropy").force(
        0.0, 1e-3, stays, 0 * stays, elastic, strip, np.array([own, 0.0]), np.zeros(0)
    )
    left = press.to(stays) + elastic
    assert np.abs(left).max() < 0.01 * np.abs(elastic).max()  # curvatures of chords are not quite a cylinder's


def test_stress_fades_as_maxwell_says(strip):
    """Bent and stretched at once, then held: exp(−t/τ), whatever the step."""
    press = Press(strip, "viscoelasticity", (1e-4, 40.0, 0.3))
    press.to(bent(strip, 0.0), dt=1e-9)
    shape = bent(strip, 6.0) * [[1.0], [1.01], [1.0]]
    first = press.to(shape, dt=0.02)
    for dt in (0.05, 0.011, 0.2):
        press.to(shape, dt)
    last = press.to(shape)
    np.testing.assert_allclose(last, first * np.exp(-0.281 / 0.3), atol=1e-9 * np.abs(first).max())


def test_what_is_quick_against_relaxation_meets_the_whole_stiffness(strip):
    """A Maxwell element that has no time is a spring: here that of `bending_anisotropy` with D_u = D₁."""
    press = Press(strip, "viscoelasticity", (1e-4, 0.0, 20.0))
    press.to(bent(strip, 0.0))
    found = press.to(bent(strip, 4.0))
    elastic = np.zeros_like(found)
    effect_named("bending_anisotropy").force(
        0.0, 1e-3, bent(strip, 4.0), 0 * found, elastic, strip, np.array([1e-4, 0.0]), np.zeros(0)
    )
    np.testing.assert_allclose(found, elastic, atol=1e-2 * np.abs(elastic).max())


def test_steady_bending_meets_the_viscous_limit(strip):
    """At a constant rate s → τ κ̇, so the couple is D₁ τ κ̇; two paces differ in proportion."""
    forces = []
    for rate in (1.0, 2.0):
        press = Press(strip, "viscoelasticity", (1e-4, 0.0, 0.02))
        for t in np.arange(0.0, 0.4, 0.01):
            press.to(bent(strip, rate * (t - 0.39) + 1.0), dt=0.01)
        forces.append(press.f)
    np.testing.assert_allclose(forces[1], 2 * forces[0], atol=0.02 * np.abs(forces[0]).max())


# --- through a model --------------------------------------------------------------------------------------------------


@on_every_model
def test_a_hanging_strip_stretches_less_as_it_stiffens(name):
    """E ε + B ε² = ρ g (L − v) at every height of an elastic strip under its own weight."""
    scene = hanging(0.05, 0.4, np.array([0.0, 0.1]), [(0.025, 0.4)], (4, 25))
    theta, along, across = cloth(name, scene, STRETCH)
    own, extra = along - across**2 / along, 5000.0
    tension = 0.2 * G * np.linspace(0, 0.4, 401)
    soft = (tension / own).mean() * 0.4
    stiffer = ((np.sqrt(own**2 + 4 * extra * tension) - own) / (2 * extra)).mean() * 0.4
    bare = -run(name, scene, theta)[0, 0, 2] - 0.4
    found = -run(name, scene, theta, ("stretch_stiffening", [extra]))[0, 0, 2] - 0.4
    assert stiffer < 0.7 * soft
    assert bare == pytest.approx(soft, rel=0.04)
    assert found == pytest.approx(stiffer, rel=0.04)


def narrowing(name, *pairs):
    """Weft contraction over warp strain of a strip pulled by 1 % at both ends."""
    ends = np.array([[u, v] for u in (0.0, 0.4) for v in np.linspace(0, 0.1, 6)])
    middle = [(0.2, 0.02), (0.2, 0.08), (0.18, 0.05), (0.22, 0.05)]
    at = np.stack([1.01 * ends[:, 0], 0 * ends[:, 0], -ends[:, 1]], axis=1)
    scene = Scene(0.4, 0.1, 0.2, np.array([0.0, 0.1]), ends, np.stack([at, at]), np.array([0.0, 0.1]),
                  np.array(middle), gravity=(0.0, 0.0, 0.0), resolution=(21, 6))  # fmt: skip
    theta, along, across = cloth(name, scene, STRETCH)
    x = run(name, scene, theta, *pairs)[-1]
    warp = np.linalg.norm(x[3] - x[2]) / 0.04 - 1
    return -(np.linalg.norm(x[1] - x[0]) / 0.06 - 1) / warp, along, across


@on_every_model
@pytest.mark.parametrize("share", [0.3, -0.25])
def test_a_pulled_strip_narrows_by_the_coupling(name, share):
    """ν = C₁₂/C₂₂ for a strip that is free to narrow."""
    before, along, across = narrowing(name)
    found, *_ = narrowing(name, ("poisson_coupling", [share * along]))
    assert before == pytest.approx(across / along, abs=0.03)
    assert found == pytest.approx(across / along + share, abs=0.03)


def clamped(length, width, shape, points, gravity=(0.0, 0.0, 0.0)):
    """A level strip in the x–y plane, held by its first two columns of nodes."""
    step = length / (shape[0] - 1)
    held = np.array([[u, v] for u in (0.0, step) for v in np.linspace(0, width, shape[1])])
    at = np.stack([held[:, 0], held[:, 1], 0 * held[:, 0]], axis=1)
    grid = np.stack([a.ravel() for a in np.meshgrid(np.linspace(0, length, 5), np.linspace(0, width, 3))], axis=1)
    where = np.vstack([np.array(points), grid])
    start = np.stack([where[:, 0], where[:, 1], 0 * where[:, 0]], axis=1)
    times = np.array([0.0, 0.1])
    return Scene(length, width, 0.2, times, held, np.stack([at, at]), times, where, gravity=gravity,
                 resolution=shape, start=start)  # fmt: skip


@on_every_model
def test_a_strip_curls_to_the_radius_of_couple_over_rigidity(name):
    """R = D/M; D from `bending_anisotropy`, beside which the model's own rigidity does not count. n = u × v is +z."""
    scene = clamped(0.12, 0.04, (13, 5), [(0.03, 0.02), (0.07, 0.02), (0.11, 0.02)])
    theta, *_ = cloth(name, scene, STIFF)
    x = run(name, scene, theta, ("bending_anisotropy", [5e-4, 5e-4]), ("rest_curvature", [4e-3 / 4, 0.0]))[-1]
    a, b, c = x[:3]
    sides = [np.linalg.norm(p - q) for p, q in ((a, b), (b, c), (c, a))]
    radius = np.prod(sides) / (2 * np.linalg.norm(np.cross(b - a, c - a)))
    assert radius == pytest.approx(5e-4 / 1e-3, rel=0.03)
    assert c[2] > b[2] > 0


def turned(x, points, direction):
    """Angle [rad] between planes through the points of a strip (N, 3) m beyond 3 cm from the line through its middle,
    above 0 where it is folded towards u × v; and how far these points lie off their planes at most [m].
    """
    across = points @ [-np.sin(direction), np.cos(direction)]
    across -= (across.min() + across.max()) / 2
    normals, off = [], 0.0
    for side in (across < -0.03, across > 0.03):
        flat = np.column_stack([points[side], np.ones(side.sum())])
        plane = np.linalg.lstsq(flat, x[side], rcond=None)[0]
        off = max(off, np.linalg.norm(flat @ plane - x[side], axis=1).max())
        normals.append(np.cross(plane[0], plane[1]) / np.linalg.norm(np.cross(plane[0], plane[1])))
    line = (np.cos(direction), np.sin(direction), 0.0)
    return np.arctan2(np.cross(*normals) @ line, normals[0] @ normals[1]), off


@pytest.mark.parametrize("shape", [(19, 7), (25, 9)])
@pytest.mark.parametrize("direction", [np.pi / 2, 1.1], ids=["straight", "oblique"])
def test_a_pressed_strip_rests_flat_on_both_sides_of_the_line_and_turned_by_couple_over_rigidity(shape, direction):
    """α = P/D of an isotropic sheet, on either mesh."""
    grid = np.stack([a.ravel() for a in np.meshgrid(np.linspace(0, 0.16, 17), np.linspace(0, 0.05, 6))], axis=1)
    scene = clamped(0.16, 0.05, shape, grid)
    rigidity, angle = 1e-4, 0.6
    theta = catalogue().make("models", "baraff_witkin").of_material(Material(rigidity, STIFF, STIFF / 2), scene)
    x = run("baraff_witkin", scene, theta, ("crease", [angle * rigidity, 0.5, direction]))[-1]
    found, off = turned(x[: len(grid)], grid, direction)
    assert found == pytest.approx(angle, rel=0.02)
    assert off < 2e-5


@pytest.mark.parametrize(("place", "expected"), [(0.5, 0.125), (0.4, 0.1)])
@pytest.mark.parametrize("held", [[], [(0.02, 0.02), (0.28, 0.02)], [(0.067, 0.011), (0.241, 0.011)]])
def test_a_crease_lies_at_its_share_of_the_cloth_wherever_the_grips_are(held, place, expected):
    """Nodes begin at grips that lie inside the hems; the cloth does not."""
    grips = np.array(held).reshape(-1, 2)
    path = np.stack([np.pad(grips, ((0, 0), (0, 1)))] * 2)
    scene = Scene(0.3, 0.25, 0.12, np.array([0.0, 1.0]), grips, path, np.array([0.0, 1.0]), np.array([[0.1, 0.1]]),
                  resolution=(13, 11))  # fmt: skip
    mesh, crease = own_sheet(MassSpring().prepare(scene).sheet), catalogue().make("effects", "crease")
    x = np.ascontiguousarray(np.stack([mesh.uv[:, 0], 0 * mesh.uv[:, 0], -mesh.uv[:, 1]]))
    state, force = np.zeros(crease.state_size(mesh)), np.zeros_like(x)
    crease.force(0.0, 1e-3, x, 0 * x, force, mesh, np.array([1e-5, place, 0.0]), state)
    # The force of a couple along the line is its second derivative: moments of order 2 and 3 tell where the line is.
    normal = force[1]
    where = (normal * mesh.uv[:, 1] ** 3).sum() / (3 * (normal * mesh.uv[:, 1] ** 2).sum())
    assert where == pytest.approx(expected, abs=2e-3)


@on_every_model
def test_a_pressed_strip_rests_turned_by_couple_over_rigidity_in_every_model(name):
    """D from `bending_anisotropy`, beside which the model's own rigidity does not count; the other way round."""
    grid = np.stack([a.ravel() for a in np.meshgrid(np.linspace(0, 0.16, 17), np.linspace(0, 0.05, 6))], axis=1)
    scene = clamped(0.16, 0.05, (17, 6), grid)
    theta, *_ = cloth(name, scene, STIFF)
    rigid = ("bending_anisotropy", [4e-4, 4e-4])
    x = run(name, scene, theta, rigid, ("crease", [-0.5 * 4e-4, 0.5, np.pi / 2]))[-1]
    found, _ = turned(x[: len(grid)], grid, np.pi / 2)
    assert found == pytest.approx(-0.5, rel=0.02)


@on_every_model
def test_warp_and_weft_overhang_differently(name):
    """A strip that bends along its stiffer direction sags less; small sag of a cantilever: ρ g L⁴/(8 D)."""
    scene = clamped(0.07, 0.03, (15, 7), [(0.07, 0.015)], gravity=(0.0, 0.0, -G))
    theta, *_ = cloth(name, scene, STIFF)
    sag = {}
    for direction, values in (("warp", [1e-3, 0.0]), ("weft", [0.0, 1e-3])):
        sag[direction] = -run(name, scene, theta, ("bending_anisotropy", values))[-1, 0, 2]
    free = 0.07 - 0.005  # the cell that the clamp holds
    assert sag["warp"] == pytest.approx(0.2 * G * free**4 / (8 * 1e-3), rel=0.02)
    assert sag["weft"] > 3 * sag["warp"]


@on_every_model
def test_a_strip_bounces_faster_where_stress_has_no_time_to_relax(name):
    """f = √(E/ρ)/(4 L) for the first mode along a strip; E grows by the Maxwell element's if τ is long."""
    times = np.arange(0.1, 0.9, 0.002)

    def pull(t):
        return np.stack([0 * t, 0 * t, 5e-4 * np.exp(-(((t - 0.05) / 0.02) ** 2))], axis=1)

    scene = hanging(0.04, 0.4, times, [(0.02, 0.4)], (3, 21), moved=pull)
    theta, along, across = cloth(name, scene, STRETCH)

    def bounce(*pairs):
        z = run(name, scene, theta, *pairs)[:, 0, 2]
        z = (z - z.mean()) / np.ptp(z)

        def mode(t, f, a, b, c, decay):
            return (a * np.sin(2 * np.pi * f * t) + b * np.cos(2 * np.pi * f * t)) * np.exp(-decay * t) + c

        rate = np.fft.rfftfreq(8 * len(z), 0.002)
        guess = rate[np.abs(np.fft.rfft(z, 8 * len(z)))[rate < 25].argmax()]
        return curve_fit(mode, times - times[0], z, p0=[guess, 0.3, 0.3, 0.0, 0.5], maxfev=20000)[0][0]

    def expected(extra):
        own = along + extra
        return np.sqrt((own - across**2 / own) / 0.2) / (4 * 0.4)

    assert bounce() == pytest.approx(expected(0.0), rel=0.04)
    assert bounce(("viscoelasticity", [0.0, 2 * STRETCH, 20.0])) == pytest.approx(expected(2 * STRETCH), rel=0.04)


@on_every_model
def test_friction_calms_a_strip_that_springs_back(name):
    """A cantilever let down by its clamp: what is left of its swinging after two seconds is less with friction."""
    times = np.linspace(0.5, 2.0, 151)
    grip_time = np.linspace(0.0, 2.0, 101)
    base = clamped(0.07, 0.03, (8, 4), [(0.07, 0.015)], gravity=(0.0, 0.0, -G))
    s = np.clip(grip_time / 0.2, 0, 1)
    drop = 0.02 * s**3 * (10 - 15 * s + 6 * s**2)
    path = base.grip_position[:1] - drop[:, None, None] * np.array([0.0, 0.0, 1.0])
    scene = Scene(0.07, 0.03, 0.2, grip_time, base.grip_material, path, times, base.points, resolution=(8, 4),
                  start=base.start)  # fmt: skip
    theta, *_ = cloth(name, scene, STIFF)
    stiff = ("bending_anisotropy", [2e-4, 2e-4])
    left = [
        np.ptp(run(name, scene, theta, stiff, *more)[-50:, 0, 2])
        for more in ((), (("bending_hysteresis", [5e-4, 5.0]),))
    ]
    assert left[1] < 0.5 * left[0]
