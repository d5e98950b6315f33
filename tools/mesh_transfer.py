"""Does a fit on a coarse mesh hold on a fine one? `python tools/mesh_transfer.py [MODEL…]` prints the table.

Each model is fitted to the fit recordings of one embedded fabric on 9², 17² and 33² nodes; and what was found on 9² is
taken to the finer meshes as it is. Errors are `node_error`; the truth is the finite-element reference simulation.
"""

from __future__ import annotations

import argparse

import numpy as np

from clothbench import read_recording
from clothbench.experiment.calibrate import Fit, Trial, calibrate, evaluate
from clothbench.experiment.suite import suites_folder
from clothbench.plugins import catalogue
from clothbench.scene import scene_of

MESHES = (9, 17, 33)
EFFECTS = {"mass_spring": ("quadratic_drag",), "mass_spring_verlet": ("quadratic_drag",), "baraff_witkin": (),
           "inextensible": ("quadratic_drag",)}  # fmt: skip


def trials(model: str, mesh: int, fabric: str, split: str) -> list[Trial]:
    plugins = catalogue()
    made, metric = plugins.make("models", model, resolution=mesh), plugins.make("metrics", "node_error")
    effects = [plugins.make("effects", name) for name in EFFECTS.get(model, ())]
    tracker, found = plugins.make("trackers", "markers"), []
    for path in sorted((suites_folder() / "embedded" / "static_dynamic" / fabric).glob("*.nc")):
        recording = read_recording(path)
        if recording.split == split:
            simulation = made.prepare(scene_of(recording), effects)
            found.append(Trial(recording.name, tracker.track(recording), simulation, metric))
    return found


def fit(both: list[Trial], budget: int) -> Fit:
    space = both[0].simulation.parameters
    return calibrate(both, catalogue().make("optimizers", "least_squares", space, seed=0, budget=budget), space)


def error(model: str, mesh: int, fabric: str, split: str, theta: np.ndarray) -> float:
    return float(evaluate(trials(model, mesh, fabric, split), theta[None])[0].value[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="*", default=list(EFFECTS), help="models (default: all four)")
    parser.add_argument("--fabric", default="linen", help="embedded fabric (default: linen)")
    parser.add_argument("--budget", type=int, default=120, help="evaluations of a fit (default: 120)")
    parser.add_argument("--meshes", type=int, nargs="+", default=MESHES, help="nodes along a side (default: 9 17 33)")
    options = parser.parse_args()
    coarse = min(options.meshes)
    for model in options.models:
        first: Fit | None = None
        for mesh in sorted(options.meshes):
            found = fit(trials(model, mesh, options.fabric, "fit"), options.budget)
            first = first or found
            if mesh == coarse:
                print(f"\n{model}, {options.fabric}: {', '.join(found.space.names)}\n")
                print(f"| nodes | parameters fitted there | fit mm | held out mm | with {coarse}²'s: fit | held out |")
                print("|---|---|---|---|---|---|")
            errors = [
                error(model, mesh, options.fabric, s, f.best) for f in (found, first) for s in ("fit", "held_out")
            ]
            values = " ".join(f"{v:.3g}{'*' * b}" for v, b in zip(found.best, found.at_bound, strict=True))
            print(f"| {mesh}² | {values} | " + " | ".join(f"{e:.2f}" for e in errors) + " |", flush=True)


if __name__ == "__main__":
    main()
