"""The loop's own blind test: `python tools/blind_test.py --out FOLDER [--cases 0-5,26] [--model NAME] [--keep]`.

Every case is a piece of cloth that the reference simulation beside this file moves (finite elements on another mesh
than any model's, explicit steps, noise, dropouts), with something in it that its recordings do not say. `clothbench
improve` sees the recordings only; its verdict is then held against what was planted. Cases 0–5 hold nothing beyond
elasticity, gravity and damping; 6–25 one effect each out of ten, drawn by the case's number; 26–27 two at once; 28–31
something that no effect of the library describes; 32–39 one effect whose amounts are other ones in each recording;
40–51 two or three effects at once; 52–63 are judged with other models than springs: nothing, one effect, two, and
something that has no name. `--seed N` makes other ones of the same kinds, which nothing was ever tuned to.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from clothbench.recordings.nodes import Recording, write_recording
from clothbench.reference.kernels import Sheet
from clothbench.reference.mesh import Mesh, build, tracking_weights
from clothbench.reference.simulation import Fabric, State, bowed, discretise, settle, simulate, stable_step
from clothbench.studies.improve.settings import LOOP

NOISE, GRIP_NOISE, DROPOUT = 1e-3, 1e-4, 0.01
HEIGHT, RATE = 1.0, 30.0  # m, Hz
SEED = 4  # of the cases whose verdicts are kept in results/
NONE, ONE, TWO, UNKNOWN = range(6), range(6, 26), range(26, 28), range(28, 32)
VARYING, SEVERAL, OTHER_MODELS = range(32, 40), range(40, 52), range(52, 64)
WORTH = {"ok": "", "open": " (open)", "missed": " (missed)", "alarm": " (false alarm)", "FALSE": " (false)"}
RESULTS = Path(__file__).resolve().parent.parent / "results" / "blind_test.json"


@dataclass(frozen=True)
class Size:
    """How much of everything: cells of the reference mesh along the width, seconds, splits of the recordings, and what
    else the command is told."""

    cells: int
    seconds: float
    split: tuple[str, ...]
    words: tuple[str, ...] = ()


FULL = Size(16, 2.5, ("fit",) * 4 + ("held_out",) * 2)


@dataclass
class World:
    """One cloth and everything about it that a planted effect may change."""

    fabric: Fabric
    width: float
    height: float
    gravity: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))
    wind: np.ndarray = field(default_factory=lambda: np.zeros(3))
    added_mass: list[Callable[[np.ndarray, np.ndarray], np.ndarray]] = field(default_factory=list)  # (uv, area) → kg
    stiffer: Callable[[np.ndarray], np.ndarray] | None = None  # factor on the rigidity of hinges, by their middle
    grips: Callable[[np.ndarray, np.ndarray], np.ndarray] = lambda time, position: position
    clock: Callable[[np.ndarray], np.ndarray] = lambda time: time  # when the cloth was as a stamp shows it
    seen: Callable[[np.ndarray, np.ndarray], np.ndarray] = lambda time, position: position
    planted: dict[str, dict[str, float]] = field(default_factory=dict)
    anew: list[Callable[[World, np.random.Generator], object]] = field(default_factory=list)  # before each recording


Plants = Sequence[Callable[[World, np.random.Generator], dict[str, float]]]

# --- what can be planted: each changes the world and notes what it did -----------------------------------------------


def quadratic_drag(world: World, random: np.random.Generator) -> dict[str, float]:
    normal = random.uniform(0.8, 1.5)
    world.fabric = dataclasses.replace(world.fabric, normal_drag=normal, tangential_drag=0.02)
    return {"normal": normal}


def steady_wind(world: World, random: np.random.Generator) -> dict[str, float]:
    # Not along the sheet, where wind hardly pushes.
    angle, side = random.uniform(np.pi / 6, 5 * np.pi / 6), random.choice([-1, 1])
    speed, normal = side * random.uniform(0.4, 0.7), random.uniform(0.8, 1.2)
    world.fabric = dataclasses.replace(world.fabric, normal_drag=normal, tangential_drag=0.02)
    world.wind = speed * np.array([np.cos(angle), np.sin(angle), 0.0])
    return {"normal": normal, "wx": world.wind[0], "wy": world.wind[1]}


def heavy_hem(world: World, random: np.random.Generator) -> dict[str, float]:
    width, density = random.uniform(0.012, 0.02), random.uniform(0.4, 0.8)
    world.added_mass.append(lambda uv, area: density * area * hem_share(uv, world, width))
    return {"areal_density": density, "width": width}


def hem_share(uv: np.ndarray, world: World, width: float) -> np.ndarray:
    """Share of a node's area that belongs to the hem, so that the hem's mass is right on any mesh."""
    inside = np.clip((uv[:, 1] - (world.height - width)) / width, 0.0, 1.0) * (uv[:, 1] > world.height - width)
    rows = np.unique(uv[:, 1])
    cell = rows[1] - rows[0]
    on_rows = np.array([np.mean(inside[uv[:, 1] == row]) for row in rows]) * cell * np.where(rows == rows[-1], 0.5, 1.0)
    return inside * width / on_rows.sum()


def point_mass(world: World, random: np.random.Generator) -> dict[str, float]:
    u, v, mass = random.uniform(0.2, 0.8), random.uniform(0.5, 0.95), random.uniform(1.0e-3, 2.5e-3)
    world.added_mass.append(lambda uv, area: spot(uv, u * world.width, v * world.height, mass))
    return {"mass": mass, "u": u, "v": v}


def spot(uv: np.ndarray, u: float, v: float, mass: float) -> np.ndarray:
    """The mass shared out among the three nodes nearest to a point, so that its centre of mass is there."""
    near = np.argsort(np.hypot(*(uv - [u, v]).T))[:3]
    share = np.linalg.solve(np.vstack([uv[near].T, np.ones(3)]), [u, v, 1.0])
    out = np.zeros(len(uv))
    out[near] = mass * np.clip(share, 0.0, 1.0) / np.clip(share, 0.0, 1.0).sum()
    return out


def gravity_tilt(world: World, random: np.random.Generator) -> dict[str, float]:
    about_x = random.choice([-1, 1]) * random.uniform(0.04, 0.1)
    c, s = np.cos(about_x), np.sin(about_x)
    world.gravity = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ world.gravity
    return {"about_x": about_x}


def grip_offset(world: World, random: np.random.Generator) -> dict[str, float]:
    offset = random.choice([-1, 1], 3) * random.uniform(0.003, 0.012, 3)
    world.grips = lambda time, position: position + offset
    return dict(zip(("dx", "dy", "dz"), offset, strict=True))


def grip_slip(world: World, random: np.random.Generator) -> dict[str, float]:
    distance, at = random.uniform(0.01, 0.02), random.uniform(0.8, 1.8)

    def slipped(time: np.ndarray, position: np.ndarray) -> np.ndarray:
        s = np.clip((time - at) / 0.05, 0.0, 1.0)
        return position - distance * (s**2 * (3 - 2 * s))[:, None, None] * [0.0, 0.0, 1.0]

    world.grips = slipped
    return {"distance": distance, "time": at}


def clock_offset(world: World, random: np.random.Generator) -> dict[str, float]:
    delay = random.uniform(0.02, 0.06)
    world.clock = lambda time: time - delay
    return {"delay": delay}


def frame_rotation(world: World, random: np.random.Generator) -> dict[str, float]:
    turn = random.choice([-1, 1]) * random.uniform(0.03, 0.08)
    c, s = np.cos(turn), np.sin(turn)

    def turned(time: np.ndarray, position: np.ndarray) -> np.ndarray:
        middle = position.mean(axis=(0, 1))
        return (position - middle) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + middle

    world.seen = turned
    return {"rz": turn}


def frame_scale(world: World, random: np.random.Generator) -> dict[str, float]:
    ratio = 1 + random.choice([-1, 1]) * random.uniform(0.02, 0.05)

    def scaled(time: np.ndarray, position: np.ndarray) -> np.ndarray:
        middle = position.mean(axis=(0, 1))
        return middle + ratio * (position - middle)

    world.seen = scaled
    return {"ratio": ratio}


# The same with amounts of its own in each recording: only the name is noted.


def each_clock(world: World, random: np.random.Generator) -> dict[str, float]:
    def started(world: World, random: np.random.Generator) -> None:
        delay = random.uniform(-0.06, 0.06)
        world.clock = lambda time: time - delay

    world.anew.append(started)
    return {}


def each_slip(world: World, random: np.random.Generator) -> dict[str, float]:
    """The cloth slips in two runs out of three, each time at another moment."""

    def gripped(world: World, random: np.random.Generator) -> None:
        world.grips = lambda time, position: position
        if random.random() < 2 / 3:
            grip_slip(world, random)

    world.anew.append(gripped)
    return {}


def each_frame(world: World, random: np.random.Generator) -> dict[str, float]:
    world.anew.append(frame_rotation)
    return {}


def each_grip(world: World, random: np.random.Generator) -> dict[str, float]:
    world.anew.append(grip_offset)
    return {}


# Nothing of this is in the library.


def drifting_clock(world: World, random: np.random.Generator) -> dict[str, float]:
    """The camera's clock runs slow, from time to time it is set right again."""
    world.clock = lambda time: time - 0.09 * ((time / 1.1) % 1.0)
    return {}


def swaying_camera(world: World, random: np.random.Generator) -> dict[str, float]:
    rate = random.uniform(1.0, 2.0)
    world.seen = lambda time, position: position + 0.008 * np.sin(2 * np.pi * rate * time)[:, None, None] * [1, 0, 0.5]
    return {}


def stiff_seam(world: World, random: np.random.Generator) -> dict[str, float]:
    middle = random.uniform(0.35, 0.65) * world.width
    world.stiffer = lambda uv: np.where(abs(uv[:, 0] - middle) < 0.04 * world.width, 60.0, 1.0)
    return {}


def wet_half(world: World, random: np.random.Generator) -> dict[str, float]:
    density = 0.6 * world.fabric.areal_density
    world.added_mass.append(lambda uv, area: density * area * (uv[:, 0] < 0.5 * world.width))
    return {}


EFFECTS = (
    quadratic_drag, clock_offset, heavy_hem, steady_wind, frame_rotation, gravity_tilt, point_mass, grip_offset,
    grip_slip, frame_scale,
)  # fmt: skip
NOT_IN_LIBRARY = (drifting_clock, swaying_camera, stiff_seam, wet_half)
EACH = {each_clock: clock_offset, each_slip: grip_slip, each_frame: frame_rotation, each_grip: grip_offset}
AT_ONCE = (
    (heavy_hem, frame_rotation), (steady_wind, clock_offset), (gravity_tilt, frame_scale), (point_mass, clock_offset),
    (quadratic_drag, grip_offset), (grip_slip, heavy_hem), (quadratic_drag, heavy_hem), (steady_wind, frame_scale),
    (heavy_hem, clock_offset, frame_scale), (quadratic_drag, clock_offset, frame_rotation),
    (point_mass, grip_offset, frame_scale), (steady_wind, heavy_hem, clock_offset),
)  # fmt: skip
BY_OTHERS: tuple[tuple[str, Plants], ...] = (
    ("baraff_witkin", ()), ("baraff_witkin", (quadratic_drag,)), ("baraff_witkin", (heavy_hem,)),
    ("baraff_witkin", (clock_offset,)), ("baraff_witkin", (heavy_hem, clock_offset)), ("baraff_witkin", (wet_half,)),
    ("inextensible", ()), ("inextensible", (steady_wind,)), ("inextensible", (grip_offset,)),
    ("[mass_spring,baraff_witkin]", ()), ("[mass_spring,baraff_witkin]", (steady_wind,)),
    ("[mass_spring,baraff_witkin]", (frame_scale,)),
)  # fmt: skip


def drawn(case: int) -> Plants:
    """What a case holds: each of the ten effects comes twice among the twenty, in an order of its own."""
    if case in ONE:
        order = np.random.default_rng(20).permutation(2 * len(EFFECTS))
        return [EFFECTS[order[case - ONE[0]] % len(EFFECTS)]]
    if case in TWO:
        pairs = ((clock_offset, heavy_hem), (quadratic_drag, frame_scale))
        return pairs[case - TWO[0]]
    if case in VARYING:
        return [list(EACH)[(case - VARYING[0]) % len(EACH)]]
    if case in SEVERAL:
        return AT_ONCE[case - SEVERAL[0]]
    if case in OTHER_MODELS:
        return BY_OTHERS[case - OTHER_MODELS[0]][1]
    return [NOT_IN_LIBRARY[case - UNKNOWN[0]]] if case in UNKNOWN else []


# --- making a case ----------------------------------------------------------------------------------------------------


def make(case: int, folder: Path, size: Size = FULL, seed: int = SEED) -> dict[str, dict[str, float]]:
    """Write the recordings of one case below `folder`; returns what was planted, which they do not say."""
    random = np.random.default_rng([case, seed])
    warp, weft, side = random.uniform(400, 700), random.uniform(400, 700), random.uniform(0.26, 0.34)
    fabric = Fabric(
        f"blind-{case:02d}", random.uniform(0.14, 0.24), warp, weft, 0.2 * min(warp, weft),
        random.uniform(0.2, 0.3) * min(warp, weft), random.uniform(1.5e-5, 4e-5), 4e-5, 4e-5, 1e-3,
        random.uniform(1.0, 2.0),
    )  # fmt: skip
    world = World(fabric, side, side * random.uniform(0.85, 1.15))
    for plant in drawn(case):
        world.planted[EACH.get(plant, plant).__name__] = plant(world, random)
    rows = 2 * round(1.155 * size.cells * world.height / world.width / 2)
    mesh = build(world.width, world.height, size.cells, rows)
    sheet = discretise(world.fabric, mesh, tuple(world.gravity))._replace(wind=world.wind)
    area = sheet.mass / world.fabric.areal_density
    for more in world.added_mass:
        sheet = sheet._replace(mass=sheet.mass + more(mesh.material, area))
    if world.stiffer is not None:
        middle = mesh.material[sheet.hinge[:, :2]].mean(axis=1)
        sheet = sheet._replace(hinge_stiffness=sheet.hinge_stiffness * world.stiffer(middle))
    step = stable_step(world.fabric, mesh, 0.6 if world.stiffer is None else 0.2)
    levels = mesh.material[mesh.row_start[:-1], 1][::2]
    points = np.array([(u, v) for v in levels[:: max(1, len(levels) // 8)] for u in np.linspace(0, world.width, 8)])
    hung = Hung(
        world, sheet, step, points, tracking_weights(mesh, points), np.array([0, size.cells]), random.uniform(0.99, 1.0)
    )
    hung.settle(mesh)
    for number, split in enumerate(size.split):
        for happens in world.anew:
            happens(world, random)
            hung.settle(mesh)
        record = measured(hung, f"{fabric.name}/rec-{number + 1:02d}", split, size.seconds, random)
        write_recording(record, folder / f"rec-{number + 1:02d}.nc")
    return world.planted


@dataclass
class Hung:
    """The cloth of one case on its mesh, and how it hangs before it is moved."""

    world: World
    sheet: Sheet
    step: float  # s
    points: np.ndarray  # (M, 2) m, tracked
    weights: np.ndarray  # (M, N), that read them from the nodes
    held: np.ndarray  # the two nodes in the grips
    apart: float  # of the grips, over the width

    @property
    def home(self) -> np.ndarray:
        """Where the grips are said to be before they move (2, 3) m."""
        half = self.apart * self.world.width / 2
        return np.array([[-half, 0.0, HEIGHT], [half, 0.0, HEIGHT - 0.004]])

    def settle(self, mesh: Mesh) -> None:
        """Bow the flat sheet, bring its corners to the grips, and wait."""
        where = self.world.grips(np.zeros(1), self.home[None])[0]
        start = bowed(mesh, self.world.width, self.apart * self.world.width)
        start = start - start[self.held].mean(axis=0) + where.mean(axis=0)

        def lower(time: np.ndarray) -> np.ndarray:
            s = np.clip(time / 0.5, 0.0, 1.0)[:, None, None]
            return start[self.held] + s**2 * (3 - 2 * s) * (where - start[self.held])

        self.rest = settle(self.sheet, start, self.held, lower, self.step, at_rest=1e-3)


def measured(hung: Hung, name: str, split: str, seconds: float, random: np.random.Generator) -> Recording:
    """One run, seen with noise and dropouts."""
    world = hung.world
    # Both corners go together, as on a bar, and across the sheet: one that hangs slack or is shaken folds and flaps,
    # and that is chaos, which no model predicts and which would hide whatever was planted.
    rate, phase = random.uniform(0.5, 1.2, 3), random.uniform(0, 2 * np.pi, 3)
    speed = random.uniform(0.6, 1.0, 3) * [0.03, 0.3, 0.015]  # m/s, the most
    amplitude = random.choice([-1, 1], 3) * speed / (2 * np.pi * rate)

    def told(time: np.ndarray) -> np.ndarray:
        """Where the grips are said to be, (K, 2, 3) m; they rise from rest within 0.6 s."""
        s = np.clip(time / 0.6, 0.0, 1.0)[:, None, None]
        wave = np.sin(2 * np.pi * rate * time[:, None, None] + phase) - np.sin(phase)
        return hung.home + s**3 * (10 - 15 * s + 6 * s**2) * amplitude * wave

    def held_at(time: np.ndarray) -> np.ndarray:
        return world.grips(time, told(time))

    time = np.arange(round(seconds * RATE)) / RATE
    wanted = np.maximum(world.clock(time), 0.0)
    fine = np.unique(np.concatenate([[0.0], wanted]))
    state = State(hung.rest, np.zeros_like(hung.rest))
    frames, _ = simulate(hung.sheet, state, hung.held, held_at, fine, hung.step)
    truth = np.einsum("mn,tnd->tmd", hung.weights, frames)[np.searchsorted(fine, wanted)]
    position = world.seen(time, truth) + random.normal(0.0, NOISE, truth.shape)
    position[random.random(position.shape[:2]) < DROPOUT] = np.nan
    grip_time = np.arange(round(seconds * 100) + 1) / 100.0
    return Recording(
        name=name, fabric=world.fabric.name, split=split, motion="both upper corners to and fro", time=time,
        material=hung.points, position=position, grip_time=grip_time,
        grip_material=np.array([[0.0, 0.0], [world.width, 0.0]]),
        grip_position=told(grip_time) + random.normal(0.0, GRIP_NOISE, (len(grip_time), 2, 3)),
        cloth_width=world.width, cloth_height=world.height, areal_density=world.fabric.areal_density,
        noise_sigma=NOISE, sensor="simulated marker tracking", source="clothbench blind test (tools/blind_test.py)",
        licence="CC0-1.0", declared_effects="gravity,elasticity,bending,damping", notes={},
    )  # fmt: skip


# --- running it and holding the verdict against the truth -------------------------------------------------------------


def judged(planted: dict[str, dict[str, float]], found: dict) -> dict[str, object]:
    """One row of the table: what was planted, what was said, and whether that is a hit, a miss or a false name."""
    sets = [{e["name"], *e["tied_with"]} for e in found["effects"]]
    known = [name for name in planted if name in {f.__name__ for f in EFFECTS}]
    hits = sum(any(name in group for group in sets) for name in known)
    false = sum(not group & set(planted) for group in sets)
    held = found["error_mm"]["held_out"]
    inside = []
    for effect in found["effects"]:
        for name, value in planted.get(effect["name"], {}).items():
            p = effect["parameters"].get(name, {})
            if None not in (p.get("low"), p.get("high")):
                inside.append(bool(p["low"] <= value <= p["high"]))
    return {
        "planted": planted, "verdict": found["verdict"],
        "named": [[e["name"], *e["tied_with"]] for e in found["effects"]],
        "p_value": max((e["p_value"] for e in found["effects"]), default=None),
        "hits": hits, "of": len(known), "false_names": false, "amounts_inside": sum(inside), "amounts": len(inside),
        "right": (hits == len(known) and not false) if planted and known else not sets and (
            found["verdict"] == ("unexplained" if planted else "complete")
        ),
        "fit_mm": [found["error_mm"]["fit"]["before"], found["error_mm"]["fit"]["after"]],
        "held_out_mm": [held["before"], held["after"]], "noise_mm": found["error_mm"]["noise"],
        "mesh_mm": found["error_mm"]["mesh"], "floor_mm": found["error_mm"]["noise_floor"],
        "wall_s": found["wall_s"],
    }  # fmt: skip


def verdict_on(name: str, recordings: Path, model: str, out: Path, *words: str) -> dict:
    """What the installed command says of a folder of recordings, or the end of all, with the case's name."""
    told = ["improve", f"recordings={recordings}", f"model={model}", f"out={out}", *words]
    done = subprocess.run([sys.executable, "-m", "clothbench", *told], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{name}: {done.stderr.strip().splitlines()[-1]}")
    return json.loads((out / "verdict.json").read_text())


def run(case: int, folder: Path, model: str, size: Size = FULL, seed: int = SEED) -> dict[str, object]:
    """Make one case, let the installed command loose on it, and judge what it says."""
    recordings, out = folder / f"case-{case:02d}", folder / f"verdict-{case:02d}-{model.strip('[]').replace(',', '-')}"
    planted_file = folder / f"case-{case:02d}.json"
    if not planted_file.is_file():
        planted_file.write_text(json.dumps(make(case, recordings, size, seed)))
    planted = json.loads(planted_file.read_text())
    # A case that was judged before is kept by the command itself, until the stages have another version.
    return {"case": case, "model": model, "stages": LOOP.stages} | judged(
        planted, verdict_on(f"case {case}", recordings, model, out, *size.words)
    )


def judge_of(case: int) -> str:
    """The model that a case is judged with; several at once in brackets."""
    return BY_OTHERS[case - OTHER_MODELS[0]][0] if case in OTHER_MODELS else "mass_spring"


def mm(error: float | None) -> str:
    """To two places; a dash where a recording could not be simulated."""
    return "–" if error is None or np.isnan(error) else f"{error:.2f}"


def mark(row: dict) -> str:
    """What the verdict is worth. Where nothing is missing: "open" if the loop says that this mesh cannot tell, "alarm"
    if it says that something is missing without a name for it.
    """
    if row["right"] or row["false_names"]:
        return "ok" if row["right"] else "FALSE"
    if row["planted"]:
        return "missed"
    return "open" if row["mesh_mm"] > row["noise_mm"] else "alarm"


def line(row: dict) -> str:
    said = "; ".join("=".join(group) for group in row["named"]) or "-"
    before, after = row["held_out_mm"]
    return (
        f"{row['case']:3d} {'+'.join(row['planted']) or '(nothing)':26s} {row['verdict']:12s} {said:36s} {mark(row):7s}"
        f" {mm(before):>6s} -> {mm(after):>6s} floor {mm(row['floor_mm'])} mm  {row['wall_s']:4.0f} s"
    )


def sets_with(row: dict, name: str) -> list[list[str]]:
    """The sets of tied names in which an effect was named; one may be in two of them, and is named once."""
    return [group for group in row["named"] if name in group]


def tied(row: dict, name: str) -> bool:
    """Whether an effect was named, and never alone."""
    return bool(groups := sets_with(row, name)) and all(len(group) > 1 for group in groups)


def summary(rows: Sequence[dict]) -> str:
    """Hit rate, false alarms and ties over the cases that were run."""
    known = [r for r in rows if r["of"]]
    others = [r for r in rows if not r["of"]]
    return (
        f"{sum(r['hits'] for r in known)} of {sum(r['of'] for r in known)} planted effects named, "
        f"{sum(tied(r, name) for r in known for name in r['planted'])} in tied sets; false names: "
        f"{sum(r['false_names'] for r in known)} where something was planted, "
        f"{sum(r['false_names'] for r in others)} of {len(others)} without anything the library knows; amounts inside "
        f"their intervals: {sum(r['amounts_inside'] for r in rows)} of {sum(r['amounts'] for r in rows)}"
    )


def by_kind(rows: Sequence[dict]) -> list[str]:
    """A table of what was planted, by its name: how often it was named, and what that took off."""
    lines = [
        "| planted | cases | named | of these tied | verdict right | held out: before | after (median) | time |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name in dict.fromkeys(name for row in rows for name in row["planted"] or ["nothing"]):
        mine = [row for row in rows if name in (row["planted"] or ["nothing"])]
        before, after = np.median([[e or np.nan for e in row["held_out_mm"]] for row in mine], axis=0)
        still_open = sum(mark(row) == "open" for row in mine)
        right = str(sum(row["right"] for row in mine)) + (f", {still_open} open" if still_open else "")
        found = [str(sum(map(bool, (sets_with(row, name) for row in mine)))), str(sum(tied(row, name) for row in mine))]
        named = found if mine[0]["of"] else ["", ""]
        cells = [
            name, str(len(mine)), *named, right, f"{mm(before)} mm", f"{mm(after)} mm",
            f"{np.median([row['wall_s'] for row in mine]):.0f} s",
        ]  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def with_kept(rows: Sequence[dict]) -> list[dict]:
    """The rows in order, and those that were kept before of cases that were not asked now."""
    kept = json.loads(RESULTS.read_text())["cases"] if RESULTS.is_file() else []
    return sorted({row["case"]: row for row in (*kept, *rows)}.values(), key=lambda row: row["case"])


def versions(rows: Sequence[dict]) -> str:
    """Which version of the stages judged the cases, and which cases an earlier one, if not all are of the same."""
    newest = max(row["stages"] for row in rows)
    earlier = [
        f"{', '.join(str(row['case']) for row in rows if row['stages'] == version)} of version {version}"
        for version in sorted({row["stages"] for row in rows} - {newest}, reverse=True)
    ]
    return f"version {newest}" + (f" (cases {'; '.join(earlier)})" if earlier else "")


def keep(rows: Sequence[dict]) -> None:
    """The rows for programs, and a table for people beside them."""
    RESULTS.write_text(json.dumps({"summary": summary(rows), "cases": rows}, indent=1, ensure_ascii=False) + "\n")
    lines = [
        "# The blind test of `improve`\n",
        f"`python tools/blind_test.py --out FOLDER --keep`, {len(rows)} of {OTHER_MODELS[-1] + 1} cases, stages of "
        f"{versions(rows)}, judged with springs where nothing else is said: {summary(rows)}.\n",
        *by_kind(rows),
        "",
        "Each case. Nothing is missing in those marked *open* and *false alarm*; where it is open, the loop says that "
        "the mesh may be wrong by more than the noise.\n",
        "| case | planted | verdict | named | held out: before | after | noise | mesh | p | amounts inside | time |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        by = "" if row["model"] == judge_of(0) else f", judged with {row['model'].strip('[]').replace(',', ' and ')}"
        planted = " and ".join(
            name + (f" ({', '.join(f'{key} {value:.3g}' for key, value in amounts.items())})" if amounts else "")
            for name, amounts in row["planted"].items()
        )
        cells = [
            str(row["case"]), (planted or "nothing") + by, row["verdict"] + WORTH[mark(row)],
            "; ".join(" or ".join(group) for group in row["named"]),
            *(f"{mm(error)} mm" for error in (*row["held_out_mm"], row["noise_mm"], row["mesh_mm"])),
            "" if row["p_value"] is None else f"{row['p_value']:.3g}",
            f"{row['amounts_inside']} of {row['amounts']}" if row["amounts"] else "", f"{row['wall_s']:.0f} s",
        ]  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    RESULTS.with_suffix(".md").write_text("\n".join(lines) + "\n")


def numbers(words: str) -> list[int]:
    """What "0-2,5" means: 0, 1, 2 and 5."""
    ends = [word.partition("-") for word in words.split(",")]
    return [case for first, _, last in ends for case in range(int(first), int(last or first) + 1)]


def main() -> None:
    parser = argparse.ArgumentParser(description="Run the loop's blind test.")
    parser.add_argument(
        "--out", type=Path, required=True, help="folder for recordings and verdicts; kept, so resumable"
    )
    parser.add_argument("--cases", default=f"0-{OTHER_MODELS[-1]}", help="FIRST-LAST or N, several of them with commas")
    parser.add_argument("--model", help="in place of what a case is judged with: springs, or as it says itself")
    parser.add_argument("--seed", type=int, default=SEED, help="other cloths, motions and amounts for the same cases")
    parser.add_argument("--keep", action="store_true", help=f"put them into the table results/{RESULTS.stem}")
    options = parser.parse_args()
    if options.keep and options.seed != SEED:
        parser.error(f"--keep is for the cases of seed {SEED}")
    out = options.out if options.seed == SEED else options.out / f"seed-{options.seed}"
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    for case in numbers(options.cases):
        rows.append(run(case, out, options.model or judge_of(case), seed=options.seed))
        print(line(rows[-1]), flush=True)
    print(summary(rows))
    if options.keep:
        keep(with_kept(rows))


if __name__ == "__main__":
    main()
