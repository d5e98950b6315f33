"""`clothbench improve`: recordings and a model in, the verdict on what the model lacks out."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from clothbench.core.errors import ClothbenchError
from clothbench.engine.checkpoint import Checkpoint
from clothbench.engine.settings import writable
from clothbench.plugins.discovery import Catalogue, catalogue
from clothbench.studies.improve.candidates import unusable
from clothbench.studies.improve.cell import ImproveCell
from clothbench.studies.improve.files import json_text, write_folder
from clothbench.studies.improve.plan import cell_of
from clothbench.studies.improve.prepare import find
from clothbench.studies.improve.settings import LOOP

NESTED = ("options", "bounds")  # settings that are told as KEY.NAME=VALUE
TYPED = (*NESTED, "timeout")  # the others are words, which the plan reads


def command(words: Sequence[str], as_json: bool = False) -> int:
    """Run the loop with settings as KEY=VALUE words gave them, and print the verdict: in words, or as the document."""
    plugins, settings = catalogue(), settings_of(words)
    out = writable(settings["out"])
    cell = cell_of(settings, plugins)
    for remark in remarks(cell, plugins, all_tried=settings["candidates"] is None):
        print(f"clothbench: {remark}", file=sys.stderr)
    if (kept := finished(out, cell.key)) is not None:
        print(f"{out}: kept, these recordings were judged with the same settings before", file=sys.stderr)
        print(json_text(kept)) if as_json else say(kept, out)
        return 0
    checkpoint = Checkpoint(out / ".unfinished")
    with StageBar() as bar:
        finding = find(cell, plugins, checkpoint, bar.stage)
        bar.stage("page, tables and Rerun files", 0, 1)
        document = write_folder(out, finding)
        checkpoint.forget()
    print(json_text(document)) if as_json else say(document, out)
    return 0


def settings_of(words: Sequence[str]) -> dict[str, Any]:
    """What `conf/improve.yaml` says, with "key=value" words over it; anything else is refused."""
    default = OmegaConf.create(files("clothbench.conf").joinpath("improve.yaml").read_text())
    settings: dict[str, Any] = OmegaConf.to_container(default)  # type: ignore[assignment]
    for word in words:
        key, sign, value = word.partition("=")
        first = key.partition(".")[0]
        if not sign or first not in settings or (key != first and first not in NESTED):
            raise ClothbenchError(f"found {word!r}, expected {' or '.join(f'{a}=VALUE' for a in settings)}")
        if first not in TYPED:
            settings[key] = value
            continue
        try:
            given: Any = OmegaConf.to_container(OmegaConf.from_dotlist([word]))
        except OmegaConfBaseException as fault:
            raise ClothbenchError(f"found {word!r}: {str(fault).splitlines()[0]}") from fault
        settings = merged(settings, given)
    return settings


def merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Two nested mappings in one; `above` has the last word."""
    out = dict(below)
    for key, value in above.items():
        nested = isinstance(value, Mapping) and isinstance(out.get(key), Mapping)
        out[key] = merged(out[key], value) if nested else value
    return out


def remarks(cell: ImproveCell, plugins: Catalogue, all_tried: bool) -> list[str]:
    """What the user may not have meant: effects that cannot be tried, too few recordings, a split that no recording
    states.
    """
    out = [f"no candidate: {reason}" for reason in (unusable(plugins) if all_tried else ())]
    fitted, least = len(cell.of_split("fit")), LOOP.least_recordings
    if fitted < least:
        out.append(f"{fitted} recordings to fit; an effect can be named from {least} on")
    if cell.split_by_seed:
        held = ", ".join(s.name for s in cell.of_split("held_out")) or "none"
        out.append(f"no recording states a split; held out by seed {cell.seed}: {held}")
    return out


def finished(out: Path, key: str) -> dict[str, Any] | None:
    """The verdict that already lies in `out`, if it is of exactly this question."""
    try:
        found = json.loads((out / "verdict.json").read_text())
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and found.get("key") == key else None


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
