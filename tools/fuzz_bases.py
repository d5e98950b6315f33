"""The valid inputs that `tools/fuzz.py` spoils: one of each kind, a results folder, and a submission."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from clothbench import (
    Camera,
    ColourVideo,
    Curve,
    DepthImages,
    GripPath,
    LaserImages,
    Obstacle,
    Projector,
    Recording,
    Silhouettes,
    Video,
    write_curve,
    write_depth,
    write_laser,
    write_recording,
    write_silhouettes,
    write_video,
)
from clothbench.cli import main
from clothbench.recordings.colour_video import Marks
from clothbench.recordings.depth import Colour

ABOUT = {"cloth_width": 0.2, "cloth_height": 0.2, "areal_density": 0.2, "fabric": "paper", "motion": "sway"}
TIME = np.linspace(0, 0.5, 6)
HELD = np.array([[0.0, 0.0], [0.2, 0.0]])
CAMERA = Camera.looking_at(np.array([0.1, -1.0, -0.1]), np.array([0.1, 0.0, -0.1]), (80, 72), 0.5)
CELL = ("model=mass_spring", "optimizer=ga", "metric=node_error", "budget=2", "jobs=1", "rerun=false", "timeout=5",
        "scene.resolution=[5,5]")  # fmt: skip


def nodes(name: str = "sway-1", split: str = "fit") -> Recording:
    u, v = (a.ravel() for a in np.meshgrid(*[np.linspace(0, 0.2, 3)] * 2))
    sway = 0.02 * np.sin(2 * np.pi * TIME)[:, None, None] * [0, 1, 0]
    noise = np.random.default_rng(len(name)).normal(0, 1e-3, (6, 9, 3))
    return Recording(
        name=name, time=TIME, material=np.stack([u, v], axis=1),
        position=np.stack([u, 0 * u, -v], axis=1) + sway + noise, grip_time=TIME, grip_material=HELD,
        grip_position=np.insert(HELD, 1, 0, axis=1) + sway, noise_sigma=1e-3, split=split, notes={"room": "4"},
        confidence=np.full((6, 9), 0.9), thickness=1e-3, outline=np.array([[0, 0], [0.2, 0], [0.2, 0.2], [0, 0.2]]),
        sight=CAMERA, **ABOUT,
    )  # fmt: skip


def watched_nodes() -> Recording:
    """With what the other has not: obstacles, and the video of stripes that a projector throws."""
    obstacles = (Obstacle("disc", (0.1, 0.0, -0.4), radius=0.05, clamps=True), Obstacle("plane", (0.0, 0.0, -1.0)))
    frame = np.random.default_rng(1).integers(0, 255, (6, 72, 80)).astype(np.uint8)
    film = Video(frame, CAMERA, Projector(CAMERA, 8.0))
    return replace(nodes("sway-3"), sight=None, obstacles=obstacles, video=film)


def grips() -> GripPath:
    return GripPath(TIME, HELD, np.zeros((6, 2, 3)))


def pictures() -> list[np.ndarray]:
    return [np.random.default_rng(k).integers(0, 255, (72, 80, 3)).astype(np.uint8) for k in range(6)]


def png(picture: np.ndarray) -> bytes:
    return cv2.imencode(".png", picture)[1].tobytes()


def write_film(path: Path) -> None:
    film = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 30, (80, 72))  # type: ignore[attr-defined]
    for picture in pictures():
        film.write(picture)
    film.release()


def video(stream: bytes, ends: np.ndarray | None) -> ColourVideo:
    return ColourVideo(
        name="film", time=np.arange(6) / 30, stream=np.frombuffer(stream, np.uint8), ends=ends, camera=CAMERA,
        world="camera", template=np.full((64, 64, 3), 90, np.uint8),
        grips=GripPath(np.arange(6) / 30, HELD, np.zeros((6, 2, 3))),
        marks=Marks(HELD, np.array([[4.0, 4], [60, 4]])), **ABOUT,
    )  # fmt: skip


def write_bases(to: Path) -> None:
    """One valid input of each kind, and a results folder and a submission made from them."""
    write_recording(nodes(), to / "nodes.nc")
    write_recording(watched_nodes(), to / "nodes_watched.nc")
    write_recording(nodes("sway-2", "held_out"), to / "measured" / "sway-2.nc")
    shutil.copy(to / "nodes.nc", to / "measured" / "sway-1.nc")
    stretch = np.linspace(1.0, 1.5, 20)
    write_curve(Curve(name="pull", stretch=stretch, force=10 * (stretch - 1), direction="warp"), to / "curve.nc")
    write_laser(
        LaserImages("line", TIME[:2], np.full((2, 20, 20), 9, np.uint8), np.eye(3), np.zeros(5), np.eye(3), np.zeros(3),
                    np.array([0, 1.0, 0, 0])), to / "laser.nc",
    )  # fmt: skip
    depth = np.full((6, 72, 80), 1000, np.uint16)
    colour = Colour(TIME, np.full((6, 72, 80, 3), 90, np.uint8))
    write_depth(
        DepthImages(name="deep", time=TIME, depth=depth, depth_step=1e-3, camera=CAMERA, colour=colour, grips=grips(),
                    **ABOUT), to / "depth.nc",
    )  # fmt: skip
    write_film(to / "film.mp4")
    parts = [png(p) for p in pictures()]
    write_video(video(b"".join(parts), np.cumsum([len(p) for p in parts])), to / "video_pictures.nc")
    write_video(video((to / "film.mp4").read_bytes(), None), to / "video_film.nc")
    shadow = np.full((1, 64, 64), 255, np.uint8)
    y, x = np.indices((64, 64)) - 31.5
    shadow[0, np.hypot(x, y) < 26] = 0
    write_silhouettes(
        Silhouettes(name="drape", image=shadow, sample=np.zeros(1, int), side=np.ones(1, int), pixel_size=4e-3,
                    disc_radius=0.15, plate_radius=0.09), to / "silhouette.nc",
    )  # fmt: skip
    write_results(to)
    write_submission(to)


def write_results(to: Path) -> None:
    words = [f"recordings={to / 'measured'}", *CELL[:3], "budget=8", *CELL[4:], "report=[relative_error]"]
    if main(["run", *words, "+analysis.variability={cases: ['*'], points: 2}", f"out={to / 'runs'}"]):
        raise SystemExit("the run that is to be spoiled has failed")
    for name in ("report.html", "rerun", "tracked", "journal"):
        shutil.rmtree(to / "runs" / name, ignore_errors=True)
        (to / "runs" / name).unlink(missing_ok=True)


def write_submission(to: Path) -> None:
    for name in ("sway-1", "sway-2"):
        measured = nodes(name, "fit" if name == "sway-1" else "held_out")
        moved = np.array(measured.position) + 0.01 * np.sin(np.pi * measured.material[:, 1] / 0.4)[:, None]
        moved[:, [0, 2]] = measured.grip_position
        write_recording(replace(measured, position=moved, source="a plate"), to / "submission" / f"{name}.nc")
    if main(["submit", str(to / "submission"), "--name", "plate", "--recordings", str(to / "measured")]):
        raise SystemExit("the submission that is to be spoiled was refused")
