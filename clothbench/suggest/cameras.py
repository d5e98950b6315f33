"""What the one camera that is to see an experiment would measure of it, from each place where it may stand.

A point's place counts as wrong by κ [m], the model's own error, in all directions alike, and the camera adds its noise
N to what it measures (where in the picture the point is; a depth camera its depth, too). A is the derivative of these
by the place, and their covariance A κ² Aᵀ + N = L Lᵀ: coordinates x in metres become L⁻¹ A x in σ. So of errors and of
parameters alike, what goes along a line of sight does not count in a picture, and what is hidden counts nowhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clothbench.core.camera import Camera
from clothbench.core.kernels import kernel
from clothbench.core.scene import Scene
from clothbench.display.film import scaled
from clothbench.modelling import inside, obstacle_table
from clothbench.studies.improve.motion import normals, oriented
from clothbench.suggest.experiments import directions
from clothbench.suggest.settings import DEPTH, PLACEMENTS, Sensor, Wanted
from clothbench.vision.depth_camera import DepthSensor
from clothbench.vision.render import depth_images
from clothbench.vision.surface import surface_of

Look = Callable[[np.ndarray], np.ndarray]  # rows of coordinates (M, …) m → rows of what is measured of them

FILLED = 0.9  # of the picture, that the motion takes at most
GRAZING = DepthSensor.grazing  # cosine between sight and surface below which a point is seen edge-on
DRAWN = 480  # px, width of the picture in which is looked up what hides what
FINER = 3  # times as many lines as the points' lattice has, in the surface that is drawn there
SLACK = 2e-3  # m, by which that surface may lie before a point and not hide it: its facets are flat
STEPS = 64  # places along a line of sight at which an obstacle is looked for
DEEP = 1e-3  # m inside an obstacle, from where on it hides: a point that lies on it is seen


@dataclass(frozen=True, eq=False)
class Placed:
    """A camera before an experiment. name: of `PLACEMENTS`; target: (3,) m, what it looks at; up: (3,), what is up in
    its picture; seen: (T, N) bool, the points that it sees, as the fit has them.
    """

    name: str
    camera: Camera
    target: np.ndarray
    up: np.ndarray
    seen: np.ndarray


def placed(like: Scene, scene: Scene, position: np.ndarray, wanted: Wanted) -> list[Placed]:
    """The cameras to choose from, before a sheet whose points are at position (T, N, 3) m in a scene; in the directions
    of the sheet as it was recorded in another.
    """
    turn, out = np.stack(directions(like)[:3]), []
    for name in wanted.cameras or ():
        way, up = np.array(PLACEMENTS[name]) @ turn
        camera, target = framing(position.reshape(-1, 3), way / np.linalg.norm(way), up, wanted.camera)
        out.append(Placed(name, camera, target, up, seen_from(camera, scene, position)))
    return out


def framing(points: np.ndarray, way: np.ndarray, up: np.ndarray, sensor: Sensor) -> tuple[Camera, np.ndarray]:
    """The camera that stands in direction `way` (3,) from the middle (3,) m of points (M, 3) m, which it looks at, just
    so far away that all are in its picture; and that middle.
    """
    middle, half = (points.min(axis=0) + points.max(axis=0)) / 2, np.tan(np.radians(sensor.field_of_view) / 2)

    def at(distance: float) -> Camera:
        return Camera.looking_at(middle + distance * way, middle, sensor.size, 2 * half * distance, tuple(up))

    beside = np.abs(at(1.0).in_view(points)[:, :2]) / (FILLED * half * np.array([1.0, sensor.size[1] / sensor.size[0]]))
    return at(float((beside.max(axis=1) + (points - middle) @ way).max())), middle


def seen_from(camera: Camera, scene: Scene, position: np.ndarray) -> np.ndarray:
    """Which points (T, N) at position (T, N, 3) m a camera sees: in its picture, not edge-on, and hidden neither by the
    sheet between the points nor by an obstacle.
    """
    material, ways = scene.points, position - camera.place
    distance = np.linalg.norm(ways, axis=-1)
    normal = normals(position, oriented(material, surface_of(material).triangle))
    cosine = np.abs((normal * ways).sum(axis=-1)) / distance
    seen = in_picture(camera, position) & (cosine > GRAZING)

    small, surface = scaled(camera, drawn_size(camera)), surface_of(material, FINER)
    pixel, depth = small.project(position)
    # Within half a pixel the sheet itself comes nearer where it leans.
    lean = np.tan(np.arccos(np.clip(cosine, GRAZING, 1.0))) * np.sqrt(0.5) * depth / small.matrix[0, 0]
    for t, frame in enumerate(position):
        nearest = depth_images(small, surface, frame[None])[0]
        column, row = np.clip(np.rint(pixel[t, seen[t]]).astype(int), 0, np.array(small.size) - 1).T
        seen[t, seen[t]] = nearest[row, column] > (depth - lean - SLACK)[t, seen[t]]
    return seen & ~behind_obstacles(camera.place, scene, position) if scene.obstacles else seen


def drawn_size(camera: Camera) -> tuple[int, int]:
    width, height = camera.size
    across = min(DRAWN, width)
    return across, max(1, round(across * height / width))


def in_picture(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Whether points (..., 3) m are before the camera and inside its picture (...)."""
    pixel, _ = camera.project(points)
    return np.asarray(((pixel > -0.5) & (pixel < np.array(camera.size) - 0.5)).all(axis=-1))


def behind_obstacles(eye: np.ndarray, scene: Scene, position: np.ndarray) -> np.ndarray:
    """Which points (T, N) at position (T, N, 3) m one of the scene's obstacles hides from an eye (3,) m."""
    table, out = obstacle_table(scene), np.zeros(position.shape[:2], bool)
    carried, home = table[:, 12] > 0, table[:, 1:4].copy()
    for points, grips, hidden in zip(position, scene.grips_at(scene.times), out, strict=True):
        if carried.any():
            away = (grips - scene.grips_at(np.array([scene.start_time]))[0]).mean(axis=0)
            table[carried, 1:4] = home[carried] + away
        mark_hidden(eye, points, table, hidden)
    return out


@kernel
def mark_hidden(eye, points, obstacles, hidden):
    """Whether an obstacle of a table (`obstacle_table`) lies between an eye (3,) m and points (N, 3) m, into (N,)."""
    for i in range(len(points)):
        for step in range(STEPS):
            x, y, z = eye + (points[i] - eye) * (step / STEPS)
            for k in range(len(obstacles)):
                if inside(obstacles[k, 0], obstacles, k, x, y, z)[0] > DEEP:
                    hidden[i] = True


def derivative(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Of a point's pixel [px/m] and depth by its place (..., 3) m: (..., 3, 3). For a lens without distortion."""
    x, y, z = np.moveaxis(camera.in_view(points), -1, 0)
    flat = np.zeros((*z.shape, 3, 3))
    flat[..., 0, 0] = flat[..., 1, 1] = 1 / z
    flat[..., 0, 2], flat[..., 1, 2], flat[..., 2, 2] = -x / z**2, -y / z**2, 1.0
    lens = camera.matrix.copy()
    lens[:2, 2] = 0.0
    return lens @ flat @ camera.rotation


def look_of(view: Placed, sensor: Sensor, place: np.ndarray, wrong: float) -> Look:
    """How coordinates (M, …) m of an experiment's first frames become rows of what the camera measures of them, in σ.

    place: (M,) m, where the points are; wrong: κ [m], by which any coordinate of the model may be wrong.
    """
    points = place.reshape(-1, view.seen.shape[1], 3)
    seen = view.seen[: len(points)] & in_picture(view.camera, points)
    measured = 3 if sensor.kind == DEPTH else 2
    slope = derivative(view.camera, points[seen])[:, :measured]
    depth = view.camera.in_view(points[seen])[:, 2]
    noise = np.full((len(depth), 3), sensor.noise)
    noise[:, 2] = sensor.depth_noise * depth**2
    covariance = wrong**2 * slope @ slope.swapaxes(1, 2) + np.eye(measured) * noise[:, :measured, None] ** 2
    weight = np.zeros((*seen.shape, measured, 3))
    weight[seen] = np.linalg.solve(np.linalg.cholesky(covariance), slope)

    def look(rows: np.ndarray) -> np.ndarray:
        return (weight @ rows.reshape(*seen.shape, 3, -1)).reshape(-1, *rows.shape[1:])

    return look
