"""Settings of the command line that change nothing: told, or refused where they can only be a mistake."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.core.optional import objectives_of
from clothbench.engine.study import Cell
from clothbench.plugins.discovery import OWN, catalogue


def say_idle(words: Sequence[str], cells: Sequence[Cell], config: Mapping[str, Any]) -> None:
    """A line for each setting of words (KEY=VALUE) that changes nothing in any of the cells, which are those of the
    settings `config`; what a suite says is for its other models.
    """
    used = {plugin.partition("/")[2] for cell in cells for plugin in cell.versions}
    named = {found[1] for word in words if (found := re.match(r"\+{0,2}options\.([^.=]+)[.=]", word))}
    for name in sorted(named - used):
        _say(f"options.{name}", f"{name} is not in use here")
    for name in sorted(set(_overruled(words, cells))):
        _say(
            f"options.{name}.resolution",
            "the scene says how fine the mesh is (scene.resolution, scene.spacing; of improve, resolution)",
        )
    if any(word.startswith("choice=") for word in words) and (metric := _of_one_objective(cells)):
        _say("choice", f"{metric} has one objective, and no front to choose from")
    recordings = config.get("recording") or config.get("recordings") or (config.get("suite") or {}).get("recordings")
    if any(word.startswith("data_dir=") for word in words) and "dataset:" not in str(recordings):
        _say("data_dir", "no recordings of a data set are named (recordings=dataset:NAME)")


def say_alone(config: Mapping[str, Any], cells: Sequence[Cell]) -> None:
    """A line where recordings that state no fabric are cases of their own, so that nothing is held out of any."""
    alone = {c.case for c in cells if [s.name for s in getattr(c, "recordings", ())] == [c.case]}
    if len(alone) > 1 and not (config.get("suite") or {}).get("case"):
        print(
            f"clothbench: {len(alone)} recordings state no fabric, so each is a case of its own with nothing held out; "
            "suite.case=all takes them together",
            file=sys.stderr,
        )


def say_split(cells: Sequence[Any]) -> None:
    """A line on what the seed holds out, for each case of `improve` in which no recording states a split."""
    drawn = [cell for cell in cells if getattr(cell, "split_by_seed", False)]
    several = len({cell.case for cell in drawn}) > 1
    for case, cell in {cell.case: cell for cell in drawn}.items():
        held = ", ".join(s.name for s in cell.of_split("held_out")) or "none"
        where = f"{case}: " if several else ""
        print(f"clothbench: {where}no recording states a split; held out by seed {cell.seed}: {held}", file=sys.stderr)


def _say(setting: str, why: str) -> None:
    print(f"clothbench: {setting}: {why}, so this changes nothing", file=sys.stderr)


def _overruled(words: Sequence[str], cells: Sequence[Any]) -> Iterator[str]:
    """Models that are told how fine a mesh to make, of cells whose scene says it."""
    for cell in cells:
        scene, model = getattr(cell, "scene", {}), str(getattr(cell, "model", ""))
        told = any(word.lstrip("+").startswith(f"options.{model}.resolution=") for word in words)
        # Of a stranger's model nobody knows which of both it follows.
        if told and (scene.get("resolution") or scene.get("spacing")) and _is_own("models", model):
            yield model


def _of_one_objective(cells: Sequence[Any]) -> str:
    """The metrics of the cells that are to choose from a front, where none of them can have one."""
    choosing = {cell.metric: cell for cell in cells if getattr(cell, "choice", "nearest") != "nearest"}
    for name, cell in choosing.items():
        if not _is_own("metrics", name):  # a stranger's code is for its own cell
            return ""
        with suppress(ClothbenchError):
            if len(objectives_of(catalogue().make("metrics", name, **cell.options.get(name, {})))) > 1:
                return ""
    return ", ".join(sorted(choosing))


def _is_own(kind: str, name: Any) -> bool:
    with suppress(ClothbenchError):
        return catalogue().find(kind, name).distribution == OWN
    return False


def refuse_idle(words: Sequence[str], settings: Mapping[str, Any], cells: Sequence[Any]) -> None:
    """Refuse an analysis that the command line asks of cases (analysis.NAME.cases=…) none of which is run."""
    named = {found[1] for word in words if (found := re.match(r"\+{0,2}analysis\.([^.=]+)\.cases=", word))}
    for name in sorted(named - {name for cell in cells for name in getattr(cell, "analysis", ())}):
        asked = settings["analysis"][name]["cases"]
        there = ", ".join(sorted({case for cell in cells for case in cell.cases}))
        raise ClothbenchError(
            f"setting 'analysis.{name}.cases' is {asked}, which matches none of the cases {there}; name one of them"
        )
