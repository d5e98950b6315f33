"""Makes the stand-in recordings of the suite `static_dynamic`: `python tools/make_static_dynamic.py`.

The protocol is the calibration set-up of Bhat et al., "Estimating cloth simulation parameters from video"
(SCA 2003): a swatch hangs from its two top corners, in `static` trials held still at two separations, in
`waving` trials with corners moved. The truth comes from the reference simulation beside this file.

On a mesh 1.5 times finer in space and time (`--convergence waving-1 waving-2 waving-3`) the markers of satin's
waving trials move by 0.5–0.6 mm on average (95 %: 1.5–2.1 mm, at rest 0.2 mm), which is below the marker noise;
linen's by 0.1 mm. Single markers of satin differ by up to 20 mm for a moment. Wider swings (60 mm at 1 Hz) make
the light fabric's folds flip, and meshes no longer agree (mean 2–4 mm). The files come out the same bit for bit
on one machine; on another processor the last digit of the tracker (8 µm) may differ.
"""

from __future__ import annotations

import argparse
import time
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from reference_mesh import Mesh, build, tracking_weights
from reference_simulation import Fabric, State, bowed, discretise, settle, simulate, stable_step

from clothbench.recording import Recording, write_recording

FOLDER = Path(__file__).resolve().parent.parent / "suites" / "embedded" / "static_dynamic"
SIDE = 0.30  # m, the swatch is square
COLUMNS, ROWS = 28, 32  # 10.7 mm × 9.4 mm: nearly equilateral
HEIGHT = 1.0  # m, of the grips above the floor
TILT = 0.003  # m, the right grip hangs lower: an even hold leaves the mirror branch to rounding errors
MARKER_NOISE, GRIP_NOISE, DROPOUT = 1.0e-3, 0.05e-3, 0.01
RESOLUTION = 2.0**-17  # m; what the simulated tracker resolves (8 µm), exact in float32, and compresses well

FABRICS = (
    Fabric("satin", 0.11, 600.0, 450.0, 80.0, 30.0, 1.2e-5, 1.5e-5, 5e-4, 4e-3, 0.10, 1.0, 0.03),
    Fabric("linen", 0.22, 900.0, 750.0, 100.0, 60.0, 1.0e-4, 1.5e-5, 5e-4, 2e-3, 0.15, 1.1, 0.03),
)


@dataclass(frozen=True)
class Trial:
    """One run. `offset` says how far the left and the right corner have moved: (K,) s -> (K, 2, 3) m."""

    name: str
    split: str
    separation: float  # of the corners, over the width
    duration: float  # s
    rate: float  # frames per second
    motion: str
    offset: Callable[[np.ndarray], np.ndarray]


def swing(t: np.ndarray, amplitude: float, frequency: float, ramp: float = 0.6) -> np.ndarray:
    """A sine [m] whose amplitude grows from nothing within `ramp` [s], to start smoothly from rest."""
    s = np.clip(t / ramp, 0.0, 1.0)
    return amplitude * s**3 * (10.0 - 15.0 * s + 6.0 * s**2) * np.sin(2.0 * np.pi * frequency * t)


def still(t: np.ndarray) -> np.ndarray:
    return np.zeros((len(t), 2, 3))


def one_corner(t: np.ndarray) -> np.ndarray:
    offset = still(t)
    offset[:, 1, 1] = swing(t, 0.045, 0.8)
    return offset


def both_corners(t: np.ndarray) -> np.ndarray:
    offset = still(t)
    offset[:, :, 1] = swing(t, 0.025, 0.9)[:, None]
    return offset


def crossed_corners(t: np.ndarray) -> np.ndarray:
    offset = still(t)
    offset[:, 0, 1] = swing(t, 0.035, 1.0)
    offset[:, 1, 2] = swing(t, 0.02, 0.7)
    return offset


TRIALS = (
    Trial("static-1", "fit", 0.95, 1.0, 10.0, "top corners held still at 0.95 of the width", still),
    Trial("static-2", "held_out", 0.70, 1.0, 10.0, "top corners held still at 0.70 of the width", still),
    Trial("waving-1", "fit", 0.90, 3.0, 30.0, "right corner to and fro, 45 mm at 0.8 Hz", one_corner),
    Trial("waving-2", "held_out", 0.90, 3.0, 30.0, "both corners to and fro, 25 mm at 0.9 Hz", both_corners),
    Trial(
        "waving-3", "held_out", 0.90, 3.0, 30.0,
        "left corner to and fro, 35 mm at 1.0 Hz; right corner up and down, 20 mm at 0.7 Hz", crossed_corners,
    ),
)  # fmt: skip


def hold(separation: float) -> np.ndarray:
    """The two grips at the start of a trial [m], (2, 3)."""
    half = 0.5 * separation * SIDE
    return np.array([[-half, 0.0, HEIGHT], [half, 0.0, HEIGHT - TILT]])


class Bench:
    """One fabric on one mesh, hung up and run; the shape at rest is kept per separation."""

    def __init__(self, fabric: Fabric, columns: int = COLUMNS, rows: int = ROWS) -> None:
        self.mesh: Mesh = build(SIDE, SIDE, columns, rows)
        self.sheet, self.step = discretise(fabric, self.mesh), stable_step(fabric, self.mesh)
        self.held = np.array([0, columns])
        self.at_rest: dict[float, np.ndarray] = {}

    def rest(self, separation: float) -> np.ndarray:
        if separation not in self.at_rest:
            start = bowed(self.mesh, SIDE, separation * SIDE) + np.array([0.0, 0.0, HEIGHT])
            first, last = start[self.held], hold(separation)

            def lower(t: np.ndarray) -> np.ndarray:
                s = np.clip(t / 0.5, 0.0, 1.0)[:, None, None]
                return first + s**2 * (3.0 - 2.0 * s) * (last - first)

            self.at_rest[separation] = settle(self.sheet, start, self.held, lower, self.step)
        return self.at_rest[separation]

    def run(self, trial: Trial, times: np.ndarray) -> np.ndarray:
        """True positions of the tracked points at `times`, (T, M, 3) [m]."""
        start = self.rest(trial.separation)
        state = State(start, np.zeros_like(start))
        grips = hold(trial.separation)
        frames, _ = simulate(self.sheet, state, self.held, lambda t: grips + trial.offset(t), times, self.step)
        return np.einsum("mn,tnd->tmd", tracking_weights(self.mesh, markers()), frames)


def markers() -> np.ndarray:
    """The tracked lattice, 9 × 9 over the whole swatch, (81, 2) [m]."""
    line = np.linspace(0.0, SIDE, 9)
    return np.array([(u, v) for v in line for u in line])


def frame_times(trial: Trial) -> np.ndarray:
    return np.arange(round(trial.duration * trial.rate)) / trial.rate


def measure(name: str, truth: np.ndarray, grips: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the simulated tracker sees of markers and grips; the noise is seeded by the recording's name."""
    random = np.random.default_rng(zlib.crc32(name.encode()))
    seen = truth + random.normal(0.0, MARKER_NOISE, truth.shape)
    seen[random.random(truth.shape[:2]) < DROPOUT] = np.nan
    felt = grips + random.normal(0.0, GRIP_NOISE, grips.shape)
    return np.round(seen / RESOLUTION) * RESOLUTION, np.round(felt / RESOLUTION) * RESOLUTION


def record(fabric: Fabric, trial: Trial, bench: Bench) -> Recording:
    """Run one trial of one fabric and measure it."""
    name, times = f"{fabric.name}/{trial.name}", frame_times(trial)
    grip_time = np.arange(round(trial.duration * 100.0) + 1) / 100.0
    grips = hold(trial.separation) + trial.offset(grip_time)
    position, grip_position = measure(name, bench.run(trial, times), grips)
    truth = {f"truth_{key}": f"{value:g}" for key, value in asdict(fabric).items() if key != "name"}
    return Recording(
        name=name, fabric=fabric.name, split=trial.split, motion=trial.motion,
        time=times, material=markers(), position=position,
        grip_time=grip_time, grip_material=np.array([[0.0, 0.0], [SIDE, 0.0]]), grip_position=grip_position,
        cloth_width=SIDE, cloth_height=SIDE, areal_density=fabric.areal_density, noise_sigma=MARKER_NOISE,
        sensor=f"simulated marker tracking, {trial.rate:g} Hz, {1e3 * MARKER_NOISE:.1f} mm noise",
        source="clothbench reference simulation (tools/make_static_dynamic.py)", licence="CC0-1.0",
        declared_effects="gravity,elasticity,bending,damping,quadratic_drag", notes=truth,
    )  # fmt: skip


def make_all() -> None:
    """Write every recording and print one line for each."""
    print(f"{'recording':<16}{'split':<10}{'frames':>7}{'kB':>6}{'s':>6}  hash")
    for fabric in FABRICS:
        bench = Bench(fabric)
        for trial in TRIALS:
            began = time.perf_counter()
            recording = record(fabric, trial, bench)
            path = write_recording(recording, FOLDER / f"{fabric.name}-{trial.name}.nc")
            spent, size = time.perf_counter() - began, path.stat().st_size / 1e3
            line = f"{recording.name:<16}{trial.split:<10}{len(recording.time):>7}{size:>6.0f}{spent:>6.0f}"
            print(f"{line}  {recording.hash[:12]}", flush=True)


def check_convergence(names: list[str]) -> None:
    """Named trials on this mesh and on one 1.5 times finer in space and time: change of the markers [mm]."""
    for fabric in FABRICS:
        benches = [Bench(fabric), Bench(fabric, COLUMNS * 3 // 2, ROWS * 3 // 2)]
        for trial in (trial for trial in TRIALS if trial.name in names):
            coarse, fine = (bench.run(trial, frame_times(trial)) for bench in benches)
            change = 1e3 * np.linalg.norm(fine - coarse, axis=2)
            mean, high, rest = change.mean(), np.percentile(change, 95), change[0].mean()
            spread = f"mean {mean:.2f}, 95 % {high:.2f}, max {change.max():.2f}, at rest {rest:.2f} mm"
            print(f"{fabric.name}/{trial.name}: {spread}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description="Make the stand-in recordings of the suite static_dynamic.")
    parser.add_argument("--convergence", nargs="+", metavar="TRIAL", help="check the mesh on these trials")
    wanted = parser.parse_args().convergence
    if wanted:
        check_convergence(wanted)
    else:
        make_all()


if __name__ == "__main__":
    main()
