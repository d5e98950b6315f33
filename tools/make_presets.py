"""Make clothbench/reference/presets.json: what measured fabrics are like, class by class, each number with its spread.

    python tools/make_presets.py DATA

DATA has `wang2011-arcsim-materials` (ten fabrics, Wang, O'Brien and Ramamoorthi 2011), `cantilever-618-fabrics`
(Feng et al. 2022) and `knit-uniaxial-gatech` (hand knits, Singal et al. 2024). The files stay there: only medians and
ranges of classes go into the project. Fold heights are those of `clothbench.reference.fabrics`; drape coefficients and
folds are what the tracker `drape` found in the silhouettes of `cusick-drape-bdp` (docs/drape.md), mean and two standard
deviations between captures; fits are those of the suite `static_dynamic` in `results/static_dynamic_paper.md`.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.datasets.knit_uniaxial_gatech import curve_of, find_swatches, read_videos
from clothbench.reference.fabrics import FABRICS

ROOT = Path(__file__).parents[1]
TARGET = ROOT / "clothbench" / "reference" / "presets.json"
FITS = ROOT / "results" / "static_dynamic_paper.md"
WANG = "Wang, O'Brien and Ramamoorthi 2011"
FENG = "Feng et al. 2022, cantilevers of 618 fabrics"
SINGAL = "Singal et al. 2024: 4 stitches knitted by hand, along courses and wales, 40 runs to 10 % strain"
BHAT = "stand-ins for what Bhat et al. 2003 found of the fabric"
PETRIK = (
    "fold heights of table I, Automatic Material Properties Estimation for the Physics-Based Robotic Garment Folding"
)
CUSICK = "Gong, Mao and Wang 2024, Cusick silhouettes, by the tracker drape (mean ± 2 standard deviations)"
WEIGHED = "Gong, Mao and Wang 2024"
STAND_INS = {"fleece": 0.24, "linen": 0.22}  # kg/m², of tools/make_static_dynamic.py
USUAL = "usual for such a fabric, ± 20 % assumed; Bhat et al. 2003 give no weight"
UNITS = {
    "areal_density": "kg/m²", "bending_warp": "N·m", "bending_weft": "N·m", "stretch": "N/m", "stretch_warp": "N/m",
    "stretch_weft": "N/m", "shear": "N/m", "drape_coefficient": "%", "folds": "1",
}  # fmt: skip
CLAMP, INITIAL = 0.0355, 0.1  # m, the clamp that scales the films (their template.nb); strain before yarns lock
FIT = re.compile(r"(\S+), (\S+) … (\S+) \((\S+)\)")  # value, interval, and what the stand-in was made with
FITTED = {"bend": "bending_warp", "stretch": "stretch", "shear": "shear"}
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


def rigidity(hinge: float) -> float:
    """Bending rigidity [N·m] of a number of ARCSim's "bending": its hinge of length l between triangles of the area A
    together has ½ (k/4) (l²/A) θ² (`bending_energy` in its physics.cpp), where that of a plate has D for k/4. Feng et
    al. 2022 compare it with the heavy elastica in the same way (`bending_validation/Main.m` of ClothDrapeTester).
    """
    return hinge / 4


def strip(along: float, coupled: float, across: float) -> float:
    """Tension [N/m] of a strip that is free to narrow over its strain, of ARCSim's c11, c12 and c22. It
    doubles all four numbers of a file (`evaluate_stretching_sample` in its dde.cpp) and multiplies Green's strain.
    """
    return 2 * (along - coupled**2 / across)


def shear_modulus(number: float) -> float:
    """[N/m], of ARCSim's c33: doubled like the others, then halved, for the force is that of an energy k (γ/2)²
    (`stretching_force` in its physics.cpp; its `stretching_energy`, which moves nothing, has half of that).
    """
    return number


class Measured:
    """The data sets of bending, stretch and shear in a folder."""

    def __init__(self, folder: Path):
        self.fabrics = {
            p.stem: json.loads(p.read_text()) for p in sorted((folder / "wang2011-arcsim-materials").glob("*.json"))
        }
        with (folder / "cantilever-618-fabrics" / "dataset.csv").open() as stream:
            rows = list(csv.reader(stream))[1:]
        self.cantilevers = np.array([[float(v) for v in row] for row in rows])
        self.hand_knits = hand_knits(folder / "knit-uniaxial-gatech")

    def wang(self, names: Sequence[str], why: str = "") -> dict[str, Number]:
        """Of these fabrics: both thread directions at all curvatures, stretch along both, shear. The first of the three
        directions is taken for the warp; the files do not say which it is.
        """
        mine = [self.fabrics[name] for name in names]
        source = f"{WANG}: {', '.join(names) if len(names) < 5 else f'{len(names)} fabrics'}{why}, median and range"
        warp, weft = ([rigidity(k) for fabric in mine for k in fabric["bending"][row]] for row in (0, 2))
        return {
            "areal_density": spread([fabric["density"] for fabric in mine], source),
            "bending_warp": spread(warp, source),
            "bending_weft": spread(weft, source),
            "stretch": spread(self.pulled(names), source),
            "shear": spread([shear_modulus(row[3]) for fabric in mine for row in fabric["stretching"]], source),
        }

    def both_threads(self, name: str) -> dict[str, Number]:
        """Stretch of one fabric whose threads differ: the geometric mean of the two, as of bending, where a median over
        both would lie in the gap between them, and the range of both; and that of each. Which is the warp is said of
        bending (`wang`): the same direction is taken for it here.
        """
        pulled = np.array(self.pulled([name])).reshape(-1, 2)
        warp, weft = (digits(value) for value in np.median(pulled, axis=0))
        source = f"{WANG}: {name}, geometric mean of {warp:.0f} along one thread and {weft:.0f} along the other"
        mean = number(math.sqrt(warp * weft), float(pulled.min()), float(pulled.max()), f"{source}, range of both")
        assumed = f"{WANG}: {name}, median and range; the first direction is taken for the warp, as of bending"
        return {
            "stretch": mean,
            **{f"stretch_{w}": spread(pulled[:, k], assumed) for k, w in enumerate(("warp", "weft"))},
        }

    def pulled(self, names: Sequence[str]) -> list[float]:
        """Stretch of strips of these fabrics along both threads, at all their strains [N/m]."""
        rows = [row for name in names for row in self.fabrics[name]["stretching"]]
        return [strip(*ends) for c11, c12, c22, _ in rows for ends in ((c11, c12, c22), (c22, c12, c11))]

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


def hand_knits(folder: Path) -> list[float]:
    """Of every run the slope over its first tenth of strain, for each metre of what the clamps hold [N/m]."""
    slopes = []
    for swatch in find_swatches(folder):
        for number, video in read_videos(swatch.path).items():
            curve, _ = curve_of(swatch, number, video, swatch.path.name)
            first = curve.stretch <= 1 + INITIAL
            width = video["fabricSize"] / video["clampSize"] * CLAMP
            slopes.append(float(np.polyfit(curve.stretch[first], curve.force[first], 1)[0] / width))
    return slopes


def suite_fits(fabric: str) -> Iterator[tuple[str, str, list[float]]]:
    """Case, parameter, and [value, low, high, truth] of the fits of a stand-in; of none that is open over its range."""
    column, case = 0, ""
    for line in FITS.read_text().splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        for k, cell in enumerate(cells):
            if re.fullmatch(rf"{fabric}/(static|waving)-\d", cell):
                column, case = k, cell
        if case and column < len(cells) and (fit := FIT.fullmatch(cells[column])):
            yield case, cells[1].split(" [")[0], [float(word) for word in fit.groups()]


def fitted(fabric: str, whole: dict[str, Number]) -> dict[str, Number]:
    """What baraff_witkin found of a stand-in: geometric mean of its fits, and the ends of their intervals. A fit whose
    interval is wider than the range of any fabric at all says nothing.
    """
    weight = STAND_INS[fabric]
    out = {"areal_density": number(weight, 0.8 * weight, 1.2 * weight, USUAL)}
    for name, quantity in FITTED.items():
        widest = whole[quantity]["high"] / whole[quantity]["low"]
        fits = [fit for fit in suite_fits(fabric) if fit[1] == name and fit[2][2] / fit[2][1] < widest]
        values, lows, highs, truths = zip(*(numbers for _, _, numbers in fits), strict=True)
        made, cases = " and ".join(f"{t:.3g}" for t in truths), " and ".join(case for case, _, _ in fits)
        source = f"fitted by baraff_witkin to {cases} of static_dynamic, 95 % intervals; {BHAT}: {made}"
        out[quantity] = number(math.exp(float(np.log(values).mean())), min(lows), max(highs), source)
    return {**out, "bending_weft": out["bending_warp"]}


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
    denim |= data.both_threads("11oz-black-denim")
    denim["areal_density"] = number(0.324, 0.324, 0.373, f"{WANG}: weighed, and what 11 oz/yd² is")
    cotton = number(0.114, 0.059, 0.192, f"{WEIGHED}: three cottons")
    once = ", one fabric, ± 20 % assumed"
    wool = number(0.274, 0.8 * 0.274, 1.2 * 0.274, WEIGHED + once)
    viscose = number(0.213, 0.8 * 0.213, 1.2 * 0.213, WEIGHED + once)
    knit = data.wang(KNITS)
    knit["stretch"] = spread([*data.pulled(KNITS), *data.hand_knits], f"{knit['stretch']['source']}; and {SINGAL}")
    sheer, woven = data.densities(0.1), data.wang(("11oz-black-denim", "royal-target"), " (99 and 65 % cotton)")
    whole = {"areal_density": data.densities(1.0), **data.weighing(0.0, 10.0), **wide}
    classes = {
        "any": ("any fabric at all", whole),
        "cotton": ("woven cotton", {"areal_density": cotton, **data.weighing(0.059, 0.192),
                                    "stretch": woven["stretch"], "shear": woven["shear"], **draped("cotton")}),
        "denim": ("denim, 11 oz", denim),
        "fleece": ("fleece as found in video", fitted("fleece", whole)),
        "knit": ("knitted jersey, rib and interlock; of stretch hand knits, too", knit),
        "linen": ("linen as found in video, stiffer than any of 618 measured fabrics", fitted("linen", whole)),
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
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, metavar="DATA", help="folder with the data sets")
    TARGET.write_text(json.dumps(presets(parser.parse_args().data), indent=1, ensure_ascii=False) + "\n")
    print(TARGET)
