"""`clothbench improve`: recordings and a model in, the verdict on what the model lacks out."""

from __future__ import annotations

import dataclasses
import json
import math
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from clothbench.core.errors import ClothbenchError
from clothbench.core.protocols import Effect
from clothbench.engine.cells import Source, resplit
from clothbench.engine.checkpoint import Checkpoint as Memory
from clothbench.engine.settings import writable
from clothbench.modelling.curves import acts_on_sheets
from clothbench.plugins.discovery import Catalogue, absent, catalogue
from clothbench.recordings.codec import kind_of
from clothbench.recordings.curve import Curve
from clothbench.recordings.nodes import Recording, find_recordings, read_recording
from clothbench.recordings.scenes import scene_of
from clothbench.studies.improve.files import json_text, write_folder
from clothbench.studies.improve.fitting import ENOUGH
from clothbench.studies.improve.problem import Case, Problem
from clothbench.studies.improve.rounds import improve
from clothbench.studies.improve.verdict import judged

KEYS = ("recordings", "model", "out", "candidates", "seed", "resolution", "base", "areal_density")
# Along the longer side, where the user does not say: implicit models take several times as long for a node, and what a
# coarser mesh does to them is known better, since they converge.
NODES, IMPLICIT_NODES = 13, 9
DAMPING = "linear_drag"  # what every model is given that has no damping of its own that takes all motion alike


def command(settings: Mapping[str, str], as_json: bool = False) -> int:
    """Run the loop with settings as KEY=VALUE words gave them, and print the verdict: in words, or as the document."""
    plugins = catalogue()
    for key in ("recordings", "model"):
        if not settings.get(key):
            raise ClothbenchError(f"found no {key}=…, expected clothbench improve recordings=DIR model=NAME [out=DIR]")
    if kind_of(find_recordings([settings["recordings"]])[0]) == "curve":
        from clothbench.cli.improve_curves import command as on_curves

        return on_curves(settings, as_json)
    out = writable(settings.get("out", "improve"))
    problem = dataclasses.replace(problem_of(settings, plugins), memory=Memory(out / ".unfinished"))
    candidates = candidates_of(settings.get("candidates"), plugins, problem)
    tell_splits(problem)
    key = problem.key("verdict", candidates)
    if (kept := finished(out, key)) is not None:
        print(f"{out}: kept, these recordings were judged with the same settings before", file=sys.stderr)
        print(json_text(kept)) if as_json else say(kept, out)
        return 0
    with StageBar() as bar:
        outcome = improve(problem, candidates, bar.stage)
        found = judged(outcome) | {"key": key}
        bar.stage("page, tables and Rerun files", 0, 1)
        write_folder(out, outcome, found)
        problem.memory.forget()
    print(json_text(found)) if as_json else say(found, out)
    return 0


def finished(out: Path, key: str) -> dict[str, Any] | None:
    """The verdict that already lies in `out`, if it is of exactly this question."""
    try:
        found = json.loads((out / "verdict.json").read_text())
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and found.get("key") == key else None


def problem_of(settings: Mapping[str, str], plugins: Catalogue) -> Problem:
    """Everything read and checked before anything is run."""
    model, seed = settings["model"], whole("seed", settings.get("seed", "0"))
    kind = plugins.load("models", model)
    if reason := absent(kind):
        raise ClothbenchError(f"model {model!r}: {reason}")
    if not {"dynamic", "effects"} <= (able := plugins.make("models", model).capabilities):
        raise ClothbenchError(
            f"model {model!r}: found the capabilities {', '.join(sorted(able))}, expected one that moves and takes "
            "effects ('dynamic', 'effects')"
        )
    recordings = [read_recording(path) for path in find_recordings([settings["recordings"]])]
    splits = splits_of(recordings, settings["recordings"], seed)
    tracker, density = plugins.make("trackers", "markers"), density_of(settings)
    usual = IMPLICIT_NODES if getattr(kind, "kind", "") == "implicit" else NODES
    nodes = whole("resolution", settings.get("resolution", str(usual)), 5)
    cases = tuple(
        Case(r.name, split, r, tracker.track(r), scene_of(r, areal_density=density, resolution=shape_of(r, nodes)))
        for r, split in zip(recordings, splits, strict=True)
    )
    problem = Problem(model, cases, plugins, seed=seed)
    base = names(settings["base"]) if "base" in settings else default_base(problem)
    for name in base:
        plugins.find("effects", name)
    return dataclasses.replace(problem, base=tuple(base))


def splits_of(recordings: Sequence[Recording | Curve], where: str, seed: int) -> list[str]:
    """ "fit" or "held_out" for each, as it states or, where none does, by seed; a name stands for one recording."""
    files: dict[str, str | Path | None] = {}
    for r in recordings:
        if r.name in files:
            raise ClothbenchError(
                f"{r.path}: found the name {r.name!r}, which {files[r.name]} has too; give each a name of its own"
            )
        files[r.name] = r.path
    sources = resplit([Source(r.path, r.name, r.hash, r.split) for r in recordings], seed)
    if not any(s.split == "fit" for s in sources):
        raise ClothbenchError(f"{where}: found only held-out recordings, expected at least one to fit")
    return [s.split for s in sources]


def tell_splits(problem: Problem) -> None:
    """What is held out by seed, since no recording says it, is told to the user, and that there are too few to name
    anything: once all else has been checked.
    """
    fitted = len(problem.of_split("fit"))
    if fitted < ENOUGH:
        print(f"clothbench: {fitted} recordings to fit; an effect can be named from {ENOUGH} on", file=sys.stderr)
    if not any(c.recording.split for c in problem.cases):
        held = ", ".join(c.name for c in problem.cases if c.split == "held_out") or "none"
        print(f"clothbench: no recording states a split; held out by seed {problem.seed}: {held}", file=sys.stderr)


def shape_of(recording: Recording, nodes: int) -> tuple[int, int]:
    """Nodes along (u, v) of cells as nearly square as may be, so many along the longer side."""
    cell = max(recording.cloth_width, recording.cloth_height) / (nodes - 1)
    return max(3, round(recording.cloth_width / cell) + 1), max(3, round(recording.cloth_height / cell) + 1)


def density_of(settings: Mapping[str, str]) -> float | None:
    """kg/m², what stands in where a recording does not know it; None if nothing was stated."""
    if (text := settings.get("areal_density")) is None:
        return None
    try:
        density = float(text)
    except ValueError:
        density = math.nan
    if not (math.isfinite(density) and density > 0):
        raise ClothbenchError(f"areal_density is {text!r}, expected kg/m², above 0")
    return density


def default_base(problem: Problem) -> list[str]:
    """Damping of all motion alike, unless a parameter of the model has that dimension already."""
    if DAMPING not in problem.plugins.names("effects"):
        return []
    unit = problem.plugins.make("effects", DAMPING).parameters.parameters[0].unit
    return [] if any(p.unit == unit for p in problem.space(())) else [DAMPING]


def candidates_of(given: str | None, plugins: Catalogue, problem: Problem) -> list[str]:
    """All installed effects that the model does not have, or those that were named."""
    effects = asked_for(given, plugins)
    on_sheets = {name: effect for name, effect in effects.items() if acts_on_sheets(effect)}
    if given and (stray := next((name for name in effects if name not in on_sheets), None)):
        raise ClothbenchError(f"effect {stray!r} acts on force-extension curves only; take it out of candidates")
    if given and (owned := next((name for name in effects if name in problem.base), None)):
        raise ClothbenchError(f"effect {owned!r} is in the base already; take it out of candidates, or state base=")
    return sensors_first({name: effect for name, effect in on_sheets.items() if name not in problem.base})


def asked_for(given: str | None, plugins: Catalogue) -> dict[str, Effect]:
    """The effects that were named; or else all that can be used, and the user is told of the others."""
    if given is not None:
        if not names(given):
            raise ClothbenchError(f"candidates is {given!r}, expected names of effects; left out, all are tried")
        return {name: plugins.make("effects", name) for name in names(given)}
    sound, broken = plugins.made("effects")
    for reason in broken.values():
        print(f"clothbench: no candidate: {reason}", file=sys.stderr)
    return sound


def sensors_first(effects: Mapping[str, Effect]) -> list[str]:
    """The order of trying: how the cloth was seen and held may look like physics."""
    order = {"sensor": 0, "boundary": 1, "dynamics": 2}
    return sorted(effects, key=lambda name: order.get(effects[name].place, 3))


def names(text: str) -> list[str]:
    return [word for word in text.strip("[]").replace(" ", "").split(",") if word]


def whole(name: str, text: str, least: int = 0) -> int:
    if not text.isdecimal() or int(text) < least:
        raise ClothbenchError(f"{name} is {text!r}, expected a whole number, at least {least}")
    return int(text)


class StageBar:
    """Which stage the loop is in and how far; without a terminal, one line for each stage."""

    def __init__(self) -> None:
        console = Console(stderr=True)
        self.live, self.last = console.is_terminal, ""
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        self.bar = Progress(*columns, console=console, disable=not self.live)
        self.task = self.bar.add_task("read", total=None)

    def __enter__(self) -> StageBar:
        self.bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.stop()

    def stage(self, name: str, done: int, planned: int) -> None:
        self.bar.update(self.task, description=name, completed=done, total=planned)
        if not self.live and name != self.last:
            print(name, file=sys.stderr)
        self.last = name


def say(found: Mapping[str, Any], out: Path) -> None:
    """The verdict in a few lines."""
    curves = found.get("kind") == "curve"
    error, unit, digits = (found["error"], "N", ".3g") if curves else (found["error_mm"], "mm", ".2f")
    held = error["held_out"]
    print(f"verdict: {found['verdict']}")
    for effect in found["effects"]:
        tied = f", tied with {', '.join(effect['tied_with'])}" if effect["tied_with"] else ""
        print(f"  {effect['name']} ({effect['place']}): {effect['summary']}{tied}")
        print(f"    p = {effect['p_value']:.3g}, chosen in {effect['selected_in']} of the leave-one-out rounds")
        for name, p in effect["parameters"].items():
            low, high = (("?" if p[k] is None else f"{p[k]:.4g}") for k in ("low", "high"))
            print(f"    {name} = {p['value']:.4g} {p['unit']} ({low} … {high})")
    print(f"fit recordings: {error['fit']['before']:{digits}} → {error['fit']['after']:{digits}} {unit}", end="")
    if held["before"] is not None:
        print(f"; held out: {held['before']:{digits}} → {held['after']:{digits}} {unit}", end="")
    print(f"; floor {'between runs' if curves else 'of noise and mesh'}: {error['noise_floor']:{digits}} {unit}")
    if found["hint"]:
        print(f"hint: {found['hint']}")
    print(f"{found['evaluations']} evaluations, {found['wall_s']:.0f} s")
    print(f"page: {out / 'index.html'}")
    rerun = "" if curves else f"; Rerun files: {out / 'rerun'}"
    print(f"verdict: {out / 'verdict.json'}; tables: {out / 'tables'}{rerun}")
    if curves:
        return
    recordings = [*found["recordings"]["held_out"], *found["recordings"]["fit"]]
    print(f"look at one with: clothbench view {shlex.quote(recordings[0])} --out {shlex.quote(str(out))}")
