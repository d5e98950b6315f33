"""The robot's swings of docs/real-cloth.md: what the recordings say without a model, what each air leaves of them, and
what `improve` names; see `real_cloth.py swings`.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from clothbench import Observation, Scene
from clothbench.datasets.convert import converted
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.nodes import Recording, read_recording
from clothbench.recordings.scenes import scene_of
from clothbench.studies.improve.motion import motion_of
from clothbench.studies.improve.torque import Balance, balance_of

DATASET = "iri_wam_cloth_swing"
# As in the suite `iri_swing`. The originals do not say the density: that of a light cotton [kg/m²].
SETTINGS = ("areal_density=0.10", "resolution=8")
STIFFEST = "[1,200]"  # N/m, bound of k1: stiffer springs move nothing that the camera sees, and take smaller steps
# Recordings that belong together, by the beginning of their names, and the models that are asked about them.
SWINGS = tuple(
    (f"2021_07_05-n8-range{size}", f"oscillations, range {size}", ("mass_spring",)) for size in (30, 60, 90, 120)
)
SESSIONS = ("2021_07_05-n8", "2021_06_23-n13", "2021_06_23-n4")  # with the lattice on which it was seen
# Springs that the swings do not determine: held, so that the airs alone are compared.
HELD = ("+bounds.k1=[99,101]", "+bounds.k2=[0.99,1.01]", "+bounds.zeta=[0.099,0.101]")
AIRS = ("linear_drag", "linear_drag,added_mass", "air_memory", "air_memory,gravity_tilt")

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


def imported(data_dir: str, out: Path) -> Path:
    """The folder of the recordings, imported if it is not there."""
    if not (recordings := out / "recordings").is_dir():
        converted(DATASET, data_dir=data_dir, out=recordings)
    return recordings


def stories(out: Path) -> list[Story]:
    """Every question asked of the recordings in `out`; what was asked before is kept, so that a stopped run goes on."""
    return [told(group, motion, model, out) for group, motion, models in SWINGS for model in models]


def told(group: str, motion: str, model: str, out: Path) -> Story:
    folder, place = out / "groups" / group, out / f"{group}-{model}"
    folder.mkdir(parents=True, exist_ok=True)
    for path in (out / "recordings").glob(f"iri-{group}-*.nc"):
        if not (folder / path.name).exists():
            (folder / path.name).symlink_to(path.resolve())
    words = [f"recordings={folder}", f"model={model}", f"out={place}", f"bounds.k1={STIFFEST}", *SETTINGS]
    print(group, model, file=sys.stderr)
    subprocess.run([sys.executable, "-m", "clothbench", "improve", *words], check=True, stdout=subprocess.DEVNULL)
    return Story(motion, model, place, json.loads((place / "verdict.json").read_text()))


def balances(recordings: Path) -> dict[str, Balance]:
    """What the recordings to fit of each session say without any model, where they say something."""
    out = {}
    for session in SESSIONS:
        read = [read_recording(path) for path in sorted(recordings.glob(f"iri-{session}-*.nc"))]
        motions = [motion_of(*beside(r), r.noise_sigma) for r in read if r.split == "fit"]
        if (found := balance_of(motions, seed=0)) is not None:
            out[session] = found
    return out


def beside(recording: Recording) -> tuple[Observation, Scene]:
    density = float(SETTINGS[0].partition("=")[2])
    seen = catalogue().make("trackers", "markers").track(recording)
    nodes = max(8, len(np.unique(recording.grip_material[:, 0])))  # a mesh line through every clip of the bar
    return seen, scene_of(recording, areal_density=density, resolution=(nodes, nodes))


def print_balances(found: Mapping[str, Balance]) -> None:
    for session, one in found.items():
        shares = ", ".join(f"{what} {share:.0%}" for what, share in one.past.shares)
        law = f"; {one.law.formula}, p = {one.law.p_value:.3g}" if one.law else "; no law"
        print(f"{session}, torque about the hanger, predicted on recordings left out: {shares}{law}")
        for amount in one.law.amounts if one.law else ():
            print(f"  {amount.term.name}: {amount.value:.3g} ({amount.low:.3g} … {amount.high:.3g}) {amount.term.unit}")


def draw_balances(found: Mapping[str, Balance], axes: Sequence[Any], colours: Sequence[str]) -> None:
    """The kernel over lag of each session, and what the torque goes with."""
    left, right = axes
    for (session, one), colour in zip(found.items(), colours, strict=False):
        past = one.past
        left.fill_between(past.lag, past.low, past.high, color=colour, alpha=0.2, lw=0)
        left.plot(past.lag, past.value, color=colour, lw=1.5, label=session)
        names = [what.replace(" and ", " and\n") for what, _ in past.shares]
        right.plot(names, [100 * share for _, share in past.shares], "o-", color=colour, lw=0.8)
    left.axhline(0.0, color="black", lw=0.6)
    left.set(xlabel="time since the sheet changed its speed [s]", ylabel="K [kg/(m²·s)]", xlim=(0, None))
    left.legend(frameon=False, fontsize=7)
    right.set(ylabel="torque predicted, left out [%]", ylim=(0, 100))


def calibrations(recordings: Path, out: Path) -> pd.DataFrame:
    """Rows of the leaderboard: `mass_spring` with each air, fitted to each session, judged on its held-out repeats."""
    store = out / "airs"
    for air in AIRS:
        words = [f"recordings={recordings}", f"effects=[{air}]", *HELD, "budget=40", "rerun=false", f"out={store}"]
        command = [sys.executable, "-m", "clothbench", "run", "+suite=iri_swing", *words]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    command = [sys.executable, "-m", "clothbench", "leaderboard", "--json", "--out", str(store)]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    rows = pd.DataFrame(json.loads(printed))
    return rows[(rows.metric == "node_error") & rows.recording.notna() & rows.status.eq("ok")]


def print_calibrations(rows: pd.DataFrame, recordings: Path, store: Path) -> None:
    """Mean node distance held out by session and range; amounts; and of each session with the amounts of another."""
    held = rows[rows.split == "held_out"].copy()
    held["range"] = held.recording.str.extract(r"-(range\d+|traj\d+)-")[0]
    print(held.pivot_table("value", ["case", "range"], "effects", aggfunc="mean").round(1).to_string())
    print(held.pivot_table("value", "case", "effects", aggfunc="mean").round(2).to_string())
    for (case, air), mine in rows.groupby(["case", "effects"]):
        amounts = pd.read_parquet(store / "cells" / mine.key.iloc[0] / "parameters.parquet")
        said = ", ".join(f"{p.name} {p.value:.3g} ({p.low:.3g} … {p.high:.3g}) {p.unit}" for p in amounts.itertuples())
        print(f"{case}, {air}: {said}")
        theta = dict(zip(amounts.name, amounts.value, strict=True))
        for session in SESSIONS:
            if not case.endswith(session):
                error = unchanged(theta, tuple(air.split(",")), session, recordings)
                print(f"  unchanged on {session}, held out: {error:.2f} mm")


def unchanged(theta: Mapping[str, float], air: Sequence[str], session: str, recordings: Path) -> float:
    """Mean node distance [mm] on the held-out recordings of a session, of given parameters."""
    model, metric = catalogue().make("models", "mass_spring"), catalogue().make("metrics", "node_error")
    effects, errors = [catalogue().make("effects", name) for name in air], []
    for path in sorted(recordings.glob(f"iri-{session}-*.nc")):
        if (recording := read_recording(path)).split != "held_out":
            continue
        observation, scene = beside(recording)
        simulation = model.prepare(scene, effects)
        rollout = simulation.run(np.array([[theta[p.name] for p in simulation.parameters]]))
        errors.append(float(metric(observation, rollout).value[0]))
    return float(np.mean(errors))


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
