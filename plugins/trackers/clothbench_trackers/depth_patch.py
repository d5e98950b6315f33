"""From a depth frame to the sheet's own pixels, by depth plane, distance and colour; and to a patch of triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

OWN = 0.25  # share of the largest piece that another piece must have to be of the sheet too
HUE_SPREAD = 12.0  # of a and b of Lab, of 255, that pixels of one hue lie within
ONE_HUE = 0.9  # share of the cloth's pixels that have it, from which on a hue is the cloth's


@dataclass(frozen=True, eq=False)
class Patch:
    """Pixels of the sheet joined to triangles (F, 3). point: (M, 3) m, world; pixel: (M, 2), row and column."""

    point: np.ndarray
    pixel: np.ndarray
    triangle: np.ndarray


def within(depth: np.ndarray, near: float, far: float) -> np.ndarray:
    """Pixels (H, W) of a depth image [m] between two planes."""
    with np.errstate(invalid="ignore"):
        return (depth > near) & (depth < far)


def without_outliers(depth: np.ndarray, mask: np.ndarray, jump: float, support: int) -> np.ndarray:
    """Pixels that have at least `support` of their eight neighbours within `jump` m, in the large pieces that these
    neighbourhoods join: flying pixels between two things have few, specks of noise make small pieces.
    """
    from scipy.ndimage import label

    kept = mask & (alike(depth, mask, jump).sum(axis=0) >= support)
    pieces, count = label(kept, structure=np.ones((3, 3)))
    if count == 0:
        return kept
    sizes = np.bincount(pieces.ravel())
    sizes[0] = 0
    return kept & (sizes >= OWN * sizes.max())[pieces]


def alike(depth: np.ndarray, mask: np.ndarray, jump: float) -> np.ndarray:
    """For each of the eight directions, whether the neighbour there is in the mask and within `jump` m: (8, H, W)."""
    padded, known = np.pad(depth, 1, constant_values=np.nan), np.pad(mask, 1)
    height, width = depth.shape
    out = []
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            if down or right:
                rows, columns = slice(1 + down, 1 + down + height), slice(1 + right, 1 + right + width)
                with np.errstate(invalid="ignore"):
                    out.append(known[rows, columns] & (np.abs(padded[rows, columns] - depth) < jump))
    return np.array(out)


def hues(colour: np.ndarray) -> np.ndarray:
    """The two colour channels (H, W, 2) of CIE Lab, which shading hardly changes."""
    import cv2

    return cv2.cvtColor(colour, cv2.COLOR_RGB2LAB)[..., 1:].astype(float)


def of_colour(hue: np.ndarray, mask: np.ndarray, wanted: np.ndarray, tolerance: float) -> np.ndarray:
    """Pixels of the mask whose hue (H, W, 2) is within `tolerance` of the wanted one (2,)."""
    return mask & (np.linalg.norm(hue - wanted, axis=-1) < tolerance)


def own_hue(hue: np.ndarray, mask: np.ndarray) -> np.ndarray | None:
    """The hue (2,) that most pixels of the mask have, of hue (H, W, 2); None if the piece of the mask in which it
    prevails has others too: a printed cloth, which no hue tells from what is around it.
    """
    from scipy.ndimage import label

    seen = hue[mask]
    if not len(seen):
        return None
    counts, a, b = np.histogram2d(seen[:, 0], seen[:, 1], bins=32, range=[[0, 256], [0, 256]])
    i, j = np.unravel_index(counts.argmax(), counts.shape)
    alike = (np.abs(hue - [a[i] + 4, b[j] + 4]) < HUE_SPREAD).all(axis=-1) & mask
    piece = label(mask, structure=np.ones((3, 3)))[0]
    own = piece == np.bincount(piece[alike]).argmax()
    return np.median(hue[alike], axis=0) if alike[own].mean() > ONE_HUE else None


def smoothed(depth: np.ndarray, mask: np.ndarray, sigma: float) -> np.ndarray:
    """Depth (H, W) m of the mask, averaged over neighbours in the mask by a Gaussian of `sigma` px; a plane stays one.

    Fitted as a plane around every pixel, so that borders are not drawn inwards.
    """
    from scipy.ndimage import gaussian_filter

    if sigma <= 0:
        return np.where(mask, depth, np.nan)
    weight = mask.astype(float)
    value = np.where(mask, depth, 0.0)
    rows, columns = (a.astype(float) for a in np.indices(depth.shape))

    def mean(a: np.ndarray) -> np.ndarray:
        return gaussian_filter(a * weight, sigma, truncate=3.0)

    w = np.maximum(mean(np.ones_like(value)), 1e-12)
    y, x, z = mean(rows) / w, mean(columns) / w, mean(value) / w
    yy, xx, xy = mean(rows**2) / w - y * y, mean(columns**2) / w - x * x, mean(rows * columns) / w - x * y
    yz, xz = mean(rows * value) / w - y * z, mean(columns * value) / w - x * z
    floor = 1e-3 * sigma * sigma
    determinant = np.maximum((yy + floor) * (xx + floor) - xy * xy, 1e-9)
    down = ((xx + floor) * yz - xy * xz) / determinant
    right = ((yy + floor) * xz - xy * yz) / determinant
    return np.where(mask, z + down * (rows - y) + right * (columns - x), np.nan)


def patch_of(point: np.ndarray, mask: np.ndarray, stride: int, longest: float) -> Patch:
    """Triangles over every `stride`-th pixel of the mask, none with a side longer than `longest` m: what the camera
    does not see between two layers is not stretched over. point: (H, W, 3) m.
    """
    height, width = mask.shape
    rows, columns = np.arange(0, height, stride), np.arange(0, width, stride)
    there = mask[np.ix_(rows, columns)]
    number = np.full(there.shape, -1)
    number[there] = np.arange(there.sum())
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    corners = [(a, c, b), (b, c, d), (a, c, d), (a, d, b)]
    whole = (a >= 0) & (b >= 0) & (c >= 0) & (d >= 0)
    found = [np.stack([corner[whole] for corner in tri], axis=1) for tri in corners[:2]]
    for tri in ((a, c, b), (b, c, d), (a, c, d), (a, d, b)):  # of cells with three corners
        three = ~whole & np.logical_and.reduce([corner >= 0 for corner in tri])
        found.append(np.stack([corner[three] for corner in tri], axis=1))
    triangle = np.concatenate(found)
    at = point[np.ix_(rows, columns)][there]
    side = np.linalg.norm(at[triangle] - at[np.roll(triangle, 1, axis=1)], axis=-1)
    triangle = triangle[(side < longest).all(axis=1)]
    pixel = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1)[there]
    return _largest(Patch(at, pixel, triangle))


def from_border(patch: Patch, mask: np.ndarray) -> np.ndarray:
    """How many pixels (M,) inside the outermost ones of the mask (H, W) the vertices of a patch lie."""
    from scipy.ndimage import distance_transform_edt

    return (distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1] - 1)[tuple(patch.pixel.T)]


def _largest(patch: Patch) -> Patch:
    """The largest piece that triangles join."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    count = len(patch.point)
    if not len(patch.triangle):
        return Patch(patch.point[:0], patch.pixel[:0], patch.triangle)
    i, j = patch.triangle.ravel(), np.roll(patch.triangle, 1, axis=1).ravel()
    graph = coo_matrix((np.ones(len(i)), (i, j)), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    mine = label == np.bincount(label[patch.triangle[:, 0]]).argmax()
    number = np.cumsum(mine) - 1
    return Patch(patch.point[mine], patch.pixel[mine], number[patch.triangle[mine[patch.triangle[:, 0]]]])
