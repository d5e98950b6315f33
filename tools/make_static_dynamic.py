"""Makes the stand-in recordings of the suite `static_dynamic`: `python tools/make_static_dynamic.py [FABRIC…]`.

The protocol is that of Bhat et al. 2003, "Estimating cloth simulation parameters from video": a swatch hangs from its
two top corners, in `static` trials still at two separations, in `waving` trials with one corner moved; then longer and
on a skirt-like garment. The true parameters are those the paper found for its fabrics: table 1 (experiment 2) in the
static trials, table 3 (the experiment it selected) in the others. The paper gives neither masses nor sizes, and its two
tables disagree about a fabric, as it says itself; so the static and the waving stand-ins of one are two cloths. The
truth comes from the reference simulation (`clothbench.reference`); a camera and a projector look at it.

`--convergence TRIAL…` says what a mesh twice as fine in space and time changes. Files come out the same bit for bit on
one machine; on another processor the last digit of the tracker (8 µm) may differ.
"""

from __future__ import annotations

import argparse
import math
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clothbench.core.camera import Camera, Projector, Video
from clothbench.core.scene import Obstacle
from clothbench.recordings.nodes import Recording, write_recording
from clothbench.reference.mesh import build, tracking_weights
from clothbench.reference.simulation import (
    AIR_DENSITY,
    NO_SPHERES,
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
from clothbench.vision.render import expose, striped
from clothbench.vision.surface import surface_of

FOLDER = Path(__file__).resolve().parent.parent / "suites" / "embedded" / "static_dynamic"
LONG = FOLDER.with_name("static_dynamic_long")  # what budget=paper looks at beside
BODY = FOLDER.with_name("static_dynamic_body")  # a skirt with hips in it
SIDE = 0.30  # m, the swatch is square
SKIRT = (0.75, 0.30)  # m, round the waist and down
HIPS, HIP = ((-0.045, 0.0, -0.12), (0.045, 0.0, -0.12)), 0.11  # m, two spheres below the waist's middle, their radius
HIP_FRICTION = 0.3
SPACING = 0.30 / 8  # m, of the tracked lattice
HEIGHT = 1.0  # m, of the grips above the floor
TILT = 0.003  # m, the right grip hangs lower: an even hold leaves the mirror branch to rounding errors
MARKER_NOISE, GRIP_NOISE, DROPOUT = 1.0e-3, 0.05e-3, 0.01
RESOLUTION = 2.0**-17  # m; what the simulated tracker resolves (8 µm), exact in float32, and compresses well
IMAGE_NOISE, GREY_LEVELS = 4.0, 32  # of 256 grey levels; steps the camera tells apart

# Parameters as the paper names and numbers them.
NAMES = ("bend", "stretch", "shear", "bend_damping", "stretch_damping", "shear_damping", "linear_drag",
         "quadratic_drag", "drag_decline")  # fmt: skip
DENSITY = {"linen": 0.22, "fleece": 0.24, "satin": 0.11, "knit": 0.17}  # kg/m², usual for such fabrics
TABLE_1 = {  # experiment 2
    "linen": (0.0045, 3682.1, 208.15, 3.22e-7, 10.17, 13.17),
    "fleece": (0.0001, 200.04, 31.39, 4.11e-7, 0.064, 3.75),
    "satin": (6.94e-6, 19.38, 69.65, 3.98e-7, 3.68, 4.56),
    "knit": (1.51e-6, 28.36, 2693.07, 2.27e-7, 11.83, 4.04),
}
TABLE_3 = {  # the experiment selected by the least E1 + E2
    "linen": (0.0008, 2935.3, 465.7, 4.7e-7, 5.2, 5.5, 2.2, 2.0, 1.3),
    "fleece": (0.0001, 89.3, 296.9, 1.3e-6, 5.9, 9.8, 1.6, 0.3, 1.2),
    "satin": (5.6e-6, 32.4, 74.2, 1.2e-7, 4.5, 4.7, 0.8, 1.5, 0.8),
    "knit": (1.1e-6, 69.7, 37.5, 1.0e-7, 4.5, 4.9, 1.5, 0.5, 1.2),
}
FABRICS = tuple(DENSITY)
AIR = {"linear_drag": 0.02, "quadratic_drag": 0.6, "drag_decline": 0.05}  # of a static trial, where it does not matter


@dataclass(frozen=True)
class Trial:
    """One run. `offset` says how far the left and the right corner have moved: (K,) s -> (K, 2, 3) m."""

    name: str
    split: str
    separation: float  # of the corners, over the width; of a skirt, how far the waist is gathered
    duration: float  # s
    rate: float  # frames per second
    motion: str
    offset: Callable[[np.ndarray], np.ndarray]
    folder: Path = FOLDER

    @property
    def experiment(self) -> str:
        return "static" if self.name.startswith("static") else "waving"

    @property
    def is_skirt(self) -> bool:
        return self.name.endswith("skirt") or self.has_body

    @property
    def has_body(self) -> bool:
        return self.name.endswith("body")


def swing(t: np.ndarray, amplitude: float, frequency: float, ramp: float = 0.3) -> np.ndarray:
    """A sine [m] whose amplitude grows from nothing within `ramp` [s], to start smoothly from rest."""
    s = np.clip(t / ramp, 0.0, 1.0)
    return amplitude * s**3 * (10.0 - 15.0 * s + 6.0 * s**2) * np.sin(2.0 * np.pi * frequency * t)


def still(t: np.ndarray) -> np.ndarray:
    return np.zeros((len(t), 2, 3))


def right_corner(*waves: tuple[float, float]) -> Callable[[np.ndarray], np.ndarray]:
    """The right corner to and fro across the sheet, by a sum of (amplitude [m], frequency [Hz])."""

    def offset(t: np.ndarray) -> np.ndarray:
        moved = still(t)
        moved[:, 1, 1] = sum(swing(t, *wave) for wave in waves)
        return moved

    return offset


def skipping(t: np.ndarray) -> np.ndarray:
    """A waist that skips: up and down twice a second, swaying once; forwards, sideways and up of its centre [m]."""
    jitter = np.random.default_rng(5).normal(0.0, 1.0, (4, 3))
    moved = still(t)
    moved[:, 0, 1], moved[:, 0, 2] = swing(t, 0.03, 1.0), swing(t, 0.035, 2.0)
    moved[:, 0] += sum(swing(t, 1.5e-3, 0.7 * (k + 1))[:, None] * jitter[k] for k in range(4))
    moved[:, 1] = moved[:, 0]
    return moved


TRIALS = (
    Trial("static-1", "fit", 0.95, 0.4, 10.0, "top corners held still at 0.95 of the width", still),
    Trial("static-2", "held_out", 0.80, 0.4, 10.0, "top corners held still at 0.80 of the width", still),
    Trial("waving-1", "fit", 0.90, 5 / 3, 30.0, "right corner to and fro, 60 mm at 1.0 Hz", right_corner((0.06, 1.0))),
    Trial("waving-2", "held_out", 0.85, 5 / 3, 30.0, "right corner to and fro, 50 mm at 1.2 Hz",
          right_corner((0.05, 1.2))),
    Trial("waving-long", "held_out", 0.88, 5.0, 15.0, "right corner to and fro, 35 mm at 0.7 Hz and 25 mm at 1.5 Hz",
          right_corner((0.035, 0.7), (0.025, 1.5))),
    Trial("waving-skirt", "held_out", 0.92, 2.0, 15.0, "a wrapped skirt on a skipping waist", skipping),
    Trial("waving-150", "held_out", 0.90, 5.0, 30.0, "right corner to and fro, 60 mm at 1.0 Hz, 150 frames",
          right_corner((0.06, 1.0)), LONG),
    Trial("waving-robot", "held_out", 0.90, 10 / 3, 30.0, "right corner along a sinusoid, 80 mm at 0.6 Hz, 100 frames",
          right_corner((0.08, 0.6)), LONG),
    Trial("waving-body", "held_out", 0.92, 2.0, 15.0, "a wrapped skirt on skipping hips", skipping, BODY),
)  # fmt: skip


def fabric_of(name: str, experiment: str) -> tuple[Fabric, dict[str, float]]:
    """The reference's fabric, and the same as the paper's nine parameters."""
    table = TABLE_1 if experiment == "static" else TABLE_3
    truth = {**AIR, **dict(zip(NAMES, table[name], strict=False))}
    bend, stretch, shear = (truth[n] for n in NAMES[:3])
    fabric = Fabric(
        name, DENSITY[name], stretch, stretch, 0.0, shear, bend,
        truth["stretch_damping"] / stretch, truth["shear_damping"] / shear, truth["bend_damping"] / bend,
        normal_drag=2 * truth["quadratic_drag"] / AIR_DENSITY, linear_drag=truth["linear_drag"],
        drag_decline=truth["drag_decline"],
    )  # fmt: skip
    return fabric, truth


def hold(separation: float) -> np.ndarray:
    """The two grips at the start of a trial [m], (2, 3)."""
    half = 0.5 * separation * SIDE
    return np.array([[-half, 0.0, HEIGHT], [half, 0.0, HEIGHT - TILT]])


def waist(u: np.ndarray, gathered: float) -> np.ndarray:
    """Where points u (K,) m of a skirt's waistband lie [m], (K, 3): round 320° of a circle, open at the back."""
    angle = math.radians(320.0) * (u / SKIRT[0] - 0.5)
    radius = gathered * SKIRT[0] / math.radians(320.0)
    return np.column_stack([radius * np.sin(angle), radius * (1 - np.cos(angle)), np.full(len(u), HEIGHT)])


def hips(gathered: float) -> np.ndarray:
    """Centres of the two spheres in a skirt whose waist is at its place [m], (2, 3)."""
    radius = gathered * SKIRT[0] / math.radians(320.0)
    return np.array([0.0, radius, HEIGHT]) + HIPS


class Bench:
    """One fabric on one mesh, hung up and run; the shape at rest is kept per separation."""

    def __init__(self, fabric: Fabric, skirt: bool = False, finer: float = 1.0) -> None:
        self.size = SKIRT if skirt else (SIDE, SIDE)
        columns, rows = (36, 16) if skirt else (14, 16)  # nearly equilateral triangles of 21 mm
        columns, rows = 2 * round(columns * finer / 2), 16 * round(rows * finer / 16)
        self.skirt, self.mesh = skirt, build(*self.size, columns, rows)
        self.sheet, self.step = discretise(fabric, self.mesh), implicit_step(fabric, self.mesh)
        self.calm = calmed(fabric, self.mesh)
        self.held = np.arange(columns + 1) if skirt else np.array([0, columns])
        self.at_rest: dict[tuple[float, bool], np.ndarray] = {}

    def grips(self, trial: Trial, t: np.ndarray) -> np.ndarray:
        """Where the held nodes are (K, G, 3) [m]."""
        if self.skirt:
            return waist(self.mesh.material[self.held, 0], trial.separation) + trial.offset(t)[:, :1]
        return hold(trial.separation) + trial.offset(t)

    def rest(self, trial: Trial) -> np.ndarray:
        """The shape at rest (N, 3) [m]; of a calmer fabric, since it is the same and there sooner."""
        at_rest = (trial.separation, trial.has_body)
        if at_rest not in self.at_rest:
            start = self._hung(trial)
            first, last = start[self.held], self.grips(trial, np.zeros(1))[0]

            def lower(t: np.ndarray) -> np.ndarray:
                s = np.clip(t / 0.5, 0.0, 1.0)[:, None, None]
                return first + s**2 * (3.0 - 2.0 * s) * (last - first)

            step = stable_step(self.calm, self.mesh)
            calm = discretise(self.calm, self.mesh)
            spheres = self.spheres(trial)
            self.at_rest[at_rest] = settle(calm, start, self.held, lower, step, at_rest=5e-4, spheres=spheres)
        return self.at_rest[at_rest]

    def _hung(self, trial: Trial) -> np.ndarray:
        """A shape without strain to begin from, (N, 3) [m]."""
        if self.skirt:
            return waist(self.mesh.material[:, 0], 1.0) - np.outer(self.mesh.material[:, 1], [0.0, 0.0, 1.0])
        return bowed(self.mesh, SIDE, trial.separation * SIDE) + np.array([0.0, 0.0, HEIGHT])

    def run(self, trial: Trial, times: np.ndarray) -> np.ndarray:
        """True positions of all nodes at `times`, (T, N, 3) [m]."""
        start = self.rest(trial)
        if trial.offset is still:
            return np.broadcast_to(start, (len(times), *start.shape))
        state = State(start, np.zeros_like(start))
        path = lambda t: self.grips(trial, t)  # noqa: E731
        return simulate(self.sheet, state, self.held, path, times, self.step, True, self.spheres(trial))[0]

    def spheres(self, trial: Trial) -> np.ndarray:
        """The hips as the reference takes them, (2, 5): centre against the grips' mean and radius [m], friction."""
        if not trial.has_body:
            return NO_SPHERES
        away = hips(trial.separation) - self.grips(trial, np.zeros(1))[0].mean(axis=0)
        return np.column_stack([away, np.full(len(away), HIP), np.full(len(away), HIP_FRICTION)])


def markers(size: tuple[float, float] = (SIDE, SIDE)) -> np.ndarray:
    """The tracked lattice over the whole cloth, (M, 2) [m]; 9 × 9 on a swatch."""
    u, v = (np.linspace(0.0, length, round(length / SPACING) + 1) for length in size)
    return np.array([(a, b) for b in v for a in u])


def frame_times(trial: Trial) -> np.ndarray:
    return np.arange(round(trial.duration * trial.rate)) / trial.rate


def rig(skirt: bool) -> tuple[Camera, Projector]:
    """A camera in front of the cloth and a projector above it: stripes some 6 px apart on an upright sheet."""
    size, across, far = ((144, 168), 0.50, 1.4) if skirt else ((120, 128), 0.40, 1.2)
    target = np.array([0.0, 0.0, HEIGHT - 0.16 - 0.02 * skirt])
    camera = Camera.looking_at(target - [0.0, far, 0.0], target, size, across)
    lens = Camera.looking_at(target - [0.0, far, -0.7 * far], target, (800, 800), 0.8)
    return camera, Projector(lens, 6.0 * across / size[0] * 1000 * math.cos(math.atan(0.7)))


def filmed(bench: Bench, frames: np.ndarray, random: np.random.Generator) -> Video:
    """What the camera saw of nodes (T, N, 3) m: the reference's own mesh, not the tracked points."""
    mesh = bench.mesh
    rows = [range(mesh.row_start[j], mesh.row_start[j + 1]) for j in range(0, len(mesh.row_start) - 1, 2)]
    whole = np.concatenate([np.array(row) for row in rows])
    camera, projector = rig(bench.skirt)
    image, _ = striped(camera, projector, surface_of(mesh.material[whole], 3), frames[:, whole])
    step = 256 // GREY_LEVELS
    return Video(expose(image, random, IMAGE_NOISE) // step * step, camera, projector)


def measure(name: str, truth: np.ndarray, grips: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the simulated tracker sees of markers and grips; the noise is seeded by the recording's name."""
    random = seeded(name)
    seen = truth + random.normal(0.0, MARKER_NOISE, truth.shape)
    seen[random.random(truth.shape[:2]) < DROPOUT] = np.nan
    felt = grips + random.normal(0.0, GRIP_NOISE, grips.shape)
    return np.round(seen / RESOLUTION) * RESOLUTION, np.round(felt / RESOLUTION) * RESOLUTION


def seeded(name: str) -> np.random.Generator:
    return np.random.default_rng(zlib.crc32(name.encode()))


def record(fabric: str, trial: Trial, bench: Bench | None = None) -> Recording:
    """Run one trial of one fabric and measure it."""
    made, truth = fabric_of(fabric, trial.experiment)
    bench = bench or Bench(made, trial.is_skirt)
    name, frames = f"{fabric}/{trial.name}", bench.run(trial, frame_times(trial))
    points = markers(bench.size)
    seen = np.einsum("mn,tnd->tmd", tracking_weights(bench.mesh, points), frames)
    grip_time = np.arange(round(trial.duration * 100.0) + 1) / 100.0
    few = bench.held[::2] if bench.skirt else bench.held  # a waistband is tracked at every second node
    grips = bench.grips(trial, grip_time)[:, ::2] if bench.skirt else bench.grips(trial, grip_time)
    position, grip_position = measure(name, seen, grips)
    notes = {f"truth_{key}": f"{value:g}" for key, value in truth.items()}
    return Recording(
        name=name, fabric=fabric, split=trial.split, motion=trial.motion,
        time=frame_times(trial), material=points, position=position,
        grip_time=grip_time, grip_material=bench.mesh.material[few], grip_position=grip_position,
        cloth_width=bench.size[0], cloth_height=bench.size[1], areal_density=made.areal_density,
        noise_sigma=MARKER_NOISE, video=filmed(bench, frames, seeded(f"{name} video")),
        sensor=f"simulated marker tracking, {trial.rate:g} Hz, {1e3 * MARKER_NOISE:.1f} mm noise; simulated camera",
        source="clothbench reference simulation (tools/make_static_dynamic.py)", licence="CC0-1.0",
        declared_effects="gravity,elasticity,bending,damping,quadratic_drag,drag_crisis,linear_drag",
        obstacles=body_of(trial), notes={"experiment": trial.experiment, **notes},
    )  # fmt: skip


def body_of(trial: Trial) -> tuple[Obstacle, ...] | None:
    """What the recording states of the body in a skirt."""
    if not trial.has_body:
        return None
    places = [(float(x), float(y), float(z)) for x, y, z in hips(trial.separation)]
    return tuple(Obstacle("sphere", place, radius=HIP, friction=HIP_FRICTION, carried=True) for place in places)


def make_all(fabrics: list[str], names: list[str] | None = None) -> None:
    """Write every recording (or those of the trials named) and print one line for each."""
    print(f"{'recording':<20}{'split':<10}{'frames':>7}{'kB':>6}{'s':>6}  hash")
    for fabric in fabrics:
        benches: dict[tuple[str, bool], Bench] = {}
        for trial in (trial for trial in TRIALS if names is None or trial.name in names):
            began, kind = time.perf_counter(), (trial.experiment, trial.is_skirt)
            if kind not in benches:
                benches[kind] = Bench(fabric_of(fabric, trial.experiment)[0], trial.is_skirt)
            recording = record(fabric, trial, benches[kind])
            path = write_recording(recording, trial.folder / f"{fabric}-{trial.name}.nc")
            spent, size = time.perf_counter() - began, path.stat().st_size / 1e3
            line = f"{recording.name:<20}{trial.split:<10}{len(recording.time):>7}{size:>6.0f}{spent:>6.0f}"
            print(f"{line}  {recording.hash[:12]}", flush=True)


def check_convergence(names: list[str], fabrics: list[str]) -> None:
    """Named trials on this mesh and on one twice as fine in space and time: change of the markers [mm]."""
    for fabric in fabrics:
        for trial in (trial for trial in TRIALS if trial.name in names):
            made = fabric_of(fabric, trial.experiment)[0]
            runs = []
            for bench in (Bench(made, trial.is_skirt, finer) for finer in (1.0, 2.0)):
                weights = tracking_weights(bench.mesh, markers(bench.size))
                runs.append(np.einsum("mn,tnd->tmd", weights, bench.run(trial, frame_times(trial))))
            change = 1e3 * np.linalg.norm(runs[1] - runs[0], axis=2)
            mean, high, rest = change.mean(), np.percentile(change, 95), change[0].mean()
            spread = f"mean {mean:.2f}, 95 % {high:.2f}, max {change.max():.2f}, at rest {rest:.2f} mm"
            print(f"{fabric}/{trial.name}: {spread}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description="Make the stand-in recordings of the suite static_dynamic.")
    parser.add_argument("fabrics", nargs="*", metavar="FABRIC", help=f"of {', '.join(FABRICS)} (default: all)")
    parser.add_argument("--trials", nargs="+", metavar="TRIAL", help="only these")
    parser.add_argument("--convergence", nargs="+", metavar="TRIAL", help="check the mesh on these trials")
    options = parser.parse_args()
    fabrics = options.fabrics or list(FABRICS)
    if options.convergence:
        check_convergence(options.convergence, fabrics)
    else:
        make_all(fabrics, options.trials)


if __name__ == "__main__":
    main()
