"""Draws the figures of docs/real-cloth.md and prints its numbers. Needs `clothbench[docs]`.

    python tools/real_cloth.py knits DATA_DIR    docs/images/knit-curves.svg, docs/images/knit-errors.svg
    python tools/real_cloth.py folds             docs/images/fold-heights.svg
    python tools/real_cloth.py swings DATA_DIR   docs/images/swing-kernel.svg, docs/images/robot-swings.svg
                                                 (two hours; a stopped run goes on)

knits: every run of every swatch is held out once; what `improve` finds on the other four is judged on it.
folds: ten fabrics, each left out once.
swings: a robot swings cloth; some recordings of each range or motion are held out.
"""

from __future__ import annotations

import argparse
import contextlib
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fold_heights as folds
import matplotlib
import numpy as np
import robot_swings as swings

from clothbench.core.statistics import t_interval
from clothbench.datasets.convert import converted
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.curve import Curve, read_curve
from clothbench.studies.improve.candidates import candidates_of
from clothbench.studies.improve.curve_steps import common_steps, loading, observed
from clothbench.studies.improve.curves import CurveCase, curve_evidence
from clothbench.studies.improve.document import verdict_document
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.fitting import fit
from clothbench.studies.improve.loop import improve
from clothbench.studies.improve.problem import Problem

matplotlib.use("svg")
import matplotlib.pyplot as plt

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
MODEL, OPTIMIZER, DATASET = "linear_stretch", "least_squares", "knit_uniaxial_gatech"
LAWS = ("strain_locking", "limited_extension")
LINEAR, LOCKING, LIMIT, GREY = "#c44e52", "#4c72b0", "#55a868", "#999999"
FURTHER = 1.05  # of the largest strain all runs reached: where the two laws are compared


@dataclass(frozen=True, eq=False)
class Knit:
    """One swatch pulled in one direction: its runs, and what came of holding out each of them.

    documents: of `verdict.json`, one for each run held out; laws: fits of all runs without and with each law.
    """

    name: str
    curves: list[Curve]
    documents: list[dict[str, Any]]
    laws: dict[str, Fitted]
    cases: tuple[CurveCase, ...]

    def errors(self, when: str) -> np.ndarray:
        """Held-out error [N] of each run, "before" or "after"."""
        return np.array([d["error"]["held_out"][when] for d in self.documents])

    @property
    def floor(self) -> float:
        return float(np.sqrt(np.mean([d["error"]["noise_floor"] ** 2 for d in self.documents])))

    @property
    def named(self) -> Counter[str]:
        """Each effect, tied ones too, by how many of the held-out runs it was named in."""
        return Counter(n for d in self.documents for e in d["effects"] for n in (e["name"], *e["tied_with"]))


def knits(data_dir: str) -> None:
    with tempfile.TemporaryDirectory() as place:
        folder = converted(DATASET, data_dir=data_dir, out=Path(place) / "knits")
        found = [knit(path) for path in sorted(p for p in folder.iterdir() if p.is_dir())]
    print_knits(found)
    with figure_file("knit-curves.svg", 2, 4, (10.0, 5.2)) as axes:
        draw_curves(found, axes)
    with figure_file("knit-errors.svg", 1, 1, (7.2, 2.9)) as axes:
        draw_errors(found, axes[0])


def knit(folder: Path) -> Knit:
    curves = [read_curve(path) for path in sorted(folder.glob("*.nc"))]
    plugins, documents = catalogue(), []
    for held in range(len(curves)):
        splits = ["held_out" if k == held else "fit" for k in range(len(curves))]
        problem = Problem(MODEL, curve_evidence(curves, splits), plugins, OPTIMIZER)
        documents.append(verdict_document(improve(problem, candidates_of(None, "curve", (), plugins))))
    evidence = curve_evidence(curves, ["fit"] * len(curves))
    whole = Problem(MODEL, evidence, plugins, OPTIMIZER)
    laws = {name: fit(whole, (name,) if name else (), None, 140) for name in ("", *LAWS)}
    return Knit(folder.name.removeprefix("acrylic-"), curves, documents, laws, evidence.cases)


def print_knits(found: Sequence[Knit]) -> None:
    print("| swatch | k [N] | stretch to | held-out error: linear | with the effect | fall (95 %) | floor | named |")
    print("|---|---|---|---|---|---|---|---|")
    for one in found:
        before, after = one.errors("before"), one.errors("after")
        low, high = t_interval(before - after)
        words = Counter(d["verdict"] for d in one.documents)
        named = ", ".join(f"`{name}` {count}/5" for name, count in one.named.most_common())
        top = common_steps(one.curves)[-1]
        columns = [
            f"{one.name.replace('-', ', along ')}s", f"{one.laws[''].theta[0]:.1f}", f"{top:.2f}",
            f"{swings.pooled(before):.2f} N", f"{swings.pooled(after):.2f} N", f"{low:.2f} … {high:.2f} N",
            f"{one.floor:.2f} N", f"{named} ({dict(words)})",
        ]  # fmt: skip
        print(f"| {' | '.join(columns)} |")
    print()
    for one in found:
        locking, limit = (one.laws[law] for law in LAWS)
        space = zip(("k", "b", "T₀"), locking.theta, locking.low, locking.high, strict=True)
        print(
            f"{one.name}: " + ", ".join(f"{n} = {value:.3g} ({low:.3g} … {high:.3g})" for n, value, low, high in space)
        )
        a, b = further(one)
        print(f"  limit at strain {1 / limit.theta[1]:.2f}; rms {locking.rms:.3f} (locking), {limit.rms:.3f} N (limit)")
        print(f"  at {FURTHER:g} of the largest strain {a:.1f} and {b:.1f} N; readings within a step "
              f"{standstill(one):.2f} N; correlation with the next step {next_step(locking):.2f}")  # fmt: skip


def further(one: Knit) -> tuple[float, float]:
    """What the two laws say a little beyond the largest stretch that was seen [N]."""
    stretch = np.array([1 + FURTHER * (common_steps(one.curves)[-1] - 1)])
    return tuple(float(answer(one, name, stretch)[0]) for name in LAWS)  # type: ignore[return-value]


def answer(one: Knit, law: str, stretch: np.ndarray) -> np.ndarray:
    from clothbench.modelling.curves import curve_of

    plugins = catalogue()
    effects = [plugins.make("effects", law)] if law else []
    return curve_of(plugins.make("models", MODEL), effects, stretch).run(one.laws[law].theta[None]).force[0]


def standstill(one: Knit) -> float:
    """How far single readings lie from the median of their step of stretch, root-mean-square over all runs [N]."""
    edges, away = common_steps(one.curves), []
    for curve in one.curves:
        stretch, force = loading(curve)
        seen = observed(curve, edges, 0.0)
        step = np.clip(np.searchsorted(edges, stretch, side="right") - 1, 0, len(edges) - 2)
        away.append((force - seen.force[step])[stretch <= edges[-1]])
    return float(np.sqrt(np.nanmean(np.concatenate(away) ** 2)))


def next_step(fitted: Fitted) -> float:
    """Correlation of a run's residual at one step of stretch with the next: 0 for noise."""
    return float(np.mean([np.mean(r[1:] * r[:-1]) / np.mean(r**2) for r in fitted.residual]))


def draw_curves(found: Sequence[Knit], axes: Sequence[Any]) -> None:
    order = sorted(found, key=lambda one: (one.name.endswith("wale"), one.name))
    for axis, one in zip(axes, order, strict=True):
        for case in one.cases:
            axis.plot(case.observation.stretch, case.observation.force, color=GREY, lw=0.7)
        stretch = np.linspace(1.0, common_steps(one.curves)[-1], 100)
        for law, colour, dash in (("", LINEAR, "--"), (LAWS[0], LOCKING, "-"), (LAWS[1], LIMIT, ":")):
            axis.plot(stretch, answer(one, law, stretch), dash, color=colour, lw=1.4, label=law or "linear_stretch")
        stitch, direction = one.name.split("-")
        axis.set_title(f"{stitch}, along {direction}s", fontsize=9)
        axis.set_ylim(-1, 31)
    for axis in axes[4:]:
        axis.set_xlabel("stretch")
    for axis in (axes[0], axes[4]):
        axis.set_ylabel("force [N]")
    axes[0].plot([], [], color=GREY, lw=0.7, label="runs")
    axes[0].legend(frameon=False, fontsize=7, loc="upper left")


def draw_errors(found: Sequence[Knit], axis: Any) -> None:
    for row, one in enumerate(found):
        for when, colour, label in (("before", LINEAR, "linear"), ("after", LOCKING, "with the named effect")):
            errors = one.errors(when)
            axis.plot(errors, [row] * len(errors), "o", ms=3.5, color=colour, alpha=0.8, label=label * (row == 0))
        label = "floor between runs" * (row == 0)
        axis.plot([one.floor] * 2, [row - 0.3, row + 0.3], color="black", lw=1.2, label=label)
    axis.set_yticks(range(len(found)), [one.name.replace("-", ", ") for one in found])
    axis.set(xscale="log", xlabel="error on the run held out [N]")
    axis.xaxis.set_major_formatter("{x:g}")
    axis.set_xticks([0.2, 0.5, 1, 2, 4])
    axis.minorticks_off()
    axis.invert_yaxis()
    axis.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))


def free_folds() -> None:
    folds.print_table()
    with figure_file("fold-heights.svg", 1, 2, (7.2, 3.0)) as axes:
        draw_folds(axes)


def draw_folds(axes: Sequence[Any]) -> None:
    heights, predicted = 1e3 * folds.HEIGHTS, 1e3 * folds.elastica(folds.ETAS)
    left, right = axes
    line = np.array([7.0, 37.0])
    left.plot(line, line, color=LINEAR, lw=1.2, ls="--", label="heavy elastica")
    offset, scale = folds.fitted("offset and scale", folds.HEIGHTS, folds.elastica(folds.ETAS))
    left.plot(line, 1e3 * offset + (1 + scale) * line, color=LOCKING, lw=1.2, label="offset and scale, of the dots")
    ends, far = 1e3 * folds.END_HEIGHTS, 1e3 * folds.elastica(folds.END_ETAS)
    left.plot(far, ends, "o", mfc="none", ms=3.5, color=GREY, label="ends of the table's intervals")
    left.errorbar(predicted, heights, yerr=0.5, fmt="o", ms=4, color="black", lw=1, label="ten fabrics, ± rounding")
    left.set(xlabel="height that η_b predicts [mm]", ylabel="height in the table [mm]")
    left.legend(frameon=False, fontsize=7)
    names = list(folds.EXPLANATIONS)
    for row, name in enumerate(names):
        score = folds.score(name)
        right.plot(1e3 * score.left_out, row, "o", ms=5, color=LOCKING, label="fabric left out" * (row == 0))
        right.plot(1e3 * score.ends, row, "o", mfc="none", ms=5, color=GREY, label="ends of intervals" * (row == 0))
    right.axvline(1e3 * folds.ROUNDING, color="black", lw=1.2, label="rounding")
    right.set_yticks(range(len(names)), names)
    right.invert_yaxis()
    right.set(xlabel="error [mm, rms]", xlim=(0, None))
    right.legend(frameon=False, fontsize=7, loc="lower center", bbox_to_anchor=(0.4, 1.0), ncols=3, columnspacing=0.8)


def robot_swings(data_dir: str, out: Path) -> None:
    recordings = swings.imported(data_dir, out)
    balances = swings.balances(recordings)
    swings.print_balances(balances)
    with figure_file("swing-kernel.svg", 1, 2, (7.2, 2.9)) as axes:
        swings.draw_balances(balances, axes, (LOCKING, LINEAR, LIMIT))
    swings.print_calibrations(swings.calibrations(recordings, out), recordings, out / "airs")
    found = swings.stories(out)
    swings.print_table(found)
    with figure_file("robot-swings.svg", 1, 2, (7.2, 3.2)) as axes:
        swings.draw_stories(found, axes, (LINEAR, LOCKING))


@contextlib.contextmanager
def figure_file(name: str, rows: int, columns: int, size: tuple[float, float]) -> Iterator[Sequence[Any]]:
    """Axes of a figure, in one list; written when the block ends."""
    plt.rcParams.update({"font.size": 8.5, "svg.hashsalt": "clothbench", "svg.fonttype": "none"})
    figure, axes = plt.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)
    for axis in axes.flat:
        axis.spines[["top", "right"]].set_visible(False)
    yield list(axes.flat)
    IMAGES.mkdir(parents=True, exist_ok=True)
    figure.savefig(IMAGES / name, metadata={"Date": None})
    print(IMAGES / name)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    stories = parser.add_subparsers(required=True)
    first = stories.add_parser("knits", help="force-extension curves of eight knits")
    first.add_argument("data_dir", metavar="DATA_DIR", help="folder with the originals")
    first.set_defaults(story=lambda o: knits(o.data_dir))
    stories.add_parser("folds", help="free-fold heights of ten fabrics").set_defaults(story=lambda _: free_folds())
    last = stories.add_parser("swings", help="cloth that a robot swings")
    last.add_argument("data_dir", metavar="DATA_DIR", help="folder with the originals")
    last.add_argument("--out", type=Path, default=Path("swings"), help="where recordings and verdicts are kept")
    last.set_defaults(story=lambda o: robot_swings(o.data_dir, o.out))
    options = parser.parse_args()
    options.story(options)


if __name__ == "__main__":
    main()
