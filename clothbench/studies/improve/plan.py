"""From settings to a cell: everything is read and checked before anything is fitted."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.engine.cells import Source, plugin_versions, resplit
from clothbench.engine.settings import mapping, option_settings, pair
from clothbench.modelling.curves import answers_curves
from clothbench.plugins.discovery import Catalogue, absent
from clothbench.recordings.codec import kind_of
from clothbench.recordings.curve import Curve, read_curve
from clothbench.recordings.nodes import Recording, find_recordings, read_recording
from clothbench.studies.improve.candidates import candidates_of, names
from clothbench.studies.improve.cell import ImproveCell
from clothbench.studies.improve.fitting import search_settings
from clothbench.studies.improve.prepare import prepare
from clothbench.studies.improve.problem import Problem

# Nodes along the longer side, where the user does not say: implicit models take several times as long for a node, and
# what a coarser mesh does to them is known better, since they converge.
NODES, IMPLICIT_NODES = 13, 9
LEAST_NODES = 5
ON_MESHES = ("resolution", "base", "areal_density")  # settings that mean nothing without a mesh


def cell_of(settings: Mapping[str, Any], plugins: Catalogue) -> ImproveCell:
    """The cell of settings as `conf/improve.yaml` has them, or as words of a command line."""
    for key in ("recordings", "model"):
        if not settings.get(key):
            raise ClothbenchError(f"found no {key}=…, expected clothbench improve recordings=DIR model=NAME [out=DIR]")
    paths = find_recordings([settings["recordings"]])
    kind = "curve" if kind_of(paths[0]) == "curve" else "nodes"
    model, seed = settings["model"], whole("seed", settings["seed"])
    loaded = plugins.load("models", model)
    if reason := absent(loaded):
        raise ClothbenchError(f"model {model!r}: {reason}")
    options = option_settings(mapping("options", settings["options"]), plugins)
    require_able(kind, model, options.get(model, {}), plugins)
    scene = {} if kind == "curve" else scene_of_settings(settings, loaded)
    if kind == "curve":
        refuse_what_needs_a_mesh(settings)
    recordings = [read_kind(path, kind) for path in paths]
    cell = ImproveCell(
        recordings=tuple(splits_of(recordings, settings["recordings"], seed)), kind=kind, model=model, base=(),
        candidates=(), tracker=settings["tracker"] if kind == "nodes" else None, optimizer=settings["optimizer"],
        options=options, scene=scene, seed=seed, timeout=positive("timeout", settings["timeout"], "seconds"),
        bounds={name: pair(f"bounds.{name}", b) for name, b in flat(mapping("bounds", settings["bounds"])).items()},
        split_by_seed=not any(r.split for r in recordings),
    )  # fmt: skip
    base = base_of(settings, prepare(cell, plugins), kind)
    candidates = candidates_of(settings["candidates"], kind, base, plugins)
    cell = dataclasses.replace(cell, base=base, candidates=candidates)
    rehearse(cell, plugins)
    return dataclasses.replace(cell, versions=plugin_versions(cell.plugins, plugins))


def require_able(kind: str, model: str, options: Mapping[str, Any], plugins: Catalogue) -> None:
    """Refuse a model that can do nothing with recordings of this kind."""
    if kind == "curve":
        if not answers_curves(plugins.load("models", model)):
            able = [name for name in plugins.names("models") if answers_curves(plugins.load("models", name))]
            raise ClothbenchError(
                f"model {model!r} answers no force-extension curves, and the recordings are such; "
                f"those that do: {', '.join(able)}"
            )
    elif not {"dynamic", "effects"} <= (able := plugins.make("models", model, **options).capabilities):
        raise ClothbenchError(
            f"model {model!r}: found the capabilities {', '.join(sorted(able))}, expected one that moves and takes "
            "effects ('dynamic', 'effects')"
        )


def refuse_what_needs_a_mesh(settings: Mapping[str, Any]) -> None:
    for key in ON_MESHES:
        if settings[key] is not None:
            raise ClothbenchError(f"found {key}=…, which force-extension curves have no use for; leave it out")


def scene_of_settings(settings: Mapping[str, Any], model: Any) -> dict[str, Any]:
    """How fine the mesh is, and the density that stands in where a recording does not know it."""
    nodes = settings["resolution"]
    if nodes is None:
        nodes = IMPLICIT_NODES if getattr(model, "kind", "") == "implicit" else NODES
    density = positive("areal_density", settings["areal_density"], "kg/m²")
    return {"areal_density": density, "resolution": whole("resolution", nodes, LEAST_NODES)}


def read_kind(path: Path, kind: str) -> Recording | Curve:
    """A recording of the kind that all of them have to be of."""
    if kind == "nodes":
        return read_recording(path)
    if (stated := kind_of(path)) != kind:
        raise ClothbenchError(f"{path}: found kind {stated!r} among curves, expected one kind in a folder")
    return read_curve(path)


def splits_of(recordings: Sequence[Recording | Curve], where: str, seed: int) -> list[Source]:
    """The recordings with their splits, as they state or, where none does, by seed; a name stands for one recording."""
    files: dict[str, Any] = {}
    for r in recordings:
        if r.name in files:
            raise ClothbenchError(
                f"{r.path}: found the name {r.name!r}, which {files[r.name]} has too; give each a name of its own"
            )
        files[r.name] = r.path
    sources = resplit([Source(str(r.path), r.name, r.hash, r.split) for r in recordings], seed)
    if not any(s.split == "fit" for s in sources):
        raise ClothbenchError(f"{where}: found only held-out recordings, expected at least one to fit")
    return sources


def base_of(settings: Mapping[str, Any], problem: Problem, kind: str) -> tuple[str, ...]:
    """The effects that belong to the model: those that were named, or else, of a sheet that moves, damping of all
    motion alike, unless a parameter of the model has that dimension already.
    """
    if settings["base"] is not None:
        base = tuple(names(settings["base"]))
        for name in base:
            problem.plugins.find("effects", name)
        return base
    damping = settings["damping"]
    if kind == "curve" or damping not in problem.plugins.names("effects"):
        return ()
    unit = problem.make("effects", damping).parameters.parameters[0].unit
    return () if any(p.unit == unit for p in problem.space(())) else (damping,)


def rehearse(cell: ImproveCell, plugins: Catalogue) -> None:
    """Make everything once without simulating: what is wrong in options and bounds comes to light before a run."""
    problem = prepare(cell, plugins)
    space = problem.space(())
    problem.plugins.make("optimizers", cell.optimizer, space, seed=0, budget=1, **search_settings(problem, first=True))
    own = {name: problem.make("effects", name).parameters.prefixed(name) for name in cell.candidates}
    known = sorted([*space.names, *(p.name for one in own.values() for p in one)])
    if strays := [name for name in cell.bounds if name not in known]:
        raise ClothbenchError(f"setting 'bounds': no parameter {strays[0]!r}; there are: {', '.join(known)}")


def flat(nested: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """ "effect.parameter" → bounds, where a parser of settings has taken the dot for a level."""
    out: dict[str, Any] = {}
    for name, value in nested.items():
        out |= flat(value, f"{above}{name}.") if isinstance(value, Mapping) else {above + name: value}
    return out


def whole(name: str, value: Any, least: int = 0) -> int:
    """A whole number, of settings or of a word."""
    text = str(value)
    if not text.isdecimal() or int(text) < least:
        raise ClothbenchError(f"{name} is {text!r}, expected a whole number, at least {least}")
    return int(text)


def positive(name: str, value: Any, unit: str) -> float | None:
    """A number above 0; None if nothing was stated."""
    if value is None:
        return None
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not (math.isfinite(number) and number > 0):
        raise ClothbenchError(f"{name} is {str(value)!r}, expected {unit}, above 0")
    return number
