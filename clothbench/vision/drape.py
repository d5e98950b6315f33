"""Outlines of drapes in pictures, and their folds: what the drape tracker and the drape metric have in common."""

from __future__ import annotations

import numpy as np

from clothbench.core.drape import ANGLES, QUANTITIES, drape_coefficient

LEAST_FOLD = 2e-3  # m, prominence of what counts as a fold: a hand's tremble in the cloth, not the camera's pixels
SMOOTH = 1.5  # degrees, of the Gaussian that takes pixels out of an outline before its folds are looked for
CREST = 3.0  # degrees to either side of a fold's crest or trough, of the parabola whose height there is the fold's
SOFT = 4  # px beyond its edge that a shape may be soft, and count for its middle
STEP = 0.25  # px along a ray
BLOCK = 2**14  # places along a ray that are read at once: OpenCV takes fewer than 2**15


def outline_in(image: np.ndarray, pixel: float, centre: tuple[float, float] | None = None) -> np.ndarray:
    """The outline r(φ) (ANGLES,) m of the dark shape in a picture (H, W) uint8, `pixel` m wide, about `centre` (x, y)
    px, or its centroid; φ runs counter-clockwise in the picture.

    Along each ray the last place where the grey, read between pixels, passes the middle between the shape's and the
    ground's: an edge of a soft picture is found to about a third of a pixel.
    """
    import cv2

    dark = darkness(image)
    x, y = centre or centroid(dark)
    reach = int(np.hypot(*image.shape) / STEP)
    turn = 2 * np.pi * np.arange(ANGLES, dtype=np.float32)[:, None] / ANGLES
    blocks = []
    for begin in range(0, reach, BLOCK):
        along = STEP * np.arange(begin, min(begin + BLOCK, reach), dtype=np.float32)
        places = x + along * np.cos(turn), y - along * np.sin(turn)
        blocks.append(cv2.remap(dark, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0.0))
    grey = np.concatenate(blocks, axis=1)
    level = 0.5 * inside(dark)
    last = reach - 1 - (grey[:, ::-1] >= level).argmax(axis=1)
    rows = np.arange(ANGLES)
    inner, outer = grey[rows, last], grey[rows, np.minimum(last + 1, reach - 1)]
    share = np.divide(inner - level, inner - outer, out=np.zeros_like(inner), where=inner > outer)
    return np.where(inner >= level, (last + share) * STEP, 0.0) * pixel


def darkness(image: np.ndarray) -> np.ndarray:
    """How much darker than its ground a picture (H, W) uint8 is: (H, W) float32, 0 or above, and 0 where a part that is
    dark does not hang together with the largest: dust is no cloth.

    The ground is the median along the border: were it taken for white where it is not, all of it would count as part of
    the shape and draw the centroid to the picture's middle.
    """
    import cv2

    border = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
    dark = np.maximum(np.float32(np.median(border)) - image.astype(np.float32), np.float32(0.0))
    if not dark.any():
        return dark
    count, part, stated, _ = cv2.connectedComponentsWithStats((dark >= 0.5 * dark.max()).astype(np.uint8))
    largest = 1 + int(stated[1:, cv2.CC_STAT_AREA].argmax())
    return dark if count == 2 else np.where((part == 0) | (part == largest), dark, np.float32(0.0))


def inside(dark: np.ndarray) -> float:
    """How dark the shape itself is in (H, W): the middle of what is half as dark as anything, which noise makes no
    darker as it does the darkest pixel; 0 where nothing is dark.
    """
    shape = dark[dark >= 0.5 * dark.max()] if dark.any() else dark[:0]
    return float(np.median(shape)) if shape.size else 0.0


def centroid(dark: np.ndarray) -> tuple[float, float]:
    """The middle (x, y) px of the shape in (H, W), soft edges included; what is dark farther out is the ground's noise,
    which would draw it to the picture's middle.
    """
    import cv2

    shape = (dark >= 0.5 * inside(dark)).astype(np.uint8)
    dark = np.where(cv2.dilate(shape, np.ones((2 * SOFT + 1, 2 * SOFT + 1), np.uint8)) > 0, dark, np.float32(0.0))
    total = max(float(dark.sum()), 1e-12)
    rows, columns = dark.sum(axis=1), dark.sum(axis=0)
    return float(columns @ np.arange(len(columns))) / total, float(rows @ np.arange(len(rows))) / total


def drape_quantities(radius: np.ndarray, plate: float, disc: float, least: float = LEAST_FOLD) -> np.ndarray:
    """What `QUANTITIES` name, of outlines (..., K) m: (..., 4), in units of 1 and m; NaN where an outline has it.

    A fold is a maximum of the smoothed outline whose prominence is `least` m or more; where there are fewer than two,
    no angles lie between any, and unevenness is 0. How deep it is, is read off the outline as it is, where the smoothed
    one has its maxima and minima: smoothing takes a twentieth of the depth of twelve folds.
    """
    flat = radius.reshape(-1, radius.shape[-1])
    out = np.full((len(flat), len(QUANTITIES)), np.nan)
    known = np.isfinite(flat).all(axis=1)
    if known.any():
        out[known, 0] = drape_coefficient(flat[known], plate, disc)
        both = zip(smoothed(flat[known]), _heights(flat[known]), strict=True)
        out[known, 1:] = [_folds(smooth, height, least) for smooth, height in both]
    return out.reshape(*radius.shape[:-1], len(QUANTITIES))


def folds_of(radius: np.ndarray, least: float = LEAST_FOLD) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the angles at which a smoothed outline (K,) m has its folds, and the prominence of each [m]."""
    from scipy.signal import find_peaks

    count = len(radius)
    begin = int(radius.argmin())  # prominences of a closed curve: cut it where it is lowest
    line = np.concatenate([np.roll(radius, -begin), radius[begin : begin + 1]])
    peaks, found = find_peaks(line, prominence=least)
    return (peaks + begin) % count, found["prominences"]


def smoothed(radius: np.ndarray) -> np.ndarray:
    """Outlines (..., K) m without what changes from pixel to pixel."""
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(radius, SMOOTH * radius.shape[-1] / 360, axis=-1, mode="wrap")


def _heights(radius: np.ndarray) -> np.ndarray:
    """Outlines (..., K) m, at each angle that of a parabola through what lies within `CREST` of it: what changes from
    pixel to pixel is halved, and of twelve folds 0.1 % is taken away.
    """
    from scipy.signal import savgol_filter

    half = max(1, round(CREST * radius.shape[-1] / 360))
    return savgol_filter(radius, 2 * half + 1, 2, axis=-1, mode="wrap")


def _folds(smooth: np.ndarray, height: np.ndarray, least: float) -> tuple[float, float, float]:
    """Number, depth [m] and unevenness of the folds of an outline: where they are is read off the smoothed one (K,) m,
    and how deep they are off the heights (K,) m.
    """
    peaks, _ = folds_of(smooth, least)
    if not len(peaks):
        return 0.0, 0.0, 0.0
    peaks = np.sort(peaks)
    count = len(smooth)
    apart = np.diff(np.append(peaks, peaks[0] + count))
    around = np.tile(smooth, 2)
    troughs = height[[(a + around[a : a + gap].argmin()) % count for a, gap in zip(peaks, apart, strict=True)]]
    depth = height[peaks] - (troughs + np.roll(troughs, 1)) / 2
    return float(len(peaks)), float(depth.mean()), float(apart.std() / apart.mean())
