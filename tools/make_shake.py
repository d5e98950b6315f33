"""Makes the stand-in recordings of the suite `shake`: `python tools/make_shake.py [TRUTH…]`.

The experiment is that of Coltraro, "Experimental Validation of an Inextensible Cloth Model": a depth camera looks at a
cotton sheet of 30 × 40 cm and 25 g, whose two upper corners a robot moves to and fro along horizontal rails at a fixed
height. The paper says neither how far nor how fast, nor which camera; here it is 25 to 100 mm at 0.8 to 1.7 Hz, gently
and fast, since only that tells a drag that grows with the speed from one that grows with its square; and a camera that
sees 3 mm a pixel, 20 times a second. The truth comes from the reference simulation (`clothbench.reference`), five
times:

damped   mass damping of 7.2 1/s, what the paper's α of 1.5 kg/(m²·s) is for this cloth, and no drag
dragged  quadratic drag and no mass damping: what does α make of it?
lagged   as `damped`, but the grips are stamped 40 ms late, which nobody declares
laden    as `damped`, but the air that moves along has 0.08 kg/m², which nobody declares
shifted  as `damped`, but the camera stands 14 mm beside where it is said to, which nobody declares

`--check` says what a mesh twice as fine changes. Files come out the same bit for bit on one machine.
"""

from __future__ import annotations

import argparse
import time
import zlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from clothbench import Camera, DepthImages, write_depth
from clothbench.core.observation import GripPath
from clothbench.recordings.depth import Colour
from clothbench.recordings.nodes import Recording, write_recording
from clothbench.reference.mesh import Mesh, build
from clothbench.reference.simulation import (
    Fabric,
    State,
    bowed,
    calmed,
    discretise,
    implicit_step,
    settle,
    simulate,
    stable_step,
)  # fmt: skip
from clothbench.vision.depth_camera import DepthSensor, sensed
from clothbench.vision.render import rasterise
from clothbench.vision.surface import surface_of

FOLDER = Path(__file__).resolve().parent.parent / "suites" / "embedded" / "shake"
NODES = FOLDER.with_name("shake_nodes")  # what of the error is not the tracker's
WIDTH, HEIGHT = 0.30, 0.40  # m
MASS = 0.025  # kg
RAIL = 1.0  # m above the floor
APART = 0.99  # of the corners, over the width
RATE, LONG = 20.0, 2.0  # 1/s, s
GRIP_RATE, GRIP_NOISE = 100.0, 0.05e-3  # 1/s, m
MASS_DAMPING = 7.2  # 1/s
SHIFT = (0.008, -0.010, 0.006)  # m, of the camera in `shifted`
LAG = 0.04  # s, of the grips' stamps in `lagged`
ADDED = 0.08  # kg/m², of air in `laden`
SOURCE, DECLARED = "clothbench reference simulation (tools/make_shake.py)", "gravity,elasticity,bending,damping"
AGE = 0.012  # s, by which the colour is older than the depth
SENSOR = DepthSensor(noise=1.2e-3)
BLUE, WALL, PERSON, RAILS = (52, 84, 168), (186, 182, 172), (120, 74, 60), (60, 62, 66)
COTTON = Fabric("cotton", MASS / (WIDTH * HEIGHT), 300.0, 260.0, 30.0, 25.0, 6e-6, 4e-3, 4e-3, 2e-3)


@dataclass(frozen=True)
class Motion:
    """How both corners move across the sheet: a sum of (amplitude [m], frequency [Hz])."""

    name: str
    split: str
    waves: tuple[tuple[float, float], ...]

    @property
    def text(self) -> str:
        return "both corners to and fro, " + " and ".join(f"{1e3 * a:.0f} mm at {f:g} Hz" for a, f in self.waves)


MOTIONS = (
    Motion("shake-1", "fit", ((0.025, 1.4),)),
    Motion("shake-2", "fit", ((0.050, 1.1),)),
    Motion("shake-3", "fit", ((0.100, 0.9),)),
    Motion("shake-4", "held_out", ((0.075, 0.8), (0.020, 1.7))),
)
TRUTHS = {
    "damped": replace(COTTON, mass_damping=MASS_DAMPING),
    "dragged": replace(COTTON, normal_drag=2.5, tangential_drag=0.05),
    "lagged": replace(COTTON, mass_damping=MASS_DAMPING),
    "laden": replace(COTTON, mass_damping=MASS_DAMPING),
    "shifted": replace(COTTON, mass_damping=MASS_DAMPING),
}


def swing(t: np.ndarray, amplitude: float, frequency: float, ramp: float = 0.3) -> np.ndarray:
    """A sine [m] whose amplitude grows from nothing within `ramp` [s], to start smoothly from rest."""
    s = np.clip(t / ramp, 0.0, 1.0)
    return amplitude * s**3 * (10.0 - 15.0 * s + 6.0 * s**2) * np.sin(2.0 * np.pi * frequency * t)


def grips(motion: Motion, t: np.ndarray) -> np.ndarray:
    """Where the two corners are (K, 2, 3) m; they move along y."""
    half = 0.5 * APART * WIDTH
    out = np.tile(np.array([[-half, 0.0, RAIL], [half, 0.0, RAIL - 0.002]]), (len(t), 1, 1))
    out[..., 1] += sum(swing(t, *wave) for wave in motion.waves)[:, None]
    return out


class Truth:
    """One cloth on one mesh, settled once; `finer` times as many nodes each way."""

    def __init__(self, name: str, finer: int = 1):
        fabric, gravity = TRUTHS[name], (0.0, 0.0, -9.81)
        if name == "laden":  # more mass and as much less gravity: mass that is moved and has no weight
            heavier = fabric.areal_density + ADDED
            gravity = (0.0, 0.0, -9.81 * fabric.areal_density / heavier)
            damping = fabric.mass_damping * fabric.areal_density / heavier
            fabric = replace(fabric, areal_density=heavier, mass_damping=damping)
        self.mesh: Mesh = build(WIDTH, HEIGHT, 20 * finer, 32 * finer)
        self.held = np.array([0, 20 * finer])
        self.sheet, self.step = discretise(fabric, self.mesh, gravity), implicit_step(fabric, self.mesh)
        calm = calmed(fabric, self.mesh)
        start = bowed(self.mesh, WIDTH, APART * WIDTH) + np.array([0.0, 0.0, RAIL])
        rest = grips(MOTIONS[0], np.zeros(1))[0]

        def lowered(t: np.ndarray) -> np.ndarray:
            s = np.clip(t / 0.5, 0.0, 1.0)[:, None, None]
            return start[self.held] + s**2 * (3.0 - 2.0 * s) * (rest - start[self.held])

        step = stable_step(calm, self.mesh)
        self.rest = settle(discretise(calm, self.mesh, gravity), start, self.held, lowered, step, at_rest=1e-3)

    def run(self, motion: Motion, times: np.ndarray) -> np.ndarray:
        """True positions of all nodes (T, N, 3) m."""
        state = State(self.rest, np.zeros_like(self.rest))
        return simulate(self.sheet, state, self.held, lambda t: grips(motion, t), times, self.step, implicit=True)[0]


def camera() -> Camera:
    """In front of the sheet and a little above its middle, 1.1 m away."""
    target = np.array([0.0, 0.0, RAIL - 0.20])
    return Camera.looking_at(target + np.array([0.08, -1.1, 0.10]), target, (176, 168), 0.56)


def moved(view: Camera, by: tuple[float, float, float]) -> Camera:
    """The same camera at another place, [m] away."""
    return replace(view, translation=view.translation - view.rotation @ np.array(by))


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Corners (8, 3) m and triangles (12, 3) of an upright box."""
    corner = np.array([[(low, high)[i >> k & 1][k] for k in range(3)] for i in range(8)], dtype=float)
    quads = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    return corner, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def background() -> list[tuple[np.ndarray, np.ndarray, tuple[int, int, int]]]:
    """A wall, a person beside the sheet, and the rails above it: corners, triangles and colour of each."""
    person = box((0.20, 0.30, 0.3), (0.48, 0.50, 1.25))
    head = box((0.27, 0.32, 1.25), (0.41, 0.48, 1.5))
    rails = [box((x - 0.01, -0.25, RAIL + 0.025), (x + 0.01, 0.25, RAIL + 0.045)) for x in (-0.141, 0.141)]
    return [
        (*box((-2, 0.9, -1), (2, 1.0, 3)), WALL), (*person, PERSON), (*head, PERSON), *((*r, RAILS) for r in rails)
    ]  # fmt: skip


def drawn(view: Camera, parts: list[tuple[np.ndarray, np.ndarray, tuple[int, int, int]]]) -> tuple[np.ndarray, ...]:
    """Depth (H, W) m and colour (H, W, 3) of triangles; the nearest wins. Shaded by how they face the camera."""
    width, height = view.size
    depth, colour = np.full((height, width), np.inf), np.zeros((height, width, 3))
    for corner, triangle, paint in parts:
        pixel, away = view.project(corner)
        nearest, shade = np.empty((height, width)), np.empty((height, width, 1))
        side = corner[triangle]
        normal = np.cross(side[:, 1] - side[:, 0], side[:, 2] - side[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-30
        lit = np.zeros(len(corner))
        np.maximum.at(lit, triangle.ravel(), np.repeat(0.45 + 0.55 * np.abs(normal @ view.rotation[2]), 3))
        rasterise(pixel, away, triangle.astype(np.int64), lit[:, None], nearest, shade)
        front = nearest < depth
        depth[front], colour[front] = nearest[front], (shade * np.array(paint, dtype=float))[front]
    return depth, colour


def filmed(
    truth: Truth, motion: Motion, times: np.ndarray, random: np.random.Generator, sensor: DepthSensor, view: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Depth (T, H, W) in millimetres and colour (T, H, W, 3), which is AGE seconds older."""
    when, which = np.unique(np.maximum(np.concatenate([times, times - AGE]), 0.0), return_inverse=True)
    places = truth.run(motion, when)[which]
    surface, still = sheet_surface(truth.mesh), background()
    depth, colour = [], []
    for now, before in zip(places[: len(times)], places[len(times) :], strict=True):
        depth.append(sensed(drawn(view, [*still, (*surface(now), BLUE)])[0], view, sensor, random))
        seen = drawn(view, [*still, (*surface(before), BLUE)])[1] + random.normal(0.0, 1.0, (*view.size[::-1], 3))
        colour.append(np.clip(np.round(seen / 16) * 16, 0, 255).astype(np.uint8))
    return np.stack(depth), np.stack(colour)


def sheet_surface(mesh: Mesh):
    """What to draw of nodes (N, 3) m: the rows that are not shifted, with finer points between."""
    rows = [range(mesh.row_start[j], mesh.row_start[j + 1]) for j in range(0, len(mesh.row_start) - 1, 2)]
    whole = np.concatenate([np.array(row) for row in rows])
    surface = surface_of(mesh.material[whole], 3)
    return lambda nodes: (surface(nodes[whole]), surface.triangle)


def record(
    name: str, motion: Motion, truth: Truth | None = None, sensor: DepthSensor = SENSOR, view: Camera | None = None
) -> DepthImages:
    """Run one motion of one truth and film it."""
    truth, view = truth or Truth(name), view or camera()
    times = np.arange(round(LONG * RATE)) / RATE
    random = np.random.default_rng(zlib.crc32(f"{name}/{motion.name}".encode()))
    depth, colour = filmed(truth, motion, times, random, sensor, moved(view, SHIFT) if name == "shifted" else view)
    grip_time = np.arange(round(LONG * GRIP_RATE) + 1) / GRIP_RATE
    felt = grips(motion, grip_time) + random.normal(0.0, GRIP_NOISE, (len(grip_time), 2, 3))
    stamped = grip_time + (LAG if name == "lagged" else 0.0)
    return DepthImages(
        name=f"{name}/{motion.name}", time=times, depth=depth, depth_step=1e-3, camera=view, cloth_width=WIDTH,
        cloth_height=HEIGHT, colour=Colour(times - AGE, colour),
        grips=GripPath(stamped, np.array([[0.0, 0.0], [WIDTH, 0.0]]), felt), areal_density=COTTON.areal_density,
        fabric=name, motion=motion.text, split=motion.split,
        sensor=f"simulated depth camera, {RATE:g} Hz, {1e3 * sensor.noise:g} mm noise at 1 m",
        source=SOURCE, licence="CC0-1.0", declared_effects=DECLARED, notes={"experiment": name, **stated(TRUTHS[name])},
    )  # fmt: skip


def stated(fabric: Fabric) -> dict[str, str]:
    """The truth of what is fitted, as notes of a recording."""
    alpha = fabric.mass_damping * COTTON.areal_density
    return {"truth_theta": f"{fabric.bending_rigidity:g}", "truth_alpha": f"{alpha:g}"}


def as_nodes(motion: Motion, truth: Truth) -> Recording:
    """The same experiment as a tracker without fault would report it, on a mesh of 9 × 9."""
    times = np.arange(round(LONG * RATE)) / RATE
    material = np.stack(np.meshgrid(*(np.linspace(0.0, size, 9) for size in (WIDTH, HEIGHT))), axis=-1).reshape(-1, 2)
    places = LinearNDInterpolator(truth.mesh.material, truth.run(motion, times).swapaxes(0, 1))(material).swapaxes(0, 1)
    grip_time = np.arange(round(LONG * GRIP_RATE) + 1) / GRIP_RATE
    return Recording(
        name=f"damped/{motion.name}", time=times, material=material, position=places, grip_time=grip_time,
        grip_material=np.array([[0.0, 0.0], [WIDTH, 0.0]]), grip_position=grips(motion, grip_time), noise_sigma=1e-5,
        cloth_width=WIDTH, cloth_height=HEIGHT, areal_density=COTTON.areal_density, fabric="damped", motion=motion.text,
        split=motion.split, sensor="none: the truth's own nodes", source=SOURCE, licence="CC0-1.0",
        declared_effects=DECLARED, notes=stated(TRUTHS["damped"]),
    )  # fmt: skip


def check() -> None:
    """What a mesh twice as fine changes, rms over nodes and frames."""
    times = np.arange(round(LONG * RATE)) / RATE
    coarse, fine = (Truth("damped", finer) for finer in (1, 2))
    a, b = coarse.run(MOTIONS[0], times), fine.run(MOTIONS[0], times)
    shared = [int(np.argmin(((fine.mesh.material - uv) ** 2).sum(axis=1))) for uv in coarse.mesh.material]
    exact = np.abs(fine.mesh.material[shared] - coarse.mesh.material).max(axis=1) < 1e-9
    away = np.linalg.norm(a - b[:, shared], axis=-1)[:, exact]
    print(f"twice as fine: {1e3 * np.sqrt((away**2).mean()):.2f} mm rms, {1e3 * away.max():.1f} mm at most")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("truths", nargs="*", metavar="TRUTH", help=", ".join(TRUTHS))
    parser.add_argument("--check", action="store_true", help="what a finer mesh changes")
    given = parser.parse_args()
    if given.check:
        return check()
    for name in given.truths or TRUTHS:
        truth = Truth(name)
        for motion in MOTIONS:
            began = time.perf_counter()
            path = write_depth(record(name, motion, truth), FOLDER / f"{name}-{motion.name}.nc")
            if name == "damped":
                write_recording(as_nodes(motion, truth), NODES / f"{name}-{motion.name}.nc")
            print(
                f"{path.stem:<18}{path.stat().st_size / 1e3:>7.0f} kB{time.perf_counter() - began:>6.0f} s", flush=True
            )
    return None


if __name__ == "__main__":
    main()
