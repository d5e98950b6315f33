"""Cloth that is no rectangle, against mechanics: mass, stiffness, clamped plates, falls and supports."""

import dataclasses

import numpy as np
import pytest
from clothbench_effects.heavy_hem import find_hem
from clothbench_effects.point_mass import find_place
from clothbench_models.baraff_witkin import BaraffWitkin, triangle_edges
from clothbench_models.inextensible import Inextensible
from clothbench_models.mass_spring import MassSpring
from clothbench_models.mass_spring_verlet import MassSpringVerlet
from clothbench_models.spring_grid import SpringGrid

from clothbench import ClothbenchError, Scene
from clothbench.core.optional import why_skipped
from clothbench.core.outline import disc_outline, signed_area
from clothbench.core.scene import Obstacle
from clothbench.modelling import Cover
from clothbench.reference.mechanics import clamped_annulus_sag

G, DENSITY = 9.81, 0.2
MODELS = [MassSpring, MassSpringVerlet, BaraffWitkin, Inextensible]
STIFF = {BaraffWitkin: [1e-4, 200, 50, 2e-7, 0.02, 0.02, 0, 0, 0], Inextensible: [1e-4, 0.5, 0]}


def cut(outline, nodes, *, points, obstacles=(), times=(0.0,), start=None, thickness=0.0):
    """A sheet cut along an outline that nothing grips."""
    size = outline.max(axis=0)
    return Scene(
        width=size[0], height=size[1], areal_density=DENSITY, grip_time=np.array([0.0, 1.0]),
        grip_material=np.zeros((0, 2)), grip_position=np.zeros((2, 0, 3)), times=np.array(times), points=points,
        resolution=(nodes, nodes), outline=outline, obstacles=obstacles, start=start, thickness=thickness,
    )  # fmt: skip


def ring(radius, count=48, about=0.15):
    return about + (disc_outline(radius, count) - radius)


def parameters(model):
    return np.array([STIFF[type(model)]]) if type(model) in STIFF else model.parameters.defaults[None]


# --- a ring that sags a little ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", [BaraffWitkin(tolerance=1e-8), Inextensible(tolerance=1e-8)], ids=lambda m: m.name)
@pytest.mark.parametrize(
    ("inner", "outer", "nodes", "within"), [(0.09, 0.15, 37, 0.05), (0.09, 0.15, 21, 0.05), (0.05, 0.15, 31, 0.08)]
)
def test_a_clamped_ring_sags_as_a_plate(model, inner, outer, nodes, within):
    bending = DENSITY * G * (outer - inner) ** 4 / 8 / 5e-5  # sags by about 50 µm, so that nothing stretches
    plate = Obstacle("disc", radius=inner, clamps=True)
    scene = cut(disc_outline(outer), nodes, points=ring(outer, about=outer), obstacles=(plate,))
    rigid = parameters(model) * 0
    rigid[0, 0] = bending
    if isinstance(model, BaraffWitkin):
        rigid[0, 1:3] = 200, 50
    rollout = model.prepare(scene).run(rigid)
    sag = -rollout.position[0, 0, :, 2]
    assert rollout.status == ("ok",)
    assert sag.mean() == pytest.approx(clamped_annulus_sag(inner, outer, DENSITY * G / bending), rel=within)
    assert np.ptp(sag) < 0.4 * sag.mean()


# --- mass and stiffness -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("nodes", [13, 25])
def test_an_even_stretch_of_springs_costs_what_the_disc_holds(nodes):
    """½ Σ k share (strain L)² over the u-springs of a disc is ½ k ε² times its area, whatever cells are cut."""
    lines, disc = np.linspace(0, 0.3, nodes), disc_outline(0.15)
    cover = Cover.of(disc, (lines, lines))
    springs = SpringGrid.of((lines, lines), (0.3, 0.3), DENSITY, ((1, 0, 0), (0, 1, 1)), cover)
    assert springs.mass.sum() == pytest.approx(DENSITY * signed_area(disc), rel=1e-9)
    energy = (springs.share * springs.rest**2).sum(axis=1) / signed_area(disc)
    assert energy == pytest.approx([1.0, 1.0], abs=0.6 / nodes)  # what the caps at the rim leave out
    lengths, _, stiffness = triangle_edges((lines, lines), (0.3, 0.3), cover)
    assert (stiffness[:2] * lengths**2).sum(axis=1) / signed_area(disc) == pytest.approx([1, 1], abs=0.3 / nodes)


def test_light_nodes_at_the_cut_hardly_shorten_the_steps():
    lines = np.linspace(0, 0.3, 25)
    whole = SpringGrid.of((lines, lines), (0.3, 0.3), DENSITY)
    for radius in (0.15, 0.1471, 0.1399):
        disc = 0.15 + (disc_outline(radius) - radius)
        part = SpringGrid.of((lines, lines), (0.3, 0.3), DENSITY, cover=Cover.of(disc, (lines, lines)))
        assert max(part.largest_eigenvalues) < 1.7 * max(whole.largest_eigenvalues)


@pytest.mark.parametrize("factory", MODELS, ids=lambda m: m.name)
def test_a_sheet_cut_to_all_of_itself_is_the_sheet(factory):
    model, whole = factory(resolution=7), np.array([[0, 0], [0.3, 0], [0.3, 0.25], [0, 0.25]])
    grips = np.array([[0.0, 0.0], [0.3, 0.0]])
    at = np.stack([grips[:, 0] * 0.9, 0 * grips[:, 0], 1 - grips[:, 1]], axis=1)
    points = np.stack(np.meshgrid(np.linspace(0, 0.3, 5), np.linspace(0, 0.25, 4)), axis=-1).reshape(-1, 2)
    start = np.stack([0.9 * points[:, 0], 0.02 * np.sin(9 * points[:, 0]), 1 - points[:, 1]], axis=1)
    moved = np.stack([at, at + np.array([0, 0.03, 0])])
    scene = Scene(0.3, 0.25, DENSITY, np.array([0, 0.1]), grips, moved, np.array([0, 0.05, 0.1]), points, start=start)
    theta = parameters(model)
    plain = model.prepare(scene).run(theta).position
    polygon = model.prepare(dataclasses.replace(scene, outline=whole)).run(theta).position
    assert polygon == pytest.approx(plain, abs=5e-5)


def test_cloth_without_a_middle_keeps_its_right_angles():
    """A U of cloth, shaken by its upper corners: the node in the middle of the grid, which is none of it, weighs 0."""
    lines = np.linspace(0, 0.3, 16)
    outline = np.array([[0, 0], [0.3, 0], [0.3, 0.3], [0.22, 0.3], [0.22, 0.08], [0.08, 0.08], [0.08, 0.3], [0, 0.3]])
    points = np.stack(np.meshgrid(lines[:5], lines), axis=-1).reshape(-1, 2)  # nodes of the left leg
    grips, stamps = np.array([[0.0, 0.0], [0.3, 0.0]]), np.linspace(0, 0.4, 17)
    at = np.stack([grips[:, 0], [0, 0], [1, 1]], axis=1)
    shaken = at + 0.04 * np.sin(4 * np.pi * stamps)[:, None, None] * [1, 0, 0]
    scene = Scene(
        0.3, 0.3, DENSITY, stamps, grips, shaken, np.linspace(0, 0.4, 5), points, outline=outline, resolution=(16, 16)
    )
    model = Inextensible()
    rollout = model.prepare(scene).run(model.parameters.defaults)
    assert rollout.status == ("ok",)
    x = rollout.position[0].reshape(5, 16, 5, 3)
    along_u = (x[:, 1:, 1:] + x[:, :-1, 1:] - x[:, 1:, :-1] - x[:, :-1, :-1]) / 2
    along_v = (x[:, 1:, 1:] + x[:, 1:, :-1] - x[:, :-1, 1:] - x[:, :-1, :-1]) / 2
    assert np.abs((along_u * along_v).sum(axis=-1)).max() < 2e-3 * 0.02**2


# --- falls and supports -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("factory", MODELS, ids=lambda m: m.name)
def test_a_disc_let_go_falls_freely(factory):
    model, points = factory(), np.vstack([ring(0.02), ring(0.15)])
    start = np.stack([points[:, 0], points[:, 1], 0 * points[:, 0]], axis=1)
    times = np.array([0.0, 0.05, 0.1])
    still = np.array([parameters(model)[0]])
    if isinstance(model, BaraffWitkin | Inextensible):
        still[0, 1 if isinstance(model, Inextensible) else 3 :] = 0
    if isinstance(model, MassSpringVerlet):
        still[0, -1] = 0
    rollout = model.prepare(cut(disc_outline(0.15), 13, points=points, times=times, start=start)).run(still)
    assert rollout.position[0, :, :, 2] == pytest.approx(np.repeat(-G / 2 * times[:, None] ** 2, 96, axis=1), abs=2e-4)


@pytest.mark.parametrize("factory", MODELS, ids=lambda m: m.name)
@pytest.mark.parametrize(
    "support", [Obstacle("plane"), Obstacle("sphere", (0, 0, -0.1), radius=0.1), Obstacle("disc", radius=0.05)],
    ids=lambda o: o.shape,
)  # fmt: skip
def test_a_disc_stays_out_of_what_bears_it(factory, support):
    model, points = factory(), np.vstack([ring(r) for r in (0.001, 0.03, 0.06, 0.09, 0.12, 0.149)])
    start = np.stack([points[:, 0] - 0.15, 0.15 - points[:, 1], 0.005 + 0 * points[:, 0]], axis=1)
    support = dataclasses.replace(support, friction=0.5)
    scene = cut(disc_outline(0.15), 13, points=points, times=(0.0, 0.3), start=start, obstacles=(support,))
    rollout = model.prepare(scene).run(parameters(model))
    x = rollout.position[0, -1]
    assert rollout.status == ("ok",)
    if support.shape == "plane":
        assert x[:, 2] == pytest.approx(0.0, abs=1e-3)
        return
    assert x[-48:, 2].mean() < -0.01  # the rim hangs
    depth = 0.1 - np.linalg.norm(x - [0, 0, -0.1], axis=1) if support.shape == "sphere" else -x[:96, 2]
    assert depth.max() < 4e-3  # between nodes the cloth may cut a curve's chord


@pytest.mark.parametrize("factory", MODELS, ids=lambda m: m.name)
def test_a_drape_hangs_from_its_plate(factory):
    plate = Obstacle("disc", (0.2, -0.1, 0.4), radius=0.09, clamps=True)
    points = np.vstack([ring(0.06), ring(0.15)])
    scene = cut(disc_outline(0.15), 17, points=points, obstacles=(plate,))
    rollout = factory().prepare(scene).run(parameters(factory()))
    inner, rim = np.split(rollout.position[0, 0] - [0.2, -0.1, 0.4], 2)
    assert inner == pytest.approx(np.column_stack([ring(0.06) - 0.15, np.zeros(48)]) * [1, -1, 1], abs=1e-9)
    assert (rim[:, 2] < -0.005).all()
    assert (np.hypot(*rim[:, :2].T) > 0.085).all()
    assert np.linalg.norm(rim, axis=1).max() < 0.155


@pytest.mark.parametrize("factory", MODELS, ids=lambda m: m.name)
def test_a_disc_that_clamps_all_of_the_cloth_is_refused(factory):
    plate = Obstacle("disc", (0.2, -0.1, 0.4), radius=1.0, clamps=True)
    scene = cut(disc_outline(0.15), 17, points=ring(0.06), obstacles=(plate,))
    with pytest.raises(ClothbenchError, match="clamps all of the cloth"):
        factory().prepare(scene).run(parameters(factory()))


def test_air_drags_a_cut_sheet_by_its_area():
    """A disc that falls flat through air of quadratic drag alone gains √(…)tanh as a body of that mass and area."""
    model = BaraffWitkin()
    points = ring(0.1)
    start = np.stack([points[:, 0], points[:, 1], 0 * points[:, 0]], axis=1)
    drag = 1.2
    times = np.array([0.0, 0.15, 0.3])
    scene = cut(disc_outline(0.15), 15, points=points, times=times, start=start)
    fallen = -model.prepare(scene).run(np.array([[1e-3, 500, 200, 0, 0, 0, drag, 0, 0]])).position[0, :, :, 2]
    speed = np.sqrt(DENSITY * G / drag)
    assert fallen.mean(axis=1) == pytest.approx(speed**2 / G * np.log(np.cosh(G * times / speed)), abs=1e-3)


# --- what is refused --------------------------------------------------------------------------------------------------


def test_only_a_disc_clamps():
    with pytest.raises(ClothbenchError, match="a plane cannot clamp the cloth"):
        Obstacle("plane", clamps=True)


def test_a_model_without_outlines_is_skipped_with_the_reason():
    class Whole(MassSpring):
        capabilities = MassSpring.capabilities - {"outline"}

    scene = cut(disc_outline(0.15), 13, points=ring(0.15))
    assert why_skipped(MassSpring(), scene) is None
    assert "cut or a clamped cloth" in why_skipped(Whole(), scene)


@pytest.mark.parametrize(
    ("lacks", "change", "says"),
    [
        ("contact", {"obstacles": (Obstacle("plane"),)}, "knows no contact"),
        ("self_contact", {"thickness": 1e-3}, "pass through each other"),
    ],
)
def test_a_model_without_contact_is_skipped_with_the_reason(lacks, change, says):
    class Bare(MassSpring):
        capabilities = MassSpring.capabilities - {lacks}

    scene = dataclasses.replace(cut(disc_outline(0.15), 13, points=ring(0.15)), **change)
    assert why_skipped(MassSpring(), scene) is None
    assert says in why_skipped(Bare(), scene)


@pytest.mark.parametrize("outline", [disc_outline(0.15), np.array([[0, 0], [0.3, 0], [0.3, 0.3], [0, 0.3]])], ids=len)
def test_cloth_that_does_not_stretch_is_not_thrown_off_a_rough_disc(outline):
    """Wherever exactly it begins: friction of one step had thrown it in the next, in every second of these runs."""
    points = np.vstack([ring(r) for r in (0.001, 0.09, 0.149)])
    support = Obstacle("disc", radius=0.05, friction=0.5)
    for shift in range(8):
        start = np.stack([points[:, 0] - 0.15 + 1e-6 * shift, 0.15 - points[:, 1], np.full(len(points), 0.005)], axis=1)
        scene = cut(outline, 13, points=points, times=np.linspace(0, 0.3, 61), start=start, obstacles=(support,))
        rollout = Inextensible().prepare(scene).run(parameters(Inextensible()))
        assert rollout.status == ("ok",)
        assert np.abs(np.diff(rollout.position[0], axis=0)).max() < 0.05  # m in 5 ms


# --- hems beside the grid ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("inset", "cut_out"), [(0.005, False), (0.012, False), (-0.005, False), (0.005, True), (0.012, True)]
)
def test_cloth_beside_a_grip_off_the_hem_counts(inset, cut_out):
    """Mass, faces and what the membrane costs in even shear are those of the whole sheet where lines were moved."""
    material = np.array([[inset, inset], [0.3 - inset, inset]])
    held = np.repeat(np.stack([material[:, 0], 0 * material[:, 0], 1 - material[:, 1]], axis=1)[None], 2, axis=0)
    outline = np.array([[0, 0], [0.3, 0], [0.3, 0.3], [0, 0.3]]) if cut_out else None
    still = np.array([0, 0.1])
    scene = Scene(0.3, 0.3, DENSITY, still, material, held, still, material, outline=outline)
    simulation = BaraffWitkin(resolution=13).prepare(scene)
    sheet, (_, _, stiffness) = simulation.sheet, simulation.edges
    assert sheet.columns == 13  # loops over whole grids stay the fast ones
    assert [sheet.area.sum(), sheet.face_area.sum(), sheet.slots[0].sum(), 2 * stiffness[2].sum()] == pytest.approx(
        [0.09] * 4, rel=1e-9
    )
    springs = SpringGrid.of(simulation.lines, (0.3, 0.3), DENSITY, cover=simulation.cover)
    for family in (2, 3):
        assert (springs.share[family] * springs.rest[family] ** 2).sum() == pytest.approx(0.18, rel=1e-9)

    state = np.zeros(1 + len(sheet.uv))
    find_hem(sheet, 0.5, 0.03, state)
    assert state[1:].sum() == pytest.approx(0.5 * 0.03 * 0.3, rel=1e-9)
    assert state[1:] @ sheet.uv[:, 1] / state[1:].sum() == pytest.approx(0.285, rel=1e-9)
    place = np.zeros(7)
    find_place(sheet, 0.5, 0.5, place)
    assert place[4:] @ sheet.uv[place[1:4].astype(int)] == pytest.approx([0.15, 0.15], rel=1e-9)
