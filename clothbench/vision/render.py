"""What a camera sees of a sheet: depth, silhouette, and stripes that a projector throws on it.

Compiled, since it stands inside a metric; frames come one after the other, and who has cores to fill gives each some of
them. Every visible point is lit: shadows that the sheet throws on itself are left out, and so is what its surface
reflects besides.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from clothbench.core.camera import Camera, Projector
from clothbench.core.errors import ClothbenchError
from clothbench.core.kernels import kernel
from clothbench.vision.surface import Surface

AMBIENT, LIT, DARK = 0.30, 0.60, 0.03  # grey of the sheet between stripes, what a stripe adds, and the background's
EDGE = 1e-9  # by which a pixel may lie outside: on a shared edge rounding must not leave it to neither triangle
NEAR = 1e-3  # m; triangles that come nearer to the lens are not drawn


@kernel
def rasterise(pixel, depth, triangle, attribute, nearest, out):
    """Draw triangles (F, 3) over an image: the nearest point at the middle of every pixel.

    pixel (M, 2) and depth (M,) m of the points, attribute (M, K) to interpolate with perspective. Overwrites
    nearest (H, W) m, infinite where there is nothing, and out (H, W, K). A triangle with a point that is not a number
    is left out.
    """
    height, width = nearest.shape
    nearest[:] = np.inf
    for f in range(len(triangle)):
        a, b, c = triangle[f]
        ax, ay, bx, by, cx, cy = pixel[a, 0], pixel[a, 1], pixel[b, 0], pixel[b, 1], pixel[c, 0], pixel[c, 1]
        twice = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if not (abs(twice) > 1e-12 and min(depth[a], depth[b], depth[c]) > NEAR):
            continue
        left = max(0, int(np.ceil(min(ax, bx, cx))))
        right = min(width - 1, int(np.floor(max(ax, bx, cx))))
        top = max(0, int(np.ceil(min(ay, by, cy))))
        bottom = min(height - 1, int(np.floor(max(ay, by, cy))))
        ia, ib, ic = 1 / depth[a], 1 / depth[b], 1 / depth[c]
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                p = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / twice
                q = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / twice
                r = 1 - p - q
                if min(p, q, r) < -EDGE:
                    continue
                z = 1 / (p * ia + q * ib + r * ic)
                if z < nearest[y, x]:
                    nearest[y, x] = z
                    p, q, r = p * ia * z, q * ib * z, r * ic * z
                    for k in range(out.shape[2]):
                        out[y, x, k] = p * attribute[a, k] + q * attribute[b, k] + r * attribute[c, k]


@kernel
def paint_stripes(nearest, place, period, image):
    """Grey of every pixel: stripes by the projector's row, place (H, W, 2) = (row · w, w); overwrites image (H, W)."""
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            if nearest[y, x] == np.inf:
                image[y, x] = DARK
            else:
                row = place[y, x, 0] / place[y, x, 1]
                image[y, x] = AMBIENT + LIT * (0.5 + 0.5 * math.cos(2 * math.pi * row / period))


def depth_images(camera: Camera, surface: Surface, position: np.ndarray) -> np.ndarray:
    """Depth (T, H, W) m of a sheet with its nodes at position (T, N, 3) m; infinite where there is none."""
    return _drawn(camera, surface, position, lambda points: np.empty((len(points), 0)))[0]


def silhouettes(camera: Camera, surface: Surface, position: np.ndarray) -> np.ndarray:
    """Where the camera sees the sheet, (T, H, W) bool."""
    return np.isfinite(depth_images(camera, surface, position))


def striped(
    camera: Camera, projector: Projector, surface: Surface, position: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Grey images (T, H, W) from 0 to 1 of a sheet lit by the projector's stripes, and its silhouettes (bool)."""
    width, height = camera.size
    image = np.empty((len(position), height, width), np.float32)
    depth, place = _drawn(camera, surface, position, lambda points: projector_rows(projector, points))
    for frame in zip(depth, place, image, strict=True):
        paint_stripes(*frame[:2], projector.period, frame[2])
    return image, np.isfinite(depth)


def projector_rows(projector: Projector, points: np.ndarray) -> np.ndarray:
    """(row · w, w) of world points (M, 3) m, both linear in space, so that triangles interpolate them exactly."""
    lens = projector.lens
    seen = lens.in_view(points)
    return np.stack([seen @ lens.matrix[1], seen[:, 2]], axis=1)


def expose(image: np.ndarray, random: np.random.Generator, noise: float = 2.0) -> np.ndarray:
    """Grey images from 0 to 1 as a sensor reads them: 8 bits, with Gaussian noise of `noise` grey levels."""
    if noise < 0:
        raise ClothbenchError(f"render: noise is {noise}, expected grey levels, 0 or above")
    levels = 255.0 * image + random.normal(0.0, noise, image.shape)
    return np.clip(np.round(levels), 0, 255).astype(np.uint8)


def _drawn(
    camera: Camera, surface: Surface, position: np.ndarray, attributes: Callable[[np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Depth (T, H, W) m and what is interpolated (T, H, W, K) of attributes(points (M, 3) m) -> (M, K)."""
    points = surface(np.asarray(position, dtype=float))
    pixel, away = camera.project(points)
    given = [np.ascontiguousarray(attributes(p)) for p in points]
    width, height = camera.size
    depth = np.empty((len(points), height, width))
    out = np.empty((len(points), height, width, given[0].shape[1] if given else 0))
    for t, attribute in enumerate(given):
        rasterise(pixel[t], away[t], surface.triangle, attribute, depth[t], out[t])
    return depth, out
