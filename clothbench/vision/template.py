"""A flat picture of the cloth, its template, found again in what a camera sees, by SIFT keypoints (Lowe 2004)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clothbench.core.camera import Camera
from clothbench.core.errors import ClothbenchError
from clothbench.vision.depth_camera import to_world

CONTRAST = 0.03  # of a keypoint, of full scale: softer prints count too (OpenCV's usual is 0.04)
RATIO = 0.8  # Lowe's: how much nearer the best descriptor has to be than the second best
LOOSE = 0.92  # the same, where a print repeats itself and the strict one leaves too few
MISS = 4.0  # px that a correspondence may miss the plane by: cloth held by hand is not quite flat
SAG = 0.04  # of its size, by which cloth that is held straight by hand may leave its plane in the picture
ROUNDS = 3
LEAST = 12  # correspondences that have to agree before a cloth counts as found
BLOCK = 1024  # rows of descriptors that are compared at once
WIDE = 1.1  # focal length over the picture's width, of a webcam (field of view 49°) whose calibration nobody knows


@dataclass(frozen=True, eq=False)
class Keypoints:
    """SIFT keypoints. place: (K, 2) px; descriptor: (K, 128), of length 1 (RootSIFT, Arandjelović and Zisserman 2012:
    the square roots of its shares, whose inner product is Hellinger's kernel).
    """

    place: np.ndarray
    descriptor: np.ndarray

    @classmethod
    def of(cls, picture: np.ndarray) -> Keypoints:
        """Those of a picture (H, W) or (H, W, 3) uint8."""
        import cv2

        grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
        # Without the precise upscale, which came with OpenCV 4.8, the doubled picture lies a quarter of a pixel off.
        sift = cv2.SIFT.create(contrastThreshold=CONTRAST, enable_precise_upscale=True)
        found, descriptor = sift.detectAndCompute(grey, None)
        if descriptor is None:
            return cls(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
        share = descriptor / np.maximum(descriptor.sum(axis=1, keepdims=True), 1e-9)
        return cls(np.array([k.pt for k in found]), np.sqrt(share).astype(np.float32))


def apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distances (A, B) between descriptors (A, 128) and (B, 128) of length 1."""
    return np.sqrt(np.maximum(2.0 - 2.0 * (a @ b.T), 0.0))


def correspondences(template: Keypoints, frame: Keypoints, ratio: float = RATIO) -> np.ndarray:
    """Pairs (M, 2) of a template's keypoint and the frame's that is nearest to it, by Lowe's ratio of distances."""
    if len(frame.place) < 2:
        return np.zeros((0, 2), dtype=int)
    pairs = []
    for begin in range(0, len(template.place), BLOCK):
        away = apart(template.descriptor[begin : begin + BLOCK], frame.descriptor)
        two = np.argpartition(away, 1, axis=1)[:, :2]
        near = np.take_along_axis(away, two, axis=1)
        first = near.argmin(axis=1)
        row = np.arange(len(two))
        good = np.flatnonzero(near[row, first] < ratio * near[row, 1 - first])
        pairs.append(np.stack([begin + good, two[good, first[good]]], axis=1))
    return np.concatenate(pairs)


@dataclass(frozen=True, eq=False)
class Found:
    """Where a template is in a frame. homography: (3, 3), template px → frame px; pairs: (M, 2), the correspondences
    that agree with it.
    """

    homography: np.ndarray
    pairs: np.ndarray

    def __call__(self, place: np.ndarray) -> np.ndarray:
        """Template px (..., 2) → frame px (..., 2)."""
        flat = np.asarray(place, dtype=float) @ self.homography[:, :2].T + self.homography[:, 2]
        return flat[..., :2] / flat[..., 2:]


def find_template(template: Keypoints, frame: Keypoints, shape: tuple[int, int], where: str) -> Found:
    """The cloth, held straight, in a frame; shape: (H, W) of the template. A cloth that is not there, or that shows too
    little to be told, is refused; where: the recording, for that line.
    """
    import cv2

    if len(template.place) < LEAST:
        raise ClothbenchError(
            f"{where}: found {len(template.place)} keypoints in the template, expected {LEAST} or more; a plain cloth "
            "shows nothing to go by: print or draw a pattern on it"
        )
    most = 0
    for ratio in (RATIO, LOOSE):
        pairs = correspondences(template, frame, ratio)
        if len(pairs) < LEAST:
            most = max(most, len(pairs))
            continue
        a, b = template.place[pairs[:, 0]], frame.place[pairs[:, 1]]
        homography, agree = cv2.findHomography(a, b, cv2.USAC_MAGSAC, MISS, maxIters=20000, confidence=0.9999)
        if homography is None:
            continue
        found = _refined(Found(homography, pairs[agree.ravel() > 0]), template, frame, pairs, shape)
        most = max(most, len(found.pairs))
        if len(found.pairs) >= LEAST and _is_a_view(found, shape):
            return found
    raise ClothbenchError(
        f"{where}: found no cloth in the first frame: {most} places agree with the template, expected {LEAST} or more; "
        "begin with the cloth held straight before the camera, and let the template show it from hem to hem"
    )


def _refined(found: Found, template: Keypoints, frame: Keypoints, pairs: np.ndarray, shape: tuple[int, int]) -> Found:
    """The plane of all of the cloth, not of the part of it that is flattest: from every correspondence that is near."""
    import cv2

    a, b = template.place[pairs[:, 0]], frame.place[pairs[:, 1]]
    for _ in range(ROUNDS):
        reach = SAG * float(np.ptp(found(corners(shape)), axis=0).max())
        near = np.linalg.norm(found(a) - b, axis=1) < reach
        homography = cv2.findHomography(a[near], b[near])[0] if near.sum() >= LEAST else None
        if homography is None:
            break
        found = Found(homography, pairs[near])
    return found


def _is_a_view(found: Found, shape: tuple[int, int]) -> bool:
    """Whether a rectangle may look like that from its front: convex, and not turned inside out."""
    corner = found(corners(shape))
    side = np.roll(corner, -1, axis=0) - corner
    after = np.roll(side, -1, axis=0)
    turn = side[:, 0] * after[:, 1] - side[:, 1] * after[:, 0]
    return bool((turn > 0).all())


def corners(shape: tuple[int, int]) -> np.ndarray:
    """The corners (4, 2) px of a picture (H, W), clockwise from the upper left one; a pixel's place is its middle."""
    height, width = shape
    return np.array([[0, 0], [width, 0], [width, height], [0, height]]) - 0.5


def to_template(material: np.ndarray, size: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Material points (..., 2) m of a cloth of `size` (2,) m → px (..., 2) of its template, which shows it from hem to
    hem.
    """
    return np.asarray(material) / size * np.array(shape[::-1]) - 0.5


@dataclass(frozen=True, eq=False)
class FirstView:
    """The flat cloth as one camera sees it. camera: with its place in the world; origin, along, down: (3,) m, the
    cloth's upper left corner and its two directions there.
    """

    camera: Camera
    origin: np.ndarray
    along: np.ndarray
    down: np.ndarray

    def places(self, material: np.ndarray) -> np.ndarray:
        """Material points (..., 2) m → where the flat cloth has them (..., 3) m."""
        return self.origin + material[..., :1] * self.along + material[..., 1:] * self.down

    def lifted(self, pixel: np.ndarray) -> np.ndarray:
        """Pixels (..., 2) → where their lines of sight meet the flat cloth's plane (..., 3) m; NaN stays NaN."""
        camera, ideal = self.camera, self.camera.straight(pixel)
        sight = np.concatenate([ideal, np.ones((*ideal.shape[:-1], 1))], axis=-1) @ camera.rotation
        normal = np.cross(self.along, self.down)
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = ((self.origin - camera.place) @ normal) / (sight @ normal)
        return camera.place + reach[..., None] * sight


def first_view(
    found: Found, shape: tuple[int, int], size: np.ndarray, pixels: tuple[int, int], camera: Camera | None, placed: bool
) -> FirstView:
    """How a camera sees a flat cloth of `size` (2,) m, `found` in a frame of `pixels` (width, height).

    camera: its calibration, or None, for which a webcam's focal length is assumed; placed: whether its place in the
    world holds, too. Else the world is the cloth's: its upper left corner at the origin, x along the upper hem, z up.
    """
    seen = camera_before(found, shape, size, pixels, camera)
    own = np.array([[0.0, 0, 0], [1.0, 0, 0], [0.0, 0, -1.0]])
    if not placed or camera is None:
        return FirstView(seen, own[0], own[1], own[2])
    at = to_world(seen.in_view(own), camera)
    return FirstView(camera, at[0], at[1] - at[0], at[2] - at[0])


def camera_before(
    found: Found, shape: tuple[int, int], size: np.ndarray, pixels: tuple[int, int], lens: Camera | None = None
) -> Camera:
    """The camera that sees a flat cloth of `size` (2,) m, hung straight in the world, as `found`.

    The world then is the cloth's: its upper left corner at the origin, x along the upper hem, z up. lens: a camera
    whose calibration holds and whose place does not; without it a webcam's focal length is assumed.
    """
    import cv2

    if lens is None:
        width, height = pixels
        focal = WIDE * width
        lens = Camera(pixels, np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]]),
                      np.eye(3), np.zeros(3))  # fmt: skip
    u, v = (np.linspace(0.0, length, 5) for length in size)
    material = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    seen = found(to_template(material, size, shape))
    flat = np.stack([material[:, 0], material[:, 1], np.zeros(len(material))], axis=1)
    straight = lens.straight(seen)
    there = np.isfinite(straight).all(axis=1)
    pose: Any = cv2.solvePnP
    ok, turn, shift = False, np.zeros(3), np.zeros(3)
    if there.sum() >= 4:
        ok, turn, shift = pose(flat[there], straight[there], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    if not ok:
        raise ClothbenchError("camera: found no place from which the first frame can have been seen")
    rotation, _ = cv2.Rodrigues(turn)
    from_world = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # world → the cloth's own axes: along u, v and behind
    return Camera(lens.size, lens.matrix, rotation @ from_world, shift.ravel(), lens.distortion)
