"""Make clothbench/reference/presets.json: what measured fabrics are like, class by class, each number with its spread.

    python tools/make_presets.py DATA

DATA has `wang2011-arcsim-materials` (ten fabrics, Wang, O'Brien and Ramamoorthi 2011) and `cantilever-618-fabrics`
(Feng et al. 2022). The files stay there: only medians and ranges of classes go into the project. Fold heights are those
of `clothbench.reference.fabrics`; drape coefficients and folds are what the tracker `drape` found in the silhouettes of
`cusick-drape-bdp` (docs/drape.md), mean and two standard deviations between captures.
"""

from __future__ import annotations

import csv
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.reference.fabrics import FABRICS

ROOT = Path(__file__).parents[1]
TARGET = ROOT / "clothbench" / "reference" / "presets.json"
WANG = "Wang, O'Brien and Ramamoorthi 2011"
FENG = "Feng et al. 2022, cantilevers of 618 fabrics"
PETRIK = (
    "fold heights of table I, Automatic Material Properties Estimation for the Physics-Based Robotic Garment Folding"
)
CUSICK = "Gong, Mao and Wang 2024, Cusick silhouettes, by the tracker drape (mean ± 2 standard deviations)"
WEIGHED = "Gong, Mao and Wang 2024"
UNITS = {
    "areal_density": "kg/m²", "bending_warp": "N·m", "bending_weft": "N·m", "stretch": "N/m", "shear": "N/m",
    "drape_coefficient": "%", "folds": "1",
}  # fmt: skip
KNITS = ("camel-ponte-roma", "gray-interlock", "ivory-rib-knit", "navy-sparkle-sweat", "white-swim-solid")
POLYESTERS = ("pink-ribbon-brown", "white-dots-on-blk", "tango-red-jet-set")
EVERY = ("11oz-black-denim", "royal-target", *KNITS, *POLYESTERS)
# Drape coefficient [%] and number of folds, mean and standard deviation between captures.
DRAPES = {
    "cotton": ((71.4, 7.2, 7.6, 0.8), (62.1, 4.5, 8.2, 0.8)), "viscose": ((14.3, 1.5, 11.9, 1.1),),
    "wool": ((78.3, 1.8, 7.7, 0.7),),
}  # fmt: skip

Number = dict[str, Any]


def number(value: float, low: float, high: float, source: str) -> Number:
    """Three digits are more than any of it is good for."""
    return {"value": digits(value), "low": digits(low), "high": digits(high), "source": source}


def digits(value: float) -> float:
    return float(f"{value:.3g}")


def spread(values: Sequence[float] | np.ndarray, source: str) -> Number:
    """Median and range of positive values; a fit's negative ones mean nothing."""
    known = np.array([v for v in values if v > 0])
    return number(float(np.median(known)), float(known.min()), float(known.max()), source)


class Measured:
    """The two data sets in a folder."""

    def __init__(self, folder: Path):
        self.fabrics = {
            p.stem: json.loads(p.read_text()) for p in sorted((folder / "wang2011-arcsim-materials").glob("*.json"))
        }
        with (folder / "cantilever-618-fabrics" / "dataset.csv").open() as stream:
            rows = list(csv.reader(stream))[1:]
        self.cantilevers = np.array([[float(v) for v in row] for row in rows])

    def wang(self, names: Sequence[str], why: str = "") -> dict[str, Number]:
        """Of these fabrics: both thread directions at all curvatures, stretch along both, shear. The first of the three
        directions is taken for the warp; the files do not say which it is.
        """
        mine = [self.fabrics[name] for name in names]
        source = f"{WANG}: {', '.join(names) if len(names) < 5 else f'{len(names)} fabrics'}{why}, median and range"
        sheets = [np.array(fabric["stretching"]) for fabric in mine]
        return {
            "areal_density": spread([fabric["density"] for fabric in mine], source),
            "bending_warp": spread(np.concatenate([fabric["bending"][0] for fabric in mine]), source),
            "bending_weft": spread(np.concatenate([fabric["bending"][2] for fabric in mine]), source),
            "stretch": spread(np.concatenate([s[:, [0, 2]].ravel() for s in sheets]), source),
            "shear": spread(np.concatenate([s[:, 3] for s in sheets]), source),
        }

    def weighing(self, low: float, high: float) -> dict[str, Number]:
        """Bending of the 618 fabrics that weigh between low and high kg/m²: median, and where 95 % of them lie."""
        weight = self.cantilevers[:, 0]
        mine = self.cantilevers[(weight >= low) & (weight <= high)]
        source = f"{FENG}: the {len(mine)} of {low:.3g} … {high:.3g} kg/m², 95 % of them"
        out = {}
        for column, name in ((1, "bending_warp"), (2, "bending_weft")):
            cut = np.percentile(mine[:, column] * 1e-9, [50, 2.5, 97.5])
            out[name] = number(*(float(v) for v in cut), source)
        return out

    def densities(self, below: float) -> Number:
        """Median and 95 % of the densities of that share of the 618 that weighs least."""
        weight = np.sort(self.cantilevers[:, 0])
        mine = weight[: max(2, round(below * len(weight)))]
        share = "all" if below == 1 else f"the lightest {below:.0%}"
        middle, low, high = (float(v) for v in np.percentile(mine, [50, 2.5, 97.5]))
        return number(middle, low, high, f"{FENG}: {share}, 95 % of them")


def folded(names: Sequence[str], density: Number) -> dict[str, Number]:
    """D = ρ/η of fold heights: the ends are those of density and height together."""
    mine = [f for f in FABRICS if f.name in names]
    middle = math.exp(float(np.mean([math.log(density["value"] / f.eta) for f in mine])))
    low = min(density["low"] / f.eta_high for f in mine)
    high = max(density["high"] / f.eta_low for f in mine)
    one = number(middle, low, high, f"{PETRIK}: {', '.join(names)}, with the density above")
    return {"bending_warp": one, "bending_weft": one}


def draped(name: str) -> dict[str, Number]:
    """Mean of the fabrics' means; the ends are two standard deviations from the outermost."""
    rows = np.array(DRAPES[name])
    out = {}
    for column, quantity in ((0, "drape_coefficient"), (2, "folds")):
        mean, sd = rows[:, column], rows[:, column + 1]
        out[quantity] = number(float(mean.mean()), float((mean - 2 * sd).min()), float((mean + 2 * sd).max()), CUSICK)
    return out


def presets(folder: Path) -> dict[str, Any]:
    """Every class: a line on what it is, and its numbers."""
    data = Measured(folder)
    every = data.wang(EVERY, ", for want of any of this class")
    wide = {name: every[name] for name in ("stretch", "shear")}
    denim = data.wang(("11oz-black-denim",))
    denim["areal_density"] = number(0.324, 0.324, 0.373, f"{WANG}: weighed, and what 11 oz/yd² is")
    cotton = number(0.114, 0.059, 0.192, f"{WEIGHED}: three cottons")
    once = ", one fabric, ± 20 % assumed"
    wool = number(0.274, 0.8 * 0.274, 1.2 * 0.274, WEIGHED + once)
    viscose = number(0.213, 0.8 * 0.213, 1.2 * 0.213, WEIGHED + once)
    sheer, woven = data.densities(0.1), data.wang(("11oz-black-denim", "royal-target"), " (99 and 65 % cotton)")
    whole = data.densities(1.0)
    classes = {
        "any": ("any fabric at all", {"areal_density": whole, **data.weighing(0.0, 10.0), **wide}),
        "cotton": ("woven cotton", {"areal_density": cotton, **data.weighing(0.059, 0.192),
                                    "stretch": woven["stretch"], "shear": woven["shear"], **draped("cotton")}),
        "denim": ("denim, 11 oz", denim),
        "knit": ("knitted jersey, rib and interlock", data.wang(KNITS)),
        "polyester": ("polyester, from jacket to blanket", data.wang(POLYESTERS)),
        "sheer": ("chiffon and georgette", {"areal_density": sheer, **folded(("chiffon", "georgette"), sheer), **wide}),
        "viscose": ("woven viscose", {"areal_density": viscose, **data.weighing(viscose["low"], viscose["high"]),
                                      **wide, **draped("viscose")}),
        "wool": ("wool suiting", {"areal_density": wool, **folded(("wool suiting",), wool), **wide, **draped("wool")}),
    }  # fmt: skip
    return {
        name: {"about": about, "numbers": {q: {"unit": UNITS[q], **numbers[q]} for q in UNITS if q in numbers}}
        for name, (about, numbers) in classes.items()
    }


if __name__ == "__main__":
    TARGET.write_text(json.dumps(presets(Path(sys.argv[1])), indent=1, ensure_ascii=False) + "\n")
    print(TARGET)
