"""`laser_profile`: a laser line in the images of a calibrated camera → points of the cloth in the laser's plane.

The line's middle is found with sub-pixel accuracy where the second derivative across it is largest (Steger 1998, An
unbiased detector of curvilinear structures); a point is where its line of sight meets the plane.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from clothbench import Camera, ClothbenchError, LaserImages, Observation, Recording, read_laser
from clothbench_trackers.options import check_number, check_whole

FADED = 0.5  # of the line's usual height, below which it is not judged
WIDEST = 100  # px of the filters, which would take minutes for what is no line any more
NEIGHBOURS = 45  # points of the line by which its noise is judged


class LaserProfile:
    """width: σ [px] of the Gaussian derivatives, about that of the line or more; contrast: least brightness of the line
    over its surroundings (0 to 255); shortest: px, length of the shortest piece that is no speckle.
    """

    name = "laser_profile"
    version = 2
    kinds = frozenset({"laser"})

    def __init__(self, width: float = 2.0, contrast: float = 25.0, shortest: int = 12):
        for word, value in (("width", width), ("contrast", contrast)):
            check_number(self.name, word, value)
        if width > WIDEST:
            raise ClothbenchError(f"{self.name}: width is {width!r}, expected {WIDEST} pixels at most")
        check_whole(self.name, "shortest", shortest, 1)
        self.width, self.contrast, self.shortest = float(width), float(contrast), shortest

    def track(self, source: Any) -> Observation:
        """`source`: a recording of kind "laser", or its file. Points have no identity: `material` only numbers them, by
        the distance [m] along the longest line; sigma is judged from how they scatter about their line.
        """
        if isinstance(source, Recording):
            raise ClothbenchError("laser_profile: found node positions, expected images of kind 'laser'")
        images = source if isinstance(source, LaserImages) else read_laser(source)
        lines = [in_plane(images, self.line(image)) for image in images.image]
        if not any(len(line) for line in lines):
            raise ClothbenchError(f"{images.path or images.name}: found no laser line of contrast {self.contrast:g}")
        most = max(map(len, lines))
        position = np.full((len(lines), most, 3), np.nan)
        for frame, line in zip(position, lines, strict=True):
            frame[: len(line)] = line
        steps = np.linalg.norm(np.diff(max(lines, key=len), axis=0), axis=1)
        number = np.concatenate([[0.0], np.cumsum(steps)])
        noise = [scatter(line) ** 2 for line in lines if len(line)]
        sigma = float(np.sqrt(np.nanmean(noise))) if np.isfinite(noise).any() else math.nan  # no line is long enough
        return Observation(
            images.time, position, np.isfinite(position).all(axis=-1), sigma, np.stack([number, 0 * number], axis=1)
        )

    def line(self, image: np.ndarray) -> np.ndarray:
        """Middle of the line in one image (y, x): (N, 2) px as x, y, sorted along x, then y."""
        import cv2

        # Nothing but what is bright, with room for the filters, has to be looked at.
        rows, columns = (np.flatnonzero((image > self.contrast).any(axis=a)) for a in (1, 0))
        if not rows.size:
            return np.zeros((0, 2))
        room = int(6 * self.width) + 1
        top, left = max(rows[0] - room, 0), max(columns[0] - room, 0)
        image = image[top : rows[-1] + room + 1, left : columns[-1] + room + 1]
        at, strength = ridges(image.astype(np.float64), self.width)
        bright = strength > self.contrast
        count, label, stats, _ = cv2.connectedComponentsWithStats(bright.astype(np.uint8), connectivity=8)
        long = np.zeros(count, bool)
        long[1:] = stats[1:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1) >= self.shortest
        bright &= long[label]
        if not bright.any():
            return np.zeros((0, 2))
        # Beyond its end a line fades, and its middle is anywhere.
        y, x = np.nonzero(bright & (strength > FADED * np.median(strength[bright])))
        points = np.stack([x + left, y + top], axis=1) + at[y, x]
        return points[np.lexsort((points[:, 1], points[:, 0]))]


def ridges(image: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    """For every pixel: the offset (y, x, 2) px, as x and y, to the ridge through it, and the ridge's height (y, x).

    Both are 0 where no ridge passes through the pixel.
    """
    import cv2

    reach = int(4 * width + 1)
    t = np.arange(-reach, reach + 1)
    bell = np.exp(-(t**2) / (2 * width**2))
    bell /= bell.sum()
    first, second = -t / width**2 * bell, (t**2 / width**2 - 1) / width**2 * bell
    # Correlation turns a kernel round: the first derivative changes its sign.
    gx, gy = (cv2.sepFilter2D(image, cv2.CV_64F, *pair) for pair in ((-first, bell), (bell, -first)))
    hxx, hyy = (cv2.sepFilter2D(image, cv2.CV_64F, *pair) for pair in ((second, bell), (bell, second)))
    hxy = cv2.sepFilter2D(image, cv2.CV_64F, first, first)
    middle, half = (hxx + hyy) / 2, np.hypot((hxx - hyy) / 2, hxy)
    across = middle - half  # the most negative curvature
    steep = np.abs(across - hyy) > np.abs(hxy)
    nx, ny = np.where(steep, across - hyy, hxy), np.where(steep, hxy, across - hxx)
    length = np.maximum(np.hypot(nx, ny), 1e-300)
    nx, ny = nx / length, ny / length
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.where(across < 0, -(gx * nx + gy * ny) / across, 1.0)
    offset = np.stack([along * nx, along * ny], axis=-1)
    here = (across < 0) & (np.abs(offset) <= 0.5).all(axis=-1)
    # A line of height 1, as wide as the filter, has the second derivative −1/(σ² √8) across it.
    strength = np.where(here, -across * width**2 * np.sqrt(8.0), 0.0)
    return np.where(here[..., None], offset, 0.0), strength


def in_plane(images: LaserImages, pixels: np.ndarray) -> np.ndarray:
    """Where the lines of sight of pixels (N, 2) meet the laser's plane before the camera, (M, 3) m; pixels whose line
    does not are left out.
    """
    size = images.image.shape[:0:-1]
    camera = Camera(size, images.camera_matrix, images.camera_rotation, images.camera_translation, images.distortion)
    flat = camera.straight(pixels)
    rays = np.column_stack([flat, np.ones(len(flat))]) @ camera.rotation
    normal, distance = images.laser_plane[:3], images.laser_plane[3]
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (distance - normal @ camera.place) / (rays @ normal)
    met = np.isfinite(reach) & (reach > 0)
    return camera.place + reach[met, None] * rays[met]


def scatter(points: np.ndarray) -> float:
    """Standard deviation [m] of points (N, 3) about the line that their neighbours make."""
    from scipy.spatial import cKDTree

    if len(points) < NEIGHBOURS:
        return float("nan")
    _, near = cKDTree(points).query(points, k=NEIGHBOURS)
    cloud = points[near] - points[near].mean(axis=1, keepdims=True)
    squares = np.linalg.svd(cloud, compute_uv=False) ** 2
    return float(np.sqrt(np.median(squares[:, 1]) / (NEIGHBOURS - 2)))
