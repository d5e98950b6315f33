"""From settings to a cell: everything is read and checked before anything is fitted."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.core.optional import absent, kind_of_model, textile_of
from clothbench.core.progress import FileProgress
from clothbench.core.scene import AIR_DENSITY
from clothbench.engine.cells import Source, matching, plugin_versions, require_own_names, resplit
from clothbench.engine.run import TRACKED
from clothbench.engine.settings import one_word, refuse, refuse_strays, require_plugins, some_words, whole
from clothbench.engine.suite import where
from clothbench.estimation.front import CHOICES
from clothbench.estimation.prior import prior_of
from clothbench.modelling.curves import answers_curves
from clothbench.plugins.discovery import Catalogue
from clothbench.recordings.codec import kind_of
from clothbench.recordings.curve import LAYOUT as CURVES
from clothbench.recordings.curve import read_curve
from clothbench.recordings.kinds import read_sheet
from clothbench.recordings.scenes import areal_density_of, refuse_stated_weight
from clothbench.recordings.silhouette import LAYOUT as DRAPES
from clothbench.reference.presets import Preset, preset
from clothbench.studies.improve.candidates import candidates_of, names
from clothbench.studies.improve.cell import ImproveCell
from clothbench.studies.improve.fitting import search_settings
from clothbench.studies.improve.prepare import prepare
from clothbench.studies.improve.problem import Problem

# Nodes along the longer side, where the user does not say: implicit models take several times as long for a node, and
# what a coarser mesh does to them is known better, since they converge.
NODES, IMPLICIT_NODES = 13, 9
LEAST_NODES = 5
DRAPE_NODES = 19  # across a disc: eight folds take five to six cells each
SUITE_WORDS = frozenset({"candidates", "base", "damping", "resolution", "select", "case"})
NEEDED = {  # capabilities, by kind of recording
    "nodes": ("moves", frozenset({"dynamic", "effects"})),
    DRAPES.kind: ("can be cut to a disc", frozenset({"outline", "effects"})),
}
NOT_ASKED = ("metric", "report", "analysis", "choice")
OF_SCENE = ("areal_density", "air_density", "start")  # settings of the scene that the loop follows


def refuse_settings(settings: Mapping[str, Any]) -> None:
    """Refuse what can be no setting of the loop, whatever the recordings."""
    suite = settings["suite"]
    require_plugins(settings, ("model", "optimizer"))
    refuse_what_is_not_asked(settings)
    some_words("suite.select", suite.get("select"), ["*"])
    if (by := suite.get("case")) not in (None, "fabric"):
        raise ClothbenchError(f"setting 'suite.case' is {by!r}, expected fabric, or null for all in one")
    if suite.get("resolution") is not None:
        whole("resolution", suite["resolution"], LEAST_NODES)
    if settings["prior"]:
        preset(str(settings["prior"]))


def plan(settings: dict[str, Any], plugins: Catalogue, progress: FileProgress | None = None) -> list[ImproveCell]:
    """A cell for each model, with each optimizer; and for each fabric, where `suite.case` asks for that."""
    paths = where(settings, progress)
    stated = kind_of(paths[0])
    kind = stated if stated in (CURVES.kind, DRAPES.kind) else "nodes"
    recordings = [read_kind(path, kind) for path in paths]
    if kind != CURVES.kind:
        refuse_stated_weight(recordings, settings["scene"].get("areal_density"))
    cases = cases_of(recordings, settings)
    if kind == "nodes" and not settings.get("prior"):  # a class of fabrics knows its weight
        chosen = {source.path for sources in cases.values() for source in sources}
        for recording in (r for r in recordings if r.path in chosen):
            areal_density_of(recording, settings["scene"].get("areal_density"))
    return [
        cell_of(case, model, optimizer, kind, sources, settings, plugins)
        for case, sources in cases.items()
        for model in dict.fromkeys(settings["model"])
        for optimizer in dict.fromkeys(settings["optimizer"])
    ]


def refuse_what_is_not_asked(settings: Mapping[str, Any]) -> None:
    """Refuse settings that the loop would not follow."""
    for key in ("resolution", "spacing"):
        if key in settings["scene"]:
            raise ClothbenchError(
                f"setting 'scene.{key}': the loop refines its own mesh; give resolution=NODES (of a suite, "
                "suite.resolution=NODES), along the longer side, and leave it out"
            )
    rest = {key: value for key, value in settings["scene"].items() if key not in OF_SCENE}
    choice = settings["choice"] if settings["choice"] != CHOICES[0] else None  # the usual one is always there
    refuse(
        {**settings, "scene": rest, "choice": choice}, NOT_ASKED,
        "the loop compares residuals, and reports on them in its own way",
        f"of the scene the loop takes {', '.join(OF_SCENE)} from the settings, and no more",
    )  # fmt: skip


def cases_of(recordings: Sequence[Any], settings: Mapping[str, Any]) -> dict[str, list[Source]]:
    """The recordings that `suite.select` names, by the case that each question is about."""
    suite, seed = settings["suite"], settings["seed"]
    chosen = matching(recordings, some_words("suite.select", suite.get("select"), ["*"]))
    if suite.get("case") is None:  # called by their folder
        return {Path(chosen[0].path).absolute().parent.name: sources_of(chosen, seed)}
    return {
        case: sources_of([r for r in chosen if r.fabric == case], seed) for case in sorted({r.fabric for r in chosen})
    }


def cell_of(
    case: str,
    model: str,
    optimizer: str,
    kind: str,
    sources: Sequence[Source],
    settings: Mapping[str, Any],
    plugins: Catalogue,
) -> ImproveCell:
    """The cell of one model and optimizer; what is wrong with them comes to light here."""
    loaded, suite = plugins.load("models", model), settings["suite"]
    if reason := absent(loaded):
        raise ClothbenchError(f"model {model!r}: {reason}")
    require_able(kind, model, settings["options"].get(model, {}), plugins)
    prior = prior_asked(settings, kind)
    if kind == CURVES.kind:
        refuse_what_needs_a_mesh(settings)
    if settings["bounds"]:  # before anything is tracked
        effects = plugins.made("effects")[0]
        own = plugins.make("models", model, **settings["options"].get(model, {})).parameters.names
        refuse_strays(settings, [*own, *of_effects(effects)], plugins)
    cell = ImproveCell(
        recordings=tuple(resplit(list(sources), settings["seed"])), kind=kind, model=model, base=(), candidates=(),
        tracker=settings["tracker"] if kind != CURVES.kind else None, optimizer=optimizer, options=settings["options"],
        scene={} if kind == CURVES.kind else scene_of_settings(settings, loaded, kind, prior), seed=settings["seed"],
        timeout=settings["timeout"], bounds=settings["bounds"], split_by_seed=not any(s.split for s in sources),
        suite=suite.get("name") or "improve", case=case,
    )  # fmt: skip
    problem = prepare(cell, plugins, kept=Path(settings["out"]) / TRACKED)
    if textile := problem.evidence.textile:  # what its drapes cannot tell is held
        free, held = textile_of(loaded, textile)
        cell = dataclasses.replace(cell, bounds=free | dict(settings["bounds"]), fixed=held)
        problem = prepare(cell, plugins, kept=Path(settings["out"]) / TRACKED)
    if prior:
        made = plugins.make("models", model, **settings["options"].get(model, {}))
        scene = problem.evidence.cases[0].scene  # type: ignore[attr-defined]  # of the only kind that is given a prior
        known = prior_of(prior, made, scene)
        cell = dataclasses.replace(cell, bounds=known.bounds | dict(settings["bounds"]), begins=known.start)
        problem = prepare(cell, plugins, kept=Path(settings["out"]) / TRACKED)
    base = base_of(settings, problem)
    candidates = candidates_of(suite.get("candidates"), kind, base, plugins, problem.evidence.in_pictures)
    cell = dataclasses.replace(cell, base=base, candidates=candidates)
    rehearse(cell, settings, plugins)
    return dataclasses.replace(cell, versions=plugin_versions(cell.plugins, plugins))


def require_able(kind: str, model: str, options: Mapping[str, Any], plugins: Catalogue) -> None:
    """Refuse a model that can do nothing with recordings of this kind."""
    if kind == CURVES.kind:
        if not answers_curves(plugins.load("models", model)):
            able = [name for name in plugins.names("models") if answers_curves(plugins.load("models", name))]
            raise ClothbenchError(
                f"model {model!r} answers no force-extension curves, and the recordings are such; "
                f"those that do: {', '.join(able)}"
            )
        return
    what, needed = NEEDED.get(kind, NEEDED["nodes"])
    if not needed <= (able := plugins.make("models", model, **options).capabilities):
        raise ClothbenchError(
            f"model {model!r}: found the capabilities {', '.join(sorted(able))}, expected one that {what} and takes "
            f"effects ({', '.join(map(repr, sorted(needed)))})"
        )


def refuse_what_needs_a_mesh(settings: Mapping[str, Any]) -> None:
    """Refuse settings that mean nothing without a mesh."""
    suite, scene = settings["suite"], dict(settings["scene"])
    if scene.get("air_density") == AIR_DENSITY:  # the usual one is always there
        del scene["air_density"]
    given = {"resolution": suite.get("resolution"), "base": own_base(settings), **{k: scene.get(k) for k in OF_SCENE}}
    for key, value in given.items():
        if value not in (None, []):  # that there is no base is what curves have, too
            raise ClothbenchError(f"found {key}=…, which force-extension curves have no use for; leave it out")


def prior_asked(settings: Mapping[str, Any], kind: str) -> Preset | None:
    """The class of fabrics that gives bounds and start of the search, if one is asked for."""
    if not settings["prior"]:
        return None
    if kind != "nodes":
        raise ClothbenchError(
            f"setting 'prior': found recordings of kind {kind!r}, expected cloth that moves; give bounds.NAME instead"
        )
    return preset(str(settings["prior"]))


def scene_of_settings(settings: Mapping[str, Any], model: Any, kind: str, prior: Preset | None) -> dict[str, Any]:
    """How fine the mesh is, the density of air, and that of cloth where a recording does not know it: stated, or that
    of a class of fabrics.
    """
    nodes, scene = settings["suite"].get("resolution"), settings["scene"]
    if nodes is None:
        nodes = IMPLICIT_NODES if kind_of_model(model) == "implicit" else NODES
        nodes = DRAPE_NODES if kind == DRAPES.kind else nodes
    begins = {"start": scene["start"]} if "start" in scene else {}
    if begins and kind == DRAPES.kind:
        raise ClothbenchError("setting 'scene.start': drapes begin from several first shapes; leave it out")
    if begins and "moving_start" not in model.capabilities:
        raise ClothbenchError(f"model {model.name!r} starts from rest only; leave scene.start=measured out")
    density = scene.get("areal_density")
    if density is None and prior:
        density = prior.numbers["areal_density"].value
    return begins | {
        "areal_density": density, "air_density": scene.get("air_density", AIR_DENSITY),
        "resolution": whole("resolution", nodes, LEAST_NODES),
    }  # fmt: skip


def read_kind(path: Path, kind: str) -> Any:
    """A recording of the kind that all of them have to be of."""
    stated = kind_of(path)
    if stated == "points":
        raise ClothbenchError(
            f"{path}: found kind 'points', whose points nobody knows again, so that nothing says where on the cloth a "
            "model is wrong; expected kind 'nodes', or calibrate it with `clothbench run … tracker=cloud "
            "metric=chamfer`"
        )
    if stated != kind and {stated, kind} & {CURVES.kind, DRAPES.kind}:
        raise ClothbenchError(f"{path}: found kind {stated!r} among others, expected one kind in a folder")
    return read_curve(path) if kind == CURVES.kind else read_sheet(path)


def sources_of(recordings: Sequence[Any], seed: int) -> list[Source]:
    """The recordings with the splits that they state; a name stands for one recording, and at least one is to fit."""
    sources = [Source(str(r.path), r.name, r.hash, r.split) for r in recordings]
    require_own_names(sources)
    if not any(s.split == "fit" for s in resplit(sources, seed)):
        raise ClothbenchError(f"{sources[0].path}: found only held-out recordings, expected at least one to fit")
    return sources


def own_base(settings: Mapping[str, Any]) -> list[str] | None:
    """The effects that the settings say belong to the model; None if they say nothing."""
    given = settings["suite"].get("base")
    return names(given) if given is not None else list(settings["effects"]) or None


def base_of(settings: Mapping[str, Any], problem: Problem) -> tuple[str, ...]:
    """The effects that belong to the model: those that were named, or else, of a sheet that moves, damping of all
    motion alike, unless a parameter of the model has that dimension already.
    """
    if (base := own_base(settings)) is not None:
        for name in base:
            problem.plugins.find("effects", name)
        return tuple(base)
    damping = settings["suite"].get("damping")
    if damping:
        problem.plugins.find("effects", one_word("suite.damping", damping))
    if problem.evidence.kind in (CURVES.kind, DRAPES.kind) or not damping:
        return ()
    unit = problem.make("effects", damping).parameters.parameters[0].unit
    return () if any(p.unit == unit for p in problem.space(())) else (damping,)


def rehearse(cell: ImproveCell, settings: Mapping[str, Any], plugins: Catalogue) -> None:
    """Make everything once without simulating: what is wrong in options and bounds, or with a recording that is held
    out, comes to light before a run.
    """
    problem = prepare(cell, plugins, kept=Path(settings["out"]) / TRACKED)
    space = problem.space(())
    problem.trials((), "held_out")
    for first in (True, False):
        search = search_settings(problem, first)
        problem.plugins.make("optimizers", cell.optimizer, space, seed=0, budget=1, **search)
    refuse_strays(
        settings,
        [*space.names, *of_effects({name: problem.make("effects", name) for name in cell.candidates})],
        plugins,
    )


def of_effects(effects: Mapping[str, Any]) -> list[str]:
    """The names of their parameters, as bounds have them."""
    return [p.name for name, effect in effects.items() for p in effect.parameters.prefixed(name)]
