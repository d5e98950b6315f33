"""Which metric tells fabrics apart, and which can be searched? `python tools/metrics_compared.py` prints three tables.

Bhat et al. 2003 tried other metrics before the folds (the silhouettes' overlap, the distance of their edges, edges
marked on the fabric), and propose one more, the mean number of folds (section 9); they give no numbers. Here all of
them look at the first waving trial of the four stand-in fabrics: with the true parameters and the density of each
fabric in turn, and along one parameter of the right one. A metric that can be searched has few dips along it, the
deepest near the truth. docs/calibration.md has the tables; the first is of `fold` alone ("Which fabric is it?").
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from clothbench.core.observation import Observation
from clothbench.core.rollout import Rollout
from clothbench.engine.suite import suites_folder
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.nodes import Recording, find_recordings, read_recording
from clothbench.recordings.scenes import scene_of

FOLD = "folds and silhouette"
METRICS: Mapping[str, tuple[str, dict[str, Any]]] = {
    FOLD: ("fold", {}),
    "silhouette, pixels": ("silhouette", {}),
    "silhouette, overlap": ("silhouette", {"quantity": "iou"}),
    "silhouette, edges": ("silhouette", {"quantity": "edge_distance"}),
    "marked edges": ("marked_edges", {}),
    "number of folds": ("fold_count", {}),
    "nodes (known here)": ("node_error", {}),
}
MODEL, TOLERANCE, SPACING = "baraff_witkin", 1e-3, 0.0375  # as in the suite `static_dynamic`
SPREAD, POINTS = 10.0, 25  # the parameter is divided and multiplied by up to so much, on so many points


def recordings() -> dict[str, Recording]:
    found = [read_recording(p) for p in find_recordings([suites_folder() / "embedded" / "static_dynamic"])]
    return {r.fabric: r for r in found if r.name.endswith("/waving-1")}


def rollouts(recorded: Recording, density: float, truth: Mapping[str, float], changes: Mapping[str, np.ndarray]):
    """The trial as cloth of this weight and these parameters would do it, with some of them changed (B values each)."""
    scene = scene_of(recorded, spacing=SPACING)
    scene = dataclasses.replace(scene, areal_density=density)
    simulation = catalogue().make("models", MODEL, tolerance=TOLERANCE).prepare(scene, [])
    count = max((len(values) for values in changes.values()), default=1)
    theta = np.tile([truth.get(name, default) for name, default in zip(
        simulation.parameters.names, simulation.parameters.defaults, strict=True)], (count, 1))  # fmt: skip
    for name, values in changes.items():
        theta[:, simulation.parameters.names.index(name)] = values
    space = simulation.parameters
    return simulation.run(np.clip(theta, space.low, space.high))


def truth_of(recording: Recording) -> dict[str, float]:
    return {k.removeprefix("truth_"): float(v) for k, v in recording.notes.items() if k.startswith("truth_")}


def values(observation: Observation, rollout: Rollout) -> dict[str, np.ndarray]:
    return {
        label: catalogue().make("metrics", name, **options)(observation, rollout).value
        for label, (name, options) in METRICS.items()
    }


def ripple(curve: np.ndarray) -> float:
    """Which share of its ups and downs a curve could do without, given its ends and its least."""
    ways = np.abs(np.diff(curve)).sum()
    return float(1 - (curve[0] + curve[-1] - 2 * curve.min()) / ways) if ways else 0.0


def dips(curve: np.ndarray) -> int:
    """How many local minima it has inside, level ones once."""
    steps = np.sign(np.diff(curve))
    steps = steps[steps != 0]
    return int(np.count_nonzero((steps[:-1] < 0) & (steps[1:] > 0)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parameter", default="bend", help="that is changed (default: bend)")
    options = parser.parse_args()
    found, tracker = recordings(), catalogue().make("trackers", "stripes")
    seen = {fabric: tracker.track(recording) for fabric, recording in found.items()}
    told: dict[str, dict[str, list[float]]] = {label: {fabric: [] for fabric in found} for label in METRICS}
    for fabric, recording in found.items():
        for other in found.values():
            run = rollouts(recording, other.areal_density, truth_of(other), {})
            for label, value in values(seen[fabric], run).items():
                told[label][fabric].append(float(value[0]))
    print("| recorded | " + " | ".join(f"as {fabric}" for fabric in found) + " |\n|" + "---|" * (len(found) + 1))
    for fabric, row in told[FOLD].items():
        print(f"| {fabric} | " + " | ".join(f"{value:.1f}" for value in row) + " |")
    print("\n| metric | fabrics known again | the next one's error, over the right one's |\n|---|---|---|")
    for label, rows in told.items():
        own = np.array([rows[fabric][k] for k, fabric in enumerate(found)])
        rest = np.array([min(np.delete(rows[fabric], k)) for k, fabric in enumerate(found)])
        shown = ", ".join(f"{fabric} {r / o:.2f}" for fabric, r, o in zip(found, rest, own, strict=True))
        print(f"| {label} | {np.count_nonzero(own < rest)} of {len(found)} | {shown} |", flush=True)
    factors = np.geomspace(1 / SPREAD, SPREAD, POINTS)
    print(f"\n| metric | dips along {options.parameter} | ripple | least at … of the truth |\n|---|---|---|---|")
    curves: dict[str, dict[str, np.ndarray]] = {label: {} for label in METRICS}
    for fabric, recording in found.items():
        truth = truth_of(recording)
        run = rollouts(
            recording, recording.areal_density, truth, {options.parameter: factors * truth[options.parameter]}
        )
        for label, curve in values(seen[fabric], run).items():
            curves[label][fabric] = curve
    for label, by_fabric in curves.items():
        row = [
            ", ".join(f"{fabric} {tell(curve)}" for fabric, curve in by_fabric.items())
            for tell in (
                dips, lambda c: f"{100 * ripple(c):.0f} %", lambda c: f"{factors[int(np.nanargmin(c))]:.2g}"
            )
        ]  # fmt: skip
        print(f"| {label} | " + " | ".join(row) + " |")


if __name__ == "__main__":
    main()
