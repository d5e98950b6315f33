"""Calibrated cameras and projectors: the pinhole with OpenCV's distortion, and what one of them saw of a run.

Camera frame as OpenCV has it: x to the right, y down, z forwards; pixel (0, 0) is the middle of the upper left one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from clothbench.core.brief import brief
from clothbench.core.errors import ClothbenchError

MOST_PIXELS = 2**25  # more than 8K video has: memory is taken for whole pictures, and a header may claim anything
UNBENT = (3, 100, 1e-12)  # OpenCV's rounds of taking distortion back, by number and step: its usual 5 end pixels off
MISSED = 0.01  # px, from where the lens shows the line of sight that was found for a pixel
LENSES = {"matrix": (3, 3), "rotation": (3, 3), "translation": (3,), "distortion": (5,)}


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole with lens distortion; a projector is one, too, run backwards. Arrays are read-only.

    size: (width, height) px; matrix: (3, 3) px, focal lengths and principal point; rotation (3, 3), translation (3,) m:
    x_camera = R x_world + t; distortion: (5,), OpenCV's k1, k2, p1, p2, k3.
    """

    size: tuple[int, int]
    matrix: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    distortion: np.ndarray = field(default_factory=lambda: np.zeros(5))

    __repr__ = brief

    def __post_init__(self) -> None:
        for name, shape in LENSES.items():
            array = np.array(getattr(self, name), dtype=float)
            if array.shape != shape or not np.isfinite(array).all():
                raise ClothbenchError(f"camera: {name} has shape {array.shape}, expected {shape} finite numbers")
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if fault := matrix_fault(self.matrix):
            raise ClothbenchError(f"camera: matrix: {fault}")
        if len(self.size) != 2 or min(self.size) < 1 or math.prod(self.size) > MOST_PIXELS:
            raise ClothbenchError(
                f"camera: size is {self.size}, expected (width, height), with {MOST_PIXELS} pixels at most"
            )
        if np.abs(self.rotation @ self.rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(self.rotation) < 0:
            raise ClothbenchError("camera: rotation is no proper rotation matrix")

    @property
    def place(self) -> np.ndarray:
        """Where it stands in the world (3,) m."""
        return -self.rotation.T @ self.translation

    def in_view(self, points: np.ndarray) -> np.ndarray:
        """World points (..., 3) m in the camera's own frame: to the right, down, forwards."""
        return np.asarray(points, dtype=float) @ self.rotation.T + self.translation

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """World points (..., 3) m → pixels (..., 2) and depth along the optical axis (...) m.

        What lies behind the camera has a depth below 0 and pixels that are not a number; so has, with any depth, what
        lies so far off the axis that the lens' polynomial would fold it back into the picture.
        """
        seen = self.in_view(points)
        depth = seen[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            flat = np.where(depth[..., None] > 0, seen[..., :2] / depth[..., None], np.nan)
        if self.distortion.any():
            flat = distorted(flat, self.distortion)
        return flat @ self.matrix[:2, :2].T + self.matrix[:2, 2], depth

    def straight(self, pixels: np.ndarray) -> np.ndarray:
        """Pixels (..., 2) → where their lines of sight pass at a depth of 1, to the right and down (..., 2): distortion
        is taken back. NaN where the lens shows nothing at such a pixel.
        """
        (fx, skew, cx), (_, fy, cy) = self.matrix[:2]
        down = (np.asarray(pixels, dtype=float)[..., 1] - cy) / fy
        bent = np.stack([(np.asarray(pixels, dtype=float)[..., 0] - cx - skew * down) / fx, down], axis=-1)
        if not self.distortion.any() or not bent.size:
            return bent
        import cv2

        flat = bent.reshape(-1, 1, 2)
        found = cv2.undistortPoints(flat, np.eye(3), np.array(self.distortion), criteria=UNBENT).reshape(bent.shape)
        missed = np.linalg.norm(distorted(found, self.distortion) - bent, axis=-1)
        return np.where(missed[..., None] < MISSED / fx, found, np.nan)

    @classmethod
    def looking_at(
        cls, position: np.ndarray, target: np.ndarray, size: tuple[int, int], across: float,
        up: tuple[float, float, float] = (0.0, 0.0, 1.0),
    ) -> Camera:  # fmt: skip
        """A camera at `position` (3,) m that sees `across` metres over its image's width at `target` (3,) m."""
        position, target = np.asarray(position, dtype=float), np.asarray(target, dtype=float)
        forward = target - position
        distance = float(np.linalg.norm(forward))
        right = np.cross(forward, up)
        if distance == 0 or np.linalg.norm(right) < 1e-9 * distance:
            raise ClothbenchError("camera: it looks along `up`, or at itself; move it")
        right = right / np.linalg.norm(right)
        turn = np.stack([right, np.cross(forward / distance, right), forward / distance])
        focal, (width, height) = size[0] * distance / across, size
        matrix = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
        return cls(size, matrix, turn, -turn @ position)


@dataclass(frozen=True, eq=False)
class Projector:
    """Horizontal stripes thrown on a scene: a pinhole run backwards, and the stripes' period in its rows [px]."""

    lens: Camera
    period: float

    __repr__ = brief

    def __post_init__(self) -> None:
        if not (math.isfinite(self.period) and self.period > 0):
            raise ClothbenchError(f"projector: period is {self.period}, expected pixels above 0")
        if self.lens.distortion.any():
            raise ClothbenchError("projector: a distorted lens is not supported; rectify its pattern")


@dataclass(frozen=True, eq=False)
class Video:
    """Grey frames (T, H, W), one byte a pixel, of one calibrated camera; the projector whose stripes they show."""

    frame: np.ndarray
    camera: Camera
    projector: Projector | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        frame = np.array(self.frame)
        frame.flags.writeable = False
        object.__setattr__(self, "frame", frame)
        expected = self.camera.size[::-1]
        if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[1:] != expected:
            raise ClothbenchError(
                f"video: found frames of {frame.dtype} {frame.shape}, expected uint8 (T, {expected[0]}, {expected[1]})"
            )


@dataclass(frozen=True, eq=False)
class View:
    """What a tracker made of a video, frame by frame; arrays are read-only.

    silhouette: (T, H, W) bool, the cloth; angle: (T, H, W) rad, modulo π, the dominant orientation of the projected
    stripes, and fold: (T, H, W) bool, where it changes fast; both None without a projector. blur: standard deviation
    [px] of the smoothing on the way to the angles, and threshold: rad/px, from which on the angle changes fast (NaN:
    not known); a simulated view has to repeat both.
    """

    camera: Camera
    silhouette: np.ndarray
    projector: Projector | None = None
    angle: np.ndarray | None = None
    fold: np.ndarray | None = None
    blur: float = 0.0
    threshold: float = math.nan

    __repr__ = brief

    def __post_init__(self) -> None:
        for name in ("silhouette", "angle", "fold"):
            if (array := getattr(self, name)) is not None:
                array = np.array(array)
                array.flags.writeable = False
                object.__setattr__(self, name, array)
                if array.shape != self.silhouette.shape:
                    raise ClothbenchError(f"view: {name} has shape {array.shape}, expected {self.silhouette.shape}")


def matrix_fault(matrix: np.ndarray) -> str | None:
    """What keeps a matrix (3, 3) from being that of a pinhole; None if nothing does."""
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0):
        return f"found focal lengths {matrix[0, 0]:g} and {matrix[1, 1]:g} px, expected both above 0"
    if matrix[1, 0] or matrix[2].tolist() != [0.0, 0.0, 1.0]:
        return f"found rows {matrix[1].tolist()} and {matrix[2].tolist()} below, expected [0, fy, cy] and [0, 0, 1]"
    return None


def distorted(flat: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Ideal image coordinates (..., 2) at unit focal length → where the lens puts them (Brown 1966, as in OpenCV); NaN
    beyond the first maximum of r (1 + k1 r² + k2 r⁴ + k3 r⁶), from where the polynomial comes back as no lens does.
    """
    k1, k2, p1, p2, k3 = coefficients
    x, y = flat[..., 0], flat[..., 1]
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    with np.errstate(invalid="ignore"):
        radial = np.where(square < _fold(k1, k2, k3), radial, np.nan)
    across = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)
    down = y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y
    return np.stack([across, down], axis=-1)


def _fold(k1: float, k2: float, k3: float) -> float:
    """r² at the first maximum of r (1 + k1 r² + k2 r⁴ + k3 r⁶); infinite where it has none."""
    turns = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])  # of its slope, in r²
    turns = turns.real[(np.abs(turns.imag) < 1e-9 * np.abs(turns)) & (turns.real > 0)]
    return float(turns.min()) if turns.size else math.inf
