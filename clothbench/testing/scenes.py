"""Small scenes for the kit, made by formula: a sheet of 0.30 m × 0.25 m on 7 × 6 nodes, 0.12 kg/m².

Wider than high, so that swapped directions show; bent on purpose, so that no rounding error decides on which
side a sheet buckles. The points looked at lie between the nodes of a regular mesh, and on the grips.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from clothbench.core.camera import Camera
from clothbench.core.outline import disc_outline
from clothbench.core.scene import Obstacle, Scene, minimum_jerk

WIDTH, HEIGHT, AREAL_DENSITY = 0.30, 0.25, 0.12  # m, m, kg/m²
RESOLUTION = (7, 6)
GRAVITY = np.array([0.0, 0.0, -9.81])
CAMERA = Camera.looking_at(np.array([0.1, -1.2, 0.95]), np.array([0.0, 0.0, 0.87]), (640, 480), 0.6)


def hanging() -> Scene:
    """Two upper corners held still, brought together to 85 % of their distance."""
    held = np.array([[0.0, 0.0], [WIDTH, 0.0]])
    return _held(held, _flat(held) * [0.85, 1.0, 1.0], np.linspace(0.0, 0.3, 7), depth=0.03)


def swinging() -> Scene:
    """Two points off every regular mesh, moved 8 cm across the sheet and 2 cm along it; uneven stamps."""
    held = np.array([[0.067, 0.011], [0.241, 0.011]])
    stamps = 0.4 * np.linspace(0.0, 1.0, 25) ** 1.2
    moved = minimum_jerk(stamps / 0.3)[:, None, None] * np.array([0.02, 0.08, 0.01])
    times = np.array([0.0, 0.03, 0.05, 0.11, 0.12, 0.19, 0.26, 0.29, 0.37, 0.43])
    return _held(held, _flat(held) * [0.95, 1.0, 1.0] + moved, times, depth=0.01, stamps=stamps)


def stretched() -> Scene:
    """Four corners, the lower two pulled down by 3 % and sideways by 4 % within 0.2 s."""
    held = np.array([[0.0, 0.0], [WIDTH, 0.0], [0.0, HEIGHT], [WIDTH, HEIGHT]])
    stamps = np.linspace(0.0, 0.3, 16)
    pull = np.where(held[:, 1:] > 0, [[0.04 * WIDTH, 0.0, -0.03 * HEIGHT]], 0.0)
    position = _flat(held) + minimum_jerk(stamps / 0.2)[:, None, None] * pull
    return _held(held, position, np.linspace(0.0, 0.3, 7), depth=0.004, stamps=stamps)


def overhanging() -> Scene:
    """Clamped level along its left side, two columns of points wide; the rest of the sheet bends down."""
    held = np.array([[u, v] for u in (0.0, 0.05) for v in np.linspace(0.0, HEIGHT, 6)])
    times = np.linspace(0.0, 0.3, 7)
    points = np.vstack([_looked_at(), held])
    slope = np.clip((points[:, 0] - 0.05) / 0.1, 0.0, 1.0) * 1.2  # rad, at the most; a quarter circle would be 1.57
    start = np.stack([points[:, 0] * np.cos(slope / 2), points[:, 1], 1.0 - points[:, 0] * np.sin(slope / 2)], axis=1)
    level = np.broadcast_to(start[-len(held) :], (2, len(held), 3))
    return Scene(
        width=WIDTH, height=HEIGHT, areal_density=AREAL_DENSITY,
        grip_time=times[[0, -1]], grip_material=held, grip_position=level,
        times=times, points=points, resolution=RESOLUTION, start=start, camera=CAMERA,
    )  # fmt: skip


def curtain() -> Scene:
    """Held along its upper edge without any slack, 13 × 11 nodes, square cells; seen at all of them."""
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0.0, WIDTH, 13), np.linspace(0.0, HEIGHT, 11)))
    points, edge = np.stack([u, v], axis=1), v == 0
    start, times = np.stack([u, 0 * u, 1.0 - v], axis=1), np.linspace(0.0, 0.1, 3)
    return Scene(
        width=WIDTH, height=HEIGHT, areal_density=AREAL_DENSITY,
        grip_time=times[[0, -1]], grip_material=points[edge], grip_position=np.stack([start[edge]] * 2),
        times=times, points=points, resolution=(13, 11), start=start, camera=CAMERA,
    )  # fmt: skip


def cut_and_short() -> tuple[Scene, Scene]:
    """`overhanging` with two fifths along one side cut off, and the same as a narrower sheet with the nodes left."""
    whole = overhanging()
    height = 0.6 * HEIGHT  # a mesh line
    above, held = (uv[:, 1] <= height + 1e-9 for uv in (whole.points, whole.grip_material))
    assert whole.start is not None
    cut = dataclasses.replace(
        whole, points=whole.points[above], start=whole.start[above],
        grip_material=whole.grip_material[held], grip_position=whole.grip_position[:, held],
        outline=np.array([[0.0, 0.0], [WIDTH, 0.0], [WIDTH, height], [0.0, height]]),
    )  # fmt: skip
    return cut, dataclasses.replace(cut, height=height, outline=None, resolution=(RESOLUTION[0], 4))


def draped() -> Scene:
    """A disc of 0.24 m clamped on a plate of 0.14 m, a little bent already; seen on the plate and at the rim."""
    turn = 2 * np.pi * np.arange(24) / 24
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    points = 0.12 + np.vstack([0.04 * ring, 0.12 * ring])
    flat = (points - 0.12) * [1, -1]
    start = np.column_stack([flat, np.repeat([0.0, 0.003], 24) * np.cos(2 * np.tile(turn, 2))])
    return Scene(
        width=0.24, height=0.24, areal_density=AREAL_DENSITY,
        grip_time=np.array([0.0, 1.0]), grip_material=np.zeros((0, 2)), grip_position=np.zeros((2, 0, 3)),
        times=np.array([0.0]), points=points, resolution=(13, 13), start=start + np.array([0.1, 0.2, 0.3]),
        outline=disc_outline(0.12), obstacles=(Obstacle("disc", (0.1, 0.2, 0.3), radius=0.07, clamps=True),),
    )  # fmt: skip


def carried() -> Scene:
    """Flat on a rough table that moves 3 cm sideways and 2 cm up within 0.2 s, with the one corner that is held."""
    stamps = np.linspace(0.0, 0.2, 21)
    points = np.vstack([_looked_at(), [[0.0, 0.0]]])
    flat = np.column_stack([points, np.zeros(len(points))])
    path = flat[-1] + minimum_jerk(stamps / 0.2)[:, None, None] * np.array([0.03, 0.0, 0.02])
    return Scene(
        width=WIDTH, height=HEIGHT, areal_density=AREAL_DENSITY, grip_time=stamps, grip_material=points[-1:],
        grip_position=path, times=np.linspace(0.0, 0.25, 6), points=points, resolution=RESOLUTION, start=flat,
        obstacles=(Obstacle("plane", friction=3.0, carried=True),),
    )  # fmt: skip


def over_a_table() -> Scene:
    """`overhanging` with a table 4 cm below it, which the sheet reaches on its way down."""
    scene = overhanging()
    start = np.column_stack([scene.points, np.ones(len(scene.points))])  # level, above the table
    bend = 0.01 * np.clip((scene.points[:, 0] - 0.05) / 0.25, 0.0, 1.0) ** 2
    return dataclasses.replace(
        scene, start=start - bend[:, None] * [0.0, 0.0, 1.0], times=np.linspace(0.0, 0.5, 6),
        grip_time=np.array([0.0, 0.5]), obstacles=(Obstacle("plane", (0.0, 0.0, 0.96)),),
    )  # fmt: skip


def on_a_slope() -> Scene:
    """Two upper corners held still, without slack; the sheet leans on a plane that rises behind it from 3 cm below."""
    held = np.array([[0.0, 0.0], [WIDTH, 0.0]])
    scene = _held(held, _flat(held), np.linspace(0.0, 0.5, 6), depth=0.0)
    normal = np.array([0.0, np.cos(0.5), np.sin(0.5)])
    below = np.maximum(scene.points[:, 1] - 0.03, 0.0)
    lean = below[:, None] * [0.0, np.sin(0.5), 1 - np.cos(0.5)]  # turned into the plane
    return dataclasses.replace(
        scene,
        start=_flat(scene.points) + lean + 1e-4 * normal,
        obstacles=(Obstacle("plane", (0.0, 0.0, 0.97), tuple(normal)),),
    )


def folded_over() -> Scene:
    """A strip of 24 cm × 6 cm laid back over itself around a loop 2.5 cm high, its lower part held, let go at rest."""
    width, loop = 0.24, 0.04 / np.pi
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0.0, width, 25), np.linspace(0.0, 0.06, 7)))
    angle = np.clip((u - 0.10) / loop, 0, np.pi)
    x = np.minimum(u, 0.10) + loop * np.sin(angle) - np.maximum(u - 0.14, 0)
    points, start = np.stack([u, v], axis=1), np.stack([x, v, loop * (1 - np.cos(angle))], axis=1)
    held, times = u <= 0.1001, np.linspace(0.0, 0.3, 4)
    return Scene(
        width=width, height=0.06, areal_density=AREAL_DENSITY, grip_time=times[[0, -1]], grip_material=points[held],
        grip_position=np.stack([start[held]] * 2), times=times, points=points, resolution=(25, 7), start=start,
        velocity=np.zeros_like(start), thickness=5e-3, camera=CAMERA,
    )  # fmt: skip


def free_fall() -> Scene:
    """Nothing holds the sheet; it starts upright and slightly bent, at rest."""
    times = np.linspace(0.0, 0.2, 6)
    return _scene(times, np.array([0.0, 0.2]), np.zeros((0, 2)), np.zeros((2, 0, 3)), depth=0.01)


def standard() -> dict[str, Scene]:
    """All of them by name."""
    made = (hanging, swinging, stretched, overhanging, free_fall)
    return {make.__name__: make() for make in made}


def moved(scene: Scene, turn: np.ndarray, shift: np.ndarray, *, with_gravity: bool) -> Scene:
    """The same scene, with all that stands in it, after x → turn·x + shift, turn (3, 3), shift (3,) m; gravity turns
    along or stays.
    """

    def placed(obstacle: Obstacle) -> Obstacle:
        centre, normal = turn @ obstacle.centre + shift, turn @ obstacle.normal
        return dataclasses.replace(obstacle, centre=tuple(centre), normal=tuple(normal))

    camera = scene.camera
    if camera is not None:
        rotation = camera.rotation @ turn.T
        camera = dataclasses.replace(camera, rotation=rotation, translation=camera.translation - rotation @ shift)
    return dataclasses.replace(
        scene,
        grip_position=scene.grip_position @ turn.T + shift,
        start=None if scene.start is None else scene.start @ turn.T + shift,
        velocity=None if scene.velocity is None else scene.velocity @ turn.T,
        gravity=tuple(turn @ scene.gravity) if with_gravity else scene.gravity,
        obstacles=tuple(map(placed, scene.obstacles)),
        camera=camera,
    )


def turn_about(axis: tuple[float, float, float], angle: float) -> np.ndarray:
    """Rotation matrix (3, 3) by `angle` rad about `axis` (Rodrigues)."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def still(scene: Scene) -> Scene:
    """The same scene with the grips left in their first pose."""
    position = np.repeat(scene.grip_position[:1], len(scene.grip_time), axis=0)
    return dataclasses.replace(scene, grip_position=position)


def with_times(scene: Scene, times: np.ndarray) -> Scene:
    return dataclasses.replace(scene, times=times)


def _held(held: np.ndarray, position: np.ndarray, times: np.ndarray, depth: float, stamps=None) -> Scene:
    """Grips `held` (G, 2) m at `position` (K, G, 3) m, or (G, 3) where they stay put."""
    stamps = np.array([times[0], times[-1]]) if stamps is None else stamps
    position = np.broadcast_to(position, (len(stamps), len(held), 3))
    return _scene(times, stamps, held, position, depth)


def _scene(times: np.ndarray, stamps: np.ndarray, held: np.ndarray, position: np.ndarray, depth: float) -> Scene:
    points = np.vstack([_looked_at(), held])
    bulge = depth * np.sin(np.pi * points[:, 0] / WIDTH) * (0.6 + 0.4 * points[:, 1] / HEIGHT)
    narrower = np.ptp(position[0, :, 0]) / np.ptp(held[:, 0]) if len(held) else 1.0
    start = _flat(points) * [narrower, 1.0, 1.0] + bulge[:, None] * [0.0, 1.0, 0.0]
    return Scene(
        width=WIDTH, height=HEIGHT, areal_density=AREAL_DENSITY,
        grip_time=stamps, grip_material=held, grip_position=position,
        times=times, points=points, resolution=RESOLUTION, start=start, camera=CAMERA,
    )  # fmt: skip


def _looked_at() -> np.ndarray:
    """Material points (20, 2) m in the middle of the cloth, on no line of a regular mesh."""
    u, v = np.meshgrid(np.linspace(0.03, 0.27, 5) + 0.002, np.linspace(0.04, 0.22, 4) + 0.003)
    return np.stack([u.ravel(), v.ravel()], axis=1)


def _flat(uv: np.ndarray) -> np.ndarray:
    """Upright sheet (n, 3) m in the x–z plane, the middle of its upper edge 1 m above the origin."""
    return np.stack([uv[:, 0] - WIDTH / 2, np.zeros(len(uv)), 1.0 - uv[:, 1]], axis=1)
