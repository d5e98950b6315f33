"""Whether `clothbench suggest` keeps what it promises: `python tools/suggest_cases.py [--cases 0-11] [--cameras]`.

In every case the reference simulation (finite elements on another mesh than any model's, explicit steps, noise) moves a
piece of cloth in a poor experiment: it hangs still, or swings a little. The model is fitted to that, the best
experiment that is suggested is made with the same cloth, and the model is fitted to both. Cases with even numbers ask
about the parameters; those with odd ones tie `quadratic_drag`, which is in the cloth, with `linear_drag`. With cameras
the experiment is seen by one alone, first from the best place, then from the worst that sees half of the points; with
pictures the poor experiment was seen by one camera alone, too.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clothbench.core.camera import Camera
from clothbench.core.parallel import set_thread_count
from clothbench.core.scene import Scene
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.nodes import Recording, write_recording
from clothbench.reference.mesh import Mesh, build, tracking_weights
from clothbench.reference.simulation import Fabric, State, bowed, discretise, settle, simulate, stable_step
from clothbench.studies.improve.problem import Problem
from clothbench.suggest.cameras import placed, seen_from
from clothbench.suggest.document import name_of
from clothbench.suggest.experiments import experiments
from clothbench.suggest.ranking import Promise, promises, ranked
from clothbench.suggest.settings import PLACEMENTS, Sensor, Wanted
from clothbench.suggest.subject import Subject, searched, subject_of, tie_of

NOISE, RATE = 1e-3, 30.0  # m, Hz
TIED = ("quadratic_drag", "linear_drag")
# What the reference can do: its grips are nodes, and there is no table.
CHOSEN = [
    ("as recorded", "hold still"), ("as recorded", "swing across the sheet, 1 Hz"),
    ("as recorded", "swing across the sheet, 0.5 Hz"), ("upper edge", "swing across the sheet, 1 Hz"),
    ("upper edge", "swing across the sheet, 2 Hz"),
]  # fmt: skip


@dataclass(frozen=True)
class Cloth:
    """What is planted. cells: of the reference mesh along the width."""

    fabric: Fabric
    width: float
    height: float
    cells: int

    @classmethod
    def drawn(cls, case: int, cells: int = 12) -> Cloth:
        """Even cases: damping of all motion alike; odd ones: air drag that grows with the square of the velocity."""
        random = np.random.default_rng([case, 26])
        warp, weft, side = random.uniform(300, 600), random.uniform(300, 600), random.uniform(0.26, 0.34)
        fabric = Fabric(
            f"suggest-{case:02d}", random.uniform(0.14, 0.24), warp, weft, 0.2 * min(warp, weft),
            random.uniform(0.2, 0.3) * min(warp, weft), random.uniform(1.5e-5, 4e-5), 4e-5, 4e-5, 1e-3,
        )  # fmt: skip
        size = random.uniform(0.5, 1.5)
        air = {"normal_drag": size, "tangential_drag": 0.02} if case % 2 else {"mass_damping": size}
        return cls(dataclasses.replace(fabric, **air), side, side * random.uniform(0.85, 1.15), cells)

    @property
    def truth(self) -> dict[str, float]:
        """Of parameters that mean the same to model and cloth; b = α ρ."""
        if self.fabric.normal_drag:
            return {"quadratic_drag.normal": self.fabric.normal_drag}
        return {"linear_drag.coefficient": self.fabric.mass_damping * self.fabric.areal_density}

    @property
    def mesh(self) -> Mesh:
        rows = 2 * round(1.155 * self.cells * self.height / self.width / 2)
        return build(self.width, self.height, self.cells, rows)

    def recorded(self, scene: Scene, name: str, random: np.random.Generator, noise: float = NOISE) -> Recording:
        """The scene as the reference simulation has it, with noise; its grips must be nodes of the mesh."""
        mesh = self.mesh
        sheet = discretise(self.fabric, mesh, scene.gravity)
        step = stable_step(self.fabric, mesh, 0.6)
        away = np.linalg.norm(mesh.material[None] - scene.grip_material[:, None], axis=2)
        assert away.min(axis=1).max() < 1e-6
        held = away.argmin(axis=1)
        home = scene.grip_position[0]
        across = np.ptp(home[:, 0]) if len(home) > 1 else self.width
        start = bowed(mesh, self.width, min(across, 0.9999 * self.width))
        start = start + home.mean(axis=0) - start[held].mean(axis=0)

        def hang(time: np.ndarray) -> np.ndarray:
            s = np.clip(time / 0.5, 0.0, 1.0)[:, None, None]
            return start[held] + s**2 * (3 - 2 * s) * (home - start[held])

        rest = settle(sheet, start, held, hang, step, at_rest=1e-3)
        frames, _ = simulate(sheet, State(rest, np.zeros_like(rest)), held, scene.grips_at, scene.times, step)
        truth = np.einsum("mn,tnd->tmd", tracking_weights(mesh, scene.points), frames)
        return Recording(
            name=name, fabric=self.fabric.name, split="fit", time=scene.times, material=scene.points,
            position=truth + random.normal(0.0, noise, truth.shape), grip_time=scene.grip_time,
            grip_material=scene.grip_material, grip_position=scene.grip_position, cloth_width=self.width,
            cloth_height=self.height, areal_density=self.fabric.areal_density, noise_sigma=noise,
        )  # fmt: skip

    def poor(self, amplitude: float, seconds: float, rate: float = 0.7) -> Scene:
        """Held at two corners and swung a little across the sheet, or (0 m) held still."""
        clock = np.arange(round(100 * seconds) + 1) / 100
        half = 0.495 * self.width
        home = np.array([[-half, 0.0, 1.0], [half, 0.0, 1.0]])
        rise = np.clip(clock / 0.6, 0.0, 1.0)
        moved = amplitude * rise**3 * (10 - 15 * rise + 6 * rise**2) * np.sin(2 * np.pi * rate * clock)
        mesh = self.mesh
        u, v = np.meshgrid(np.linspace(0, self.width, 7), mesh.material[mesh.row_start[:-1], 1][::2])
        return Scene(
            self.width, self.height, self.fabric.areal_density, clock, np.array([[0.0, 0.0], [self.width, 0.0]]),
            home + moved[:, None, None] * [0.0, 1.0, 0.0], np.arange(round(seconds * RATE)) / RATE,
            np.stack([u.ravel(), v.ravel()], axis=1),
        )  # fmt: skip


@dataclass(frozen=True)
class Kept:
    """What was promised and what came of it. factors: by parameter, (promised, kept, half-width before and after in
    scaled ranges); inside: by parameter whose truth is known, whether its interval holds it, before and after; sigma:
    (now, promised, kept) of the tie, or None.
    """

    experiment: str
    factors: dict[str, tuple[float, float, float, float]]
    inside: dict[str, tuple[bool, bool]]
    sigma: tuple[float, float, float] | None


def kept(
    cloth: Cloth, problem_of, wanted: Wanted, chosen: Sequence[tuple[str, str]], poor: Sequence[Scene], tied: bool,
    pictures: bool = False,
) -> list[Kept]:  # fmt: skip
    """Fit, suggest, do what is suggested, fit again; where cameras are asked for, with the best of them and the worst.
    problem_of: recordings → their problem; pictures: whether the poor experiments, too, were seen by one camera alone.
    """
    random = np.random.default_rng(7)
    recordings = [
        cloth.recorded(scene, f"poor-{k}", random, 0.0 if pictures else NOISE) for k, scene in enumerate(poor)
    ]
    if pictures:
        aside = dataclasses.replace(wanted, cameras=("three-quarter",))
        for k, scene in enumerate(poor):
            (view,) = placed(scene, scene, recordings[k].position, aside)
            recordings[k] = pictured(recordings[k], scene, view.camera, wanted.camera, random)
    names = TIED[:1] if tied else ()
    subject = subject_of(problem_of(recordings), names, [TIED] if tied else [])
    found, _ = promises(subject, list(experiments(subject.like.scene, RATE, wanted, False, chosen)), wanted)
    best = ranked(subject, found, wanted.rank)[0]
    scene = best.experiment.lasting(best.duration)
    if not wanted.cameras:
        done = cloth.recorded(scene, "suggested", random)
        return [held_against(cloth, subject, best, problem_of([*recordings, done]))]
    out, truth = [], cloth.recorded(scene, "suggested", random, noise=0.0)
    for seen in (best.views[0], [one for one in best.views if one.view.seen.mean() > 0.5][-1]):
        done = pictured(truth, scene, seen.view.camera, wanted.camera, random)
        out.append(held_against(cloth, subject, seen, problem_of([*recordings, done])))
    return out


def pictured(truth: Recording, scene: Scene, camera: Camera, sensor: Sensor, random: np.random.Generator) -> Recording:
    """A recording without noise as one colour camera has it: places on lines of sight, where it sees the points."""
    metres = sensor.noise * camera.in_view(truth.position)[..., 2:] / camera.matrix[0, 0]  # that the noise is there
    seen = seen_from(camera, scene, truth.position)
    place = truth.position + metres * random.normal(size=(*seen.shape, 2)) @ camera.rotation[:2]
    return dataclasses.replace(
        truth, position=np.where(seen[..., None], place, np.nan), sight=camera,
        noise_sigma=float(metres.mean()),
    )  # fmt: skip


def held_against(cloth: Cloth, subject: Subject, best: Promise, both: Problem) -> Kept:
    """A promise beside the fit to all recordings."""

    def again(known, names):
        values = dict(zip(known.fitted.space.names, known.fitted.theta.tolist(), strict=True))
        return searched(both, names, values)

    before, after = subject.known, again(subject.known, subject.known.fitted.effects)
    space, now, then = before.fitted.space, before.half, after.half
    factors = {
        name: (float(now[k] / best.after[k]), float(now[k] / then[k]), float(now[k]), float(then[k]))
        for k, name in enumerate(space.names)
    }
    inside, truth = {}, space.to_unit(np.array([cloth.truth.get(p.name, p.default) for p in space]))
    for name in cloth.truth:
        k = space.names.index(name)
        inside[name] = tuple(bool(abs(truth[k] - o.unit[k]) < h[k]) for o, h in ((before, now), (after, then)))
    sigma = None
    for tie, apart in zip(subject.ties, best.apart, strict=True):
        sigma = (tie.now, apart.sigma, tie_of(*TIED, after, again(tie.rival, TIED[1:])).now)
    experiment = name_of(best) + (f", seen from {best.view.name}" if best.view else "")
    return Kept(experiment, factors, inside, sigma)


def problem_in(folder: Path, resolution: int):
    """Writes recordings into a folder and reads them as a problem, as the command does."""
    from clothbench.cli.improve import settings_of
    from clothbench.suggest.source import problem_of_settings

    def problem_of(recordings: Sequence[Recording], base: str = "") -> Problem:
        place = Path(tempfile.mkdtemp(dir=folder))
        for recording in recordings:
            write_recording(recording, place / f"{recording.name}.nc")
        words = [f"recordings={place}", "model=mass_spring", f"resolution={resolution}", f"base={base}"]
        words.append(f"out={folder}")
        return problem_of_settings(settings_of(words), catalogue(), folder)

    return problem_of


def case_of(
    number: int, folder: Path, resolution: int = 9, cameras: tuple[str, ...] | None = None, pictures: bool = False
) -> list[Kept]:
    cloth, tied = Cloth.drawn(number), bool(number % 2)
    problem_of = problem_in(folder, resolution)
    base = "" if tied else "linear_drag"
    swings = [cloth.poor(0.02, 1.0), cloth.poor(0.015, 1.0, 1.0)]
    poor = swings if number % 4 else [cloth.poor(0.0, 1.0)] * 2
    wanted = Wanted(durations=(2.0,), draws=2, cameras=cameras)
    return kept(cloth, lambda r: problem_of(r, base), wanted, CHOSEN, poor, tied, pictures)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--cases", default="0-7", help="numbers, as 0-7 or 3,5")
    arguments.add_argument(
        "--cameras", action="store_true", help="seen by one camera, from the best place and the worst"
    )
    arguments.add_argument(
        "--pictures", action="store_true", help="the same, and the poor experiment seen by one camera, too"
    )
    given = arguments.parse_args()
    cameras = tuple(PLACEMENTS) if given.cameras or given.pictures else None
    ends = [part.split("-") for part in given.cases.split(",")]
    set_thread_count(0)
    for number in [n for first, *last in ends for n in range(int(first), int((last or [first])[-1]) + 1)]:
        with tempfile.TemporaryDirectory() as folder:
            rows = case_of(number, Path(folder), cameras=cameras, pictures=given.pictures)
        for row in rows:
            say(number, row)
        print(f"     {time.process_time():.0f} s of CPU so far", flush=True)


def say(number: int, row: Kept) -> None:
    print(f"{number:2d} {row.experiment}")
    for name, (promised, came, now, then) in row.factors.items():
        inside = "".join(f"   truth inside: {a}, {b}" for a, b in [row.inside[name]]) if name in row.inside else ""
        print(f"     {name:24s} promised ÷ {promised:5.2f}  kept ÷ {came:5.2f}   ({now:.3f} → {then:.3f}){inside}")
    if row.sigma:
        print("     tie: now {:.1f} σ, promised {:.1f} σ, kept {:.1f} σ".format(*row.sigma))


if __name__ == "__main__":
    main()
