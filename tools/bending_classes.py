"""Fitted bending beside fabrics that were measured: `python tools/bending_classes.py RUNS DATASET.csv`.

RUNS: a folder of `clothbench run +suite=drape_bending`. DATASET.csv: `dataset.csv` of ClothDrapeTester (Feng, Huang, Xu
and Wang 2022), areal density [kg/m²] and linear bending stiffness [1e-9 N·m] of 618 unnamed fabrics from cantilevers.
Printed is where each fit lies among the fabrics whose density is within a fifth of its own, by the length at which
each bends under its own weight.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from clothbench.engine.store import Store
from clothbench.recordings.kinds import read_sheet
from clothbench.reference.mechanics import bending_length

NEAR = 0.2  # relative, of areal density


def measured(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Areal density [kg/m²] and bending stiffness [N·m], mean of warp and weft, of each fabric."""
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    return rows[:, 0], 1e-9 * rows[:, 1:3].mean(axis=1)


def lengths_near(own: float, density: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Lengths [mm] at which fabrics bend under their own weight, whose density [kg/m²] is within a fifth of `own`."""
    near = abs(density - own) < NEAR * own
    return np.array([1e3 * bending_length(*fabric) for fabric in zip(stiffness[near], density[near], strict=True)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", type=Path)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("recordings", type=Path, nargs="+", help="silhouettes of the fabrics that were fitted")
    given = parser.parse_args()
    density, stiffness = measured(given.dataset)
    heavy = {r.fabric: r.areal_density for r in (read_sheet(path) for path in given.recordings)}
    store = Store(given.runs)
    cases = {r["key"]: r["case"] for r in store.rows()}
    for p in store.table("parameters"):
        if p["name"] != "bend" or cases[p["key"]] not in heavy:
            continue
        own, fitted = heavy[cases[p["key"]]], p["value"]
        near = lengths_near(own, density, stiffness)
        length = 1e3 * bending_length(fitted, own)
        low, middle, high = np.quantile(near, (0.1, 0.5, 0.9))
        print(f"{cases[p['key']]}: {own:.3f} kg/m², D {fitted:.3g} N·m ({p['low']:.2g} … {p['high']:.2g}), "
              f"bending length {length:.1f} mm; {len(near)} measured fabrics as heavy: "
              f"{middle:.1f} mm ({low:.1f} … {high:.1f}, tenth to ninth decile); more limp than it: "
              f"{np.mean(near < length):.0%}")  # fmt: skip


if __name__ == "__main__":
    main()
