"""Sheets, points and curves as Rerun logs them."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
from scipy.sparse import csr_array

from clothbench.core.errors import ClothbenchError
from clothbench.core.observation import Observation
from clothbench.vision.surface import delaunay

SEEN, CLOTH, AWAY, HELD, NOISE = (
    (240, 160, 40),
    (110, 160, 215),
    (220, 60, 60),
    (60, 170, 110),
    (150, 150, 150),
)
Colour = tuple[int, ...] | np.ndarray


def log_seen(
    stream: Any, path: str, time: np.ndarray, position: np.ndarray, visible: np.ndarray, radius: float
) -> None:
    stream.log(path, rr.Points3D.from_fields(colors=[SEEN], radii=[radius]), static=True)
    columns = rr.Points3D.columns(positions=np.float32(position[visible]))
    stream.send_columns(path, at_times(time), columns.partition(visible.sum(axis=1)))


def log_points(
    stream: Any, path: str, time: np.ndarray, position: np.ndarray, colour: tuple[int, ...], radius: float
) -> None:
    """Points (T, n, 3) m that are there in every frame."""
    if len(time):
        stream.log(path, rr.Points3D.from_fields(colors=[colour], radii=[radius]), static=True)
        columns = rr.Points3D.columns(positions=np.float32(position.reshape(-1, 3)))
        stream.send_columns(path, at_times(time), columns.partition(np.full(len(time), position.shape[1])))


def log_sheet(
    stream: Any, path: str, time: np.ndarray, position: np.ndarray, material: np.ndarray, colour: Colour = CLOTH
) -> None:
    """The simulated nodes (T, N, 3) m: as a mesh, or as points where they all lie on one line. colour: of all, or of
    each node in each frame (T, N, 3), 8 bits.
    """
    triangles = triangulate(material)
    if len(triangles):
        log_mesh(stream, path, time, position, triangles, colour)
    else:
        one = CLOTH if isinstance(colour, np.ndarray) else colour
        log_points(stream, path, time, position, one, 0.12 * typical_distance(material))


def log_mesh(
    stream: Any, path: str, time: np.ndarray, position: np.ndarray, triangles: np.ndarray, colour: Colour = CLOTH
) -> None:
    """The sheet (T, N, 3) m: triangles and one colour once, what changes for every frame in one go."""
    if not len(time):
        return
    by_node = isinstance(colour, np.ndarray)
    albedo = None if by_node else (*colour, 190)
    stream.log(path, rr.Mesh3D.from_fields(triangle_indices=triangles, albedo_factor=albedo), static=True)
    normals = vertex_normals(position, triangles)
    columns = rr.Mesh3D.columns(
        vertex_positions=np.float32(position.reshape(-1, 3)),
        vertex_normals=np.float32(normals.reshape(-1, 3)),
        vertex_colors=np.reshape(colour, (-1, 3)) if by_node else None,
    )
    stream.send_columns(path, at_times(time), columns.partition(np.full(len(time), position.shape[1])))


def log_away(
    stream: Any, path: str, seen: Observation, simulated: np.ndarray, there: np.ndarray, radius: float
) -> None:
    """Arrows from simulated to seen nodes, where both are known."""
    both = seen.visible & there[:, None]
    stream.log(path, rr.Arrows3D.from_fields(colors=[AWAY], radii=[radius]), static=True)
    vectors = -seen.in_space(seen.differences(simulated)[both])
    columns = rr.Arrows3D.columns(origins=np.float32(simulated[both]), vectors=np.float32(vectors))
    stream.send_columns(path, at_times(seen.time), columns.partition(both.sum(axis=1)))


def nearest(points: np.ndarray, among: np.ndarray) -> np.ndarray:
    """How far points (F, P, 3) m are in each frame from the nearest of others (F, Q, 3) m, (F, P) m; not a number where
    either is not known.
    """
    from scipy.spatial import cKDTree

    out = np.full(points.shape[:2], np.nan)
    for away, here, there in zip(out, points, among, strict=True):
        known, others = np.isfinite(here).all(axis=1), there[np.isfinite(there).all(axis=1)]
        if known.any() and len(others):
            away[known] = cKDTree(others).query(here[known])[0]
    return out


def log_curve(
    stream: Any, path: str, time: np.ndarray, value: np.ndarray, name: str, colour: tuple[int, ...] | None = None
) -> None:
    """A curve over time; without a colour the viewer gives each its own."""
    if len(time):
        colours = [colour] if colour else None
        stream.log(path, rr.SeriesLines(names=name, colors=colours, widths=[2.0]), static=True)
        stream.send_columns(path, at_times(time), rr.Scalars.columns(scalars=value))


def at_times(time: np.ndarray) -> list[Any]:
    return [rr.TimeColumn("time", duration=time)]


def triangulate(material: np.ndarray) -> np.ndarray:
    """Delaunay triangles (F, 3) of material points (N, 2) m without slivers; none if all lie on one line."""
    try:
        return delaunay(material).astype(np.uint32)
    except ClothbenchError:  # fewer than three points, or all on one line
        return np.zeros((0, 3), dtype=np.uint32)


def typical_distance(material: np.ndarray) -> float:
    """Distance of neighbours [m] if the points (N, 2) m were spread evenly; what is drawn is sized by it."""
    return float(np.ptp(material, axis=0).max() / max(np.sqrt(len(material)) - 1, 1)) or 0.01


def vertex_normals(position: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Unit normals (T, N, 3) of a moving mesh (T, N, 3) m: the triangles around a node, weighted by area.

    Summed by one sparse product over all frames, which needs no compiling in a fresh worker process.
    """
    frames, nodes = position.shape[:2]
    corner = position[:, triangles]
    normal = np.cross(corner[:, :, 1] - corner[:, :, 0], corner[:, :, 2] - corner[:, :, 0])
    rows, columns = triangles.ravel(), np.repeat(np.arange(len(triangles)), 3)
    around = csr_array((np.ones(len(rows)), (rows, columns)), shape=(nodes, len(triangles)))
    total = (around @ normal.swapaxes(0, 1).reshape(len(triangles), -1)).reshape(nodes, frames, 3).swapaxes(0, 1)
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    return total / np.where(length > 0, length, 1.0)
