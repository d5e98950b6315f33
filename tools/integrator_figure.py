"""Draws docs/images/integrators.svg: what each integrator leaves of a swing in vacuum. Needs `clothbench[docs]`.

The sheet of `physical_validation`'s energy test on 17 nodes, without any damping: implicit Euler and BDF2 with steps of
2 ms, and Dormand and Prince's pair with steps as it chooses them.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import numpy as np

from clothbench.plugins.discovery import catalogue
from clothbench.studies.mechanics import trials

matplotlib.use("svg")
import matplotlib.pyplot as plt

FILE = Path(__file__).resolve().parents[1] / "docs" / "images" / "integrators.svg"
MODEL, STEP = "baraff_witkin", 2e-3  # s
SETTINGS = (("implicit_euler", "#c44e52", "-"), ("bdf2", "#4c72b0", "-"), ("rk45", "#55a868", "--"))
SHOWN = 5.0  # s


def hem(integrator: str) -> tuple[np.ndarray, np.ndarray]:
    """When (T,) s, and how far the middle of the lower edge is beside the grips (T,) m."""
    trial = trials.drift(17)[0]
    options = {} if integrator == "rk45" else {"dt": STEP}
    made = catalogue().make("models", MODEL, integrator=integrator, **options)
    theta = made.of_material(trial.material, trial.scene)
    rollout = made.prepare(trial.scene).run(theta[None])
    across = trial.scene.resolution[0]
    time, y = trial.scene.times[1:], rollout.position[0, 1:, :, 1]
    return time - time[0], y[:, -1 - across // 2] - y[:, across // 2]


def main() -> None:
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    plt.rcParams.update({"font.size": 9, "svg.hashsalt": "clothbench", "svg.fonttype": "none"})
    figure, axes = plt.subplots(figsize=(7.2, 2.6), layout="constrained")
    for integrator, colour, dash in SETTINGS:
        time, aside = hem(integrator)
        seen = time <= SHOWN
        axes.plot(time[seen], 1e3 * aside[seen], dash, color=colour, lw=1.2, label=integrator)
        late = (time > time[-1] - 2) & (time <= time[-1])
        print(f"{integrator}: {100 * np.ptp(aside[late]) / np.ptp(aside[time < 2]):.1f} % of the swing after 10 s")
    axes.set(xlabel="time [s]", ylabel="hem beside the grips [mm]", xlim=(0, SHOWN))
    axes.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    axes.spines[["top", "right"]].set_visible(False)
    FILE.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(FILE, metadata={"Date": None})
    print(FILE)


if __name__ == "__main__":
    main()
