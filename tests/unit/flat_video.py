"""A printed cloth that moves before a camera without bending, so that the truth is known to a fraction of a pixel."""

from __future__ import annotations

import cv2
import numpy as np

from clothbench import Camera, ColourVideo
from clothbench.vision.template import to_template

SIZE = np.array([0.40, 0.20])  # m
PIXELS = (480, 320)
CAMERA = Camera.looking_at(np.array([0.05, -0.8, 0.02]), np.array([0.0, 0.0, 0.0]), PIXELS, 0.62)


def template(plain: bool = False) -> np.ndarray:
    random = np.random.default_rng(2)
    out = np.full((320, 640, 3), (220, 214, 200), np.uint8)
    for _ in range(0 if plain else 260):
        at, size = random.uniform(0, (640, 320)).astype(int).tolist(), int(random.uniform(5, 16))
        colour = tuple(int(c) for c in random.integers(20, 160, 3))
        cv2.ellipse(out, at, (size, size // 2), float(random.uniform(0, 180)), 0, 360, colour, -1)
        cv2.circle(out, random.uniform(0, (640, 320)).astype(int).tolist(), size, colour, 2)
    return out


def place(material: np.ndarray, frame: int) -> np.ndarray:
    """Where material points (N, 2) m are in a frame (N, 3) m: the flat cloth, turned and moved in its plane."""
    angle, shift = 0.01 * frame, np.array([0.004 * frame, -0.003 * frame])
    x, z = material[:, 0] - SIZE[0] / 2, SIZE[1] / 2 - material[:, 1]
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * x - s * z + shift[0], np.zeros_like(x), s * x + c * z + shift[1]], axis=1)


def frames(count: int, plain: bool = False, covered: int | None = None) -> list[np.ndarray]:
    """Pictures (H, W, 3); from frame `covered` on, a board hides the right third."""
    flat, random = template(plain), np.random.default_rng(4)
    room = cv2.GaussianBlur(random.integers(0, 255, (*PIXELS[::-1], 3)).astype(np.uint8), (0, 0), 15)
    corner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * SIZE
    out = []
    for k in range(count):
        there = CAMERA.project(place(corner, k))[0]
        move, _ = cv2.findHomography(to_template(corner, SIZE, flat.shape[:2]), there)
        small = cv2.GaussianBlur(flat, (0, 0), 0.8)
        cloth = cv2.warpPerspective(small, move, PIXELS)
        mask = cv2.warpPerspective(np.full(flat.shape[:2], 255, np.uint8), move, PIXELS)[..., None] / 255
        picture = cloth * mask + room * (1 - mask) + random.normal(0, 1.5, cloth.shape)
        if covered is not None and k >= covered:
            picture[:, 320:] = (90, 80, 70)
        out.append(np.clip(picture, 0, 255).astype(np.uint8))
    return out


def encoded(pictures: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    parts = [cv2.imencode(".png", p[..., ::-1])[1].ravel() for p in pictures]
    return np.concatenate(parts), np.cumsum([len(p) for p in parts])


def video(count: int = 6, plain: bool = False, covered: int | None = None, **changes) -> ColourVideo:
    stream, ends = encoded(frames(count, plain, covered))
    content = {"name": "flat", "time": np.arange(count) / 30.0, "stream": stream, "ends": ends,
               "template": template(plain),
               "cloth_width": SIZE[0], "cloth_height": SIZE[1], "camera": CAMERA, "world": "camera"}  # fmt: skip
    return ColourVideo(**{**content, **changes})
