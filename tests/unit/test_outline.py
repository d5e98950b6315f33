"""Outlines: polygons over grids, what of each box lies in them, and which of them are refused."""

import numpy as np
import pytest

from clothbench import ClothbenchError
from clothbench.core.outline import checked_outline, covered, disc_outline, signed_area, within
from clothbench.core.rollout import Interpolator
from clothbench.modelling import Cover, grid_triangles, sheet_of, tributary

ELL = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2.0]])


def rectangle(width, height):
    return np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=float)


@pytest.mark.parametrize(
    ("outline", "says"),
    [
        (np.array([[0, 0], [2, 0], [2, 1], [1, 0], [1, 2], [0, 2.0]]), "corner 3 lies on side 0"),
        (np.array([[0, 0], [2, 0], [2, 2], [0, 2], [0, 0.0]]), "corner 0 lies on side 3"),
        (np.array([[0, 0], [2, 0], [2, 0], [2, 2], [0, 2.0]]), "corner 1 lies on side 2"),
    ],
)
def test_an_outline_that_touches_itself_is_refused(outline, says):
    with pytest.raises(ClothbenchError, match=says):
        checked_outline(outline, 2.0, 2.0)


def test_boxes_hold_what_the_outline_encloses():
    lines = np.linspace(0, 2, 5)
    assert covered(ELL, lines, lines) / 0.25 == pytest.approx(np.kron([[1, 1], [1, 0]], np.ones((2, 2))))
    disc = disc_outline(0.15)
    boxes = covered(disc, np.linspace(0, 0.3, 24), np.linspace(0, 0.3, 18))
    assert boxes.sum() == pytest.approx(signed_area(disc), rel=1e-12)
    assert boxes.sum() == pytest.approx(np.pi * 0.15**2, rel=1e-4)


def test_boxes_agree_with_counting_points():
    rng = np.random.default_rng(4)
    turn = np.sort(rng.uniform(0, 2 * np.pi, 17))
    star = 0.5 + rng.uniform(0.1, 0.5, 17)[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    u, v = np.linspace(0, 1, 5), np.linspace(0, 1, 4)
    points = rng.uniform(0, 1, (200_000, 2))
    counted, *_ = np.histogram2d(*points[within(star, points)].T, bins=(u, v))
    assert covered(star, u, v) == pytest.approx(counted.T / len(points), abs=2e-3)


def test_a_polygon_of_the_whole_sheet_covers_all_of_it():
    u, v = np.linspace(0, 0.3, 9) ** 1.1, np.linspace(0, 0.2, 7)
    cover = Cover.of(rectangle(u[-1], v[-1]), (u, v))
    assert cover.nodes.all()
    assert cover.area == pytest.approx(np.outer(tributary(v, v[-1]), tributary(u, u[-1])), rel=1e-9)
    assert cover.cells == pytest.approx(np.ones((6, 8)))
    assert cover.widths(1, 0)[:, :-1] == pytest.approx(np.repeat(tributary(v, v[-1])[:, None], 8, axis=1))


@pytest.mark.parametrize("outline", [disc_outline(0.15), 0.15 * ELL], ids=["disc", "ell"])
@pytest.mark.parametrize("nodes", [9, 14, 25])
def test_no_cloth_is_lost_between_nodes(outline, nodes):
    lines = np.linspace(0, 0.3, nodes)
    cover = Cover.of(outline, (lines, lines))
    assert cover.area.sum() == pytest.approx(signed_area(outline), rel=1e-9)
    place = np.stack(np.meshgrid(lines, lines), axis=-1)
    fine = np.linspace(0, 0.3, 301)
    middle = (fine[1:] + fine[:-1]) / 2
    exact = np.array([(covered(outline, fine, fine) * axis).sum() for axis in np.meshgrid(middle, middle)])
    centre = (cover.area[..., None] * place).sum(axis=(0, 1)) / cover.area.sum()
    assert centre == pytest.approx(exact / cover.area.sum(), abs=0.05 * 0.3 / (nodes - 1))
    triangles, share = cover.triangles(grid_triangles((nodes, nodes)))
    assert cover.nodes.ravel()[triangles].all()
    assert (share > 0).all()
    assert (share <= 1 + 1e-9).all()


@pytest.mark.parametrize("nodes", [13, 25, 31, 49])
@pytest.mark.parametrize("beside", [-0.02, -0.01, 0.008])
def test_grips_beside_a_hem_neither_add_nor_lose_cloth(nodes, beside):
    """Mesh lines go through grips, which may lie over a hem by 2 % of the sheet, or within it by a part of a cell."""
    u, v = np.linspace(0, 1, nodes), np.linspace(0, 1, nodes)
    u[0] = beside
    length = tributary(u, 1.0)
    assert length.sum() == pytest.approx(1.0)
    assert (length > 0).all()
    if beside < 0:
        assert length[0] == pytest.approx(0.5 / (nodes - 1))
    for outline in (rectangle(1, 1), np.array([[0, 0], [1, 0], [1, 1], [0.5, 1], [0, 0.5]])):
        assert Cover.of(outline, (u, v), (1.0, 1.0)).area.sum() == pytest.approx(signed_area(outline))


def test_cells_that_an_outline_cuts_are_not_taken_for_whole():
    """However little it cuts: loops over a grid would else weigh its border as if it were all cloth."""
    lines = np.linspace(0, 1, 11)
    for inset, columns in ((0.0, 11), (0.01, 0), (0.02, 0)):
        outline = inset + (1 - 2 * inset) * rectangle(1, 1)
        cover = Cover.of(outline, (lines, lines))
        triangles, share = cover.triangles(grid_triangles((11, 11)))
        assert len(triangles) == 200
        uv = np.stack(np.meshgrid(lines, lines), axis=-1).reshape(-1, 2)
        area = cover.area.ravel()
        sheet = sheet_of(uv, area, area, triangles, (0, 0, -9.81), 1.2, share=share)
        assert sheet.columns == columns
        assert sheet.slots[0].sum() == pytest.approx(sheet.face_area.sum())


def test_a_strip_that_holds_no_whole_cell_is_refused():
    lines = np.linspace(0, 1, 13)
    along = np.array([[0.02, 0], [1, 0.98], [0.98, 1], [0, 0.02]])
    with pytest.raises(ClothbenchError, match="no whole cell"):
        Cover.of(along, (lines, lines)).nodes  # noqa: B018


def test_points_of_a_cut_sheet_are_read_from_its_own_nodes():
    lines = np.linspace(0, 0.3, 13)
    cover = Cover.of(disc_outline(0.15), (lines, lines))
    points = disc_outline(0.15, 48)
    interpolator = Interpolator.on_lines(points, lines, lines, cover.nodes)
    used = np.abs(interpolator.weight) > 1e-12
    assert cover.nodes.ravel()[interpolator.index[used]].all()
    uv = np.stack(np.meshgrid(lines, lines), axis=-1).reshape(-1, 2)
    assert interpolator(uv @ [[1, 2, 3], [4, 5, 6.0]]) == pytest.approx(points @ [[1, 2, 3], [4, 5, 6.0]], abs=1e-12)


def test_corners_run_counter_clockwise():
    assert signed_area(checked_outline(ELL[::-1], 2, 2)) == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("outline", "says"),
    [
        (np.zeros((2, 2)), "at least three corners"),
        (np.array([[0, 0], [1, np.nan], [0, 1]]), "finite"),
        (ELL + 0.5, "within the sheet of 2 × 2 m"),
        (np.array([[0, 0], [1, 1], [1, 0], [0, 1.0]]), "sides 0 and 2 cross"),
        (np.array([[0, 0], [1, 1], [2, 2.0]]), "a polygon with an area"),
    ],
)
def test_what_is_no_outline_is_refused(outline, says):
    with pytest.raises(ClothbenchError, match=says):
        checked_outline(outline, 2, 2)


def test_a_grid_too_coarse_for_the_outline_is_refused():
    lines = np.linspace(0, 1, 4)
    with pytest.raises(ClothbenchError, match="raise the resolution"):
        Cover.of(0.1 * ELL, (lines, lines)).nodes  # noqa: B018
