"""Figures 4, 5 and 10–15 of Bhat et al. 2003, of a finished `budget=paper`: `python tools/paper_figures.py FOLDER`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from clothbench_metrics.fold import turned
from fold_figure import shaded

from clothbench.engine.store import Store
from clothbench.plugins.discovery import catalogue
from clothbench.studies.calibration.cell import Bench, asked_and_fitted, set_up, with_recordings
from clothbench.studies.calibration.transfer import confusions, transfers
from clothbench.vision.render import striped

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
FABRICS = ("linen", "fleece", "satin", "knit")
COLOURS = ("#1f5fa8", "#c8551b", "#2b8a4f", "#8a3fa0")
HIGHEST = 100.0  # %, above which the paper does not tell variabilities apart
ZOOM = 2
# Figure numbers of the paper, and what is shown for them.
SHAPE = ("fleece/waving-2", 30)  # figures 12 and 13
ROBOT, LONG = "waving-robot", "waving-150"  # figures 15 and 10
FRAMES = {ROBOT: (12, 28, 44, 70), LONG: (20, 60, 100, 140)}


def draw_all(store: Store) -> None:
    rows = [r for r in store.rows() if r["metric"] == r["objective"]]
    keys = {r["case"]: r["key"] for r in rows}
    chosen = chosen_fits(store, rows)
    draw_curves(store, keys, rows)
    draw_progress(store, keys["satin/waving-1"])
    write("paper-shape.png", shape_panels(store, keys[SHAPE[0]], SHAPE[1]))
    for trial, name in ((ROBOT, "paper-robot.png"), (LONG, "paper-150-frames.png")):
        strips = [strip(store, keys[chosen[f"{f}/waving"]], f"{f}/{trial}", FRAMES[trial]) for f in FABRICS]
        write(name, np.vstack(strips) if trial == ROBOT else strips[FABRICS.index("satin")])


def chosen_fits(store: Store, rows: Sequence[dict[str, Any]]) -> dict[str, str]:
    """The case with the least E1 + E2 of each fabric and experiment ("satin/waving"), as the paper chose."""
    return {t.group: t.case for t in transfers(rows, store.table("starts")) if t.chosen}


def draw_curves(store: Store, keys: dict[str, str], rows: Sequence[dict[str, Any]]) -> None:
    """Figure 4 (perturbations of bending at the solution), 11 (variability) and 14 (each fabric as all four)."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(11, 3.2), layout="constrained")
    where = {key: case for case, key in keys.items()}
    moved = pd.DataFrame(store.table("perturbations")).assign(case=lambda t: t.key.map(where))
    found = pd.DataFrame(store.table("variability")).assign(case=lambda t: t.key.map(where))
    names = list(dict.fromkeys(found[found.case == "linen/waving-1"].name))
    for k, (fabric, colour) in enumerate(zip(FABRICS, COLOURS, strict=True)):
        case = f"{fabric}/waving-1"
        mine = moved[(moved.case == case) & (moved.name == "bend")]
        at = found[(found.case == case) & (found.name == "bend")].iloc[0]
        base = next(r["value"] for r in rows if r["case"] == case and r["recording"] == case)
        left.plot(100 * mine.change, mine.error / base, "o", ms=3, color=colour, label=fabric)
        share = np.linspace(-0.2, 0.2, 50)
        left.plot(100 * share, 1 + (at.slope * share + at.curvature * share**2 / 2) / base, color=colour, lw=1)
        percent = found[found.case == case].set_index("name").percent.reindex(names)
        tall = np.minimum(percent.fillna(HIGHEST).to_numpy(float), HIGHEST)
        middle.bar(np.arange(len(names)) + 0.2 * (k - 1.5), tall, 0.2, color=colour)
    left.set(xlabel="bending changed by [%]", ylabel="error, over that of the fit")
    left.legend(frameon=False, fontsize=7)
    middle.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=6.5)
    middle.set(ylabel="variability [%], at most 100", yscale="log")
    told = confusions(store.table("confusion"), rows, store.table("starts"))[-1]
    for fabric, colour in zip(FABRICS, COLOURS, strict=True):
        curve = [told.error[simulated][fabric] for simulated in FABRICS]
        right.plot(FABRICS, curve, "o-", ms=3, lw=1, color=colour, label=f"filmed {fabric}")
        right.plot([told.nearest(fabric)], [min(v for v in curve if v is not None)], "o", ms=8, mfc="none", mec=colour)
    right.set(xlabel="simulated as", ylabel="mean error over the trials [px]", yscale="log")
    right.legend(frameon=False, fontsize=7)
    figure.savefig(IMAGES / "paper-curves.svg")


def draw_progress(store: Store, key: str) -> None:
    """Figure 5: error and temperature over the evaluations, on the coarse mesh and then on the finer one."""
    folder = store.cell(key)
    figure, axes = plt.subplots(figsize=(7, 2.8), layout="constrained")
    hot, begin = axes.twinx(), 0
    for name in ("coarse_history", "history"):
        history = pd.read_parquet(folder / f"{name}.parquet")
        at = begin + np.arange(1, len(history) + 1)
        axes.plot(at, history.value, ".", ms=2.5, color="0.65")
        axes.plot(at, history.value.cummin(), color=COLOURS[0], lw=1.4)
        hot.plot(at, history.temperature, color=COLOURS[1], lw=1)
        begin = at[-1]
        if name == "coarse_history":
            axes.axvline(begin, color="black", lw=0.6, ls=":")
    axes.set(xlabel="evaluations (after the dotted line on the finer mesh)", ylabel="error [px]", yscale="log")
    axes.yaxis.label.set_color(COLOURS[0])
    hot.set(ylabel="temperature [px]", yscale="log")
    hot.yaxis.label.set_color(COLOURS[1])
    figure.savefig(IMAGES / "paper-progress.svg")


def bench_of(store: Store, key: str, recording: str) -> tuple[Bench, np.ndarray, np.ndarray]:
    """One recording of a finished cell ready to be simulated, and the parameters (1, P) at the start and at the end."""
    cell, fitted = asked_and_fitted(store, key)
    source = next(s for s in cell.recordings if s.name == recording)
    bench = set_up(with_recordings(cell, key, [source]), catalogue())
    known = {p["name"]: p for p in fitted}
    start, best = ([known[name][what] for name in bench.space.names] for what in ("start", "value"))
    return bench, np.array([start]), np.array([best])


def shape_panels(store: Store, key: str, frame: int) -> np.ndarray:
    """Figures 12 and 13, before (top) and after: film, simulation, their angle maps, how far these are apart."""
    cell, _ = asked_and_fitted(store, key)
    bench, start, best = bench_of(store, key, cell.case)
    (trial,), (recording,) = bench.trials, bench.recordings
    sight = trial.metric.sights.of(trial.observation)  # type: ignore[attr-defined]
    view, rows = trial.observation.view, []
    for theta in (start, best):
        position = trial.simulation.run(theta).position[0]
        image, _ = striped(view.camera, view.projector, sight.surface, position[[frame]])
        angle, shape = sight.stripes(position, slice(frame, frame + 1))
        both = shape[0] & view.silhouette[frame]
        apart = np.where(both & view.fold[frame], turned(angle[0] - view.angle[frame]) ** 2, 0.0)
        rows.append([
            grey(recording.video.frame[frame]), grey(255 * image[0]), shaded(view.angle[frame], view.silhouette[frame]),
            shaded(angle[0], shape[0]), grey(255 - np.clip(apart * 255, 0, 255)),
        ])  # fmt: skip
    return np.vstack([np.hstack(row) for row in rows])


def strip(store: Store, key: str, recording: str, frames: Sequence[int]) -> np.ndarray:
    """Film above, simulation with the fitted parameters below, at some frames."""
    bench, _, best = bench_of(store, key, recording)
    (trial,), (recorded,) = bench.trials, bench.recordings
    view = trial.observation.view
    sight = trial.metric.sights.of(trial.observation)  # type: ignore[attr-defined]
    position = trial.simulation.run(best).position[0][list(frames)]
    image, _ = striped(view.camera, view.projector, sight.surface, position)
    film = np.hstack([grey(recorded.video.frame[f]) for f in frames])
    return np.vstack([film, np.hstack([grey(255 * i) for i in image])])


def grey(image: np.ndarray) -> np.ndarray:
    """A picture (H, W), 0 … 255, as BGR."""
    return cv2.cvtColor(np.asarray(image).astype(np.uint8), cv2.COLOR_GRAY2BGR)


def write(name: str, picture: np.ndarray) -> None:
    larger = cv2.resize(picture, None, fx=ZOOM, fy=ZOOM, interpolation=cv2.INTER_NEAREST)
    cv2.imwrite(str(IMAGES / name), larger, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", metavar="FOLDER", help="results folder of the finished run")
    draw_all(Store(parser.parse_args().folder))
