"""Importer for `phi_sft_r1`: a printed cloth hung by its upper edge and blown at, as colour and as point clouds.

Two recordings. One of kind "depth": the clouds seen by the sequence's own camera at a quarter of its resolution, at
which every pixel of the cloth has a point of its own. One of kind "video": the pictures as they are, and the texture of
the template mesh laid flat. What the originals leave open, and what is made of it:

- The frame rate is not in the files. Stamps are frame numbers at 30 a second, and the note `frame_rate` says so; fit no
  dynamics to them.
- Wind, mass and what holds the cloth are not stated; so are none here, and no areal density.
- The cloth's size is that of the template mesh, along its rows and columns.
- The pictures are masked: what is no cloth is black in them.
- The texture is the first picture upside down; the mesh says where its lines are in it.
"""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.core import pictures
from clothbench.core.camera import Camera
from clothbench.core.errors import ClothbenchError
from clothbench.core.files import read_json
from clothbench.core.progress import FileProgress
from clothbench.datasets import registry
from clothbench.datasets.depth_folder import LEVEL, projected
from clothbench.datasets.report import ImportReport, write_report
from clothbench.recordings.codec import write
from clothbench.recordings.colour_video import ColourVideo
from clothbench.recordings.depth import Colour, DepthImages

NAME, VIDEO = "phi_sft_r1", "phi_sft_r1_video"
REPORT = "import-report.json"
RATE = 30.0  # 1/s, assumed
FINER = 2.0  # pixels of the flat template along one of the texture's
COARSER = 4  # pixels of the sequence's camera along a side of one here
DEPTH_STEP = 1e-4  # m
NEXT = "clothbench validate {folder}"


def convert(source: Path, out: Path, progress: FileProgress | None = None) -> list[ImportReport]:
    """Write the sequence under `source` into `out` as two recordings, with import-report.json; returns their reports.

    `progress(done, planned, name)` is called after every frame.
    """
    source, check = Path(source), registry.verify(NAME, Path(source))
    clouds = sorted(source.glob(registry.DATASETS[NAME].pattern))
    if not clouds:
        raise ClothbenchError(
            f"{source}: found no ground_truth/point_cloud_NNN.pt, expected the clouds; check data_dir"
        )
    if check.wrong:
        raise ClothbenchError(f"{min(check.wrong)}: SHA-256 differs from the registry's; fetch it again")
    camera, (width, height) = camera_of(source / "scenes" / "R1.json"), size_of(source / "templates" / "0_R1_quad.obj")
    depth, colour = [], []
    for done, path in enumerate(clouds, 1):
        depth.append(projected(cloud_of(path), camera, DEPTH_STEP, path))
        colour.append(picture_of(source / "rgbs" / f"rgb_{path.stem[-3:]}.png", camera))
        if progress:
            progress(done, len(clouds), path.name)
    time, dataset = np.arange(len(clouds)) / RATE, registry.DATASETS[NAME]
    about: dict[str, Any] = {
        "cloth_width": width, "cloth_height": height, "fabric": "printed cloth", "motion": "blown at",
        "licence": dataset.licence, "notes": {"frame_rate": f"not stated; {RATE:g} 1/s assumed"},
    }  # fmt: skip
    origin = f"github.com/{dataset.repository}@{dataset.commit}"
    images = DepthImages(
        name=NAME, time=time, depth=np.stack(depth), depth_step=DEPTH_STEP, camera=camera,
        colour=Colour(time, np.stack(colour)), sensor="depth camera, clouds cut out by hand or mask",
        source=f"{origin}: evaluation/R1/ground_truth", **about,
    )  # fmt: skip
    files = [(source / "rgbs" / f"rgb_{path.stem[-3:]}.png").read_bytes() for path in clouds]
    video = ColourVideo(
        name=VIDEO, time=time, stream=np.frombuffer(b"".join(files), np.uint8),
        ends=np.cumsum([len(file) for file in files]), template=flat_template(source),
        camera=camera_of(source / "scenes" / "R1.json", 1), world="camera", sensor="colour camera, masked",
        source=f"{origin}: data/R1", **about,
    )  # fmt: skip
    written = [write(each, Path(out) / f"{name}.nc", each.layout) for each, name in ((images, NAME), (video, VIDEO))]
    notes = tuple(f"{name} is not in the registry: not verified" for name in sorted(check.unknown))
    reports = [ImportReport(source.name, w.name, len(clouds), len(clouds), notes=notes) for w in written]
    header = {"dataset": NAME, "source": f"{dataset.repository}@{dataset.commit}", "licence": dataset.licence}
    write_report(reports, Path(out) / REPORT, **header, next=NEXT)
    return reports


def cloud_of(path: Path) -> np.ndarray:
    """Points (n, 3) m in the camera's frame of a PyTorch archive that holds one tensor of single precision."""
    try:
        with zipfile.ZipFile(path) as archive:
            (name,) = (n for n in archive.namelist() if n.endswith("/data/0"))
            return np.frombuffer(archive.read(name), "<f4").reshape(-1, 3).astype(float)
    except (OSError, ValueError, zipfile.BadZipFile) as fault:
        raise ClothbenchError(f"{path}: found no cloud that can be read ({fault}); fetch it again") from fault


def camera_of(path: Path, coarser: int = COARSER) -> Camera:
    """The camera that a scene's file states, with pixels `coarser` times as large; it looks along +y, level."""
    try:
        told = read_json(path, "a camera")
        (fx, fy), (cx, cy), (rows, columns) = told["focal_length"], told["optical_center"], told["image_size"]
    except (KeyError, TypeError, ValueError) as fault:
        raise ClothbenchError(
            f"{path}: found no camera ({fault!r}), expected focal_length, optical_center, image_size"
        ) from fault
    half = (1 - 1 / coarser) / 2  # the centre of the first large pixel lies between those of the first small ones
    matrix = np.array([[fx / coarser, 0, cx / coarser - half], [0, fy / coarser, cy / coarser - half], [0, 0, 1.0]])
    return Camera((columns // coarser, rows // coarser), matrix, LEVEL, np.zeros(3))


def mesh_of(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (V, 3) m of a template mesh, its texture's coordinates (V, 2), and faces (F, 4, 2): both of each
    corner.
    """
    try:
        lines = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
        place = np.array([line[1:4] for line in lines if line[:1] == ["v"]], dtype=float)
        texture = np.array([line[1:3] for line in lines if line[:1] == ["vt"]], dtype=float)
        faces = np.array([[c.split("/")[:2] for c in line[1:]] for line in lines if line[:1] == ["f"]], dtype=int) - 1
    except (OSError, ValueError) as fault:
        raise ClothbenchError(f"{path}: found no mesh of quadrilaterals with a texture ({fault})") from fault
    return place, texture, faces


def flat_template(source: Path) -> np.ndarray:
    """The texture (H, W, 3) laid flat from hem to hem, along the lines of the square template mesh."""
    import cv2
    from scipy.ndimage import map_coordinates

    file = source / "R1_texture.png"
    texture = pictures.picture_of(file, cv2.IMREAD_COLOR)
    if texture is None:
        raise ClothbenchError(f"{file}: found no picture that can be read; fetch it again")
    _, at, _ = mesh_of(source / "templates" / "0_R1_quad.obj")
    lines = math.isqrt(len(at))
    pixel = at.reshape(lines, lines, 2).swapaxes(0, 1) * texture.shape[1::-1] - 0.5  # rows downwards, then columns
    width, height = (
        round(FINER * float(np.linalg.norm(np.diff(pixel, axis=a), axis=-1).sum(axis=a).mean())) for a in (1, 0)
    )
    v, u = np.meshgrid(*((np.arange(n) + 0.5) / n * (lines - 1) for n in (height, width)), indexing="ij")
    x, y = (map_coordinates(pixel[..., c], [v, u], order=1).astype(np.float32) for c in (0, 1))
    flat = cv2.remap(cv2.flip(texture, 0), x, y, cv2.INTER_CUBIC)
    return cv2.cvtColor(flat, cv2.COLOR_BGR2RGB)


def size_of(path: Path) -> tuple[float, float]:
    """Width and height [m] of a template mesh with as many rows as columns: the mean length of its lines."""
    place, texture, faces = mesh_of(path)
    step = np.roll(faces, -1, axis=1)
    along = np.abs(texture[step[..., 1]] - texture[faces[..., 1]])
    length = np.linalg.norm(place[step[..., 0]] - place[faces[..., 0]], axis=-1)
    lines_across = math.isqrt(len(place))  # the mesh is square
    width, height = (float(length[along[..., c] > along[..., 1 - c]].mean()) * (lines_across - 1) for c in (0, 1))
    return width, height


def picture_of(path: Path, camera: Camera) -> np.ndarray:
    """A picture (H, W, 3) of the camera's size, RGB."""
    import cv2

    image = pictures.picture_of(path, cv2.IMREAD_COLOR)
    if image is None:
        raise ClothbenchError(f"{path}: found no picture that can be read; fetch it again")
    return np.ascontiguousarray(cv2.resize(image, camera.size, interpolation=cv2.INTER_AREA)[..., ::-1])
