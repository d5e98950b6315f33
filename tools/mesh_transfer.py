"""Does a fit on a coarse mesh hold on a fine one? `python tools/mesh_transfer.py [MODEL…]` prints the table.

Each model is fitted to the fit recordings of one embedded fabric on 9², 17² and 33² nodes; and what was found on 9² is
taken to the finer meshes as it is. Errors are `node_error`; the truth is the finite-element reference simulation.
"""

from __future__ import annotations

import argparse

import numpy as np

from clothbench.engine.suite import suites_folder
from clothbench.estimation.calibrate import Fit, calibrate
from clothbench.estimation.trials import Trial, evaluate
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.nodes import find_recordings, read_recording
from clothbench.recordings.scenes import scene_of

MESHES = (9, 17, 33)
EFFECTS = {"mass_spring": ("quadratic_drag",), "mass_spring_verlet": ("quadratic_drag",), "baraff_witkin": (),
           "inextensible": ("quadratic_drag",)}  # fmt: skip


def trials(model: str, mesh: int, fabric: str, split: str) -> list[Trial]:
    plugins = catalogue()
    made, metric = plugins.make("models", model, resolution=mesh), plugins.make("metrics", "node_error")
    effects = [plugins.make("effects", name) for name in EFFECTS.get(model, ())]
    tracker, found = plugins.make("trackers", "markers"), []
    for path in find_recordings([suites_folder() / "embedded" / "static_dynamic"]):
        recording = read_recording(path)
        if (recording.fabric, recording.split) == (fabric, split):
            simulation = made.prepare(scene_of(recording), effects)
            found.append(Trial(recording.name, tracker.track(recording), simulation, metric))
    return found


def fit(both: list[Trial], budget: int) -> Fit:
    space = both[0].simulation.parameters
    return calibrate(both, catalogue().make("optimizers", "least_squares", space, seed=0, budget=budget), space)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="*", default=list(EFFECTS), help="models (default: all four)")
    parser.add_argument("--fabric", default="linen", help="embedded fabric (default: linen)")
    parser.add_argument("--budget", type=int, default=120, help="evaluations of a fit (default: 120)")
    parser.add_argument("--meshes", type=int, nargs="+", default=MESHES, help="nodes along a side (default: 9 17 33)")
    parser.add_argument("--fits", type=int, nargs="+", help="meshes on which to fit as well (default: all)")
    options = parser.parse_args()
    for model in options.models:
        table(model, options.fabric, sorted(options.meshes), set(options.fits or options.meshes), options.budget)


def table(model: str, fabric: str, meshes: list[int], fits: set[int], budget: int) -> None:
    first = fit(trials(model, meshes[0], fabric, "fit"), budget)
    print(f"\n{model}, {fabric}: {', '.join(first.space.names)} (* on its bound); errors in mm, fit / held out\n")
    print(f"| nodes | with the parameters of {meshes[0]}² | parameters fitted there | error |\n|---|---|---|---|")
    for mesh in meshes:
        cells = [f"{mesh}²", errors(model, mesh, fabric, first.best)]
        if mesh in fits:
            found = first if mesh == meshes[0] else fit(trials(model, mesh, fabric, "fit"), budget)
            values = " ".join(f"{v:.3g}{'*' * int(b)}" for v, b in zip(found.best, found.at_bound, strict=True))
            cells += [values, errors(model, mesh, fabric, found.best)]
        else:
            cells += ["", ""]
        print("| " + " | ".join(cells) + " |", flush=True)


def errors(model: str, mesh: int, fabric: str, theta: np.ndarray) -> str:
    both = (trials(model, mesh, fabric, split) for split in ("fit", "held_out"))
    return " / ".join(f"{float(evaluate(some, theta[None])[0].value[0]):.2f}" for some in both)


if __name__ == "__main__":
    main()
