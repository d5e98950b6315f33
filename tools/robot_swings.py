"""The robot's swings of docs/real-cloth.md: what `improve` says of each cloth and model; see `real_cloth.py swings`."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from clothbench.datasets.convert import converted

DATASET = "iri_wam_cloth_swing"
# As in the suite `iri_swing`. The originals do not say the density: that of a light cotton [kg/m²].
SETTINGS = ("areal_density=0.10", "resolution=8")
# Recordings that belong together, by the beginning of their names, and the models that are asked about them.
SWINGS = (("2021_07_05-n8-range30", "oscillations, range 30", ("mass_spring",)),)

RESTS = 1.0  # [s] the arm has not begun to move
NEAREST = 4  # candidates of each round that are told of


@dataclass(frozen=True)
class Story:
    """One cloth and motion beside one model: where `improve` left its verdict, and that verdict."""

    motion: str
    model: str
    folder: Path
    verdict: dict[str, Any]

    @property
    def errors(self) -> dict[str, Any]:
        return self.verdict["error_mm"]

    @property
    def named(self) -> str:
        return ", ".join(" or ".join(f"`{n}`" for n in (e["name"], *e["tied_with"])) for e in self.verdict["effects"])

    def table(self, name: str) -> pd.DataFrame:
        return pd.read_parquet(self.folder / "tables" / f"{name}.parquet")


def stories(data_dir: str, out: Path) -> list[Story]:
    """Import what is not yet in `out`, and judge it; what was judged before is kept, so that a stopped run goes on."""
    recordings = out / "recordings"
    if not recordings.is_dir():
        converted(DATASET, data_dir=data_dir, out=recordings)
    return [told(group, motion, model, out) for group, motion, models in SWINGS for model in models]


def told(group: str, motion: str, model: str, out: Path) -> Story:
    folder, place = out / "groups" / group, out / f"{group}-{model}"
    folder.mkdir(parents=True, exist_ok=True)
    for path in (out / "recordings").glob(f"iri-{group}-*.nc"):
        if not (folder / path.name).exists():
            (folder / path.name).symlink_to(path.resolve())
    words = [f"recordings={folder}", f"model={model}", f"out={place}", *SETTINGS]
    print(group, model, file=sys.stderr)
    subprocess.run([sys.executable, "-m", "clothbench", "improve", *words], check=True, stdout=subprocess.DEVNULL)
    return Story(motion, model, place, json.loads((place / "verdict.json").read_text()))


def print_table(found: Sequence[Story]) -> None:
    print("| motion | model | held out: before | after | floor | verdict |")
    print("|---|---|---|---|---|---|")
    for one in found:
        held, floor = one.errors["held_out"], one.errors["noise_floor"]
        said = f"{one.verdict['verdict']} {one.named}".strip()
        errors = [f"{value:.1f} mm" for value in (held["before"], held["after"], floor)]
        print(f"| {' | '.join([one.motion, f'`{one.model}`', *errors, said])} |")
    for one in found:
        print_details(one)
        for effect in one.verdict["effects"]:
            amounts = ", ".join(
                f"{name} = {p['value']:.3g} ({p['low']:.3g} … {p['high']:.3g}) {p['unit']}"
                for name, p in effect["parameters"].items()
            )
            chance = f"p = {effect['p_value']:.3g}, {effect['selected_in']}"
            print(f"{one.motion}, {one.model}: {effect['name']}: {amounts}; {chance}")
        print(f"{one.motion}, {one.model}: {one.verdict['hint']}; {one.verdict['wall_s']:.0f} s")


def print_details(one: Story) -> None:
    """What the calibrated model gets wrong on recordings held out, what it came to, and what was tried beside it."""
    held = "split == 'held_out'"
    portrait = one.table("portrait").query(f"{held} and fit == 'before'")
    parts = ", ".join(f"{name} {pooled(portrait[name]):.1f} mm" for name in ("normal", "warp", "weft"))
    frames, nodes = one.table("frames").query(held), one.table("nodes").query(held)
    resting, peak = frames[frames.time < RESTS], frames.groupby("recording").before.max()
    thirds = nodes.groupby(pd.cut(nodes.v / nodes.v.max(), 3, labels=False)).before.agg(pooled)
    print(f"{one.motion}, {one.model}: {parts}; correlation with the next frame {portrait.next_frame.mean():.2f}")
    print(f"  first {RESTS:g} s {pooled(resting.before):.1f} mm, peaks {peak.min():.0f} … {peak.max():.0f} mm; thirds "
          f"of the cloth from v = 0 on: {', '.join(f'{value:.1f}' for value in thirds)} mm")  # fmt: skip
    for row in one.table("parameters").query("fit == 'before'").itertuples():
        end = ", at its bound" * row.at_bound
        print(f"  {row.symbol} = {row.value:.3g} ({row.low:.3g} … {row.high:.3g}) {row.unit}{end}")
    for turn, rows in one.table("candidates").groupby("round"):
        for row in rows.head(NEAREST).itertuples():
            print(f"  round {turn}: {row.name}: to first order {row.share:.1%}, p = {row.p_value:.3g}, fitted "
                  f"{row.gain:.3g} {row.unit}, chosen {row.selected} of {row.of}; {row.why_not}")  # fmt: skip


def pooled(errors: np.ndarray | pd.Series[float]) -> float:
    """Root-mean-square."""
    return float(np.sqrt(np.mean(errors**2)))


def draw_stories(found: Sequence[Story], axes: Sequence[Any], colours: tuple[str, str]) -> None:
    """Held-out errors of every recording before and after; and over time, in the recording that is worst before."""
    left, right = axes
    for row, one in enumerate(found):
        for when, colour in zip(("before", "after"), colours, strict=True):
            errors = [r[when] for r in one.errors["held_out"]["per_recording"]]
            label = {"before": "calibrated", "after": "with what was named"}[when] * (row == 0)
            left.plot(errors, [row] * len(errors), "o", ms=3.5, color=colour, alpha=0.8, label=label)
        floor = [one.errors["noise_floor"]] * 2
        left.plot(floor, [row - 0.3, row + 0.3], color="black", lw=1.2, label="floor of noise and mesh" * (row == 0))
    left.set_yticks(range(len(found)), [f"{one.motion}\n{one.model}" for one in found], fontsize=7)
    left.invert_yaxis()
    left.set(xlabel="error on recordings held out [mm]", xlim=(0, None))
    left.legend(frameon=False, fontsize=7, ncols=3, loc="lower center", bbox_to_anchor=(0.4, 1.0), columnspacing=0.8)
    one = next(one for one in found if one.verdict["effects"]) if any(o.verdict["effects"] for o in found) else found[0]
    worst = max(one.errors["held_out"]["per_recording"], key=lambda r: r["before"])["recording"]
    frames = one.table("frames")
    frames = frames[frames.recording == worst]
    for when, colour in zip(("before", "after"), colours, strict=True):
        right.plot(frames.time, frames[when], color=colour, lw=1.0)
    right.axhline(one.errors["noise_floor"], color="black", lw=1.0)
    right.set(xlabel="time [s]", ylabel="error over the cloth [mm]", ylim=(0, None))
    right.set_title(f"{worst}, {one.model}", fontsize=7.5)
