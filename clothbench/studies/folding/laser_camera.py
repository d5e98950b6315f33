"""A laser line on a strip, as a calibrated camera sees it: rendered images of kind "laser"."""

from __future__ import annotations

import dataclasses

import numpy as np

from clothbench.core.camera import Camera
from clothbench.recordings.laser import LaserImages

WIDE, HIGH = 1600, 900  # px
FOCAL = 1450.0  # px
DISTORTION = np.array([-0.12, 0.05, 3e-4, -2e-4, 0.0])
EYE, LOOKS_AT = np.array([0.05, -1.25, 0.75]), np.array([0.53, 0.0, 0.17])  # m
PROJECTOR = np.array([-0.6, 0.0, 1.8])  # m, in the laser's plane y = 0
WIDTH = 1.4  # px, σ of the line
BRIGHT, SPECKLE = 150.0, 0.35  # of 255; relative, from grain to grain
WANDER = 0.2  # px, how far speckle moves the line's middle
LAYER = 3e-3  # m, from a point, within which its own surroundings do not hide it
SIDES = 200  # of a profile, that are asked whether they hide a point
GRAIN = 3  # px
GROUND, NOISE = 12.0, 2.5  # of 255


def rendered(name: str, profile: np.ndarray, time: float, seed: int, fabric: str = "") -> LaserImages:
    """One image of a profile (M, 2) m, x and z in order along the strip, where laser and camera see its upper side.

    Lens distortion, speckle, sensor noise and 8 bits take part.
    """
    matrix = np.array([[FOCAL, 0.0, WIDE / 2 - 7.0], [0.0, FOCAL, HIGH / 2 + 4.0], [0.0, 0.0, 1.0]])
    straight = Camera.looking_at(EYE, LOOKS_AT, (WIDE, HIGH), across=1.0)
    camera = dataclasses.replace(straight, matrix=matrix, distortion=DISTORTION)
    points = np.stack([profile[:, 0], 0 * profile[:, 0], profile[:, 1]], axis=1)[upper_side(profile)]
    image = drawn(camera.project(points)[0], np.random.default_rng(seed))
    return LaserImages(
        name=name, time=np.array([time]), image=image[None], camera_matrix=camera.matrix,
        distortion=camera.distortion, camera_rotation=camera.rotation, camera_translation=camera.translation,
        laser_plane=np.array([0.0, 1.0, 0.0, 0.0]),
        fabric=fabric, source="clothbench testbed",
    )  # fmt: skip


def upper_side(profile: np.ndarray) -> np.ndarray:
    """Which points (M,) of a profile are lit and seen, on the side that was up when the strip lay flat, and not behind
    another part of it.
    """
    along = np.gradient(profile, axis=0)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    from_above = np.ones(len(profile), bool)
    for source in (PROJECTOR[[0, 2]], EYE[[0, 2]]):
        from_above &= ((source - profile) * normal).sum(axis=1) > 0
        from_above &= ~hidden(profile, source)
    return from_above


def hidden(profile: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Which points (M,) of a profile (M, 2) m another part of it hides from a place (2,) m: a side of it crosses the
    line of sight farther than a layer's thickness from the point. The camera stands aside of the plane, in which what
    hides a point hides it just as well, since the strip is as wide as it likes.
    """
    line = profile[:: max(1, len(profile) // SIDES)]
    begin, side = line[:-1] - source, np.diff(line, axis=0)
    to = profile - source
    across = to[:, :1] * side[:, 1] - to[:, 1:] * side[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (begin[:, 0] * side[:, 1] - begin[:, 1] * side[:, 0]) / across  # of the way to the point
        share = (begin[:, 0] * to[:, 1:] - begin[:, 1] * to[:, :1]) / across  # of the side
        apart = (1 - along) * np.linalg.norm(to, axis=1)[:, None]
    return np.asarray(((share >= 0) & (share <= 1) & (along > 0) & (apart > LAYER)).any(axis=1))


def drawn(pixels: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """The image (HIGH, WIDE) of a line through pixels (M, 2), of whole numbers from 0 to 255."""
    import cv2

    steps = np.linalg.norm(np.diff(pixels, axis=0), axis=1)
    whole = np.concatenate([[0.0], np.cumsum(np.minimum(steps, 5.0))])
    at = np.arange(0.0, whole[-1], 0.25)
    line = np.stack([np.interp(at, whole, pixels[:, k]) for k in range(2)], axis=1)
    grains = (at / GRAIN).astype(int)
    line = line + WANDER * random.normal(size=(grains[-1] + 1, 2))[grains]
    bright = BRIGHT * np.exp(SPECKLE * random.normal(size=grains[-1] + 1))[grains]
    image, reach = np.zeros((HIGH, WIDE)), int(4 * WIDTH) + 1
    inside = (line > reach).all(axis=1) & (line < [WIDE - reach - 1, HIGH - reach - 1]).all(axis=1)
    corner = np.floor(line).astype(int)
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            x, y = (corner + np.array([dx, dy]))[inside].T
            near = np.exp(-((np.stack([x, y], axis=1) - line[inside]) ** 2).sum(axis=1) / (2 * WIDTH**2))
            np.add.at(image, (y, x), bright[inside] * near)
    # As many samples overlap as there are on √(2π) σ of the line; what they add up to is its brightness.
    image *= 0.25 / (np.sqrt(2 * np.pi) * WIDTH)
    image += cv2.GaussianBlur(random.normal(GROUND, 4 * NOISE, image.shape), (0, 0), 2.0)
    return np.clip(np.round(image + random.normal(0.0, NOISE, image.shape)), 0, 255).astype(np.uint8)
