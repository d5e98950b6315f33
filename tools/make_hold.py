"""Makes the stand-in videos of the suite `hold_and_move`: `python tools/make_hold.py [TRUTH…]` (needs PyAV to encode).

The experiment is that of "Cloth mechanical parameter estimation and simulation for optimized robotic manipulation": a
printed cloth of 60 × 30 cm, held by its upper corners, is stretched, slackened and moved before a webcam of 1280 × 720.
The paper says neither how long nor how fast, nor what the cloths weigh; here it is 3 s at 30 frames a second. The truth
comes from the reference simulation (`clothbench.reference`):

soft, stiff   two fabrics in two hands, which cover the corners; nothing but the video is recorded
straight      as `soft`, moved by a robot that hardly slackens it, and whose plan is recorded
bent          as `straight`, but the lens bends the picture
slow          as `straight`, but the camera takes 3 % fewer frames a second than its file says
drifting      as `straight`, but the grips wander from the plan by some millimetres

What the last three hide nobody declares. `--check` says what a mesh twice as fine changes.
"""

from __future__ import annotations

import argparse
import io
import time
import zlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from clothbench import Camera, ColourVideo, write_video
from clothbench.core.observation import GripPath
from clothbench.recordings.nodes import Recording, write_recording
from clothbench.reference.mesh import build
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
from clothbench.vision.render import rasterise
from clothbench.vision.surface import surface_of

SUITES = Path(__file__).resolve().parent.parent / "suites" / "embedded"
FOLDER, NODES = SUITES / "hold", SUITES / "hold_nodes"  # the latter: what of the error is not the tracker's
WIDTH, HEIGHT = 0.60, 0.30  # m
SIZE = (1280, 720)  # px
RATE, LONG, ROBOT_LONG = 30.0, 3.0, 2.0  # 1/s, s
TIGHT = 1.003  # of the corners in the first frame, over the width: slightly stretched
TREMOR = 0.8e-3  # m, of hands
LENS, SLOW, DRIFT = -0.25, 1.03, 0.006  # k1; true time between frames over the stated one; m
EXPOSURE = 0.006  # s, over which a frame is blurred
NOISE = 2.0  # of 255
QUALITY = "27"  # of H.264, smaller is better
SOURCE, DECLARED = "clothbench reference simulation (tools/make_hold.py)", "gravity,elasticity,bending,damping"
AIR = {"normal_drag": 1.4, "tangential_drag": 0.03}
FABRICS = {
    "soft": Fabric("soft", 0.13, 260.0, 220.0, 25.0, 12.0, 4e-6, 4e-3, 4e-3, 3e-3, **AIR),
    "stiff": Fabric("stiff", 0.24, 600.0, 520.0, 60.0, 90.0, 9e-5, 4e-3, 4e-3, 3e-3, **AIR),
}  # fmt: skip
TRUTHS = {"soft": "soft", "stiff": "stiff", "straight": "soft", "bent": "soft", "slow": "soft", "drifting": "soft"}
ROBOT = ("straight", "bent", "slow", "drifting")
SKIN, ROOM = np.array([196.0, 148.0, 122.0]), np.array([168.0, 172.0, 164.0])


@dataclass(frozen=True)
class Motion:
    """How two hands move. slack: share of the width that they come nearer, to and fro, at `beat` Hz; waves: along x, y
    (to the camera) and z, (amplitude [m], frequency [Hz]).
    """

    name: str
    split: str
    slack: float
    beat: float
    waves: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]


MOTIONS = (
    Motion("hold-1", "fit", 0.16, 0.67, ((0.05, 0.9), (0.0, 1.0), (0.03, 1.3))),
    Motion("hold-2", "held_out", 0.12, 0.9, ((0.07, 0.6), (0.0, 1.0), (0.04, 0.8))),
)
MOVES = (  # of a robot, which hardly slackens: a sheet that buckles hides what the camera does
    Motion("move-1", "fit", 0.02, 0.5, ((0.09, 0.8), (0.0, 1.0), (0.03, 1.1))),
    Motion("move-2", "fit", 0.03, 0.8, ((0.05, 1.3), (0.03, 0.9), (0.05, 0.7))),
    Motion("move-3", "fit", 0.01, 1.0, ((0.03, 1.0), (0.05, 0.8), (0.07, 1.0))),
    Motion("move-4", "held_out", 0.025, 0.6, ((0.07, 1.0), (0.02, 0.7), (0.04, 0.9))),
)


def hands(motion: Motion, t: np.ndarray, drift: float = 0.0) -> np.ndarray:
    """Where the two corners are (K, 2, 3) m: apart by less and more, moved together, each with a tremor of its own."""
    s = np.clip(t / 0.5, 0.0, 1.0)
    ramp = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    apart = WIDTH * (TIGHT - motion.slack * ramp * 0.5 * (1 - np.cos(2 * np.pi * motion.beat * t)))
    out = np.zeros((len(t), 2, 3))
    out[:, 0, 0], out[:, 1, 0] = -apart / 2, apart / 2
    for c, (amplitude, frequency) in enumerate(motion.waves):
        out[..., c] += (ramp * amplitude * np.sin(2 * np.pi * frequency * t))[:, None]
    for hand, phase in ((0, 0.0), (1, 2.0)):
        out[:, hand, 0] += drift * ramp * np.sin(2 * np.pi * 0.4 * t + phase)
        out[:, hand, 2] += drift * ramp * np.cos(2 * np.pi * 0.3 * t + phase)
    random = np.random.default_rng(zlib.crc32(motion.name.encode()))
    for hand in range(2):
        for c in range(3):
            for frequency in (0.8, 1.7, 3.1):
                out[:, hand, c] += ramp * TREMOR / frequency * np.sin(2 * np.pi * (frequency * t + random.random()))
    return out


class Truth:
    """One cloth on one mesh, settled once; `finer` times as many nodes each way."""

    def __init__(self, fabric: Fabric, finer: int = 1):
        self.fabric = fabric
        nu, nv = 40 * finer, 22 * finer
        self.mesh, self.held = build(WIDTH, HEIGHT, nu, nv), np.array([0, nu])
        self.sheet, self.step = discretise(fabric, self.mesh), implicit_step(fabric, self.mesh)
        calm = calmed(fabric, self.mesh)
        start, rest = bowed(self.mesh, WIDTH, 0.995 * WIDTH), hands(MOTIONS[0], np.zeros(1))[0]

        def lowered(t: np.ndarray) -> np.ndarray:
            s = np.clip(t / 0.5, 0.0, 1.0)[:, None, None]
            return start[self.held] + s**2 * (3.0 - 2.0 * s) * (rest - start[self.held])

        step = stable_step(calm, self.mesh)
        self.rest = settle(discretise(calm, self.mesh), start, self.held, lowered, step, at_rest=1e-3)

    def run(self, motion: Motion, times: np.ndarray, drift: float = 0.0) -> np.ndarray:
        """True positions of all nodes (T, N, 3) m."""
        state = State(self.rest, np.zeros_like(self.rest))
        path = lambda t: hands(motion, t, drift)  # noqa: E731
        return simulate(self.sheet, state, self.held, path, times, self.step, implicit=True)[0]


def camera(name: str = "soft") -> Camera:
    """A webcam before the cloth, a little above its middle and aside."""
    target = np.array([0.0, 0.0, -0.17])
    view = Camera.looking_at(target + np.array([0.06, -1.0, 0.08]), target, SIZE, 0.98)
    return replace(view, distortion=np.array([LENS, 0, 0, 0, 0])) if name == "bent" else view


def template(pattern: str = "printed", seed: int = 3) -> np.ndarray:
    """A flat picture (H, W, 3) of the cloth, 2 px a millimetre: "printed" with figures of all kinds, "striped", or
    "plain" but for its weave.
    """
    import cv2

    width, height = round(2000 * WIDTH), round(2000 * HEIGHT)
    random = np.random.default_rng(seed)
    out = np.full((height, width, 3), (226, 218, 200), np.uint8)
    if pattern == "striped":
        out[:, (np.arange(width) // 24) % 2 == 0] = (70, 96, 150)
    elif pattern == "printed":
        for _ in range(900):
            at, size = random.uniform(0, (width, height)).astype(int), int(random.uniform(6, 26))
            colour = tuple(float(c) for c in random.choice([(60, 90, 150), (170, 60, 50), (50, 120, 80), (40, 40, 46)]))
            kind = random.integers(4)
            turned = float(random.uniform(0, 360))
            if kind == 0:
                cv2.ellipse(out, at.tolist(), (size, max(3, size // 2)), turned, 0, 360, colour, -1, cv2.LINE_AA)
            elif kind == 1:
                box = cv2.boxPoints((at.tolist(), (size, 1.6 * size), turned)).astype(np.int32)
                cv2.fillPoly(out, [box], colour, cv2.LINE_AA)
            elif kind == 2:
                cv2.circle(out, at.tolist(), size, colour, 3, cv2.LINE_AA)
            else:
                letter = chr(int(random.integers(65, 91)))
                cv2.putText(out, letter, at.tolist(), cv2.FONT_HERSHEY_SIMPLEX, size / 16, colour, 3, cv2.LINE_AA)
    weave = 2.0 * ((np.arange(width) // 2 + np.arange(height)[:, None] // 2) % 2)
    return np.clip(out + weave[..., None], 0, 255).astype(np.uint8)


def room(seed: int = 8) -> np.ndarray:
    """What is behind the cloth (H, W, 3): soft shapes of a room."""
    import cv2

    random = np.random.default_rng(seed)
    out = np.full((SIZE[1], SIZE[0], 3), ROOM)
    for _ in range(14):
        corner, size = random.uniform(0, SIZE, 2), random.uniform(60, 380, 2)
        colour = tuple(float(c) for c in ROOM * random.uniform(0.45, 1.15))
        cv2.rectangle(out, corner.astype(int).tolist(), (corner + size).astype(int).tolist(), colour, -1)
    return cv2.GaussianBlur(out, (0, 0), 2.5)


class Scenery:
    """What does not change from frame to frame: camera, cloth's picture, room."""

    def __init__(self, view: Camera, picture: np.ndarray, mesh):
        self.view, self.picture, self.room = view, picture, room()
        rows = [range(mesh.row_start[j], mesh.row_start[j + 1]) for j in range(0, len(mesh.row_start) - 1, 2)]
        self.whole = np.concatenate([np.array(row) for row in rows])
        self.surface = surface_of(mesh.material[self.whole], 3)

    def drawn(self, nodes: np.ndarray, held: np.ndarray, covered: bool) -> np.ndarray:
        """A frame (H, W, 3) without noise, of nodes (N, 3) m, held at (2, 3) m by hands that cover it, or not."""
        import cv2

        width, height = SIZE
        place, triangle = self.surface(nodes[self.whole]), self.surface.triangle
        pixel, away = self.view.project(place)
        side = place[triangle]
        normal = np.cross(side[:, 1] - side[:, 0], side[:, 2] - side[:, 0])
        sums = np.zeros_like(place)
        for k in range(3):
            np.add.at(sums, triangle[:, k], normal)
        sums /= np.linalg.norm(sums, axis=1, keepdims=True) + 1e-30
        light = np.array([-0.4, -0.8, 0.45])
        shade = 0.55 + 0.45 * np.abs(sums @ light)
        attribute = np.column_stack([self.surface.material, shade])
        nearest, seen = np.empty((height, width)), np.empty((height, width, 3))
        rasterise(pixel, away, triangle, attribute, nearest, seen)
        rows, columns = self.picture.shape[:2]
        there = np.isfinite(nearest)
        seen[~there] = 0.0
        at = (seen[..., :2] / [WIDTH, HEIGHT] * [columns, rows] - 0.5).astype(np.float32)
        small = cv2.GaussianBlur(self.picture, (0, 0), 0.9)  # a pixel of the camera is as large as two of the picture
        cloth = cv2.remap(small, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        out = np.where(there[..., None], cloth * seen[..., 2:], self.room)
        if covered:
            for hand, point in enumerate(held):
                x, y = self.view.project(point)[0]
                tilt = 25 if hand else -25
                cv2.ellipse(
                    out, (round(float(x)), round(float(y)) - 18), (30, 44), tilt, 0, 360, SKIN.tolist(), -1, cv2.LINE_AA
                )
                for finger in range(4):
                    end = np.array([x - 22 + 13 * finger, y - 26 + 9 * (finger % 2)])
                    begin = np.array([x - 12 + 8 * finger, y + 12 - 3 * (finger % 2)])
                    shade = (SKIN * (0.62 + 0.08 * finger)).tolist()
                    cv2.line(
                        out,
                        np.round(begin).astype(int).tolist(),
                        np.round(end).astype(int).tolist(),
                        shade,
                        4,
                        cv2.LINE_AA,
                    )
        return out


def record(
    name: str, motion: Motion, truth: Truth, pattern: str = "printed", encoded: bool = True
) -> tuple[ColourVideo, np.ndarray]:
    """Run one motion and film it: the recording, and where all nodes truly were at its stamps (T, N, 3) m."""
    view, drift = camera(name), DRIFT if name == "drifting" else 0.0
    robot = name in ROBOT
    stamps = np.arange(round((ROBOT_LONG if robot else LONG) * RATE)) / RATE
    moments = stamps * (SLOW if name == "slow" else 1.0)
    when = np.concatenate([moments, moments + EXPOSURE])
    order = np.argsort(when)
    places = np.empty((len(when), len(truth.mesh.material), 3))
    places[order] = truth.run(motion, when[order], drift)
    held = hands(motion, when, drift)
    scenery, random = (
        Scenery(view, template(pattern), truth.mesh),
        np.random.default_rng(zlib.crc32(f"{name}/{motion.name}".encode())),
    )
    count, frames = len(stamps), []
    for k in range(count):
        both = [scenery.drawn(places[j], held[j], not robot) for j in (k, count + k)]
        noisy = 0.5 * (both[0] + both[1]) + random.normal(0.0, NOISE, both[0].shape)
        frames.append(np.clip(np.round(noisy), 0, 255).astype(np.uint8))
    fabric = FABRICS[TRUTHS[name]]
    if encoded:
        stream, ends = film(frames), None
    else:
        stream, ends = pictures(frames)
    plan = np.arange(round(100 * LONG * SLOW) + 2) / 100.0
    straight = replace(view, distortion=np.zeros(5))
    video = ColourVideo(
        name=f"{name}/{motion.name}", time=stamps + EXPOSURE / 2, stream=stream, ends=ends, template=template(pattern),
        cloth_width=WIDTH, cloth_height=HEIGHT, camera=straight, world="camera" if robot else "cloth",
        grips=GripPath(plan, np.array([[0.0, 0.0], [WIDTH, 0.0]]), hands(motion, plan)) if robot else None,
        areal_density=fabric.areal_density, fabric=name, split=motion.split,
        motion=f"stretched, slackened and moved by {'a robot' if robot else 'two hands'}",
        sensor=f"simulated webcam, {SIZE[0]} × {SIZE[1]}, {RATE:g} Hz", source=SOURCE, licence="CC0-1.0",
        declared_effects=DECLARED, notes={"experiment": name},
    )  # fmt: skip
    return video, 0.5 * (places[:count] + places[count:])


def as_nodes(name: str, motion: Motion, truth: Truth, places: np.ndarray, stamps: np.ndarray) -> Recording:
    """The same in the same picture as a tracker without fault would report it, and the hands where they were."""
    u, v = ((np.arange(n) + 0.5) / n * length for n, length in ((20, WIDTH), (10, HEIGHT)))
    material = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    return Recording(
        name=f"{name}/{motion.name}", time=stamps, material=material, position=seen_truth(truth, places, material),
        grip_time=stamps, grip_material=np.array([[0.0, 0.0], [WIDTH, 0.0]]), grip_position=hands(motion, stamps),
        noise_sigma=1e-5, cloth_width=WIDTH, cloth_height=HEIGHT, areal_density=truth.fabric.areal_density, fabric=name,
        motion="stretched, slackened and moved by two hands", split=motion.split, sight=camera(),
        sensor="none: the truth's own nodes in the picture", source=SOURCE, licence="CC0-1.0",
        declared_effects=DECLARED,
    )  # fmt: skip


def film(frames: list[np.ndarray]) -> np.ndarray:
    """Frames as the bytes of an MP4 file (H.264)."""
    import av

    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as out:
        stream = out.add_stream("libx264", rate=round(RATE), options={"crf": QUALITY, "preset": "slow"})
        stream.width, stream.height, stream.pix_fmt, stream.thread_count = *SIZE, "yuv420p", 1
        for frame in frames:
            out.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        out.mux(stream.encode())
    return np.frombuffer(file.getvalue(), np.uint8)


def pictures(frames: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Frames as the bytes of JPEG pictures, and where each ends."""
    import cv2

    parts = [cv2.imencode(".jpg", frame[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])[1].ravel() for frame in frames]
    return np.concatenate(parts), np.cumsum([len(part) for part in parts])


def seen_truth(truth: Truth, places: np.ndarray, material: np.ndarray) -> np.ndarray:
    """True positions (T, N, 3) m of material points (N, 2) m."""
    return LinearNDInterpolator(truth.mesh.material, places.swapaxes(0, 1))(material).swapaxes(0, 1)


def check() -> None:
    """What a mesh twice as fine changes, rms over nodes and frames."""
    times = np.arange(round(LONG * RATE)) / RATE
    for fabric in FABRICS.values():
        coarse, fine = (Truth(fabric, finer) for finer in (1, 2))
        a, b = coarse.run(MOTIONS[0], times), fine.run(MOTIONS[0], times)
        b = seen_truth(fine, b, coarse.mesh.material)
        away = np.linalg.norm(a - b, axis=-1)
        print(
            f"{fabric.name}: twice as fine {1e3 * np.sqrt(np.nanmean(away**2)):.2f} mm rms, "
            f"{1e3 * np.nanmax(away):.1f} mm at most"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("truths", nargs="*", metavar="TRUTH", help=", ".join(TRUTHS))
    parser.add_argument("--check", action="store_true", help="what a finer mesh changes")
    given = parser.parse_args()
    if given.check:
        return check()
    known = {fabric: Truth(FABRICS[fabric]) for fabric in {TRUTHS[name] for name in given.truths or TRUTHS}}
    for name in given.truths or TRUTHS:
        for motion in MOVES if name in ROBOT else MOTIONS:
            began = time.perf_counter()
            truth = known[TRUTHS[name]]
            video, places = record(name, motion, truth)
            if name in FABRICS:
                write_recording(as_nodes(name, motion, truth, places, video.time), NODES / f"{name}-{motion.name}.nc")
            path = write_video(video, FOLDER / f"{name}-{motion.name}.nc")
            print(
                f"{path.stem:<18}{path.stat().st_size / 1e3:>7.0f} kB{time.perf_counter() - began:>6.0f} s", flush=True
            )
    return None


if __name__ == "__main__":
    main()
