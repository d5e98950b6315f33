"""Numbers and figures of docs/folding.md: `python tools/folding.py tables`, `… figures RUNS`, `… speed`, `… peer`,
`… guesses`, `… over`.

RUNS is the folder of a finished `clothbench run +suite=fold_phase_one`.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from clothbench_models import strip_path, strip_trials
from clothbench_models.kirchhoff_love import KirchhoffLove
from clothbench_models.strip import Strip
from scipy.optimize import brentq

from clothbench.core.folding import circular_path, geometric_places, triangular_path
from clothbench.engine.store import Store
from clothbench.engine.study import Context
from clothbench.engine.suite import suites_folder
from clothbench.plugins.discovery import catalogue
from clothbench.reference import lifted_strip
from clothbench.reference import mechanics as references
from clothbench.reference.fabrics import FABRICS, Fabric
from clothbench.studies.folding.cell import FoldingCell, fold_settings
from clothbench.studies.folding.run import run as run_fold

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
G = references.G


def eta_of_height(height: float, **about: Any) -> float:
    """η_b [m⁻⁴·s²] of the 1 m strip whose fold stands `height` m high, by the model."""
    tip = about.pop("tip", 0.0)

    def excess(log_eta: float) -> float:
        return strip_trials.fold_height(strip_trials.free_fold(Strip(**about), float(np.exp(log_eta)), tip)) - height

    return float(np.exp(brentq(excess, np.log(1e3), np.log(2e5), xtol=1e-3)))


def fold_rows() -> list[tuple[Fabric, float, float, float]]:
    """Each fabric with the model's η_b of its height; with a shorter overlap; of cloth 1 mm thick, at its top."""
    return [
        (f, eta_of_height(f.height), eta_of_height(f.height, tip=0.3), eta_of_height(f.height - 1e-3, thickness=1e-3))
        for f in FABRICS
    ]


def print_folds() -> None:
    print("| fabric | height | η_b, table | ± 2σ | model | deviation | overlap shorter by 15 cm | 1 mm thick |")
    print("|---|---|---|---|---|---|---|---|")
    for f, eta, shorter, thick in fold_rows():
        print(f"| {f.name} | {1e3 * f.height:.0f} mm | {f.eta:.2g} | {f.eta_low:.2g} … {f.eta_high:.2g} | {eta:.3g} | "
              f"{100 * (eta / f.eta - 1):+.0f} % | {100 * (shorter / eta - 1):+.1f} % | "
              f"{100 * (thick / f.eta - 1):+.0f} % |")  # fmt: skip


def print_refinement() -> None:
    """Errors of the cantilever's tip, the fold's height and length and a lifted strip over the number of elements."""
    meshes = (64, 128, 256)
    print("| test | reference | " + " | ".join(f"{n} elements" for n in meshes) + " |")
    print("|---|---|" + "---|" * len(meshes))
    for gamma in (1.0, 100.0, 1e4):
        _line(f"cantilever, Γ = {gamma:g}: tip", "heavy elastica", meshes, functools.partial(_tip, gamma))
    for eta in (2.6e3, 3.5e4):
        height = references.fold_coefficients()[0] * Strip().size(eta)
        _line(f"free fold, η_b = {eta:g}: height", "0.9066 (D/ρg)^⅓", meshes, lambda n, e=eta, h=height: abs(
            strip_trials.fold_height(strip_trials.free_fold(Strip(elements=n), e)) / h - 1))  # fmt: skip
        length = references.fold_coefficients()[1] * Strip().size(eta)
        _line(f"free fold, η_b = {eta:g}: length of the loop", "4.683 (D/ρg)^⅓", meshes, lambda n, e=eta, s=length: abs(
            strip_trials.fold_length(strip_trials.free_fold(Strip(elements=n), e)) / s - 1))  # fmt: skip
        for raised in (0.04, 0.4):
            name = f"lifted by {raised:g} m, η_b = {eta:g}: any point"
            _line(name, "heavy elastica", meshes, functools.partial(_away, eta, raised))
    for kind, turn in strip_trials.TURNS.items():
        loop = lifted_strip.hanging_loop(100.0, *turn)
        _line(f"hanging {kind} loop, Γ = 100: lowest point", "heavy elastica", meshes, lambda n, k=kind, r=loop: abs(
            strip_trials.hanging_loop(Strip(1.0, 1e-7, n, desk=False), 100.0 / G, k).at(np.array([0.5]))[0, 1]
            - r.z[-1]))  # fmt: skip


def _tip(gamma: float, elements: int) -> float:
    """How far a cantilever's tip is from the elastica's, over its length."""
    reference = references.cantilever(gamma)
    found = strip_trials.cantilever(Strip(1.0, 1e-7, elements, desk=False), gamma / G).control[-1]
    return float(np.hypot(found[0] - reference.x[-1], found[1] - reference.z[-1]))


def _away(eta: float, height: float, elements: int) -> float:
    """How far any point of a lifted strip is from the elastica [m]."""
    truth, u = lifted_strip.lift(1.0, lambda u: eta + 0 * u, height), np.linspace(0, 1, 400)
    return float(np.abs(strip_trials.lift(Strip(1.0, 1e-7, elements), eta, height).at(u) - truth.line(u)).max())


def _line(name: str, reference: str, meshes: Sequence[int], error: Callable[[int], float]) -> None:
    print(f"| {name} | {reference} | " + " | ".join(f"{error(n):.1e}" for n in meshes) + " |", flush=True)


def print_speed(count: int = 60) -> None:
    """Wall times [ms] of equilibria of a 1 m strip, from flat, of random fabrics and heights; compiled beforehand."""
    random, strip = np.random.default_rng(0), Strip()
    strip_trials.lift(strip, 1e3, 0.1)
    wall, cpu, held = [], [], []
    for eta, height in zip(10 ** random.uniform(2, 6, count), random.uniform(0.01, 0.45, count), strict=True):
        began = time.perf_counter(), time.process_time()
        state = strip_trials.lift(strip, eta, height)
        wall.append(1e3 * (time.perf_counter() - began[0]))
        cpu.append(1e3 * (time.process_time() - began[1]))
        began = time.perf_counter(), time.process_time()
        strip.beside(state, 1.1 * eta, state.ends)
        held.append(1e3 * (time.process_time() - began[1]))
    for name, times in (
        ("from flat, wall", wall),
        ("from flat, processor", cpu),
        ("beside a known one, processor", held),
    ):
        print(f"{name}: median {np.median(times):.1f} ms, 90 % below {np.quantile(times, 0.9):.1f} ms")


def print_peer(gamma: float = 100.0, elements: int = 50) -> None:
    """The same cantilever by PyElastica (`pip install pyelastica`), a general solver of Cosserat rods in time.

    A round rod, slender enough that it neither stretches nor shears (radius 5 mm, length 1 m), damped until it hangs.
    """
    import elastica

    class Room(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping):
        pass

    radius, density, seconds, damping = 0.005, 1000.0, 8.0, 0.3
    young = 4 * density * G / (gamma * radius**2)  # Γ = ρ A g L³/(E I), I/A = r²/4
    step = 0.3 * radius / np.sqrt(young / density)

    def hang(duration: float) -> tuple[np.ndarray, float]:
        room = Room()
        rod = elastica.CosseratRod.straight_rod(
            elements, np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), 1.0, radius, density,
            youngs_modulus=young, shear_modulus=young / 2,
        )  # fmt: skip
        room.append(rod)
        room.constrain(rod).using(elastica.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
        room.add_forcing_to(rod).using(elastica.GravityForces, acc_gravity=np.array([0, 0, -G]))
        room.dampen(rod).using(elastica.AnalyticalLinearDamper, damping_constant=damping, time_step=step)
        room.finalize()
        began = time.process_time()
        elastica.integrate(elastica.PositionVerlet(), room, duration, round(duration / step), progress_bar=False)
        return rod.position_collection[[0, 2], -1], time.process_time() - began

    hang(0.01)  # compiles
    tip, spent = hang(seconds)
    strip, reference = Strip(1.0, 1e-7, elements, desk=False), references.cantilever(gamma)
    strip_trials.cantilever(strip, gamma / G)
    began = time.process_time()
    ours = [strip_trials.cantilever(strip, gamma / G).control[-1] for _ in range(20)][-1]
    each = (time.process_time() - began) / 20
    end = np.array([reference.x[-1], reference.z[-1]])
    for name, found, cost in (("PyElastica", tip, spent), ("kirchhoff_love", ours, each)):
        print(f"{name}: tip off by {1e3 * np.hypot(*(found - end)):.2g} mm after {1e3 * cost:.3g} ms of processor time")
    print(f"ratio of times: {spent / each:.0f}")


def print_guesses(guesses: Sequence[float] = (1e2, 1e3, 1e4, 1e5)) -> None:
    """The last estimate of each fabric from first guesses far apart, in the suite's setting otherwise."""
    suite = yaml.safe_load((suites_folder() / "suite" / "fold_phase_one.yaml").read_text())
    about = fold_settings(suite["suite"]["fold"])
    bounds = {name: tuple(ends) for name, ends in suite["bounds"].items()}
    print("| fabric | " + " | ".join(f"from {g:.0e}" for g in guesses) + " | spread | largest friction |")
    print("|---|" + "---|" * (len(guesses) + 2))
    for fabric in FABRICS:
        ends, friction = [], []
        for guess in guesses:
            cell = FoldingCell(
                "guesses", fabric.name, suite["model"][0], tuple(suite["effects"]), suite["optimizer"][0],
                suite["metric"][0] if isinstance(suite["metric"], list) else suite["metric"], suite["tracker"],
                dataclasses.replace(about, first=guess), bounds=bounds, evaluations=suite["budget"],
            )  # fmt: skip
            with tempfile.TemporaryDirectory() as folder:
                steps = run_fold(cell, Context(catalogue(), Path(folder))).tables["fold"]
            ends.append(steps[-1]["value"])
            friction.append(max(s["friction"] for s in steps))
        spread = 100 * (max(ends) / min(ends) - 1)
        print(f"| {fabric.name} | " + " | ".join(f"{e:.4g}" for e in ends) + f" | {spread:.2f} % | "
              + ", ".join(f"{f:.2f}" for f in friction) + " |", flush=True)  # fmt: skip


def draw_paths() -> None:
    """Phase 1 for fabrics of every stiffness, between the triangular and the circular path (figure 3 of the paper)."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    height = np.linspace(0.0, 0.42, 29)
    for eta in (1e2, 1e3, 1e4, 1e5, 1e6):
        x = [1.0, *(strip_trials.lift(Strip(), eta, z).ends.x1 for z in height[1:])]
        for axis in axes:
            axis.plot(x, height, label=f"η$_b$ = 10$^{int(np.log10(eta))}$")
    for axis in axes:
        axis.plot(triangular_path(1.0, height), height, "k--", lw=1, label="triangular")
        axis.plot(circular_path(1.0, height), height, "k:", lw=1, label="circular")
        axis.set(xlabel="x [m]", ylabel="z [m]")
    axes[1].set(xlim=(0.9, 1.003), ylim=(0.0, 0.12), title="where it begins")
    axes[0].legend(fontsize=7)
    figure.savefig(IMAGES / "folding-paths.svg")


def draw_over(etas: Sequence[float] = (1e2, 1e3, 1e4, 1e5)) -> None:
    """Whole paths with their phases, and the strip on its way along one of them (figure 2 of the paper)."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(9, 7), layout="constrained")
    colours = {1: "C2", 2: "C3", 3: "C0"}  # as in the paper
    for axis, eta in zip(axes.flat, etas, strict=True):
        found = KirchhoffLove().strip(1.0).fold(np.array([eta, 1e-5, 0.3]))
        laid = len(found.phase) - found.laid
        for phase, colour in colours.items():
            mine = np.flatnonzero(found.phase == phase)
            axis.plot(*found.places[max(mine[0] - 1, 0) : mine[-1] + 1].T, color=colour, label=f"phase {phase}")
        axis.plot(*found.places[laid - strip_path.FALLS - 1 : laid + 1].T, color="C0", ls=":", lw=3, label="falls over")
        shown = np.unique(
            np.concatenate([np.linspace(0, laid - strip_path.FALLS - 1, 7), [laid, len(found.phase) - 1]])
        )
        for state in shown.astype(int):
            axis.plot(*found.state.profile[state].T, color="0.5", lw=0.8)
        for name, dash in (("triangular", "--"), ("circular", ":")):
            axis.plot(*geometric_places(name, 1.0, 200).T, "k", ls=dash, lw=0.8, label=name)
        axis.set(title=f"η$_b$ = 10$^{int(np.log10(eta))}$, friction {found.needed.max():.2f}", aspect="equal")
    axes[0, 0].legend(fontsize=7)
    figure.savefig(IMAGES / "folding-over.svg")


def draw_estimates(runs: Path) -> None:
    """Last estimates beside the references, and every step (figures 8 and 10 of the paper)."""
    import matplotlib.pyplot as plt

    steps = Store(runs).table("fold")
    cells = {s["key"]: [t for t in steps if t["key"] == s["key"]] for s in steps}
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    for n, mine in enumerate(cells.values()):
        last = mine[-1]
        left.plot([last["reference_low"], last["reference_high"]], [n, n], color="0.6", lw=5, solid_capstyle="butt")
        left.plot(last["reference"], n, "gx")
        left.plot(last["value"], n, "ko", ms=5)
        right.semilogy(
            [s["step"] for s in mine], [s["value"] / s["reference"] for s in mine], "o-", ms=3, label=last["case"]
        )
    left.set_yticks(range(len(cells)), [mine[-1]["case"] for mine in cells.values()])
    left.set(xscale="log", xlabel="η$_b$ [m⁻⁴ s²]", title="last estimate (dot), table and ± 2σ")
    right.set(xlabel="step", ylabel="estimate over table", title="every step")
    right.legend(fontsize=6, ncols=2)
    figure.savefig(IMAGES / "fold-phase-one.svg")


def print_estimates(runs: Path) -> None:
    steps = Store(runs).table("fold")
    count = max(s["step"] for s in steps)
    print("| fabric | table | ± 2σ | " + " | ".join(map(str, range(1, count + 1))) + " | 95 % | friction | time |")
    print("|---|---|---|" + "---|" * (count + 3))
    for key in dict.fromkeys(s["key"] for s in steps):
        mine = [s for s in steps if s["key"] == key]
        last = mine[-1]
        known = f"{last['reference']:.2g} | {last['reference_low']:.2g} … {last['reference_high']:.2g}"
        print(f"| {last['case']} | {known} | "
              + " | ".join(f"{s['value']:.3g}" for s in mine) + f" | {last['low']:.3g} … {last['high']:.3g} | "
              f"{max(s['friction'] for s in mine):.2f} | {sum(s['wall_s'] for s in mine):.1f} s |")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description="Numbers and figures of docs/folding.md.")
    parser.add_argument("what", choices=("tables", "figures", "speed", "peer", "guesses", "over"))
    parser.add_argument("runs", nargs="?", type=Path, help="results of the suite fold_phase_one")
    options = parser.parse_args()
    if options.what == "tables":
        print_folds()
        print_refinement()
    elif options.what == "speed":
        print_speed()
    elif options.what == "peer":
        print_peer()
    elif options.what == "guesses":
        print_guesses()
    elif options.what == "over":
        draw_over()
    else:
        draw_paths()
    if options.runs:
        print_estimates(options.runs)
        if options.what == "figures":
            draw_estimates(options.runs)


if __name__ == "__main__":
    main()
