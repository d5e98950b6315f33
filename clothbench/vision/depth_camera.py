"""What a depth camera makes of a scene: noise, steps, holes, flying pixels; and what it says about points in space.

The faults are those that measurements of structured-light and stereo sensors report (Khoshelham and Elberink 2012,
Accuracy and Resolution of Kinect Depth Data, eq. 11: noise and steps grow with the square of the distance).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np

from clothbench.core.camera import Camera
from clothbench.core.errors import ClothbenchError

EDGE = 0.03  # m between neighbouring pixels, from which on they lie on two things
DEPTH_STEP = 1e-3  # m


@dataclass(frozen=True)
class DepthSensor:
    """noise: m at 1 m, standard deviation of one pixel, growing with z²; step: m at 1 m, of what it can tell apart,
    growing alike; blur: px over which noise is alike; holes: share of pixels without a value; grazing: cosine between
    sight and surface below which nothing comes back; flying: share of the pixels along an edge that lie between;
    reach: m, beyond which nothing is measured.
    """

    noise: float = 1.5e-3
    step: float = 1e-3
    blur: float = 0.8
    holes: float = 0.01
    grazing: float = 0.15
    flying: float = 0.4
    reach: float = 1.8

    def __post_init__(self) -> None:
        for name in (field.name for field in fields(self)):
            if not 0 <= getattr(self, name) < np.inf:
                raise ClothbenchError(f"depth sensor: {name} is {getattr(self, name)}, expected 0 or above")


def sensed(depth: np.ndarray, camera: Camera, sensor: DepthSensor, random: np.random.Generator) -> np.ndarray:
    """True depth (H, W) m, infinite where there is nothing → whole millimetres (H, W) uint16, 0 where nothing is said.

    Edges get flying pixels, everything noise and steps that grow with z²; grazing surfaces and random patches are lost.
    """
    from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

    there = np.isfinite(depth)
    far = np.where(there, depth, np.nanmax(np.where(there, depth, np.nan), initial=1.0))
    low, high = minimum_filter(far, 3), maximum_filter(far, 3)
    edge = (high - low > EDGE) & (random.random(far.shape) < sensor.flying)
    mixed = np.where(edge, low + random.random(far.shape) * (high - low), far)
    rough = random.normal(size=far.shape)
    if sensor.blur > 0:
        rough = gaussian_filter(rough, sensor.blur)
        rough /= rough.std()
    told = mixed + sensor.noise * mixed**2 * rough
    if sensor.step > 0:  # whole steps of disparity: 1/z is what such a sensor reads
        told = 1 / (np.round(1 / told / sensor.step) * sensor.step)
    patches = gaussian_filter(random.normal(size=far.shape), 1.5)
    lost = patches > np.quantile(patches, 1 - min(sensor.holes, 1.0))
    with np.errstate(invalid="ignore"):
        lost |= ~there | (mixed > sensor.reach) | (facing(far, camera) < sensor.grazing) & ~edge
    return np.where(lost, 0, np.clip(np.round(told / DEPTH_STEP), 0, 65535)).astype(np.uint16)


def facing(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Cosine (H, W) between the line of sight and the surface that a depth image (H, W) m shows."""
    points = seen_points(depth, camera)
    right, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
    normal = np.cross(right, down)
    length = np.linalg.norm(normal, axis=-1) * np.linalg.norm(points, axis=-1)
    return np.abs((normal * points).sum(axis=-1)) / np.maximum(length, 1e-12)


def seen_points(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Points (H, W, 3) m in the camera's frame of a depth image (H, W) m; lens distortion is taken back."""
    return depth[..., None] * sight(camera)


@lru_cache(maxsize=8)  # every frame of a recording asks for the same
def sight(camera: Camera) -> np.ndarray:
    """The line of sight (H, W, 3) of every pixel in the camera's frame, with a depth of 1; NaN where the lens shows
    none. Read-only.
    """
    width, height = camera.size
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
    lines = np.concatenate([camera.straight(pixels), np.ones((height, width, 1))], axis=-1)
    lines.flags.writeable = False
    return lines


def to_world(points: np.ndarray, camera: Camera) -> np.ndarray:
    """Points (..., 3) m from the camera's frame to the world's."""
    return (points - camera.translation) @ camera.rotation
