"""Dominant orientation of an image by steerable filters, and where it changes fast: angle maps and their folds.

Freeman and Adelson 1991, The design and use of steerable filters: the quadrature pair G2, H2 (second derivative of a
Gaussian and a fit of its Hilbert transform), separable in x and y (table III, V), the orientation of the highest energy
from the lowest frequency of the energy over the angle (appendix I). Bhat et al. 2003 use it with a kernel of size 12.
"""

from __future__ import annotations

import functools

import numpy as np

from clothbench.core.kernels import kernel

TAPS, SPACING = 12, 0.5  # kernel size; distance of its taps, at which it answers best to stripes 6.3 px apart
loose_kernel = functools.partial(kernel, fastmath=True)


@functools.cache
def filter_bank() -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """(along x, along y) of G2a, G2b, G2c, H2a, H2b, H2c, H2d, each (12,) float32."""
    x = SPACING * (np.arange(TAPS) - (TAPS - 1) / 2)
    bell = np.exp(-(x**2))
    second, mixed = 0.9213 * (2 * x**2 - 1) * bell, x * bell
    third, slope = 0.9780 * (x**3 - 2.254 * x) * bell, 0.9780 * (x**2 - 0.7515) * bell
    pairs = [(second, bell), (1.843 * mixed, mixed), (bell, second)]
    pairs += [(third, bell), (slope, mixed), (mixed, slope), (bell, third)]
    return tuple((a.astype(np.float32), b.astype(np.float32)) for a, b in pairs)


def responses(image: np.ndarray) -> np.ndarray:
    """The seven basis filters' answers (7, H, W) to a grey image (H, W)."""
    import cv2

    grey = np.ascontiguousarray(image, dtype=np.float32)
    return np.stack([cv2.sepFilter2D(grey, cv2.CV_32F, x, y, borderType=cv2.BORDER_REFLECT) for x, y in filter_bank()])


@loose_kernel
def energy_direction(r, cosine, sine):
    """C2 and C3 of the oriented energy C1 + C2 cos 2θ + C3 sin 2θ + … (appendix I), from responses r (7, H, W).

    θ grows from x to y, which in an image points down; the paper's grows the other way, hence the sign of C3.
    """
    for y in range(r.shape[1]):
        for x in range(r.shape[2]):
            ga, gb, gc = r[0, y, x], r[1, y, x], r[2, y, x]
            ha, hb, hc, hd = r[3, y, x], r[4, y, x], r[5, y, x], r[6, y, x]
            cosine[y, x] = (
                0.5 * (ga * ga - gc * gc) + 0.46875 * (ha * ha - hd * hd) + 0.28125 * (hb * hb - hc * hc)
                + 0.1875 * (ha * hc - hb * hd)
            )  # fmt: skip
            sine[y, x] = ga * gb + gb * gc + 0.9375 * (hc * hd + ha * hb) + 1.6875 * hb * hc + 0.1875 * ha * hd


def angle_map(image: np.ndarray, blur: float) -> np.ndarray:
    """Dominant orientation (H, W) rad in (−π/2, π/2] of a grey image (H, W): the direction across the stripes.

    blur: px, standard deviation of the Gaussian over the coefficients before the angle is taken of them.
    """
    import cv2

    answer = responses(image)
    cosine, sine = np.empty_like(answer[0]), np.empty_like(answer[0])
    energy_direction(answer, cosine, sine)
    if blur > 0:
        cosine, sine = (cv2.GaussianBlur(c, (0, 0), blur, borderType=cv2.BORDER_REFLECT) for c in (cosine, sine))
    return 0.5 * np.arctan2(sine, cosine)


def turned(angle: np.ndarray) -> np.ndarray:
    """Differences of orientations [rad], which are the same modulo π, as −π/2 … π/2."""
    return angle - np.pi * np.round(angle / np.pi)


def fold_mask(angle: np.ndarray, silhouette: np.ndarray, threshold: float) -> np.ndarray:
    """Where the orientation (H, W) changes by `threshold` rad/px or more, well inside the silhouette (Bhat, eq. 4).

    At the hem the filters see the background as well: a margin of half their size is left out.
    """
    import cv2

    down, across = _slopes(angle)
    margin = np.ones((TAPS + 1, TAPS + 1), np.uint8)
    inside = cv2.erode(silhouette.astype(np.uint8), margin, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return (np.hypot(down, across) >= threshold) & (inside > 0)


def _slopes(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Central differences of an orientation (H, W), rad/px, modulo π."""
    down, across = np.zeros_like(angle), np.zeros_like(angle)
    down[1:-1] = (turned(angle[2:] - angle[1:-1]) + turned(angle[1:-1] - angle[:-2])) / 2
    across[:, 1:-1] = (turned(angle[:, 2:] - angle[:, 1:-1]) + turned(angle[:, 1:-1] - angle[:, :-2])) / 2
    return down, across
